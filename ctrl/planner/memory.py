"""Memory of a `TipController`: snapshot, transitions as pure functions, and the state and plan for a planner."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.models.model import Predictor
from hystmpc.trajectories.motion import Kinematics
from hystmpc.trials.brief import brief, in_brief
from hystmpc.trials.errors import ControllerError, did_you_mean, shown
from hystmpc.trials.types import Vec

from ..command import Command, CommandLimits, Source, attempt, number_of, numbers_of, replace
from ..estimation.observer import usable_angle
from .reference import Reference, ReferenceRequest, rest_reference

if TYPE_CHECKING:
    from hystmpc.models.scheduled import MeasuredInput

    from ..guarded import GuardedController, GuardedState

_SAME_COMMAND = 1e-6  # of the command's range: two records of one command may differ by it

_ROUNDING = 1e-9  # of a limit or a time, that passes


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Complete memory of a `TipController`: equal snapshots have equal futures.

    Attributes:
        origin: kind and fingerprint of the controller that it belongs to.
        command: the last answer; at first the command that the device holds.
        sent: whether this controller has sent that command, so that the device certainly holds it.
        control: the controller's own state; None before the first usable measurement.
        reference: present reference; None before that.
        request: reference from the first usable measurement on.
        inputs: last usable value of each measured input.
        unmeasured: whether it was said that an input has no value yet.
    """

    origin: str
    command: Command
    sent: bool = False
    steps: int = 0
    control: GuardedState | None = None
    reference: Reference | None = None
    request: ReferenceRequest | None = None
    halted: bool = False
    inputs: Mapping[str, float] = field(default_factory=dict)
    unmeasured: bool = False
    __repr__ = brief

    @property
    def stopped(self) -> bool:
        """Whether the stop is latched."""
        return self.halted or (self.control is not None and self.control.stopped)

    @property
    def stop_cause(self) -> str:
        """Cause of a latched stop."""
        control = self.control
        return control.cause if control is not None and control.stopped else "by stop()"

    @property
    def disturbance_deg(self) -> float:
        """Estimated difference between device and model [deg]."""
        return 0.0 if self.control is None else self.control.known.disturbance + self.control.known.added

    @property
    def measured_deg(self) -> float:
        """Last accepted measurement [deg]; not-a-number before the first."""
        return math.nan if self.control is None else float(self.control.known.measured)

    def motion(self, t: float) -> Kinematics:
        """State of motion of the reference at `t` [s]; not-a-number if there is none or a user's function fails."""
        reference = self.reference
        motion = None if reference is None else attempt(lambda: reference.motion(t))[0]
        return motion if motion is not None and math.isfinite(motion.theta_deg) else Kinematics(math.nan)


def initial_snapshot(origin: str, command: float, sent: bool = False) -> Snapshot:
    """Return the snapshot before the start, the device holding `command`."""
    return Snapshot(origin, Command(command, Source.HOLD, "not started"), sent)


def start_control(memory: Snapshot, controller: GuardedController, y: float) -> Snapshot:
    """Return the snapshot at rest at the measured angle `y` [deg], with the request turned into a reference."""
    control = controller.init(y, memory.command.u)
    if memory.halted:
        control = controller.stop(control, "by stop()")
    request, start = memory.request, Kinematics(float(y))
    reference = rest_reference(float(y), 0.0) if request is None else request(start, 0.0)
    return replace(memory, steps=0, control=control, reference=reference, request=None)


def replay_recording(origin: str, controller: GuardedController, commands: Vec, angles: Vec) -> Snapshot:
    """Return the snapshot at time 0 after a recording of commands and angles, at rest at the last measured angle."""
    control = controller.replay(commands, angles)
    held = Command(control.estimate.command, Source.HOLD, "replayed")
    return Snapshot(origin, held, control=control, reference=rest_reference(control.due, 0.0))


def try_to_start(memory: Snapshot, controller: GuardedController, y: object) -> Snapshot:
    """Start the controller if `y` is usable; otherwise return a snapshot with a held command and the reason."""
    angle = usable_angle(y)
    after, reason = attempt(lambda: start_control(memory, controller, angle))
    if math.isnan(angle):
        reason = "no usable measurement yet; reset(angle) declares the angle of rest"
    return after or replace(memory, command=Command(memory.command.u, Source.HOLD, f"not started: {reason}"))


class HasInputs(Protocol):
    """Memory of a controller whose model depends on measured inputs; attributes as of `Snapshot`."""

    @property
    def control(self) -> Any:
        """The controller's state; None before its start."""
        ...

    @property
    def inputs(self) -> Mapping[str, float]:
        """Last usable values."""
        ...

    @property
    def unmeasured(self) -> bool:
        """Whether it was said that an input has no value yet."""
        ...


class TakesInputs(Protocol):
    """Controller whose states have values of measured inputs."""

    def with_inputs(self, state: Any, inputs: Mapping[str, float]) -> Any:
        """Return the state with the present values of measured inputs."""
        ...


AnyMemory = TypeVar("AnyMemory", bound=HasInputs)


def with_inputs(
    memory: AnyMemory, controller: TakesInputs, known: Sequence[MeasuredInput], given: object
) -> tuple[AnyMemory, str]:
    """Return the snapshot with the usable values of measured inputs, and what there is to say of the others.

    An input without a usable value keeps its last one; without any, that of the identification counts, which is said
    once. A value beyond the range of the identification counts as the nearest one.
    """
    if not known and given is None:
        return memory, ""
    names, notes = {one.name: one for one in known}, list[str]()
    if not isinstance(given, Mapping | None):
        notes.append(f"inputs: got {shown(given, 40)}, expected a mapping of numbers by name")
        given = None
    values = dict(memory.inputs)
    for name, value in (given or {}).items():
        number = number_of(value)
        if name not in names:
            notes.append(f"inputs: no {shown(name, 40)}, {did_you_mean(str(name), names)}")
        elif number is None or not math.isfinite(number):
            last = "its last value holds" if name in values else "the identified one counts"
            notes.append(f"input {name}: got {shown(value, 40)}, expected a finite number; {last}")
        else:
            values[name] = number
            one = names[name]
            if not one.lower <= number <= one.upper:
                notes.append(
                    f"input {name}: {number:.4g}, identified {one.lower:.4g} to {one.upper:.4g}: the nearest counts"
                )
    missing = [f"{one.name} {one.reference:.4g}" for one in known if one.name not in values]
    if missing and not memory.unmeasured and memory.control is not None:
        notes.append(f"inputs: none given of {', '.join(missing)}, the identified value counts")
        memory = _changed(memory, unmeasured=True)
    if memory.control is not None and values:
        memory = _changed(memory, control=controller.with_inputs(memory.control, values))
    return _changed(memory, inputs=values), "; ".join(notes)


def _changed(memory: AnyMemory, **changes: object) -> AnyMemory:
    return cast(AnyMemory, replace(cast(Any, memory), **changes))  # a data class, which no protocol can say


class HasStatus(Protocol):
    """Command of a step, with what was unusual."""

    @property
    def status(self) -> str:
        """`ok`, or what was unusual."""
        ...


AnyCommand = TypeVar("AnyCommand", bound=HasStatus)


def also_said(command: AnyCommand, said: str) -> AnyCommand:
    """Command whose status also has a text; unchanged for an empty one."""
    if not said:
        return command
    status = said if command.status == "ok" else f"{command.status}; {said}"
    return cast(AnyCommand, replace(cast(Any, command), status=status))


def set_request(memory: Snapshot, request: ReferenceRequest, dt: float, start: Kinematics) -> Snapshot:
    """Set the requested reference, from the state of motion `start` on; before the start, store the request.

    Raises:
        ControllerError: if the stop is latched.
        TrajectoryError: if no motion is found.
    """
    if memory.stopped:
        raise ControllerError("the stop is latched: got a new reference, expected reset() first")
    if memory.control is None:
        return replace(memory, request=request)
    if math.isnan(start.theta_deg):  # the present reference fails: start from the tip's position
        start = Kinematics(memory.measured_deg)
    return replace(memory, reference=request(start, memory.steps * dt))


def halted(memory: Snapshot, controller: GuardedController, cause: str = "by stop()") -> Snapshot:
    """Return the snapshot with the stop latched."""
    control = None if memory.control is None else controller.stop(memory.control, cause)
    return replace(memory, control=control, halted=True)


def holding(control: GuardedState | None, controller: GuardedController, held: float) -> GuardedState | None:
    """Set the command `held` in the controller's state: the next command is limited from it."""
    if control is None or control.known.command == held:
        return control
    return controller.holding(control, held)


def skipped(memory: Snapshot, controller: GuardedController, cause: str) -> Snapshot:
    """Return the snapshot after a sample without a command: the device holds, also in a stop with a ramp."""
    control, held = memory.control, memory.command.u
    if control is None:
        return memory
    if memory.stopped:  # a step would compute the next command of the ramp
        command = replace(memory.command, source=Source.STOP, status=f"stopped: latched {memory.stop_cause}; {cause}")
    else:
        command, control = controller.step(control, math.nan, np.empty(0))
        command = replace(command, status=f"reference: {cause}")
    command = replace(command, u=held)
    return replace(memory, steps=memory.steps + 1, control=holding(control, controller, held), command=command)


def take_up(memory: Snapshot, present: Snapshot, controller: GuardedController, held: float) -> Snapshot:
    """Restore or replay a memory in place of the present one, the device holding `held`; a latched stop remains."""
    command = memory.command
    if command.u != held:
        command = replace(command, u=held, status=f"taken up, the device holds {held:.6g}")
    control = holding(memory.control, controller, held)
    memory = replace(memory, command=command, control=control, sent=present.sent)
    return halted(memory, controller, present.stop_cause) if present.stopped else memory


def held_after_replay(memory: Snapshot, present: Snapshot, limits: CommandLimits) -> float:
    """Return the command that the device holds after a recording: its newest, which must equal the one sent last.

    Raises:
        ControllerError: if this controller has sent another one.
    """
    newest, sent = memory.command.u, present.command.u
    if not present.sent:
        return newest
    if abs(newest - sent) > _SAME_COMMAND * (limits.upper - limits.lower):
        raise ControllerError(
            f"replay: got a recording that ends at command {newest:.6g}, expected {sent:.6g}, which this controller "
            "sent last; say with held= which of them the device holds"
        )
    return sent


def require_within(command: object, limits: CommandLimits, what: str) -> float:
    """Convert `command` to a number and check that it lies within the limits.

    Raises:
        ControllerError: if it is none.
    """
    number = number_of(command)
    if number is None or not limits.lower <= number <= limits.upper:
        raise ControllerError(f"{what} {shown(command)}, expected {limits.lower} to {limits.upper}")
    return number


def require_number(value: object, what: str) -> float:
    """Convert `value` to a number; not-a-number is allowed.

    Raises:
        ControllerError: if it is none.
    """
    number = number_of(value)
    if number is None:
        raise ControllerError(f"{what}: got {shown(value)}, expected a number")
    return number


def require_usable(snapshot: object, origin: str, limits: CommandLimits, controller: GuardedController) -> Snapshot:
    """Check that this controller can continue from a snapshot, and return it.

    Raises:
        ControllerError: if it is none, belongs to another controller, or holds a command beyond the limits.
    """
    if not isinstance(snapshot, Snapshot):
        raise ControllerError(f"restore: got {type(snapshot).__name__}, expected what snapshot() returns")
    if snapshot.origin != origin:
        raise ControllerError(
            f"restore: got a snapshot of {snapshot.origin!r}, expected one of {origin!r}: the same kind of controller, "
            "settings, limits and model"
        )
    if snapshot.control is not None:
        controller.check_state(snapshot.control)
    commands = (
        [snapshot.command.u] if snapshot.control is None else [snapshot.command.u, snapshot.control.known.command]
    )
    if not all(limits.lower <= u <= limits.upper for u in commands):
        raise ControllerError(
            f"restore: got a snapshot with command {snapshot.command.u}, expected {limits.lower} to {limits.upper}"
        )
    return snapshot


@dataclass(frozen=True)
class TipState:
    """State of the controller between two steps.

    Attributes:
        time_s: end of the running sample: steps taken times the sample time.
        measured_deg: last accepted measurement, made at the beginning of the running sample; NaN before the first.
            Without a sensor: the model's angle.
        predicted_deg: angle expected at the end of it, disturbance included; NaN without a model.
        reference_deg, reference_velocity_deg_s: reference at the same time.
        command: the command that is being held [mm or bar].
        disturbance_deg: estimated difference between device and model.
        sigma_deg: standard deviation of the error of the estimated angle, by the Kalman filters; without a sensor, the
            error of the model's free runs. NaN if unknown.
        source, status: of that command.
        done: whether the reference has ended.
        settled: done, and the measurement is within the tolerance.
        stopped: whether the stop is latched, by `stop` or after repeated failures.
    """

    time_s: float
    measured_deg: float
    predicted_deg: float
    reference_deg: float
    reference_velocity_deg_s: float
    command: float
    disturbance_deg: float
    sigma_deg: float
    source: Source
    status: str
    done: bool
    settled: bool
    stopped: bool
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class TipPlan:
    """Planned commands and predictions; rows belong to the running and the next samples (H,).

    Attributes:
        time_s: ends of the samples.
        command: planned commands; only the one that is held where the controller does not plan.
        predicted_deg: angles at these ends, disturbance included; as many as are known.
        reference_deg: reference at these ends; NaN before the start.
        sigma_deg: standard deviation of the error of each predicted angle: that of the estimate now, and what drift and
            motion of the model's noise add until then; NaN where it is not known.
    """

    time_s: Vec
    command: Vec
    predicted_deg: Vec
    reference_deg: Vec
    sigma_deg: Vec

    def __repr__(self) -> str:
        ends = (self.time_s[0], self.time_s[-1], self.command[0], self.command[-1])
        text = "{} samples, {:.4g} to {:.4g} s: command {:.4g} to {:.4g}".format(self.time_s.size, *ends)
        known = self.predicted_deg.size > 0
        more = f", {self.predicted_deg[-1]:.4g} deg predicted, sigma {self.sigma_deg[-1]:.2g} deg" if known else ""
        return in_brief(self, text + more)


def tip_state(memory: Snapshot, controller: GuardedController, tolerance_deg: float) -> TipState:
    """Return the state of the controller, from a snapshot."""
    now, command = memory.steps * controller.dt, memory.command
    motion, measured = memory.motion(now), memory.measured_deg
    done = memory.reference is not None and now >= memory.reference.end_s - _ROUNDING
    return TipState(
        time_s=now,
        measured_deg=measured,
        predicted_deg=float(command.predicted[0]) if command.predicted.size else math.nan,
        reference_deg=motion.theta_deg,
        reference_velocity_deg_s=motion.velocity_deg_s,
        command=command.u,
        disturbance_deg=memory.disturbance_deg,
        sigma_deg=math.nan if memory.control is None else controller.sigma_deg(memory.control),
        source=command.source,
        status=command.status,
        done=done,
        settled=done and abs(measured - motion.theta_deg) <= tolerance_deg,
        stopped=memory.stopped,
    )


def tip_plan(memory: Snapshot, controller: GuardedController) -> TipPlan:
    """Return the plan of the last step, from a snapshot."""
    dt = controller.dt
    command, reference = memory.command, memory.reference
    planned = command.plan if command.plan.size else np.array([command.u])
    times = dt * (memory.steps + np.arange(max(planned.size, command.predicted.size), dtype=np.float64))
    wanted = None if reference is None else attempt(lambda: reference.at(times))[0]
    reference_deg = np.full(times.size, np.nan) if wanted is None else wanted
    return TipPlan(times, planned, command.predicted, reference_deg, _sigma_of_plan(memory, controller, planned))


def _sigma_of_plan(memory: Snapshot, controller: GuardedController, planned: Vec) -> Vec:
    """Standard deviations of the predicted angles at the ends of the running and the next samples [deg]."""
    control, rows = memory.control, memory.command.predicted.size
    if control is None or not rows:
        return np.full(rows, np.nan)
    coming = np.concatenate([planned[1:], np.full(rows, planned[-1])])[: rows - 1]
    return np.concatenate([[controller.sigma_deg(control)], controller.sigma_ahead_deg(control, coming)])


def predicted_angles(
    predictor: Predictor, limits: CommandLimits, memory: Snapshot, controller: GuardedController, commands: ArrayLike
) -> Vec:
    """Predict the angles [deg], disturbance included, at the ends of the samples of one plan (N,) or several (K, N)."""
    plans, control = usable_plans(predictor, limits, memory, commands)
    under_way = np.array(control.estimate.angles[1:])  # of commands already sent that have not acted yet
    new = predictor.rollout(controller.model_state(control), plans)
    angles = np.hstack([np.tile(under_way, (len(plans), 1)), new])[:, : plans.shape[1]] + control.known.disturbance
    return angles.reshape(np.shape(commands))


def predicted_sigmas(
    predictor: Predictor, limits: CommandLimits, memory: Snapshot, controller: GuardedController, commands: ArrayLike
) -> Vec:
    """Standard deviations of the errors of `predicted_angles` [deg], of the same shape."""
    plans, control = usable_plans(predictor, limits, memory, commands)
    return np.array([controller.sigma_ahead_deg(control, plan) for plan in plans]).reshape(np.shape(commands))


def usable_plans(
    predictor: Predictor, limits: CommandLimits, memory: Snapshot, commands: ArrayLike
) -> tuple[Vec, GuardedState]:
    """Return plans (K, N) checked against the limits, and the state of the controller from which they start.

    Raises:
        ControllerError: if there is no estimate of a model's state, or a plan is not finite or beyond the limits.
    """
    control = memory.control
    if control is None or not control.estimate.angles:
        reason = "has not started" if control is None else "has no model"
        raise ControllerError(f"predict: the controller {reason}, expected one with a model after its first step")
    plans, last = np.atleast_2d(numbers_of(commands)), control.known.command
    moves = np.abs(np.diff(plans, axis=-1, prepend=last))
    low, high, reach = limits.lower - _ROUNDING, limits.upper + _ROUNDING, limits.rate * predictor.dt * (1 + _ROUNDING)
    if plans.ndim != 2 or not plans.size or not np.all((plans >= low) & (plans <= high) & (moves <= reach + _ROUNDING)):
        raise ControllerError(
            f"predict: got plans of shape {plans.shape}, expected (N,) or (K, N) finite commands within "
            f"{limits.lower:g} to {limits.upper:g} at {limits.rate:g} per second from {last:.6g} on"
        )
    return plans, control
