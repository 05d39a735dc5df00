"""Guarded controller of two axes: a controller for each, the commands of both within their limits, as one call."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.core.library import HoldsAddresses, engine
from hystmpc.core.outside import faults, forget_faults
from hystmpc.core.rooms import in_room
from hystmpc.core.structs import Struct, constants, layout, struct
from hystmpc.models.model import Inverse, Predictor, static_gain
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.models.two_axes.model import AXES, TwoAxisModel
from hystmpc.trials.brief import brief
from hystmpc.trials.errors import ControllerError, did_you_mean, shown
from hystmpc.trials.types import Vec

from ..answers import SOURCES
from ..build import build_controller, pair_for
from ..command import EMPTY, CommandLimits, Source, Timing, numbers_of, replace
from ..config import AnyControllerSettings
from ..estimation.observer import Bytes, Places, usable_angle
from ..guarded import GuardedController, GuardedState, check_memory
from ..law_tables import law_over
from ..learning.predictor import LearnedPredictor
from ..mpc_settings import LinearisedMpcSettings, PredictiveSettings, doubling_blocks
from ..planner.reach import angles_at_rest
from ..problem import CHANGES

Predictive = TypeVar("Predictive", bound=PredictiveSettings)
_PREDICTIVE, _PAST = constants()["HYSTMPC_PREDICTIVE"], constants()["HYSTMPC_PAST"]
_ANSWERS = layout("hystmpc_command") * AXES
_ROUNDING = 1e-6  # samples by which a frame may seem to be of the future
_STOPPED = "after repeated failures"
_WORSE = tuple(list(Source).index(source) for source in SOURCES)  # of the engine's levels of fallback
_Part = tuple[slice, Places]
_DEAR_S, _TOLERANCE = 0.018, 0.25  # where friction is shared: T [s]; tolerance of a hold, of the model's error


@dataclass(frozen=True, eq=False)
class TwoAxisCommand:
    """Commands of one step of a device with two axes, with the plan and the prediction behind them.

    Attributes:
        u: commands (n,), always finite and within the limits on value and rate.
        source: the worse level of fallback of both axes.
        status: `ok`, or what was unusual of which axis, in one line.
        plan: planned commands (H, n); empty where an axis does not plan.
        predicted: predicted angles (H, 2) [deg] at the ends of this and the next samples, disturbances included.
        disturbance: estimated differences between device and model (2,) [deg].
        timing: of the step.
    """

    u: Vec
    source: Source = Source.HOLD
    status: str = "ok"
    plan: Vec = field(default_factory=lambda: EMPTY)
    predicted: Vec = field(default_factory=lambda: EMPTY)
    disturbance: Vec = field(default_factory=lambda: EMPTY)
    timing: Timing = field(default_factory=Timing)
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class TwoAxisState:
    """Complete state of a controller of two axes.

    Attributes:
        memory: bytes of the engine (B,), never changed, see core/axes.h.
        parts: where the memory of each axis lies in it, with the places of its estimate.
        cause: why the stop is latched.
        refusal: why the next step has no time for a plan; empty if it has.
    """

    memory: Bytes
    parts: tuple[_Part, _Part]
    cause: str = _STOPPED
    refusal: str = ""
    __repr__ = brief

    @cached_property
    def axes(self) -> tuple[GuardedState, GuardedState]:
        """States of both axes, in their coordinates w and y, to be read."""
        (first, at_first), (second, at_second) = self.parts
        return GuardedState(self.memory[first], at_first), GuardedState(self.memory[second], at_second)

    @property
    def first(self) -> GuardedState:
        """State of x."""
        return self.axes[0]

    @property
    def second(self) -> GuardedState:
        """State of y."""
        return self.axes[1]

    @property
    def stopped(self) -> bool:
        """Whether the stop is latched."""
        return any(axis.stopped for axis in self.axes)


@final
class TwoAxisController(HoldsAddresses):
    """Controller of a device with two bending axes: its step never raises, its commands never leave the limits.

    Each axis has its own observer, learning, hold and fallbacks, in the coordinates of the axes. Where the limits of
    the commands bind, one quadratic program decides between the axes, see core/axes.h.

    Args:
        model: of the device; its limits are those of the commands.
        settings: of any controller; both axes have the same.

    Attributes:
        problem: struct `hystmpc_axes` of core/axes.h.
        rests: how the predictors of x and y come to rest, structs `hystmpc_rest_rule`; None without one.
        model, limits: of the device, and of every command.
        horizon: H, reference samples that a step uses.

    Raises:
        ControllerError: if the settings contradict each other or the model.
    """

    def __init__(self, model: TwoAxisModel, settings: AnyControllerSettings) -> None:
        wanted = settings.resolved()
        if wanted.limits is not None:
            raise ControllerError("two axes: got controller.limits of one command, expected `limits` with a list each")
        if isinstance(wanted, PredictiveSettings) and wanted.weights.limits_angle:
            raise ControllerError("two axes: got weights.angle_limits_deg of one angle, expected none")
        self.model = model
        self.limits = tuple(
            CommandLimits(limits.lower, limits.upper, rate)
            for limits, rate in zip(model.command_limits, model.command_rates_per_s, strict=True)
        )
        pairs, travels = _pairs(model, settings), [CommandLimits(*ends) for ends in model.travel_limits()]
        each = [settings] * AXES
        if model.cross_friction is not None and isinstance(settings, PredictiveSettings):
            settings = _dearer(settings, [static_gain(pair[0]) for pair in pairs], model.dt_s)
            each = [_tolerant(settings, axis) for axis in model.axes]
        x, y = (build_controller(*one) for one in zip(each, *zip(*pairs, strict=True), travels, strict=True))
        self._axes = x, y
        modelled = (pair[0].model if isinstance(pair[0], LearnedPredictor) else pair[0] for pair in pairs)
        self.rests = tuple(predictor.rest_part for predictor in modelled)
        self._ends = [
            angles_at_rest(pair[0], ends, axis.trained_angle_deg.lower)
            for pair, ends, axis in zip(pairs, travels, model.axes, strict=True)
        ]
        self.problem = _problem(model, settings, self.limits, self._axes)
        self._engine, self._address = engine(), self.problem.address
        self._bytes = int(self._engine.axes_bytes(self._address))
        self._room = int(self._engine.axes_room_bytes(self._address))
        sizes = [int(self._engine.memory_bytes(axis.problem.address)) for axis in self._axes]
        head = self._bytes - sum(sizes)
        self._parts = (slice(head, head + sizes[0]), x.places), (slice(head + sizes[0], self._bytes), y.places)
        self._turn = model.turn.tolist()
        self.horizon = self._axes[0].horizon
        self._planned = int(self._axes[0].problem.fields["law"].fields["horizon"])

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._axes[0].dt

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the measured inputs on which the model depends."""
        return tuple(one.name for one in self.model.inputs)

    def init(self, angles_deg: ArrayLike, commands: ArrayLike) -> TwoAxisState:
        """State at rest at angles (2,) [deg] under commands (n,).

        Raises:
            ControllerError: if one is not finite or beyond the limits, or a model fails at rest.
        """
        angles, held = usable_angles(angles_deg), numbers_of(commands)
        inside = held.shape == (len(self.limits),) and all(
            limits.lower <= u <= limits.upper for u, limits in zip(held, self.limits, strict=True)
        )
        if not (np.all(np.isfinite(angles)) and inside):
            raise ControllerError(
                f"controller: got a start at {shown(angles_deg, 60)} deg with commands {shown(commands, 60)}, expected "
                f"two finite angles and {len(self.limits)} commands within the limits"
            )
        y, w = np.empty(AXES), np.empty(AXES)
        self._engine.axes_at(self._address, angles, np.ascontiguousarray(held), y, w)
        begun = [axis.init(float(y[i]), float(w[i])) for i, axis in enumerate(self._axes)]
        memory = np.zeros(self._bytes, dtype=np.uint8)
        for (part, _), state in zip(self._parts, begun, strict=True):
            memory[part] = state.memory
        self._engine.axes_begin(self._address, memory, np.ascontiguousarray(held))
        return TwoAxisState(memory, self._parts)

    def replay(self, commands: Vec, angles_deg: Vec) -> TwoAxisState:
        """State after a recording, hysteresis included, as if this controller had sent its commands.

        Args:
            commands: sent last (T, n) [mm or bar], the newest at the end.
            angles_deg: measured when each was sent (T, 2) [deg]; not-a-number where there was none. Each axis is taken
                to rest at its first usable angle, under the commands sent before it.

        Raises:
            ControllerError: if the shapes do not fit, a command is beyond the limits, or an axis has no usable angle.
        """
        low, high = (np.array([getattr(each, end) for each in self.limits]) for end in ("lower", "upper"))
        if not commands.size or commands.shape != (len(angles_deg), low.size) or angles_deg.shape[1:] != (AXES,):
            raise ControllerError(
                f"replay: got commands {commands.shape} and angles {angles_deg.shape}, "
                f"expected (T, {low.size}) and (T, 2)"
            )
        if not np.all((low <= commands) & (commands <= high)):
            raise ControllerError(
                f"replay: got a command beyond {low.tolist()} to {high.tolist()}, expected all within"
            )
        travels, y = self.model.travels(commands), self.model.in_axes(angles_deg)
        memory = np.zeros(self._bytes, dtype=np.uint8)
        shared = self._replay_friction(travels)
        for i, ((part, _), axis) in enumerate(zip(self._parts, self._axes, strict=True)):
            w = np.clip(travels[:, i], axis.limits.lower, axis.limits.upper)
            memory[part] = axis.replay(w, y[:, i] - (0.0 if shared is None else shared[0][:, i])).memory
        self._engine.axes_begin(self._address, memory, np.ascontiguousarray(commands[-1]))
        if shared is not None:
            numbers = np.concatenate([commands[-1], *shared[1:]]).view(
                np.uint8
            )  # the head of a memory, see core/axes.h
            memory[: numbers.size] = numbers
        return TwoAxisState(memory, self._parts)

    def _replay_friction(self, travels: Vec) -> tuple[Vec, Vec, Vec] | None:
        """Shared friction (T, 2) in angles of a recording, last values (newest first) and state; None without it."""
        friction, dt_s = self.model.cross_friction, self.model.dt_s
        if friction is None:
            return None
        c, state = friction.advance(friction.at_rest(travels[0], dt_s), travels, dt_s)
        late = 1 + int(self._axes[0].problem.fields["sensing"].fields.get("delay", 0))
        past = np.zeros((max(_PAST, late) + len(c), AXES))
        past[-len(c) :] = c
        return past[-late - len(c) : -late], past[: -_PAST - 1 : -1].ravel(), state

    def step(
        self, state: TwoAxisState, angles_deg: ArrayLike, reference: ArrayLike
    ) -> tuple[TwoAxisCommand, TwoAxisState]:
        """Compute the commands of one sample.

        Args:
            angles_deg: measured angles (2,) [deg]; not-a-number where there is none.
            reference: wanted angles (H, 2) [deg] at the ends of this and the next samples; empty for a hold.

        Raises:
            ControllerError: if the state is of another controller, or cut off.
        """
        began = perf_counter()
        wanted, fault = numbers_of(reference), ""
        if wanted.ndim != AXES or wanted.shape[0] < self.horizon or wanted.shape[1] != AXES:
            fault = f"reference: got shape {wanted.shape}, expected ({self.horizon}, 2)"
            wanted = np.full((self.horizon, AXES), np.nan)
        wanted = np.ascontiguousarray(wanted[: self.horizon].T)
        n, memory, answers = len(self.limits), self._copied(state), _ANSWERS()
        u, numbers = np.empty(n), np.empty((n + AXES, self._planned))
        if state.refusal:
            self._engine.axes_hurry(self._address, memory)
        forget_faults()
        unusual = in_room(
            self._room, self._engine.axes_step, self._address, memory, usable_angles(angles_deg), wanted, u,
            ctypes.addressof(answers), numbers,
        )  # fmt: skip
        after = TwoAxisState(memory, self._parts, state.cause)
        x, y = answers
        planned, off_x, off_y = min(x.planned, y.planned), x.departure_deg, y.departure_deg
        command = TwoAxisCommand(
            u,
            SOURCES[max(x.source, y.source, key=_WORSE.__getitem__)],
            self._status(state, after, answers, fault) if unusual else "ok",
            plan=numbers[:n, :planned].T,
            predicted=numbers[n:, : planned or 1].T,
            disturbance=np.array([by_x * off_x + by_y * off_y for by_x, by_y in self._turn]),
            timing=Timing({"step": perf_counter() - began}),
        )
        return command, after

    def measure(self, state: TwoAxisState, angles_deg: ArrayLike, age: float) -> TwoAxisState:
        """Measurement update with angles (2,) [deg] taken `age` samples before the next step.

        Raises:
            ControllerError: if the observers accept no late measurements, or none of that age.
        """
        age = 0.0 if -_ROUNDING < age < 0.0 else age
        memory, angles = self._copied(state), usable_angles(angles_deg)
        forget_faults()
        if not self._engine.axes_measure(self._address, memory, angles, age):
            reason = "; ".join(faults()) or f"angles {shown(angles_deg, 60)} deg of age {age:.3g} samples are unusable"
            raise ControllerError(f"measure: {reason}")
        return TwoAxisState(memory, self._parts, state.cause)

    def with_inputs(self, state: TwoAxisState, inputs: Mapping[str, float]) -> TwoAxisState:
        """State with the present values of measured inputs, see `GuardedController.with_inputs`.

        Raises:
            ControllerError: if no axis depends on an input of that name.
        """
        if unknown := [name for name in inputs if name not in self.inputs]:
            raise ControllerError(
                f"controller: no input {shown(unknown[0], 40)}, {did_you_mean(unknown[0], self.inputs)}"
            )
        memory = self._copied(state)
        for (part, places), axis in zip(self._parts, self._axes, strict=True):
            known = {name: value for name, value in inputs.items() if name in axis.inputs}
            memory[part] = axis.with_inputs(GuardedState(memory[part], places), known).memory
        return replace(state, memory=memory)

    def stop(self, state: TwoAxisState, cause: str) -> TwoAxisState:
        """State with the stop of both axes latched, until a new `init`."""
        memory = self._copied(state)
        self._engine.axes_stop(self._address, memory)
        return TwoAxisState(memory, self._parts, cause)

    def holding(self, state: TwoAxisState, commands: ArrayLike) -> TwoAxisState:
        """State in which the device holds commands (n,) in place of those sent last."""
        memory = self._copied(state)
        self._engine.axes_held(self._address, memory, np.ascontiguousarray(commands, dtype=np.float64))
        return TwoAxisState(memory, self._parts, state.cause)

    def nearest(self, angles_deg: Vec, disturbance_deg: Vec) -> tuple[Vec, Vec]:
        """Angles (2,) [deg] nearest to the wanted ones that commands within the limits can hold, and these commands.

        Each axis is taken as a line between its rests at both ends of its travel.
        """
        ends = [np.array(pair) for pair in self._ends]
        travels = [np.array([axis.limits.lower, axis.limits.upper]) for axis in self._axes]
        y = self.model.in_axes(angles_deg - disturbance_deg)
        w = [float(np.interp(y[i], ends[i], travels[i])) for i in range(AXES)]
        commands = np.clip(
            self.model.commands(w), [one.lower for one in self.limits], [one.upper for one in self.limits]
        )
        held = self.model.travels(commands)
        nearest = np.array([float(np.interp(held[i], travels[i], ends[i])) for i in range(AXES)])
        return self.model.turn @ nearest + disturbance_deg, commands

    def measured_deg(self, state: TwoAxisState) -> Vec:
        """Last accepted measurement (2,) [deg], with the shared friction of the newest sample that was measured."""
        y = np.array([axis.known.measured for axis in state.axes])
        if self.model.cross_friction is not None:  # axes see their angles without it; the head of a memory, core/axes.h
            n, late = len(self.limits), 1 + int(self._axes[0].problem.fields["sensing"].fields.get("delay", 0))
            past = state.memory[: 8 * (n + AXES * _PAST)].view(np.float64)[n:].reshape(_PAST, AXES)
            y = y + past[min(late, _PAST - 1)]
        return self.model.turn @ y

    def sigma_deg(self, state: TwoAxisState) -> Vec:
        """Standard deviations of the errors of the estimated angles (2,) [deg]; not-a-number where unknown."""
        sigmas = [axis.sigma_deg(part) for axis, part in zip(self._axes, state.axes, strict=True)]
        return np.asarray(np.sqrt(self.model.turn**2 @ np.square(sigmas)))

    def _copied(self, state: TwoAxisState) -> Bytes:
        check_memory(state.memory, self._bytes)
        return state.memory.copy()

    def _status(self, before: TwoAxisState, after: TwoAxisState, answers: Any, fault: str) -> str:
        words = []
        for name, axis, old, new, answer in zip("xy", self._axes, before.axes, after.axes, answers, strict=True):
            said = axis.status(replace(old, cause=before.cause, refusal=before.refusal), new, answer, fault)
            if said != "ok":
                words.append(f"{name}: {said}")
        return "; ".join(words) or "ok"


def usable_angles(angles_deg: object) -> Vec:
    """Two angles (2,) [deg] of whatever was measured; not-a-number for what cannot be used."""
    angles = numbers_of(angles_deg)
    if angles.shape != (AXES,):
        return np.full(AXES, np.nan)
    return np.array([usable_angle(angle) for angle in angles.tolist()])


def _dearer(settings: Predictive, gains: Sequence[float], dt_s: float) -> Predictive:
    """Settings of axes that share friction: a command's speed costs the square of the angle it moves within a time.

        w_r = (T g / dt)^2,    g^2 the mean square of both static gains

    Moves are counted beside those of the reference. A plan that crosses a dead band to and fro is worth it on one axis
    alone. Here the other axis removes the dead band, more or less than the model says.
    """
    if "rate" in settings.weights.model_fields_set:
        return settings
    rate = max(float(np.mean(np.square(gains))) * (_DEAR_S / dt_s) ** 2, settings.weights.rate_close)
    weights = settings.weights.model_copy(update={"rate": rate, "rate_close": rate})
    return settings.model_copy(update={"weights": weights})


def _tolerant(settings: Predictive, axis: Simulator) -> Predictive:
    """Settings of an axis that shares friction: a hold leaves a share of the model's error alone.

    A correction within a dead band moves nothing, but stores a force. A motion of the other axis sets it free: the
    correction is too much then.
    """
    noise = axis.identification.noise
    if settings.hold.tolerance_deg is not None or noise is None or noise.model_sigma_deg is None:
        return settings
    hold = settings.hold.model_copy(update={"tolerance_deg": _TOLERANCE * noise.model_sigma_deg})
    return settings.model_copy(update={"hold": hold})


def _pairs(model: TwoAxisModel, settings: AnyControllerSettings) -> list[tuple[Predictor, Inverse]]:
    """Predictor and inverse of each axis."""
    return [pair_for(settings, controller_model(ChainModel(axis, "conditioned"))) for axis in model.axes]


def _problem(
    model: TwoAxisModel,
    settings: AnyControllerSettings,
    limits: tuple[CommandLimits, ...],
    axes: tuple[GuardedController, GuardedController],
) -> Struct:
    """Struct `hystmpc_axes` of both controllers."""
    law = None
    first = axes[0].problem.fields["law"]
    if isinstance(settings, LinearisedMpcSettings) and first.fields["kind"] == _PREDICTIVE:
        horizon = int(first.fields["horizon"])
        blocks = settings.blocks(model.dt_s)
        if model.cross_friction is not None and settings.move_blocking is None:
            blocks = doubling_blocks(horizon)  # of what the program changes of plans in which every sample moves
        for number in reversed(range(len(limits))):
            law = law_over(settings.weights, horizon, limits[number], model.dt_s, blocks, law)
            if number >= AXES:  # a command without an angle
                law = struct("hystmpc_law", **{k: v for k, v in law.fields.items() if k != "tracking"})
    return struct(
        "hystmpc_axes",
        first=axes[0].problem,
        second=axes[1].problem,
        commands=len(limits),
        changes=CHANGES,
        mix=model.matrix,
        unmix=model.unmix,
        rest=np.array(model.rest_commands),
        frame=model.turn,
        unframe=np.linalg.inv(model.turn),
        lower=np.array([each.lower for each in limits]),
        upper=np.array([each.upper for each in limits]),
        reach=np.array([each.rate for each in limits]) * model.dt_s,
        cross=None if model.cross_friction is None else model.cross_friction.struct(model.dt_s),
        law=law,
    )
