"""Model of two axes as one ONNX step: all commands and the whole state in, both angles and the next state out."""

from __future__ import annotations

import json
from functools import cached_property
from pathlib import Path
from typing import Any, final

import casadi as ca
import numpy as np

from hystmpc.trials.errors import ExportError, ModelError
from hystmpc.trials.types import Vec

from ..contract.export import STEPS, EquivalenceReport, ExportedStep, compare_steps, with_properties, write_model
from ..contract.metadata import PREFIX, TWO_AXES_FORMAT
from ..decades import Decades
from ..model import StepFunction
from ..motions import probe_commands
from ..program import dense
from ..stages import prepared
from .model import AXES, TwoAxisModel

_SHIFT = 17  # samples by which the commands of the check follow each other


@final
class TwoAxisStep(StepFunction):
    """Step of a model of two axes with explicit state: those of both axes, then that of the friction that both share.

    Args:
        model: without measured inputs.

    Raises:
        ModelError: if an axis depends on a measured input.
    """

    def __init__(self, model: TwoAxisModel) -> None:
        if names := ", ".join(one.name for axis in model.axes for one in axis.chain.inputs):
            raise ModelError(f"two axes: the model depends on {names}, supported are models without measured inputs")
        self.model, rest = model, np.array(model.rest_commands)
        self._runs = [prepared(axis.chain.operators, axis.dt_s) for axis in model.axes]
        shared = model.cross_friction
        states = np.empty(0) if shared is None else shared.at_rest(model.travels(rest), model.dt_s)
        self.sizes = (*(axis.chain.state_size for axis in model.axes), states.size)
        self.state_size = sum(self.sizes)

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        """Angles (N, 2) [deg] and next states (N, S) from states (N, S) and commands (N, n), by the engine."""
        travels, model, parts = self.model.travels(u), self.model, self._parts(state)
        made = [
            run.run(np.ascontiguousarray(part), np.ascontiguousarray(travels[:, i : i + 1]))
            for i, (run, part) in enumerate(zip(self._runs, parts, strict=False))
        ]
        y, shared = np.hstack([angle for angle, _ in made]), parts[AXES]
        if model.cross_friction is not None:
            moved = [
                model.cross_friction.advance(np.ascontiguousarray(one), w[None], model.dt_s)
                for one, w in zip(shared, travels, strict=True)
            ]
            y, shared = y + np.vstack([c for c, _ in moved]), np.vstack([after for _, after in moved])
        return y @ model.turn.T, np.hstack([*(after for _, after in made), shared])

    def at_rest(self, angles_deg: Vec, commands: Vec) -> Vec:
        """State (S,) at rest at angles (2,) [deg] under commands (n,), as `TwoAxisModel.run` starts."""
        from ..simulator import ChainModel

        model, w = self.model, self.model.travels(commands)
        shared = np.empty(0) if model.cross_friction is None else model.cross_friction.at_rest(w, model.dt_s)
        y = model.in_axes(angles_deg) - self._shown(w)
        axes = (ChainModel(axis).at_rest(float(y[i]), float(w[i])) for i, axis in enumerate(model.axes))
        return np.concatenate([*axes, shared])

    def jacobian(self, state: Vec, u: Any) -> Vec:
        """Derivative of (angles, next state) by (state, commands), (2 + S, S + n)."""
        return np.asarray(self._derivative(state, u))

    @cached_property
    def function(self) -> ca.Function:
        """Step in CasADi: (state (S, 1), u (n, 1)) -> (theta (2, 1), next state (S, 1))."""
        model, x, u = self.model, ca.SX.sym("x", self.state_size), ca.SX.sym("u", len(self.model.command_limits))
        ends = np.cumsum(self.sizes)
        w = ca.DM(model.matrix) @ u
        parts = x[: ends[0]], x[ends[0] : ends[1]]
        steps = [axis.chain.bound(axis.dt_s) for axis in model.axes]
        made = [step(part, w[i]) for i, (step, part) in enumerate(zip(steps, parts, strict=True))]
        y, after = ca.vertcat(*(angle for angle, _ in made)), [following for _, following in made]
        if model.cross_friction is not None:
            c, following = _shared_step(model, x[ends[1] :], w)
            y, after = y + c, [*after, following]
        return dense("model", [x, u], [ca.DM(model.turn) @ y, ca.vertcat(*after)])

    @cached_property
    def _derivative(self) -> ca.Function:
        x, u = ca.SX.sym("x", self.state_size), ca.SX.sym("u", len(self.model.command_limits))
        return dense("jacobian", [x, u], [ca.jacobian(ca.vertcat(*self.function(x, u)), ca.vertcat(x, u))])

    def _parts(self, state: Vec) -> list[Vec]:
        """States (N, .) of both axes, and of what they share."""
        return np.split(state, np.cumsum(self.sizes)[:-1], axis=1)

    def _shown(self, travels: Vec) -> Vec:
        """What both axes share of the angles y (2,) at rest at travels (2,) [deg]."""
        shared = self.model.cross_friction
        return np.zeros(AXES) if shared is None else shared.run(travels[None], self.model.dt_s)[0]


def _shared_step(model: TwoAxisModel, x: Any, w: Any) -> tuple[Any, Any]:
    """c (2) and the next state of `hystmpc_cross_friction` from a state and travels w (2), as core/cross_friction.c."""
    shared = model.cross_friction
    assert shared is not None
    facts, plays = shared.struct(model.dt_s).fields, len(shared.radii)
    v, both, alone = x[:AXES], x[AXES : AXES * (1 + plays)], x[AXES * (1 + plays) : AXES * (1 + 2 * plays)]
    waiting = ca.vertcat(x[AXES * (1 + 2 * plays) :], w)
    v = waiting[:AXES] + facts["keep"] * (v - waiting[:AXES])
    c, moved, slid = _coupled(model, v), [], []
    for j, radius in enumerate(shared.radii):
        off = v - both[AXES * j : AXES * (j + 1)]
        share = radius / ca.sqrt(ca.fmax(ca.sumsqr(off), radius**2))  # one within the radius
        moved.append(v - share * off)
        slid.append(ca.fmax(v - radius, ca.fmin(v + radius, alone[AXES * j : AXES * (j + 1)])))
        c += ca.DM([row[j] for row in shared.weights]) * (moved[j] - slid[j])
    return c, ca.vertcat(v, *moved, *slid, waiting[AXES:])


def _coupled(model: TwoAxisModel, v: Any) -> Any:
    """Static coupling (2) at travels v (2)."""
    rows = None if model.cross_friction is None else model.cross_friction.coupling
    if rows is None:
        return ca.SX.zeros(AXES)
    made = []
    for i, weights in enumerate(rows):
        x, o = v[i], v[1 - i]
        made.append(ca.dot(ca.DM(weights), ca.vertcat(x * o, o * o, x * o * o, x * x * o, o * o * o)))
    return ca.vertcat(*made)


def export_two_axes(model: TwoAxisModel, path: Path | str) -> EquivalenceReport:
    """Write a model of two axes as an ONNX file of one step, after the comparison of `check_equivalence`.

    Inputs are u [N, n] and state [N, S], outputs theta [N, 2] and next_state [N, S], in double.

    Raises:
        ExportError: if onnxruntime or CasADi disagree with the reference, or the file cannot be written; an earlier
            file at `path` is left unchanged.
    """
    try:
        content, report = _compared(TwoAxisStep(model), str(path))
    except ModelError as error:
        raise ExportError(f"{error}; nothing was written") from None
    except ExportError as error:
        raise ExportError(f"{path}: {error}; nothing was written") from None
    write_model(path, content)
    return report


def _compared(step: TwoAxisStep, where: str) -> tuple[bytes, EquivalenceReport]:
    """Content of the file, and its differences from the reference."""
    from ..contract.casadi_ import to_casadi
    from ..contract.load import check_graph, open_session, parse_model
    from ..contract.onnx_nodes import step_graph

    content = with_properties(step_graph(step.function, "two_axes"), _properties(step))
    proto = parse_model(content, where)
    run = open_session(content, check_graph(proto, step.state_size, where), where).run
    model, facts = step.model, step.model.axes[0].metadata()
    units = Decades.of_ranges(facts.trained_command, facts.trained_angle)
    start = step.at_rest(np.zeros(AXES), np.array(model.rest_commands))[None]

    def advance(state: Vec, u: Vec) -> tuple[Vec, Vec]:
        theta, following = run(["theta", "next_state"], {"u": u, "state": state})
        return np.asarray(theta), np.asarray(following)

    made = ExportedStep(advance, to_casadi(proto.graph), start, units.command, units.angle, facts.angle_unit, "float64")
    return content, compare_steps(step, made, _probe(model))


def _probe(model: TwoAxisModel) -> Vec:
    """Commands (T, n) over the whole range of each, one after the other."""
    wave = probe_commands(model.axes[0].metadata())
    share = np.resize((wave - wave.min()) / np.ptp(wave), STEPS)
    ends = [(one.lower, one.upper) for one in model.command_limits]
    return np.stack([low + (high - low) * np.roll(share, _SHIFT * k) for k, (low, high) in enumerate(ends)], axis=1)


def _properties(step: TwoAxisStep) -> dict[str, str]:
    """Entries of the file's metadata: numbers and lists of each command, axis or entry of the state."""
    model, axes = step.model, [axis.metadata() for axis in step.model.axes]
    rest = np.array(model.rest_commands)
    facts: dict[str, Any] = {
        "format": TWO_AXES_FORMAT,
        "kind": "two_axes",
        "dt_s": model.dt_s,
        "command_unit": axes[0].command_unit,
        "angle_unit": axes[0].angle_unit,
        "command_limits": [[one.lower, one.upper] for one in model.command_limits],
        "command_rates_per_s": list(model.command_rates_per_s),
        "rest_commands": rest.tolist(),
        "initial": _rule(step, rest),
        "warmup_samples": max(one.warmup_samples for one in axes),
        "training_data_hash": [one.training_data_hash for one in axes],
    }
    return {PREFIX + name: json.dumps(value) for name, value in facts.items()}


def _rule(step: TwoAxisStep, rest: Vec) -> dict[str, Any]:
    """State at rest at angles theta under commands u: x0 = offset + by_angle theta + by_command (u - at_command).

    It holds at the rest commands, and beyond them without the static coupling of both axes.
    """
    model = step.model
    travels, inverse, shown = model.travels(rest), np.linalg.inv(model.turn), step._shown(model.travels(rest))
    offsets, by_angle, by_command = [], [], []
    for i, axis in enumerate(model.axes):
        rule = axis.metadata().initial
        slope, moved = np.array(rule.slope), np.array(rule.by_command)
        offsets.append(np.array(rule.offset) - slope * shown[i] + moved * (travels[i] - rule.at_command))
        by_angle.append(np.outer(slope, inverse[i]))
        by_command.append(np.outer(moved, model.matrix[i]))
    places = step.sizes[AXES] // AXES  # every entry of the shared friction's state is a travel at rest
    offsets.append(np.tile(travels, places))
    by_angle.append(np.zeros((step.sizes[AXES], AXES)))
    by_command.append(np.tile(model.matrix, (places, 1)))
    rows = {"by_angle": np.vstack(by_angle), "by_command": np.vstack(by_command)}
    return {
        "offset": np.concatenate(offsets).tolist(),
        **{name: matrix.tolist() for name, matrix in rows.items()},
        "at_command": rest.tolist(),
    }
