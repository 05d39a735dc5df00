"""Controller for motion planners: set a target or a preview, step, read state and plan, stop."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import partial
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, Self, cast, final

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trajectories.motion import Kinematics
from hystmpc.trials.brief import in_brief
from hystmpc.trials.errors import ControllerError, shown
from hystmpc.trials.types import Vec

from ..command import Command, attempt, numbers_of, replace
from .memory import (
    Snapshot,
    TipPlan,
    TipState,
    also_said,
    halted,
    held_after_replay,
    holding,
    initial_snapshot,
    predicted_angles,
    predicted_sigmas,
    replay_recording,
    require_number,
    require_usable,
    require_within,
    set_request,
    skipped,
    start_control,
    take_up,
    tip_plan,
    tip_state,
    try_to_start,
    with_inputs,
)
from .reach import Reach
from .reference import ReferenceRequest, given_request, waypoint_request
from .settings import TipSettings, of_two_axes, read_settings

if TYPE_CHECKING:
    from ..guarded import GuardedState
    from .settings import Assembly


_ROUNDS = 3  # evaluations of a reference within one step, if another thread sets a new one each time


@final
class TipController:
    """Controller with its clock and its reference: one call per sample, new targets at any time.

        tip = TipController.from_config("tip.yaml")
        tip.set_target(60.0)
        while not tip.state().settled:
            device.send(tip.step(device.measure()).u)

    `step` never raises and never leaves the limits, for any measurement; everything else raises `ControllerError` with
    one line. Time is the number of steps times the sample time. All methods may be called from any thread while one
    thread steps; each waits for at most one step of the controller itself: a reference function is evaluated outside
    the lock, however long it takes, and `stop` meanwhile is honoured by that very step.

    All memory is one frozen `Snapshot`. Only `reset` releases a latched stop. After a restore, replay or reset the next
    command is limited from the last one sent, unless the caller gives another held command.

    Raises:
        ControllerError: if the start command is beyond the limits.
    """

    def __init__(self, assembly: Assembly, settings: TipSettings) -> None:
        limits, start = assembly.limits, settings.start_command
        start = assembly.rests_at if start is None else start
        if not limits.lower <= start <= limits.upper:
            raise ControllerError(f"start_command: got {start}, expected {limits.lower} to {limits.upper}")
        self._assembly, self._settings, self._lock = assembly, settings, RLock()
        self._motion = settings.motion
        self._controller = assembly.controller
        self._nothing = np.empty(0)  # empty reference: the controller holds
        self._ahead: Vec = self.dt * np.arange(1, self._controller.horizon + 1, dtype=np.float64)
        self._origin = assembly.origin(settings)
        self._memory = initial_snapshot(self._origin, start)

    @classmethod
    def from_config(cls, source: Path | str | Mapping[str, Any] | TipSettings) -> Self:
        """Build a controller that is ready to step: files opened, first steps taken.

        A model of two bending axes gives a `TwoAxisTipController`: the same calls, with arrays of both axes.

        Args:
            source: a YAML file or mapping, see `TipSettings`; relative file names start at the file's folder.

        Raises:
            ConfigError: on an unknown key (with the nearest right one) or a value out of bounds.
            ModelError: if a model file is missing or unusable.
            ControllerError: if the settings contradict each other or the model.
            FitError: if a network has no `inverse` and none can be fitted.
        """
        from .settings import assemble  # CasADi and onnxruntime take long to import

        if of_two_axes(source):
            from ..two_axes.tip_controller import TwoAxisTipController

            return cast(Self, TwoAxisTipController.from_settings(cast(Any, source)))
        settings, folder = read_settings(source)
        return cls(assemble(settings, folder), settings)

    def __repr__(self) -> str:
        settings, memory, limits = self._settings, self._memory, self._assembly.limits
        model = f"{settings.controller.kind} on {Path(settings.model).name}, every {self.dt:.4g} s"
        now = f"{memory.measured_deg:.4g} deg at {memory.command.u:.4g} {self._assembly.unit}"
        word = "stopped" if memory.stopped else str(memory.command.source)
        return in_brief(self, f"{model}, {limits}; step {memory.steps}: {now}, {word}")

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._controller.dt

    def step(self, measured_theta_deg: float, refusal: str = "", inputs: Mapping[str, float] | None = None) -> Command:
        """Compute the command to send now, and advance the clock by one sample.

        Args:
            measured_theta_deg: present tip angle [deg]; NaN if there is none. The first usable one starts the
                controller at rest there; until then the start command is held.
            refusal: why there is no time for a plan in this sample: the fallbacks answer, and the status tells why.
            inputs: present values of measured inputs of the model by name, held over the preview. One that is left out
                or no finite number keeps its last value, or that of the identification, and the status tells it.
        """
        with self._lock:
            self._memory, said = with_inputs(self._memory, self._controller, self._assembly.predictor.inputs, inputs)
        return also_said(self._stepped(measured_theta_deg, refusal), said)

    def _stepped(self, measured_theta_deg: float, refusal: str) -> Command:
        for _ in range(_ROUNDS):
            with self._lock:
                memory = self._memory
                if memory.control is None:
                    memory = try_to_start(memory, self._controller, measured_theta_deg)
                    self._memory = memory
                reference = memory.reference
                if reference is None or memory.stopped:
                    return self._answer(measured_theta_deg, self._nothing, "", refusal)
                ahead: Vec = memory.steps * self.dt + self._ahead
                if not reference.foreign:
                    return self._answer(measured_theta_deg, *attempt(partial(reference.at, ahead)), refusal)
            wanted, fault = attempt(partial(reference.at, ahead))  # a user's code: anything may happen meanwhile
            with self._lock:
                now = self._memory
                if now.stopped or (now.reference is reference and now.steps == memory.steps):
                    return self._answer(measured_theta_deg, wanted, "" if now.stopped else fault, refusal)
        with self._lock:
            fault = "another was set each time this one was evaluated"
            return self._answer(measured_theta_deg, None, fault, refusal)

    def skip(self) -> Command:
        """Advance by one sample in which nothing was sent and the device held; the command returned says so."""
        with self._lock:
            self._memory = skipped(self._memory, self._controller, "sample skipped, command held")
            return self._memory.command

    def took(self, steps: int, command: Command, control: GuardedState | None = None) -> None:
        """Take over samples in which the same controller was stepped elsewhere, such as in the control loop in C.

        Args:
            command: answer of the last of them.
            control: the controller's state after it; None if further samples follow.

        Raises:
            ControllerError: if the command is beyond the limits, or `steps` is no whole number.
        """
        u = require_within(getattr(command, "u", None), self._assembly.limits, "took: got command")
        whole = require_number(steps, "took: steps")
        if not (whole >= 0 and whole < math.inf and whole == int(whole)):
            raise ControllerError(f"took: got {shown(steps)} steps, expected a whole number")
        with self._lock:
            memory = self._memory
            after = holding(memory.control if control is None else control, self._controller, u)
            self._memory = replace(memory, steps=memory.steps + int(whole), control=after, command=command, sent=True)

    def measure(self, theta_deg: float, taken_at_s: float) -> None:
        """Update the estimate by a frame of an intermittent sensor, taken in the past; between frames `step` gets NaN.

        The estimate is corrected at that instant and predicted forward. The first frame starts the controller, at rest.

        Args:
            theta_deg: tip angle in the frame [deg].
            taken_at_s: when it was taken, on the clock of `state().time_s` [s].

        Raises:
            ControllerError: if the angle or the time cannot be used, or the controller's sensor is not intermittent.
        """
        controller = self._controller
        angle, taken_s = require_number(theta_deg, "measure: angle"), require_number(taken_at_s, "measure: time")
        with self._lock:
            memory = self._memory
            if memory.control is None:
                self._memory = start_control(memory, controller, angle)
                return
            control = controller.measure(memory.control, angle, memory.steps - taken_s / self.dt)
            self._memory = replace(memory, control=control)

    def _answer(self, measured_theta_deg: float, wanted: Vec | None, fault: str, refusal: str) -> Command:
        """Compute the command of this sample and store it as sent, under the lock."""
        memory = self._memory
        command, control = memory.command, memory.control
        if control is None:
            self._memory = replace(memory, sent=True)
            return command
        preview = self._nothing if wanted is None else wanted
        if refusal:
            control = replace(control, refusal=refusal)
        command, control = self._controller.step(control, measured_theta_deg, preview)
        if fault:
            command = replace(command, status=f"reference: {fault}")
        self._memory = replace(memory, steps=memory.steps + 1, control=control, command=command, sent=True)
        return command

    def set_target(self, theta_deg: float) -> Reach:
        """Move to `theta_deg` [deg] and stay, by the fastest motion within the limits from the present state of motion.

        Position, velocity and acceleration of the reference are continuous. The result says whether the target can be
        reached, and the nearest reachable angle, to which the controller goes otherwise.

        Raises:
            ControllerError: if it is not a finite angle, or the stop is latched.
        """
        angle = require_number(theta_deg, "set_target")
        self._request(waypoint_request([angle], [0.0], self._motion))
        return self.reachable(angle)

    def set_waypoints(self, angles_deg: Sequence[float], holds_s: Sequence[float]) -> None:
        """Move through angles [deg] one after another and rest at each for its hold [s]; then stay at the last.

        Raises:
            ControllerError: if the counts differ, a number makes no sense, or the stop is latched.
        """
        self._request(waypoint_request(angles_deg, holds_s, self._motion))

    def set_reference(self, source: Callable[[Any], Any] | ArrayLike) -> None:
        """Follow a preview exactly as given, from the next sample on.

        Args:
            source: a function of the seconds since this call, such as a trajectory; or reference angles (T,) [deg] at
                the ends of the coming samples, the last of which is held. A function has to be pure.

        Raises:
            ControllerError: if it is neither or does not answer with finite angles, or the stop is latched.
        """
        self._request(given_request(source, self.dt, self._motion))

    def state(self) -> TipState:
        """Return the present state of the controller."""
        return tip_state(self._memory, self._controller, self._settings.tolerance_deg)

    def plan(self) -> TipPlan:
        """Return the plan of the last step over its horizon."""
        return tip_plan(self._memory, self._controller)

    def predict(self, commands: ArrayLike) -> Vec:
        """Predict angles [deg], disturbance included, at the ends of the samples of `commands`; nothing is sent.

        Args:
            commands: one plan (N,) or several (K, N) [mm or bar], the first to be sent next; angles have its shape.

        Raises:
            ControllerError: if the controller has not started or has no model, or a plan is not finite or beyond
                the limits on value or rate.
        """
        assembly = self._assembly
        return predicted_angles(assembly.predictor, assembly.limits, self._memory, self._controller, commands)

    def predict_sigma_deg(self, commands: ArrayLike) -> Vec:
        """Standard deviations of the errors of the angles that `predict` returns [deg], of the same shape.

        With a sensor the error is that of the present estimate plus the random walk of the disturbance, see
        `NoiseModel`:

            sigma_k^2 = sigma_now^2 + k drift^2 dt + motion^2 (|du_1| + ... + |du_k|)

        Without a sensor it is the error of the model's free runs. NaN if unknown. The noise of later readings is not
        included. Arguments and exceptions are those of `predict`.
        """
        assembly = self._assembly
        return predicted_sigmas(assembly.predictor, assembly.limits, self._memory, self._controller, commands)

    def fork(self) -> Self:
        """Return an independent copy for a planner that predicts while this controller controls the device.

        It shares model, settings and limits and has its separate memory, clock and lock, so both may be stepped at the
        same time from two threads. The commands of a copy are not sent.
        """
        other = copy(self)
        other._lock = RLock()
        return other

    def reachable(self, theta_deg: float) -> Reach:
        """Return whether the model can be held at `theta_deg` [deg] within command and soft angle limits."""
        return self._assembly.workspace.judge(require_number(theta_deg, "reachable"), self._memory.disturbance_deg)

    def stop(self) -> None:
        """Hold, or ramp to the configured `safe_command`, from the next step on; latched until `reset`."""
        with self._lock:
            self._memory = halted(self._memory, self._controller)

    def reset(self, measured_theta_deg: float | None = None, command: float | None = None) -> None:
        """Reset to rest at time 0 without a target; the only call that releases a latched stop.

        Args:
            measured_theta_deg: start at this angle [deg] now; None to start with the first usable measurement.
            command: the command that the device holds; None for the one sent last.

        Raises:
            ControllerError: if the command is beyond the limits, or the controller cannot start from the angle.
        """
        with self._lock:
            held = self._memory.command.u
            if command is not None:
                held = require_within(command, self._assembly.limits, "reset: got command")
            memory = initial_snapshot(self._origin, held, command is None and self._memory.sent)
            memory = replace(memory, inputs=self._memory.inputs)
            if measured_theta_deg is not None:
                angle = require_number(measured_theta_deg, "reset: angle")
                memory = start_control(memory, self._controller, angle)
            self._memory = memory

    def replay(self, commands: ArrayLike, angles_deg: ArrayLike, held: float | None = None) -> None:
        """Reset to the state after a recording of another controller, hysteresis included; a latched stop remains.

        Args:
            commands: the last commands that were sent (T,) [mm or bar], the newest at the end.
            angles_deg: tip angles (T,) [deg] measured when each was sent; NaN where there was none. `step` takes the
                next one.
            held: the command that the device holds now, from which the next one is limited; None for the newest of
                `commands`, which then has to be the one that this controller sent last, if it has sent any.

        Raises:
            ControllerError: if the lengths differ, no angle is usable, a command is beyond the limits, or the recording
                ends at another command than this controller sent last.
        """
        sent, seen = (np.atleast_1d(numbers_of(values)) for values in (commands, angles_deg))
        memory = replay_recording(self._origin, self._controller, sent, seen)  # takes longer than a sample
        said = None if held is None else require_within(held, self._assembly.limits, "replay: got held")
        with self._lock:
            present = self._memory
            holds = held_after_replay(memory, present, self._assembly.limits) if said is None else said
            self._memory = take_up(replace(memory, inputs=present.inputs), present, self._controller, holds)

    def snapshot(self) -> Snapshot:
        """Return a snapshot of the whole state, which with the inputs determines all future commands."""
        return self._memory

    def restore(self, snapshot: Snapshot, held: float | None = None) -> None:
        """Restore the state of `snapshot`, except a latched stop and the held command.

        With a simulated device that is reset too: `restore(snapshot, held=snapshot.command.u)`, after a stop `reset`
        first.

        Args:
            held: the command that the device holds now, from which the next one is limited; None for the one sent last.

        Raises:
            ControllerError: if it is no snapshot, one of another controller, or a command is beyond the limits.
        """
        usable = require_usable(snapshot, self._origin, self._assembly.limits, self._controller)
        said = None if held is None else require_within(held, self._assembly.limits, "restore: got held")
        with self._lock:
            present = self._memory
            holds = present.command.u if said is None else said
            self._memory = take_up(usable, present, self._controller, holds)

    def _request(self, request: ReferenceRequest) -> None:
        """Set a requested reference; a user's reference is evaluated outside the lock."""
        while True:
            with self._lock:
                memory = self._memory
                reference, now_s = memory.reference, memory.steps * self.dt
                if reference is None or memory.stopped or not (request.from_motion and reference.foreign):
                    start = memory.motion(now_s) if request.from_motion else Kinematics(memory.measured_deg)
                    self._memory = set_request(memory, request, self.dt, start)
                    return
            start = memory.motion(now_s)
            with self._lock:
                now = self._memory
                if now.reference is reference and now.control is not None:
                    if now.steps != memory.steps:  # steps were taken meanwhile: use the present reference angle
                        start = replace(start, theta_deg=now.control.due)
                    self._memory = set_request(now, request, self.dt, start)
                    return
