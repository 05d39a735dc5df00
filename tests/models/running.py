"""Running one operator over a signal, by the engine."""

from __future__ import annotations

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.operators.operator import Operator
from hystmpc.models.stages import prepared

from .zoo import DT


def run_operator(operator: Operator, u: np.ndarray, seen: float = 0.0, dt: float = DT) -> np.ndarray:
    """Output over `u`, from rest at the first input with the output seen at `seen`."""
    state = np.array(operator_rest(operator, float(u[0]), seen)).reshape(1, -1)
    return prepared([operator], dt).run(state, u[None])[0][0]


def operator_rest(operator: Operator, u: float, seen: float) -> np.ndarray:
    """State at rest, as numbers."""
    import casadi as ca

    p = ca.DM(list(operator.values))
    return np.asarray(ca.DM(operator.at_rest(ca.DM(u), ca.DM(seen), p)))


def run_chain(chain: Chain, u: np.ndarray, seen: float = 0.0, dt: float = DT) -> np.ndarray:
    """Output of a chain over `u` from rest at the first input, by CasADi alone."""
    import casadi as ca

    x, command = ca.SX.sym("x", chain.state_size), ca.SX.sym("u")
    theta, following = chain.bound(dt)(x, command)
    step = ca.Function("step", [x, command], [following, theta])
    rest = chain.rest(seen, float(u[0]), chain.values)
    return np.asarray(step.mapaccum(u.size)(rest, u[None])[1]).ravel()
