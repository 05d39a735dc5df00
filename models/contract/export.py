"""Export of a model: numeric check against its reference, and a file that is written whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from hystmpc.trials.brief import brief
from hystmpc.trials.errors import ExportError, ModelError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Vec

from ..decades import Decades
from ..model import StepFunction
from .metadata import ModelMetadata

if TYPE_CHECKING:
    import onnx

    from .load import OnnxModel


@dataclass(frozen=True)
class ExportBundle:
    """One model ready for export.

    Attributes:
        graph: inputs u [N,1] and state [N,S], outputs theta [N,1] and next_state [N,S], batch axis N symbolic, all four
            float32 or all four double, operators from the list; or a function that makes it.
        reference: the implementation that the graph has to agree with.
        probe: commands (T,) [command unit], T >= 2, a persistent excitation inside the trained range.

    Raises:
        ExportError: if the parts do not fit each other.
    """

    graph: onnx.GraphProto | Callable[[], onnx.GraphProto]
    metadata: ModelMetadata
    reference: StepFunction
    probe: Vec

    def __post_init__(self) -> None:
        probe = np.array(self.probe, dtype=np.float64)
        probe.setflags(write=False)
        object.__setattr__(self, "probe", probe)
        trained = self.metadata.trained_command
        if probe.ndim != 1 or probe.size < 2:
            raise ExportError(f"probe has shape {probe.shape}, expected (T,) with T >= 2")
        outside = np.flatnonzero(~trained.contains(probe))
        if outside.size:
            k = int(outside[0])
            raise ExportError(
                f"probe is {probe[k]:.6g} {self.metadata.command_unit} at sample {k}, "
                f"expected the trained range {trained.lower:.6g} to {trained.upper:.6g}"
            )
        if self.reference.state_size != self.metadata.state_size:
            raise ExportError(
                f"reference has {self.reference.state_size} state entries, metadata {self.metadata.state_size}, "
                "expected as many"
            )


def export_onnx(bundle: ExportBundle, path: Path | str) -> EquivalenceReport:
    """Compare a model with its reference and write it as an ONNX file.

    The file is loaded in memory as a user would load it, then checked by `check_equivalence`: 1,000 free-running steps,
    random states in batches of 1 and 8, onnxruntime and CasADi within 1e-3 deg of the reference, and Jacobians.

    Returns:
        The largest differences.

    Raises:
        ExportError: if the graph breaks the contract or differs from the reference, or the file cannot be written; an
            earlier file at `path` is left unchanged.
    """
    from .load import OnnxModel  # onnxruntime is not loaded for a model that stays in memory

    try:
        content = model_bytes(bundle)
        report = check_equivalence(bundle.reference, OnnxModel(content, str(path)), bundle.probe)
    except ModelError as error:
        raise ExportError(f"{error}; nothing was written") from None
    except ExportError as error:
        raise ExportError(f"{path}: {error}; nothing was written") from None
    write_model(path, content)
    return report


def write_model(path: Path | str, content: bytes) -> None:
    """Write a model file, whole or not at all.

    Raises:
        ExportError: if it cannot be written.
    """
    try:
        write_atomically(path, content)
    except OSError as error:
        raise ExportError(f"{path}: cannot be written ({error.strerror})") from None


def model_bytes(bundle: ExportBundle) -> bytes:
    """Content of the model file of a bundle."""
    return graph_bytes(bundle.graph() if callable(bundle.graph) else bundle.graph, bundle.metadata)


def graph_bytes(graph: onnx.GraphProto, facts: ModelMetadata) -> bytes:
    """Content of the model file of a graph with its metadata."""
    return with_properties(graph, facts.to_properties())


def with_properties(graph: onnx.GraphProto, properties: Mapping[str, str]) -> bytes:
    """Content of the model file of a graph with these entries of `metadata_props`."""
    import onnx.helper

    from .load import IR_VERSION, OPSET

    proto = onnx.helper.make_model(
        graph,
        producer_name="hystmpc",
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    onnx.helper.set_model_props(proto, dict(properties))
    return proto.SerializeToString(deterministic=True)


STEPS = 1000
BATCH = 8
TOLERANCE_DEG = 1e-3  # for a catheter of tens of degrees; other devices in working units, see `Decades`
_DRAWS = 25  # batches of random states
_JACOBIANS = 50
_SPREAD = 0.1  # spread of random states around visited ones, in standard deviations of each entry
# A play in contact rests on a kink, where rounding may choose the branch. A point counts as a kink if the reference's
# own Jacobian jumps within this relative distance; the loose tolerance covers the curvature over the distance.
_NUDGE, _NUDGES, _LOOSE = 1e-5, 16, 1e-3
_JACOBIAN_TOLERANCE = {"float32": (1e-3, 1e-4), "float64": (1e-9, 1e-9)}  # relative, absolute

Step = Callable[[Vec, Vec], tuple[Vec, Vec]]
Output = tuple[float, str, int]
"""Units of theta in one working unit, their name, and the number of outputs."""


@dataclass(frozen=True, eq=False)
class ExportedStep:
    """Step graph that is compared with its reference; of several axes with as many commands and angles as it has.

    Attributes:
        advance: in onnxruntime.
        function: in CasADi.
        start: state (1, S) of the free run.
        command_unit, angle_unit: log units in one working unit, see `Decades`.
        unit_name: of the angle.
        precision: float32 or float64, the least precise number type in the graph.
    """

    advance: Step
    function: ca.Function
    start: Vec
    command_unit: float
    angle_unit: float
    unit_name: str
    precision: str


@dataclass(frozen=True)
class EquivalenceReport:
    """Largest differences from the reference in the equivalence check.

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
    """Compare the reference with the graph in onnxruntime and in CasADi, in working units (`Decades`).

    Single steps from random states drawn around those visited in batches of 1 and 8, then a free run of 1,000 samples
    by the probe (repeated or cut) from the initial state, then Jacobians at visited states. The message on a free run
    that differs includes the sensitivity of the reference to its initial state.

    Raises:
        ExportError: on the first disagreement; names implementation, worst step and numbers.
    """
    angle = model.metadata.trained_angle  # the run starts at the angle of this range that is nearest to zero
    start = model.metadata.initial.state(np.clip([[0.0]], angle.lower, angle.upper))
    units, name = _working_units(model.metadata), model.metadata.angle_unit
    step = ExportedStep(model.advance, model.casadi_function(), start, *units, name, _precision(model))
    return compare_steps(reference, step, np.resize(probe, STEPS)[:, None])


def compare_steps(reference: StepFunction, step: ExportedStep, commands: Vec) -> EquivalenceReport:
    """Compare a step with its reference over commands (T, nu), as `check_equivalence` says.

    Raises:
        ExportError: on the first disagreement.
    """
    function, start = step.function, step.start
    out = (step.angle_unit, step.unit_name, function.numel_out(0))
    expected = _free_run(reference.advance, start, commands)
    visited = np.vstack([start, expected[:-1, out[2] :]])
    rng = np.random.default_rng(0)
    worst = {}
    for name, run in (("onnxruntime", step.advance), ("CasADi", _casadi_step(function))):
        single = _single_steps(reference, run, visited, commands, out, rng, name)
        try:
            free = _compare(expected, _free_run(run, start, commands), out, f"{name} on its own, sample")
        except ExportError as error:
            reason = _amplification(reference, start, commands, expected, single[1], out)
            raise ExportError(f"{error}; {reason}") from None
        worst[name] = np.maximum(single, free)
    jacobian, kinks = _compare_jacobians(reference, step, visited, commands)
    return EquivalenceReport(
        steps=len(commands),
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
    """Log units in one working unit of the model's input, and of its output."""
    ranges = (facts.trained_command, facts.trained_angle)[:: -1 if facts.inverted else 1]
    decades = Decades.of_ranges(*ranges)
    return (decades.angle, decades.command) if facts.inverted else (decades.command, decades.angle)


def _precision(model: OnnxModel) -> str:
    """Least precise number type in the graph; a network in single may be connected with operators in double."""
    kinds = {weight.dtype.name for weight in model.initializers.values()} | {model.dtype.name}
    return "float32" if "float32" in kinds else "float64"


def _casadi_step(function: ca.Function) -> Step:
    def step(state: Vec, u: Vec) -> tuple[Vec, Vec]:
        theta, following = function(state.T, u.T)
        return np.array(theta).T, np.array(following).T

    return step


def _free_run(step: Step, state: Vec, commands: Vec) -> Vec:
    """Angles (ny) and next state of every sample over commands (T, nu), (T, ny + S)."""
    rows = []
    for u in commands:
        theta, state = step(state, u[None])
        rows.append(np.concatenate([theta, state], axis=1))
    return np.concatenate(rows)


def _amplification(reference: StepFunction, start: Vec, commands: Vec, expected: Vec, step: float, out: Output) -> str:
    """Sensitivity of the reference's free run to a change `step` of its initial state."""
    moved = _free_run(reference.advance, start + step * (1 + np.abs(start)), commands)
    spread = float(np.abs(moved - expected)[:, : out[2]].max())
    what = f"and the reference moved by this much by {spread:.3g} {out[1]}"
    if spread > TOLERANCE_DEG * out[0]:
        what += ": the model itself is sensitive, fit it with another seed or fewer units"
    return f"single steps agree to {step:.1e} {what}"


def _single_steps(
    reference: StepFunction, step: Step, visited: Vec, commands: Vec, out: Output, rng: np.random.Generator, name: str
) -> Vec:
    """Compare single steps from random states, in batches of 8 and row by row."""
    worst = np.zeros(2)
    spread = _SPREAD * visited.std(axis=0)
    for draw in range(_DRAWS):
        states = rng.choice(visited, BATCH) + spread * rng.standard_normal((BATCH, visited.shape[1]))
        u = rng.uniform(commands.min(axis=0), commands.max(axis=0), (BATCH, commands.shape[1]))
        expected = np.hstack(reference.advance(states, u))
        whole = np.hstack(step(states, u))
        single = np.vstack([np.hstack(step(states[k : k + 1], u[k : k + 1])) for k in range(BATCH)])
        for batch, got in ((BATCH, whole), (1, single)):
            worst = np.maximum(worst, _compare(expected, got, out, f"{name} in batches of {batch}, draw {draw}, row"))
    return worst


def _compare(expected: Vec, got: Vec, out: Output, what: str) -> Vec:
    """Largest difference of theta [deg] and of the state (relative); raises an error beyond the tolerance."""
    unit, name, angles = out
    scale = np.ones_like(expected)
    scale[:, :angles] = unit
    scale[:, angles:] += np.abs(expected[:, angles:])
    difference = np.abs(got - expected) / scale
    if not np.all(difference <= TOLERANCE_DEG):
        row, column = np.unravel_index(np.argmax(difference), difference.shape)
        entry, allowed = (
            (f"theta [{name}]", TOLERANCE_DEG * unit)
            if column < angles
            else (f"next_state[{column - angles}]", TOLERANCE_DEG)
        )
        raise ExportError(
            f"{what} {row}: {entry} is {got[row, column]:.9g}, expected {expected[row, column]:.9g} of the reference "
            f"within {allowed:g}"
        )
    return np.array([unit * difference[:, :angles].max(), difference[:, angles:].max(initial=0.0)])


def _compare_jacobians(reference: StepFunction, step: ExportedStep, visited: Vec, commands: Vec) -> tuple[float, int]:
    """Largest difference of the Jacobians and number of kinks; too many kinks are an error, too."""
    jacobian, outputs = _jacobian_of(step.function), step.function.numel_out(0)
    relative, absolute = _JACOBIAN_TOLERANCE[step.precision]
    worst, kinks = 0.0, 0
    for k in np.linspace(0, len(commands) - 1, _JACOBIANS).astype(int):
        state, u = visited[k : k + 1], commands[k]
        expected, got = reference.jacobian(state[0], _alone(u)), jacobian(state[0], u)
        if got.shape != expected.shape:
            raise ExportError(f"the reference's Jacobian has shape {expected.shape}, expected {got.shape}")
        size = np.ones_like(expected)
        size[:outputs] /= step.angle_unit
        size[:, -u.size :] *= step.command_unit
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


def _alone(commands: Vec) -> Any:
    """The one command as a number, or several as an array."""
    return float(commands[0]) if commands.size == 1 else commands


def _at_kink(reference: StepFunction, state: Vec, u: Vec, got: Vec) -> bool:
    """Whether the reference's Jacobian jumps near the point and `got` lies within the jump."""
    rng = np.random.default_rng(0)
    point, count = np.append(state, u), u.size
    reach = _NUDGE * (1.0 + np.abs(point))
    sides = rng.choice([-1.0, 1.0], (_NUDGES, point.size))
    ahead = np.eye(point.size)[-count:]
    near = [
        reference.jacobian(p[:-count], _alone(p[-count:])) for p in point + reach * np.vstack([ahead, -ahead, sides])
    ]
    lower, upper = np.min(near, axis=0), np.max(near, axis=0)
    slack = _LOOSE * (1.0 + np.abs(got))
    jumps = np.any(upper - lower > slack)
    return bool(jumps and np.all((lower - slack <= got) & (got <= upper + slack)))


def _jacobian_of(function: ca.Function) -> Callable[[Vec, Vec], Vec]:
    """Derivative of (theta, next state) by (state, u), (ny + S, S + nu)."""
    size = function.size1_in("state")
    point = ca.MX.sym("point", size + function.size1_in("u"))
    outputs = ca.vertcat(*function(point[:size], point[size:]))
    derivative = ca.Function("derivative", [point], [ca.jacobian(outputs, point)])
    return lambda state, u: np.array(derivative(np.append(state, u)))
