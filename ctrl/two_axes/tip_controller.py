"""Controller of two axes for motion planners: set targets or a preview, step, read state and plan, stop."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as dataclass_replace
from functools import partial
from pathlib import Path
from threading import RLock
from typing import Annotated, Any, Self, final

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hystmpc.models.contract.metadata import Range
from hystmpc.models.load import model_path
from hystmpc.models.two_axes.model import AXES, TwoAxisModel, load_two_axes
from hystmpc.trajectories.motion import Kinematics, MotionLimits
from hystmpc.trials.brief import brief, in_brief
from hystmpc.trials.config import Positive, Settings, read_yaml
from hystmpc.trials.errors import ControllerError, ModelError, shown
from hystmpc.trials.types import Vec

from ..command import CommandLimits, ModelledLimitsSettings, Source, attempt, modelled_limits, numbers_of, replace
from ..config import ControllerSettings
from ..mpc_settings import LinearisedMpcSettings
from ..planner.memory import also_said, with_inputs
from .guarded import TwoAxisCommand, TwoAxisController, TwoAxisState, usable_angles
from .reference import FollowedReference, MovesReference, Pair, PlaneReference, followed, rest_at, usable_points

_ROUNDS = 3  # evaluations of a reference within one step, if another thread sets a new one each time
_ROUNDING = 1e-9


class TwoAxisLimitsSettings(Settings):
    """Hard limits of n commands.

    Attributes:
        lower, upper: of every command, n each [mm or bar].
        rate_per_s: greatest change of every command per second, n.
        beyond_model: whether they may be wider than those of the model.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    rate_per_s: tuple[Positive, ...]
    beyond_model: Annotated[bool, Field(strict=True)] = False


class TwoAxisTipSettings(Settings):
    """Settings of a `TwoAxisTipController`; keys as of `TipSettings`.

    Attributes:
        model: a model of two axes (.yaml).
        controller: a controller block, the same for both axes.
        limits: hard limits of the commands; those of the model where left out.
        motion: limits of the reference's own motion, of each axis.
        start_command: commands that the device holds before the first step; the model's rest where left out.
        tolerance_deg: how close both measured angles have to be to count as settled.
    """

    model: str
    controller: Annotated[ControllerSettings, Field(validate_default=True)] = LinearisedMpcSettings()
    limits: TwoAxisLimitsSettings | None = None
    motion: MotionLimits = MotionLimits()
    start_command: tuple[float, ...] | None = None
    tolerance_deg: Positive = 0.5


def read_two_axis_settings(source: Path | str | Mapping[str, Any]) -> tuple[TwoAxisTipSettings, Path]:
    """Read the settings, and return the folder of their relative file names: the file's, else the present one.

    Raises:
        ConfigError: on an unreadable file, an unknown key or a value out of bounds.
    """
    if isinstance(source, Mapping):
        return TwoAxisTipSettings.parse(dict(source)), Path()
    return TwoAxisTipSettings.parse(read_yaml(source), str(source)), Path(source).resolve().parent


@dataclass(frozen=True, eq=False)
class PlaneReach:
    """Reachability of two angles; its truth value is `reachable`.

    Attributes:
        nearest_deg: reachable angles nearest to the requested ones (2,) [deg].
        reason: which command would be beyond its limits, in one line.
    """

    reachable: bool
    nearest_deg: Vec
    reason: str
    __repr__ = brief

    def __bool__(self) -> bool:
        return self.reachable


@dataclass(frozen=True, eq=False)
class TwoAxisTipState:
    """State of the controller between two steps; names and meanings as of `TipState`, arrays of two axes.

    Attributes:
        measured_deg, predicted_deg, reference_deg, reference_velocity_deg_s, disturbance_deg, sigma_deg: (2,).
        command: commands that are being held (n,).
    """

    time_s: float
    measured_deg: Vec
    predicted_deg: Vec
    reference_deg: Vec
    reference_velocity_deg_s: Vec
    command: Vec
    disturbance_deg: Vec
    sigma_deg: Vec
    source: Source
    status: str
    done: bool
    settled: bool
    stopped: bool
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class TwoAxisTipPlan:
    """Planned commands and predictions; rows belong to the running and the next samples (H,).

    Attributes:
        time_s: ends of the samples (H,).
        command: (H, n).
        predicted_deg, reference_deg: angles at these ends (H, 2) [deg].
    """

    time_s: Vec
    command: Vec
    predicted_deg: Vec
    reference_deg: Vec
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class _Memory:
    command: TwoAxisCommand
    steps: int = 0
    control: TwoAxisState | None = None
    reference: PlaneReference | None = None
    request: Callable[[Pair, float], PlaneReference] | None = None
    halted: bool = False
    origin: str = ""
    inputs: Mapping[str, float] = field(default_factory=dict)
    unmeasured: bool = False

    @property
    def stopped(self) -> bool:
        return self.halted or (self.control is not None and self.control.stopped)


@final
class TwoAxisTipController:
    """Controller of two bending axes with its clock and its reference; `TipController.from_config` builds it.

        tip = TipController.from_config({"model": "two_axes.yaml"})
        tip.set_target((20.0, -10.0))
        while not tip.state().settled:
            device.send(tip.step(device.measure()).u)

    `step` never raises and never leaves the limits, for any measurement. All methods may be called from any thread
    while one thread steps; a reference function is evaluated outside the lock. Only `reset` releases a latched stop.

    Raises:
        ControllerError: if the start commands are beyond the limits, or settings contradict each other.
    """

    def __init__(self, model: TwoAxisModel, settings: TwoAxisTipSettings) -> None:
        self._settings, model = settings, within_limits(model, settings.limits)
        start = np.array(model.rest_commands if settings.start_command is None else settings.start_command)
        low, high = (np.array([getattr(each, end) for each in model.command_limits]) for end in ("lower", "upper"))
        if start.shape != low.shape or not np.all((low <= start) & (start <= high)):
            raise ControllerError(f"start_command: got {start.tolist()}, expected {low.tolist()} to {high.tolist()}")
        self._low, self._high = low, high
        self._controller = TwoAxisController(model, settings.controller)
        self._ahead: Vec = self.dt * np.arange(1, self._controller.horizon + 1, dtype=np.float64)
        facts = settings.model_dump_json(), repr(model), model.mix, model.frame, model.command_limits
        self._origin = hashlib.sha256(repr(facts).encode()).hexdigest()[:12]
        self._lock = RLock()
        self._memory = _Memory(TwoAxisCommand(start, Source.HOLD, "not started"), origin=self._origin)

    @classmethod
    def from_settings(cls, source: Path | str | Mapping[str, Any]) -> Self:
        """Build a controller from a YAML file or a mapping, see `TwoAxisTipSettings`.

        Raises:
            ConfigError: on an unknown key or a value out of bounds.
            ModelError: if the model file is missing or unusable.
            ControllerError: if the settings contradict each other or the model.
        """
        settings, folder = read_two_axis_settings(source)
        return cls(load_two_axes(model_path(settings.model, folder)), settings)

    def __repr__(self) -> str:
        memory = self._memory
        now = f"step {memory.steps}: {memory.command.u.round(4).tolist()}, {memory.command.source}"
        return in_brief(self, f"{self._settings.controller.kind} of two axes, every {self.dt:.4g} s; {now}")

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._controller.dt

    def step(
        self, measured_theta_deg: ArrayLike, refusal: str = "", inputs: Mapping[str, float] | None = None
    ) -> TwoAxisCommand:
        """Compute the commands to send now, and advance the clock by one sample.

        Args:
            measured_theta_deg: present angles (2,) [deg]; NaN where there is none. The first usable pair starts the
                controller at rest there; until then the start commands are held.
            refusal: why there is no time for a plan in this sample: the fallbacks answer, and the status tells why.
            inputs: present values of measured inputs of the model by name, see `TipController.step`.
        """
        with self._lock:
            self._memory, said = with_inputs(self._memory, self._controller, self._controller.model.inputs, inputs)
        return also_said(self._stepped(measured_theta_deg, refusal), said)

    def _stepped(self, measured_theta_deg: ArrayLike, refusal: str) -> TwoAxisCommand:
        for _ in range(_ROUNDS):
            with self._lock:
                memory = self._memory
                if memory.control is None:
                    memory = self._memory = self._try_to_start(memory, measured_theta_deg)
                if memory.control is None:
                    return memory.command
            reference, ahead = memory.reference, memory.steps * self.dt + self._ahead
            assert reference is not None
            wanted, fault = attempt(partial(reference.at, ahead))  # a user's code: anything may happen
            with self._lock:
                now = self._memory
                if now.stopped or (now.reference is reference and now.steps == memory.steps):
                    return self._answer(measured_theta_deg, wanted, fault, refusal)
        with self._lock:
            return self._answer(measured_theta_deg, None, "another was set each time this one was evaluated", refusal)

    def _answer(self, measured: ArrayLike, wanted: Vec | None, fault: str, refusal: str) -> TwoAxisCommand:
        memory = self._memory
        assert memory.control is not None
        control = replace(memory.control, refusal=refusal) if refusal else memory.control
        command, control = self._controller.step(control, measured, np.empty((0, AXES)) if wanted is None else wanted)
        if fault and not memory.stopped:
            command = replace(command, status=f"reference: {fault}")
        self._memory = replace(memory, steps=memory.steps + 1, control=control, command=command)
        return command

    def _try_to_start(self, memory: _Memory, measured: ArrayLike) -> _Memory:
        angles = usable_angles(measured)
        started, reason = attempt(lambda: self._started(memory, angles))
        if not np.all(np.isfinite(angles)):
            reason = "no usable measurement of both angles yet; reset(angles) declares the angles of rest"
        held = TwoAxisCommand(memory.command.u, Source.HOLD, f"not started: {reason}")
        return started or replace(memory, command=held)

    def _started(self, memory: _Memory, angles: Vec) -> _Memory:
        control = self._controller.init(angles, memory.command.u)
        if memory.halted:
            control = self._controller.stop(control, "by stop()")
        start = Kinematics(float(angles[0])), Kinematics(float(angles[1]))
        reference = rest_at(angles.tolist(), 0.0) if memory.request is None else memory.request(start, 0.0)
        return replace(memory, steps=0, control=control, reference=reference, request=None)

    def measure(self, theta_deg: ArrayLike, taken_at_s: float) -> None:
        """Update the estimates by a frame of an intermittent sensor; between frames `step` gets NaN.

        Args:
            theta_deg: angles (2,) [deg] in the frame.
            taken_at_s: when it was taken, on the clock of `state().time_s` [s].

        Raises:
            ControllerError: if the angles or the time cannot be used, or the sensor is not intermittent.
        """
        with self._lock:
            memory = self._memory
            if memory.control is None:
                self._memory = self._started(memory, usable_angles(theta_deg))
                return
            age = memory.steps - float(taken_at_s) / self.dt
            self._memory = replace(memory, control=self._controller.measure(memory.control, theta_deg, age))

    def skip(self) -> TwoAxisCommand:
        """Advance by one sample in which nothing was sent and the device held; the command returned says so."""
        with self._lock:
            memory, control = self._memory, self._memory.control
            held, status = memory.command.u, "sample skipped, command held"
            command = replace(memory.command, status=status)
            if control is not None and not memory.stopped:  # a step would compute the next command of a stop's ramp
                command, control = self._controller.step(control, np.full(AXES, np.nan), np.empty((0, AXES)))
                command, control = replace(command, u=held, status=status), self._controller.holding(control, held)
            if control is not None:
                self._memory = replace(memory, steps=memory.steps + 1, control=control, command=command)
            return self._memory.command

    def replay(self, commands: ArrayLike, angles_deg: ArrayLike) -> None:
        """Reset to the state after a recording of another controller, hysteresis included; a latched stop remains.

        Args:
            commands: the last commands that were sent (T, n) [mm or bar]; the device holds the newest, at the end.
            angles_deg: angles (T, 2) [deg] measured when each was sent; NaN where there was none.
                `step` takes the next.

        Raises:
            ControllerError: if the shapes do not fit, an axis has no usable angle, or a command is beyond the limits.
        """
        sent, seen = np.atleast_2d(numbers_of(commands)), np.atleast_2d(numbers_of(angles_deg))
        control = self._controller.replay(sent, seen)  # takes longer than a sample
        rest = rest_at(self._controller.measured_deg(control).tolist(), 0.0)
        command = TwoAxisCommand(sent[-1], Source.HOLD, "replayed")
        with self._lock:
            if halted := self._memory.stopped:
                control = self._controller.stop(control, "by stop()")
            self._memory = replace(
                self._memory, command=command, steps=0, control=control, reference=rest, request=None, halted=halted
            )

    def set_target(self, theta_deg: ArrayLike) -> PlaneReach:
        """Move to angles (2,) [deg] and stay; both axes arrive at the same time, within the limits of the motion.

        Raises:
            ControllerError: if they are no two finite angles, or the stop is latched.
        """
        target = numbers_of(theta_deg)
        self.set_waypoints([target], [0.0])
        return self.reachable(target)

    def set_waypoints(self, angles_deg: ArrayLike, holds_s: Sequence[float]) -> None:
        """Move through angles (K, 2) [deg] and rest at each for its hold [s]; then stay at the last.

        Raises:
            ControllerError: if the counts differ, a number makes no sense, or the stop is latched.
        """
        points, holds = usable_points(angles_deg, holds_s)
        self._request(lambda start, t: MovesReference(start, points, holds, self._settings.motion, t))

    def set_reference(self, source: Callable[[Any], Any] | ArrayLike) -> None:
        """Follow a preview exactly as given, from the next sample on.

        Args:
            source: a function of the seconds since this call, to (2,) or (T, 2) angles [deg]; or angles (T, 2) at the
                ends of the coming samples, the last of which is held.

        Raises:
            ControllerError: if it is neither or does not answer with finite angles, or the stop is latched.
        """
        function, duration = followed(source, self.dt)
        self._request(lambda _, t: FollowedReference(function, t, duration, self.dt, self._settings.motion))

    def _request(self, request: Callable[[Pair, float], PlaneReference]) -> None:
        with self._lock:
            memory = self._memory
            if memory.stopped:
                raise ControllerError("the stop is latched: got a new reference, expected reset() first")
            if memory.reference is None or memory.control is None:
                self._memory = replace(memory, request=request)
                return
            now = memory.steps * self.dt
            motion = attempt(lambda: memory.reference.motion(now))[0]  # type: ignore[union-attr]
            if motion is None:  # the present reference fails: start from the tip's position
                x, y = self._controller.measured_deg(memory.control)
                motion = Kinematics(float(x)), Kinematics(float(y))
            self._memory = replace(memory, reference=request(motion, now))

    def reachable(self, theta_deg: ArrayLike) -> PlaneReach:
        """Whether the model can be held at angles (2,) [deg] within the limits of all commands.

        Each axis is taken as a line between its rests at both ends of its travel, and the estimated disturbance counts.
        """
        wanted = numbers_of(theta_deg)
        if wanted.shape != (AXES,) or not np.all(np.isfinite(wanted)):
            return PlaneReach(False, np.full(AXES, np.nan), f"got {shown(theta_deg)}, expected two finite angles")
        off = self._memory.command.disturbance
        shift = off if off.size else np.zeros(AXES)
        nearest_deg, commands = self._controller.nearest(wanted, shift)
        gap = float(np.abs(nearest_deg - wanted).max())
        if gap <= self._settings.tolerance_deg:
            return PlaneReach(True, wanted, "within reach")
        return PlaneReach(
            False, nearest_deg, f"{gap:.3g} deg beyond what the commands {commands.round(4).tolist()} can hold"
        )

    def state(self) -> TwoAxisTipState:
        """Return the present state of the controller."""
        memory, nothing = self._memory, np.full(AXES, np.nan)
        now, command, control = memory.steps * self.dt, memory.command, memory.control
        motion = None if memory.reference is None else attempt(lambda: memory.reference.motion(now))[0]  # type: ignore[union-attr]
        reference = nothing if motion is None else np.array([axis.theta_deg for axis in motion])
        velocity = nothing if motion is None else np.array([axis.velocity_deg_s for axis in motion])
        measured = nothing if control is None else self._controller.measured_deg(control)
        done = memory.reference is not None and now >= memory.reference.end_s - _ROUNDING
        near = bool(np.all(np.abs(measured - reference) <= self._settings.tolerance_deg))
        return TwoAxisTipState(
            now,
            measured,
            command.predicted[0] if command.predicted.size else nothing,
            reference,
            velocity,
            command.u,
            command.disturbance if command.disturbance.size else np.zeros(AXES),
            nothing if control is None else self._controller.sigma_deg(control),
            command.source,
            command.status,
            done,
            done and near,
            memory.stopped,
        )

    def plan(self) -> TwoAxisTipPlan:
        """Return the plan of the last step over its horizon."""
        memory = self._memory
        command = memory.command.plan if memory.command.plan.size else memory.command.u[None]
        rows = max(len(command), len(memory.command.predicted))
        times = self.dt * (memory.steps + np.arange(rows, dtype=np.float64))
        wanted = None if memory.reference is None else attempt(lambda: memory.reference.at(times))[0]  # type: ignore[union-attr]
        reference = np.full((rows, AXES), math.nan) if wanted is None else wanted
        return TwoAxisTipPlan(times, command, memory.command.predicted, reference)

    def stop(self) -> None:
        """Hold, or ramp to the configured `safe_command`, from the next step on; latched until `reset`."""
        with self._lock:
            memory = self._memory
            control = None if memory.control is None else self._controller.stop(memory.control, "by stop()")
            self._memory = replace(memory, control=control, halted=True)

    def reset(self, measured_theta_deg: ArrayLike | None = None, command: ArrayLike | None = None) -> None:
        """Reset to rest at time 0 without a target; the only call that releases a latched stop.

        Args:
            measured_theta_deg: start at these angles (2,) [deg] now; None to start with the first usable pair.
            command: commands (n,) that the device holds; None for those sent last.

        Raises:
            ControllerError: if a command is beyond the limits, or the controller cannot start from the angles.
        """
        with self._lock:
            held = self._memory.command.u if command is None else numbers_of(command)
            if held.shape != self._low.shape or not np.all((self._low <= held) & (held <= self._high)):
                raise ControllerError(f"reset: got commands {shown(command)}, expected {self._low.size} within limits")
            command_now = TwoAxisCommand(held, Source.HOLD, "not started")
            memory = _Memory(command_now, origin=self._origin, inputs=self._memory.inputs)
            if measured_theta_deg is not None:
                memory = self._started(memory, usable_angles(measured_theta_deg))
            self._memory = memory

    def snapshot(self) -> object:
        """Return a snapshot of the whole state, which with the inputs determines all future commands."""
        return self._memory

    def restore(self, snapshot: object, held: ArrayLike | None = None) -> None:
        """Restore the state of `snapshot`, except a latched stop; the device holds `held`, or the commands sent last.

        Raises:
            ControllerError: if it is no snapshot of this controller, or a command is beyond the limits.
        """
        if not isinstance(snapshot, _Memory) or snapshot.origin != self._origin:
            raise ControllerError(f"restore: got {type(snapshot).__name__}, expected a snapshot of this controller")
        with self._lock:
            present = self._memory
            holds = present.command.u if held is None else numbers_of(held)
            if holds.shape != self._low.shape or not np.all((self._low <= holds) & (holds <= self._high)):
                raise ControllerError(f"restore: got commands {shown(held)}, expected {self._low.size} within limits")
            control = snapshot.control
            if control is not None:
                control = self._controller.holding(control, holds)
                control = self._controller.stop(control, "by stop()") if present.stopped else control
            command = replace(snapshot.command, u=holds)
            self._memory = replace(
                snapshot, control=control, command=command, halted=present.halted, inputs=present.inputs
            )


def within_limits(model: TwoAxisModel, settings: TwoAxisLimitsSettings | None) -> TwoAxisModel:
    """Model with the limits of the settings, or its own where left out.

    Raises:
        ControllerError: if counts differ, limits are wider than those of the model, or a rest is beyond them.
    """
    if settings is None:
        return model
    rows, count = (settings.lower, settings.upper, settings.rate_per_s), len(model.command_limits)
    if {len(row) for row in rows} != {count}:
        got = [len(row) for row in rows]
        raise ControllerError(f"limits: got {got} lower, upper and rate_per_s, expected {count} of each")
    made = []
    for k, (low, high, rate) in enumerate(zip(*rows, strict=True)):
        given = {"lower": low, "upper": high, "rate_per_s": rate, "beyond_model": settings.beyond_model}
        known = CommandLimits(
            model.command_limits[k].lower, model.command_limits[k].upper, model.command_rates_per_s[k]
        )
        made.append(modelled_limits(ModelledLimitsSettings.parse(given, f"limits[{k}]"), known))
    limits = tuple(Range(lower=one.lower, upper=one.upper) for one in made)
    try:
        return dataclass_replace(model, command_limits=limits, command_rates_per_s=tuple(one.rate for one in made))
    except ModelError as error:
        raise ControllerError(f"limits: {error}") from None
