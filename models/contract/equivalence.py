"""Numeric equivalence check of an export: reference, onnxruntime and CasADi agree, Jacobians included."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hystmpc.trials.brief import brief
from hystmpc.trials.errors import ExportError
from hystmpc.trials.types import Vec

from ..decades import Decades
from ..model import StepFunction
from .load import OnnxModel
from .metadata import ModelMetadata

STEPS = 1000
BATCH = 8
TOLERANCE_DEG = 1e-3  # of a catheter of tens of degrees; of another device in its working units, see `Decades`
_DRAWS = 25  # batches of random states
_JACOBIANS = 50
_SPREAD = 0.1  # of random states around those visited, in standard deviations of each entry
# A play in contact rests on a kink, where rounding may choose the branch. A point counts as a kink if the reference's
# own Jacobian jumps within this relative distance; the loose tolerance covers what curvature does over the distance.
_NUDGE, _NUDGES, _LOOSE = 1e-5, 16, 1e-3
_JACOBIAN_TOLERANCE = {"float32": (1e-3, 1e-4), "float64": (1e-9, 1e-9)}  # relative, absolute

Step = Callable[[Vec, Vec], tuple[Vec, Vec]]
Output = tuple[float, str]
"""Units of theta in one working unit, and their name."""


@dataclass(frozen=True)
class EquivalenceReport:
    """Largest differences from the reference that the check has seen.

    Attributes:
        steps: free-running samples from the initial state.
        batches: batch sizes of the steps from random states.
        runtime_deg, casadi_deg: of theta, onnxruntime and CasADi, free-running and from random states [deg].
        runtime_state, casadi_state: of the next state, |difference| / (1 + |reference|).
        jacobian: of d(theta, next state) / d(state, u), CasADi, absolute.
        jacobian_points: visited states at which Jacobians were compared.
        kinks: points left out because the reference's own Jacobian jumps there and CasADi takes the other branch.
    """

    steps: int
    batches: tuple[int, ...]
    runtime_deg: float
    casadi_deg: float
    runtime_state: float
    casadi_state: float
    jacobian: float
    jacobian_points: int
    kinks: int
    __repr__ = brief


def check_equivalence(reference: StepFunction, model: OnnxModel, probe: Vec) -> EquivalenceReport:
    """Compare the three implementations; outputs and their derivatives in working units (`Decades`).

    Single steps from random states drawn around those visited in batches of 1 and 8, then a free run of 1,000 samples
    by the probe (repeated or cut) from the initial state, then Jacobians at visited states. A free run that differs
    although every single step agrees has a second number: how far the reference leaves its own run.

    Raises:
        ExportError: on the first disagreement; names implementation, worst step and numbers.
    """
    function = model.casadi_function()
    commands = np.resize(probe, STEPS)
    units = _working_units(model.metadata)
    out = (units[1], model.metadata.angle_unit)
    angle = model.metadata.trained_angle  # the run starts at the angle of this range that is nearest to zero
    start = model.metadata.initial.state(np.clip([[0.0]], angle.lower, angle.upper))
    expected = _free_run(reference.advance, start, commands)
    visited = np.vstack([start, expected[:-1, 1:]])
    rng = np.random.default_rng(0)
    worst = {}
    for name, step in (("onnxruntime", model.advance), ("CasADi", _casadi_step(function))):
        single = _single_steps(reference, step, visited, commands, out, rng, name)
        try:
            free = _compare(expected, _free_run(step, start, commands), out, f"{name} on its own, sample")
        except ExportError as error:
            reason = _amplification(reference, start, commands, expected, single[1], out)
            raise ExportError(f"{error}; {reason}") from None
        worst[name] = np.maximum(single, free)
    jacobian, kinks = _compare_jacobians(reference, function, visited, commands, _precision(model), units)
    return EquivalenceReport(
        steps=STEPS,
        batches=(1, BATCH),
        runtime_deg=float(worst["onnxruntime"][0]),
        casadi_deg=float(worst["CasADi"][0]),
        runtime_state=float(worst["onnxruntime"][1]),
        casadi_state=float(worst["CasADi"][1]),
        jacobian=jacobian,
        jacobian_points=_JACOBIANS,
        kinks=kinks,
    )


def _working_units(facts: ModelMetadata) -> tuple[float, float]:
    """Units of the model in one working unit of its input, and of its output."""
    ranges = (facts.trained_command, facts.trained_angle)[:: -1 if facts.inverted else 1]
    decades = Decades.of_ranges(*ranges)
    return (decades.angle, decades.command) if facts.inverted else (decades.command, decades.angle)


def _precision(model: OnnxModel) -> str:
    """The least precise number type within: a network in single may be connected with operators in double."""
    kinds = {weight.dtype.name for weight in model.initializers.values()} | {model.dtype.name}
    return "float32" if "float32" in kinds else "float64"


def _casadi_step(function: ca.Function) -> Step:
    """The CasADi function in batched form."""

    def step(state: Vec, u: Vec) -> tuple[Vec, Vec]:
        theta, following = function(state.T, u.T)
        return np.array(theta).T, np.array(following).T

    return step


def _free_run(step: Step, state: Vec, commands: Vec) -> Vec:
    """Angle and next state of every sample, (T, 1 + S)."""
    rows = []
    for u in commands:
        theta, state = step(state, np.array([[u]]))
        rows.append(np.concatenate([theta, state], axis=1))
    return np.concatenate(rows)


def _amplification(reference: StepFunction, start: Vec, commands: Vec, expected: Vec, step: float, out: Output) -> str:
    """Tell a step that is wrong from a model that is sensitive: run the reference again, its start moved by `step`.

    `step` is the largest relative difference of the next state that single steps had.
    """
    moved = _free_run(reference.advance, start + step * (1 + np.abs(start)), commands)
    own = float(np.abs(moved - expected)[:, 0].max())
    what = f"and the reference moved by this much by {own:.3g} {out[1]}"
    if own > TOLERANCE_DEG * out[0]:
        what += ": the model itself is sensitive, fit it with another seed or fewer units"
    return f"single steps agree to {step:.1e} {what}"


def _single_steps(
    reference: StepFunction, step: Step, visited: Vec, commands: Vec, out: Output, rng: np.random.Generator, name: str
) -> Vec:
    """Compare one step from random states: each batch of 8 whole, and its rows one by one."""
    worst = np.zeros(2)
    spread = _SPREAD * visited.std(axis=0)
    for draw in range(_DRAWS):
        states = rng.choice(visited, BATCH) + spread * rng.standard_normal((BATCH, visited.shape[1]))
        u = rng.uniform(commands.min(), commands.max(), (BATCH, 1))
        expected = np.hstack(reference.advance(states, u))
        whole = np.hstack(step(states, u))
        single = np.vstack([np.hstack(step(states[k : k + 1], u[k : k + 1])) for k in range(BATCH)])
        for batch, got in ((BATCH, whole), (1, single)):
            worst = np.maximum(worst, _compare(expected, got, out, f"{name} in batches of {batch}, draw {draw}, row"))
    return worst


def _compare(expected: Vec, got: Vec, out: Output, what: str) -> Vec:
    """Largest difference of theta [deg] and of the state (relative); `out`: see `Output`.

    Raises:
        ExportError: if either is beyond the tolerance; a value that is not finite is.
    """
    unit, name = out
    scale = np.ones_like(expected)
    scale[:, 0] = unit
    scale[:, 1:] += np.abs(expected[:, 1:])
    difference = np.abs(got - expected) / scale
    if not np.all(difference <= TOLERANCE_DEG):
        row, column = np.unravel_index(np.argmax(difference), difference.shape)
        entry, allowed = (
            (f"theta [{name}]", TOLERANCE_DEG * unit) if column == 0 else (f"next_state[{column - 1}]", TOLERANCE_DEG)
        )
        raise ExportError(
            f"{what} {row}: {entry} is {got[row, column]:.9g}, expected {expected[row, column]:.9g} of the reference "
            f"within {allowed:g}"
        )
    return np.array([unit * difference[:, 0].max(), difference[:, 1:].max(initial=0.0)])


def _compare_jacobians(
    reference: StepFunction,
    function: ca.Function,
    visited: Vec,
    commands: Vec,
    dtype: str,
    units: tuple[float, float],
) -> tuple[float, int]:
    """Largest difference of the Jacobians, and the number of kinks among the points.

    Raises:
        ExportError: on a difference beyond the tolerance, or if more than half of the points are kinks.
    """
    jacobian = _jacobian_of(function)
    relative, absolute = _JACOBIAN_TOLERANCE[dtype]
    worst, kinks = 0.0, 0
    for k in np.linspace(0, len(commands) - 1, _JACOBIANS).astype(int):
        state, u = visited[k : k + 1], float(commands[k])
        expected, got = reference.jacobian(state[0], u), jacobian(state[0], u)
        if got.shape != expected.shape:
            raise ExportError(f"the reference's Jacobian has shape {expected.shape}, expected {got.shape}")
        size = np.ones_like(expected)
        size[0], size[:, -1] = size[0] / units[1], size[:, -1] * units[0]
        excess = size * (np.abs(got - expected) - relative * np.abs(expected)) - absolute
        if np.all(excess <= 0):
            worst = max(worst, float(np.abs(got - expected).max()))
        elif _at_kink(reference, state[0], u, got):
            kinks += 1
        else:
            i, j = np.unravel_index(np.argmax(excess), excess.shape)
            raise ExportError(
                f"CasADi Jacobian at sample {k}: entry [{i}, {j}] is {got[i, j]:.9g}, the reference gives "
                f"{expected[i, j]:.9g}, expected within {absolute:g} + {relative:g} relative"
            )
    if kinks > _JACOBIANS // 2:
        raise ExportError(
            f"{kinks} of {_JACOBIANS} Jacobians differ from the reference on kinks, expected at most half: "
            "the probe rests too long, or the graph takes the other branch at a tie"
        )
    return worst, kinks


def _at_kink(reference: StepFunction, state: Vec, u: float, got: Vec) -> bool:
    """Whether the reference's Jacobian jumps beside the point and `got` is within the jump."""
    rng = np.random.default_rng(0)
    point = np.append(state, u)
    reach = _NUDGE * (1.0 + np.abs(point))
    sides = rng.choice([-1.0, 1.0], (_NUDGES, point.size))
    sides = np.vstack([np.eye(point.size)[-1], -np.eye(point.size)[-1], sides])
    beside = [reference.jacobian(p[:-1], float(p[-1])) for p in point + reach * sides]
    lower, upper = np.min(beside, axis=0), np.max(beside, axis=0)
    slack = _LOOSE * (1.0 + np.abs(got))
    jumps = np.any(upper - lower > slack)
    return bool(jumps and np.all((lower - slack <= got) & (got <= upper + slack)))


def _jacobian_of(function: ca.Function) -> Callable[[Vec, float], Vec]:
    """Derivative of (theta, next state) by (state, u), (1 + S, S + 1)."""
    size = function.size1_in("state")
    point = ca.MX.sym("point", size + 1)
    outputs = ca.vertcat(*function(point[:size], point[size]))
    derivative = ca.Function("derivative", [point], [ca.jacobian(outputs, point)])
    return lambda state, u: np.array(derivative(np.append(state, u)))
