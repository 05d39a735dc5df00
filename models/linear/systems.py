"""Models as discrete-time systems of python-control, and its linear systems as operators of a chain.

The output of a system is the angle now, which is a state: in a loop around it nothing is algebraic.

    [x, theta]_{k+1} = [g(x_k, u_k), f(x_k, u_k)],   y_k = theta_k

where (f, g) is the step of the model. `control` is imported at the first call, and by no control loop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Mat, Vec

from ..contract.metadata import ModelMetadata
from ..operators.dynamics import LinearDynamics
from ..operators.operator import Operator
from ..stages import prepared

System = Any
"""A system of python-control, which has no types."""

_Run = Callable[[Vec, Vec], tuple[Vec, Vec]]
_NO_LINK = 1e-8  # relative; the rounding of a numeric linearisation
_NUDGE = 1e-4  # of the command range: beyond the step of a numeric linearisation, small against a play


class Steps(Protocol):
    """Model that can be run from any state."""

    metadata: ModelMetadata
    state_size: int

    def run_on(self, states: Vec, commands: Vec) -> tuple[Vec, Vec]:
        """Angles (N, T) over commands (N, T) from states (N, S), and the states after them."""
        ...


class LinearPart(NamedTuple):
    """Matrices of one sample, x' = A x + B u, y = C x + D u."""

    a: Mat
    b: Mat
    c: Mat
    d: Mat


def linear_part(operator: Operator, dt_s: float) -> LinearPart | None:
    """Matrices of a linear operator at a sample time [s], exact; None of any other, or of one with an offset."""
    n = len(operator.states)
    x, u = ca.SX.sym("x", n), ca.SX.sym("u")
    following, y = operator.equation(x, u, ca.DM(list(operator.values)), ca.DM(dt_s))
    step, at = ca.SX(ca.vertcat(following, y)), ca.vertcat(x, u)
    slopes = ca.jacobian(step, at)
    if ca.symvar(slopes) or np.any(np.asarray(ca.evalf(ca.substitute(step, at, ca.DM.zeros(n + 1))))):
        return None
    m = np.asarray(ca.evalf(slopes))
    return LinearPart(m[:n, :n], m[:n, n:], m[n:, :n], m[n:, n:])


def control_system(
    model: Steps, name: str, operators: Sequence[Operator] = (), drive: Sequence[Operator] = ()
) -> System:
    """Discrete-time system of a model, of a chain by its operators, behind a drive; see `LoadedModel.to_control`."""
    from control import interconnect

    facts = model.metadata
    ends = f"command_{facts.command_unit}", f"angle_{facts.angle_unit}"
    nudge = _NUDGE * (facts.command_limits.upper - facts.command_limits.lower)
    groups = _groups((*drive, *operators), facts.dt_s)
    names = [*_names(groups), *([] if operators else ["model"])]
    signals = [ends[0], *(f"{block}_out" for block in names[:-1]), ends[1]]
    if len(names) == 1:
        names = [name]
    blocks = [
        _block(group, (signals[k], signals[k + 1]), facts.dt_s, names[k], nudge, last=k + 1 == len(names))
        for k, group in enumerate(groups)
    ]
    if not operators:
        labels = [f"x{k}" for k in range(model.state_size)]
        blocks += [_nonlinear(model.run_on, labels, (signals[-2], ends[1]), facts.dt_s, names[-1], nudge, last=True)]
    if len(blocks) == 1:
        return blocks[0]
    return interconnect(blocks, inputs=[ends[0]], outputs=[ends[1]], name=name)


def reduced(system: System) -> System:
    """Linear system without the states that no input reaches, or that no output shows.

    A play that is stuck is such a state: it only shifts the output.
    """
    from control import ss

    links = np.abs(system.A) > _NO_LINK * max(1.0, float(np.abs(system.A).max(initial=0.0)))
    reached, shown = np.any(np.abs(system.B) > 0, axis=1), np.any(np.abs(system.C) > 0, axis=0)
    for _ in range(system.nstates):
        reached, shown = reached | (links @ reached), shown | (shown @ links)
    keep = np.flatnonzero(reached & shown)
    part = (system.A[np.ix_(keep, keep)], system.B[keep], system.C[:, keep], system.D)
    return ss(*part, system.dt, inputs=system.input_labels, outputs=system.output_labels, remove_useless_states=False)


def _groups(operators: Sequence[Operator], dt_s: float) -> list[list[Operator]]:
    """Operators in series: each linear one alone, those between two of them together."""
    keys = [k if linear_part(operator, dt_s) else -1 for k, operator in enumerate(operators)]
    return [[o for _, o in pairs] for _, pairs in groupby(zip(keys, operators, strict=True), key=lambda pair: pair[0])]


def _names(groups: Sequence[Sequence[Operator]]) -> list[str]:
    """Names of the blocks, each once."""
    return _each_once(["_".join(dict.fromkeys(operator.name for operator in group)) for group in groups])


def _each_once(names: Sequence[str]) -> list[str]:
    """Names with a number where one occurs several times, as that of an operator before and behind the core does."""
    return [f"{name}_{names[:k].count(name) + 1}" if names.count(name) > 1 else name for k, name in enumerate(names)]


def _block(
    group: Sequence[Operator], ends: tuple[str, str], dt_s: float, name: str, nudge: float, *, last: bool
) -> System:
    """One block: a `StateSpace` of a linear operator, else a `NonlinearIOSystem`; the last one stores the angle."""
    from control import ss

    part = linear_part(group[0], dt_s) if len(group) == 1 else None
    several = len(group) > 1
    labels = _each_once([f"{o.name}_{state}" if several else state for o in group for state in o.states])
    if part is None:
        run = prepared(group, dt_s).run
        return _nonlinear(run, labels, ends, dt_s, name, nudge, last=last)
    if last:
        n = len(labels)
        a = np.block([[part.a, np.zeros((n, 1))], [part.c, np.zeros((1, 1))]])
        part = LinearPart(a, np.vstack([part.b, part.d]), np.append(np.zeros(n), 1.0)[None], np.zeros((1, 1)))
        labels = [*labels, ends[1]]
    return ss(*part, dt_s, inputs=[ends[0]], outputs=[ends[1]], states=labels, name=name, remove_useless_states=False)


def _nonlinear(
    run: _Run, labels: Sequence[str], ends: tuple[str, str], dt_s: float, name: str, nudge: float, *, last: bool
) -> System:
    from control import nlsys

    def step(x: Vec, u: Vec, params: Mapping[str, float]) -> tuple[float, Vec]:
        commanded = np.atleast_1d(u)[0] + nudge * params.get("branch", 0.0)
        angles, following = run(np.atleast_1d(x)[None, : len(labels)], np.array([[commanded]]))
        return float(angles[0, 0]), following[0]

    def update(t: float, x: Vec, u: Vec, params: Mapping[str, float]) -> Vec:
        del t
        angle, following = step(x, u, params)
        return np.append(following, angle) if last else following

    def output(t: float, x: Vec, u: Vec, params: Mapping[str, float]) -> Vec:
        del t
        return x[-1:] if last else np.array([step(x, u, params)[0]])

    states = [*labels, ends[1]] if last else list(labels)
    shown = {"inputs": [ends[0]], "outputs": [ends[1]], "states": states}
    return nlsys(update, output, dt=dt_s, name=name, params={"branch": 0.0}, **shown)


_UNIT_GAIN = 1e-9


def from_control(system: System, dt_s: float) -> LinearDynamics:
    """Linear system of python-control as an operator: a drive before the hysteresis, or dynamics behind it.

    A continuous system gets the input of a sample from that sample's begin on (zero-order hold), and its output counts
    at the sample's end, as for a `Lag`. A discrete one is taken sample by sample as it is.

    Args:
        system: `StateSpace` or `TransferFunction`, one input, one output, stable, static gain 1.
        dt_s: sample time of the chain [s].

    Raises:
        ModelError: if it is no such system, or of another sample time.
    """
    from control import sample_system, ss, tf

    try:
        given: System = ss(system)
    except Exception as error:  # noqa: BLE001 - python-control raises many kinds on what is no linear system
        raise ModelError(f"from_control: got {type(system).__name__}, expected a linear system: {error}") from None
    if not given.issiso() or not (given.isctime() or given.dt in (True, dt_s)):
        raise ModelError(
            f"from_control: got {given.ninputs} inputs, {given.noutputs} outputs, sample time {given.dt}, "
            f"expected one of each, continuous or at {dt_s:.6g} s"
        )
    poles, continuous = given.poles(), given.isctime(strict=True)
    if np.any(poles.real >= 0) if continuous else np.any(np.abs(poles) >= 1):
        raise ModelError(f"from_control: got poles at {np.round(poles, 6).tolist()}, expected stable ones")
    gain = float(np.real(given.dcgain()))
    if abs(gain - 1.0) > _UNIT_GAIN:
        raise ModelError(f"from_control: got a static gain of {gain:.9g}, expected 1: the gain is the model's")
    if continuous:
        held: System = sample_system(given, dt_s, method="zoh")
        given = ss(held.A, held.B, given.C @ held.A, given.C @ held.B + given.D, dt_s)
    fraction: System = tf(given)
    numerator, denominator = np.asarray(fraction.num[0][0]), np.asarray(fraction.den[0][0])
    numerator = np.concatenate([np.zeros(denominator.size - numerator.size), numerator]) / denominator[0]
    return LinearDynamics(tuple(denominator[1:] / denominator[0]), tuple(numerator))
