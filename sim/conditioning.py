"""The rest from which a simulated device starts: before or after its initialisation flexure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.kernels.chain_kernels import compile_step
from hystmpc.models.motions import initialisation_flexure
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.simulator import Simulator
from hystmpc.trials.types import Vec

_SETTLED = 20.0  # time constants after which nothing is left of a step: e^-20 of 100 deg is 2e-7 deg
_LONGEST_REST_S = 600.0  # slower creep has not settled when an experiment begins


def conditioned(simulator: Simulator, state: Vec, commands: Range) -> tuple[float, Vec]:
    """Angle [deg] and state at the lowest command after the initialisation flexure and a rest.

    The rest lasts until lags have settled, and creep within ten minutes. What follows a clock stands still meanwhile:
    the clock starts with the run.

    Args:
        simulator: the device with its effects.
        state: at rest at the lowest command.
        commands: between which it is flexed.
    """
    flexure = initialisation_flexure(commands, simulator.dt_s, warmup_samples=1)
    samples = round(settling_s(simulator.chain) / simulator.dt_s)
    return _run(simulator, state, np.concatenate([flexure, np.full(samples, commands.lower)]))


def fresh(simulator: Simulator, state: Vec, commands: Range) -> tuple[float, Vec]:
    """Angle [deg] and state at the lowest command of a device that was never bent; arguments as `conditioned`."""
    return _run(simulator, state, np.full(1, commands.lower))


def _run(simulator: Simulator, state: Vec, commands: Vec) -> tuple[float, Vec]:
    """The last angle, and the state with its clocks at zero."""
    chain = simulator.chain
    kernels = compile_step(chain.transition)
    following, theta = state.reshape(1, -1).copy(), np.empty((1, commands.size))
    dt = np.array([simulator.dt_s])
    kernels.simulate(following, commands[None], still(chain), dt, kernels.step_constants, theta)
    return float(theta[0, -1]), np.where(clocks(chain), 0.0, following[0])


def settling_s(chain: Chain) -> float:
    """Time after which a held command leaves the chain at rest [s]."""
    return sum(_settling_of(operator) for operator in chain.operators)


def _settling_of(operator: Operator) -> float:
    if isinstance(operator, Lag):
        return _SETTLED * max(operator.tau_s, *operator.tau_down_s, 0.0)
    if isinstance(operator, Creep):
        return min(_SETTLED * max(operator.taus_s), _LONGEST_REST_S)
    return operator.delay_s if isinstance(operator, Delay) else 0.0


def still(chain: Chain) -> Vec:
    """Parameter values of the chain with everything that follows a clock at its neutral values."""
    values: list[float] = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        values += effect.neutral_values(operator) if effect is not None and effect.clocks else operator.values
    return np.array(values)


def clocks(chain: Chain) -> NDArray[np.bool_]:
    """Which entries of the state are clocks."""
    found = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        found += [effect is not None and name in effect.clocks for name in operator.states]
    return np.array(found, dtype=bool)
