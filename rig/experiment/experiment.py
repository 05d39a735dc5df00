"""Controllers as phases of a run: tracking of a reference after a bumpless transfer, and steering to targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, cast, final

import numpy as np

from hystmpc.ctrl.command import Command, CommandLimits, Source, modelled_limits
from hystmpc.ctrl.config import ControllerSettings, sensor_fault
from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.ctrl.monitor import ChangeMonitor, MonitorState
from hystmpc.ctrl.planner.reach import beyond_reach
from hystmpc.ctrl.planner.settings import Assembly, assemble, of_two_axes, read_settings
from hystmpc.ctrl.planner.tip_controller import TipController
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisTipController, read_two_axis_settings, within_limits
from hystmpc.models.load import model_path
from hystmpc.models.scheduled import MeasuredInput
from hystmpc.models.two_axes.model import load_two_axes
from hystmpc.trajectories.motion import Kinematics, PiecewiseCubic
from hystmpc.trajectories.ruckig_ import move_to_rest
from hystmpc.trajectories.trajectory import Trajectory, TrajectoryChain
from hystmpc.trials.errors import ConfigError, ControllerError
from hystmpc.trials.types import Vec

from ..axes import NAMES, PerAxis, each, from_array, is_known
from ..config import RunSettings
from ..live.desk import Desk, Reply
from ..recording.sample import Sink
from ..run import BenchResult, Note, run_bench
from ..safety.intake import SensorSettings
from ..safety.plausibility import AxesFrame, ModelWatch, PlausibilitySettings
from ..safety.stop import StopFlag
from ..transports.transport import PlantFactory, Transport
from .phases import REMEMBERED, Decision, Past, Phase, PhaseInput

if TYPE_CHECKING:
    from ..compiled.loop import CompiledLoop

LATE = "late: no time for a plan"
"""Why a sample that begins late is answered by the fallbacks."""

_FOR_GOOD = 1 << 62  # steps

# From the measured angle [deg] to the trajectory that starts there.
LeadIn = Callable[[PerAxis], Trajectory]


def run_experiment(
    settings: RunSettings,
    sink: Callable[[], Sink],
    plants: PlantFactory,
    *,
    folder: Path | None = None,
    note: Note = lambda text: None,
    transport: Transport | None = None,
    desk: Desk | None = None,
) -> BenchResult:
    """Run the experiment after a check of settings and model; arguments as of `run_bench`.

    With a desk the run also accepts targets; after the first target it continues until a person ends it.

    Raises:
        HystmpcError: of `tracking_phase` and `run_bench`.
    """
    tracking = tracking_phase(settings, note=note)
    if desk is not None:
        desk.take_targets(tracking.target, *tracking.reach_deg)
    return run_bench(
        settings, lambda: [tracking], sink, plants, folder=folder, note=note, transport=transport, desk=desk
    )


def tracking_phase(settings: RunSettings, threaded: bool = True, note: Note = lambda text: None) -> Tracking:
    """Build the phase that tracks the reference of an experiment, with its controller built and its first steps taken.

    Args:
        threaded: whether the transfer to the controller runs in a thread, see `Tracking`.
        note: called where the reference is beyond the model's reach.

    Raises:
        ConfigError: if model and bench differ in rate or unit, or the controller's limits exceed the bench's.
        ModelError: if a model file is missing, corrupt or unusable.
        ControllerError: if the settings of the controller contradict each other or the model, or limits exceed the
            model's without permission.
        TrajectoryError: if the reference cannot be built.
    """
    limits, tip_settings = settings.limits, settings.controller
    law = tip_settings.controller
    ladder = law.resolved().ladder
    if ladder.safe_command is None:  # a stop of the controller's own goes where the loop's would
        with_safe = {"ladder": {**ladder.model_dump(), "safe_command": settings.safe_command}}
        law = type(law).parse({**law.model_dump(exclude_unset=True), **with_safe})
        tip_settings = tip_settings.model_copy(update={"controller": law})
    tip_settings = tip_settings.model_copy(
        update={"limits": tip_settings.limits or limits, "start_command": settings.safe_command}
    )
    assembly = assemble(tip_settings, Path())
    _fits(settings, assembly)
    compiled = None
    if settings.realtime.backend != "python":
        from ..compiled.loop import compiled_loop

        compiled = compiled_loop(assembly.controller, settings.realtime.spin_s)
    tip = TipController(assembly, tip_settings)
    if line := not_measured(assembly.predictor.inputs, settings.inputs):
        note(line)
    reference = settings.reference.build()
    if beyond := beyond_reach(reference(np.linspace(0.0, reference.duration_s, 1000)), assembly.workspace.model):
        note(f"warning: the reference {beyond}")
    motion = tip_settings.motion

    def lead_in(angle_deg: float) -> Trajectory:
        segments = move_to_rest(Kinematics(angle_deg), float(reference(0.0)), motion)
        return TrajectoryChain((PiecewiseCubic(segments), reference)) if segments.size else reference

    drill = settings.drill
    fails = None if drill is None else (drill.solver_fails_from_s, drill.solver_fails_from_s + drill.solver_fails_for_s)
    watch = model_watch(settings.plausibility, law, settings.dt_s)
    monitor = ChangeMonitor(assembly.predictor.noise, settings.dt_s, assembly.workspace.model)
    return Tracking(tip, lead_in, watch, monitor, fails, settings.sensor, threaded, compiled)


def not_measured(known: Sequence[MeasuredInput], inputs: Sequence[str]) -> str:
    """Line on measured inputs of a model that no reading has; empty without one."""
    missing = [f"{one.name} {one.reference:.4g}" for one in known if one.name not in inputs]
    names = "the key `inputs` names what the device measures"
    return f"warning: the controller takes {', '.join(missing)} as identified; {names}" if missing else ""


def _fits(settings: RunSettings, assembly: Assembly) -> None:
    dt_s, unit = assembly.controller.dt, assembly.unit
    if abs(dt_s * settings.rate_hz - 1) > 1e-6:
        raise ConfigError(
            f"controller: got a model at {1 / dt_s:g} Hz, expected rate_hz {settings.rate_hz:g}; identify one at that "
            "rate (`fit --rate-hz`), or run at the model's"
        )
    if unit != settings.command_unit:
        raise ConfigError(f"controller: got a model with commands in {unit}, expected {settings.command_unit}")
    modelled_limits(settings.limits, assembly.model_limits)
    bench = settings.limits.build()
    if not bench.contains(assembly.limits):
        raise ConfigError(f"controller: got limits {assembly.limits}, expected them within the bench's {bench}")


@final
class Tracking(Phase):
    """Phase in which a `TipController` tracks a reference, starting from the present state of the device.

    The controller replays the commands and angles so far, hysteresis included. That takes longer than a sample, so a
    thread does it while the command is held. A sample after a missed deadline is answered by the fallbacks (shifted
    plan, inverse, hold); samples without a sent command count as holds for the controller.

    A frame of an intermittent sensor is used at the time at which it was taken. Then, and without a sensor, the samples
    of the hand-over count as holds too, since an old frame belongs before them, and the model has no other input.

    Args:
        lead_in: measured angle to the reference to follow.
        monitor: reports in the status that the device has changed since identification; None for two axes.
        drill_s: start and end of an exercise in which the law fails [s]; None for never.
        sensor: of the bench; continuous where left out.
        threaded: whether the transfer has its own thread; False for a computed device, so that each run is the same.
        compiled: the loop in C, which may execute whole samples.
    """

    name = "track"

    def __init__(
        self,
        tip: TipController,
        lead_in: LeadIn,
        watch: ModelWatch,
        monitor: ChangeMonitor | None,
        drill_s: tuple[float, float] | None = None,
        sensor: SensorSettings | None = None,
        threaded: bool = True,
        compiled: CompiledLoop | None = None,
    ) -> None:
        self._threaded, self._compiled = threaded, compiled
        self._tip, self._lead_in, self._watch, self._drill = tip, lead_in, watch, drill_s
        self._kind, self._rest_deg = ("continuous", None) if sensor is None else (sensor.kind, sensor.rest_deg)
        self._monitor, self._changed = monitor, ""
        self._judged: MonitorState | None = None
        self._held_samples = 0
        self._early_frames: list[tuple[float, float]] = []
        self._reference: Trajectory | None = None
        self._worker: Thread | None = None
        self._past: Past | None = None
        self._failure: Exception | None = None
        self._turn = Lock()  # of the end of the reference, and a target that comes at that moment
        self._tracks = self._stays = False
        self._k = 0

    @property
    def closed_loop(self) -> bool:
        return True

    @property
    def reach_deg(self) -> tuple[float, float]:
        """Least and greatest target angle of the controller [deg]."""
        reach = self._tip.reachable(math.nan)
        return reach.low_deg, reach.high_deg

    def target(self, angle_deg: float) -> Reply:
        """Move to an angle [deg] and hold it instead of the reference, until the end of the run; by any thread.

        Raises:
            ControllerError: if the stop is latched.
        """
        reach = self._tip.reachable(angle_deg)
        if not reach:
            return Reply(False, reach.reason)
        with self._turn:
            if not self._tracks:
                return Reply(False, "no target can be set now: the controller does not track")
            self._tip.set_target(angle_deg)
            self._stays = True
            if self._compiled is not None:
                self._compiled.interrupt()
        return Reply(True, reach.reason)

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now
        self._past = past

    def step(self, now: PhaseInput) -> Decision:
        """Hold during the hand-over, then execute one step of the controller."""
        if self._waits(now):
            return Decision(now.held, "hold", "hand-over to the controller")
        if self._failure is not None:
            raise self._failure
        for _ in range(now.skipped + self._held_samples):
            self._tip.skip()
        if self._held_samples:
            self._tip.set_reference(self._wanted)  # it begins now
            self._held_samples = 0
        now_s = self._tip.dt * self._tip.snapshot().steps
        for angle, taken_s in [*self._early_frames, *((frame.angle_deg, now_s - frame.age_s) for frame in now.frames)]:
            with suppress(ControllerError):  # older than what the controller remembers
                self._tip.measure(angle, taken_s)
        self._early_frames.clear()
        control = None if self._monitor is None else self._tip.snapshot().control
        if self._kind == "continuous" and control is not None and control.estimate.angles:
            self._judge(now.angle_deg, control.estimate.angles[0] - control.estimate.added)
        angle = now.angle_deg if self._kind == "continuous" else math.nan
        command = self._tip.step(angle, self._refusal(now), now.inputs or None)
        self._k += 1 + now.skipped
        return self._decision(command, self._due_deg())

    def compiled(self) -> CompiledLoop | None:
        """Loop in C, once the controller tracks and before the reference ends."""
        if not self._tracks or self._kind != "continuous" or self._drill is not None:
            return None
        return self._compiled

    def taken_in_c(self, flag: StopFlag) -> Generator[tuple[Any, Decision]]:
        tip, memory, loop = self._tip, self._tip.snapshot(), self.compiled()
        reference, control = memory.reference, memory.control
        if loop is None or control is None or reference is None or self._reference is None:
            return
        estimate, over = control.estimate, math.ceil(self._reference.duration_s / tip.dt)
        over += (over * tip.dt < self._reference.duration_s) - ((over - 1) * tip.dt >= self._reference.duration_s)
        known, stalled, command = bool(estimate.angles), estimate.stalled, None
        model = estimate.angles[0] - estimate.added if known else math.nan
        loop.take_up(control)
        numbers = {**self._watch.numbers(), "steps": memory.steps}
        end = _FOR_GOOD if self._stays else memory.steps + over - self._k
        with closing(loop.samples(numbers, lambda steps: reference.at(tip.dt * steps), end, flag)) as samples:
            for sample in samples:
                if known:
                    self._judge(sample.angle_deg, model)
                command = loop.command(sample, stalled, LATE)
                model, stalled = sample.model_deg, sample.stalled
                tip.took(1 + sample.skipped, command)
                self._k += 1 + sample.skipped
                yield sample, self._decision(command, sample.due_deg)
        if command is not None:
            tip.took(0, command, loop.after(control))

    def _due_deg(self) -> PerAxis:
        """Reference angle at the end of the sample [deg]."""
        if self._monitor is None:
            return from_array(self._tip.state().reference_deg)
        control = self._tip.snapshot().control
        return math.nan if control is None else control.due

    def _judge(self, angle_deg: float, model: float) -> None:
        """Compare predicted and measured angle; test once a second whether the device has changed."""
        if self._monitor is None:
            return
        if self._judged is None:
            self._judged = self._monitor.init(model, angle_deg)
        self._judged = self._monitor.advance(self._judged, model, angle_deg)
        if self._k % max(round(1.0 / self._tip.dt), 1) == 0:
            change = self._monitor.change(self._judged)
            self._changed = f"; {change.sign}" if change.certain else ""

    def _waits(self, now: PhaseInput) -> bool:
        """Whether the transfer to the controller lasts; it starts with the first usable angle, or without a sensor."""
        past = self._past
        if past is not None:
            past.keep(now, self._tip.dt)
            if is_known(now.angle_deg) or self._kind == "none":
                self._past = None
                self._worker = Thread(target=self._hand_over, args=(past,), name="hand-over", daemon=True)
                self._worker.start()
                if not self._threaded:
                    self._worker.join()
            return True
        waits = self._worker is not None and self._worker.is_alive()
        if waits and self._kind != "continuous":
            now_s = self._tip.dt * (self._held_samples + now.skipped)
            self._early_frames += [(frame.angle_deg, now_s - frame.age_s) for frame in now.frames]
            self._held_samples += 1 + now.skipped
        return waits

    def _hand_over(self, past: Past) -> None:
        try:
            if self._rest_deg is not None:
                self._declare(past, self._rest_deg)
            self._tip.replay(past.commands, past.angles_deg)
            angle = past.angles_deg[-1] if self._kind == "continuous" else present_angle(self._tip)
            self._reference = self._lead_in(angle)
            self._tip.set_reference(self._wanted)
        except Exception as error:  # noqa: BLE001 - raised again in the loop, which stops safely
            self._failure = error

    @staticmethod
    def _declare(past: Past, rest_deg: float) -> None:
        """Set the declared rest angle at the first sample of the history, which has to start at rest."""
        if len(past.commands) >= REMEMBERED:
            raise ConfigError(f"sensor.rest_deg: got {len(past.commands)} samples since the rest, expected fewer")
        past.angles_deg[:] = [rest_deg, *([math.nan] * (len(past.commands) - 1))]

    def _wanted(self, t: Vec) -> Vec:
        assert self._reference is not None
        return self._reference(t)

    def _refusal(self, now: PhaseInput) -> str:
        if now.late or now.skipped:
            return LATE
        t = self._k * self._tip.dt
        if self._drill is not None and self._drill[0] <= t < self._drill[1]:
            return "drill: solver made to fail"
        return ""

    def _decision(self, command: Command, due_deg: PerAxis) -> Decision:
        reference = self._reference
        assert reference is not None
        t = self._k * self._tip.dt
        with self._turn:
            over = t >= reference.duration_s and not self._stays
            self._tracks = not over
        return replace(decision_of(command, due_deg, self._watch, self._changed), finished=over)


def decision_of(command: Command, due_deg: PerAxis, watch: ModelWatch, note: str = "") -> Decision:
    """Decision from a controller's command; a stop of the controller or a large model error is a fault.

    Of two axes the greater model error counts.

    `due_deg` is the reference angle at the end of the sample [deg]; `note` is appended to the status.
    """
    predicted = from_array(command.predicted[0]) if command.predicted.size else math.nan
    stopped = command.source is Source.STOP
    return Decision(
        u=from_array(command.u),
        source=str(command.source),
        status=command.status + note,
        reference_deg=due_deg,
        predicted_deg=predicted,
        stages_s=(*command.timing.stages.items(), ("total", command.timing.total_s)),
        fault=f"controller {command.status}" if stopped else watch.judge(_greatest(command.disturbance)),
    )


def _greatest(disturbance_deg: PerAxis) -> float:
    """Estimated disturbance of the axis with the greater one [deg]; not-a-number only where none is known."""
    return max(each(from_array(disturbance_deg)), key=lambda one: -1.0 if math.isnan(one) else abs(one), default=0.0)


def model_watch(plausibility: PlausibilitySettings, law: ControllerSettings, dt_s: float) -> ModelWatch:
    """Monitor of a controller's model error, bounded by the disturbance limit of its estimator."""
    estimator = law.resolved().estimator
    limit = estimator.disturbance_limit_deg if isinstance(estimator, EstimatorSettings) else math.inf
    return ModelWatch(plausibility, limit, dt_s)


def present_angle(tip: TipController) -> float:
    """Present tip angle as estimated by the controller [deg]; the last measured angle without a model."""
    control = tip.snapshot().control
    assert control is not None
    estimate = control.estimate
    return estimate.angles[0] + estimate.disturbance if estimate.angles else estimate.measured


@final
class Steering(Phase):
    """Phase in which a `TipController` starts at rest at the present command and accepts targets by any thread.

    It steps as `Tracking` does: samples without a sent command count as holds, a late sample is answered by the
    fallbacks, and a large model error is a fault. It has no regular end.

    Attributes:
        tip: the controller, for targets, its state and its stop; of a model of two axes a `TwoAxisTipController`.
        limits: of the command; of two axes a tuple of both.
        unit: of the command, mm or bar.
        safe_command: target of a stop; NaN rests in place.
        frame: coordinates in which the motion of two axes is watched; None for one axis.

    Raises:
        ConfigError: if the controller's file cannot be used, its controller wants no continuous sensor, or a model of
            two axes has more than two commands.
        HystmpcError: of `assemble`.
    """

    name = "steer"

    def __init__(self, config: Path | str) -> None:
        self.frame: AxesFrame | None = None
        self._open_in_plane(config) if of_two_axes(config) else self._open(config)
        if fault := sensor_fault(self._settings, "continuous"):
            raise ConfigError(f"{config}: controller.{fault}")
        self.watch(PlausibilitySettings())

    def _open(self, config: Path | str) -> None:
        settings, folder = read_settings(config)
        self._settings = settings.controller
        assembly = assemble(settings, folder)
        self.tip = TipController(assembly, settings)
        self.limits: CommandLimits = assembly.limits
        self.unit = assembly.unit
        safe = self._settings.resolved().ladder.safe_command
        self.safe_command: PerAxis = math.nan if safe is None else safe

    def _open_in_plane(self, config: Path | str) -> None:
        settings, folder = read_two_axis_settings(config)
        model = within_limits(load_two_axes(model_path(settings.model, folder)), settings.limits)
        if (count := len(model.command_limits)) != len(NAMES):
            raise ConfigError(
                f"{config}: got a model of {count} commands, expected two: Clarke's coordinates of tendons"
            )
        self._settings, self.unit, self.frame = settings.controller, model.axes[0].command_unit, AxesFrame.of(model)
        # The loop passes on what it gets: a controller and limits of both axes in place of those of one.
        self.tip = cast(TipController, TwoAxisTipController(model, settings))
        ends = zip(model.command_limits, model.command_rates_per_s, strict=True)
        self.limits = cast(CommandLimits, tuple(CommandLimits(one.lower, one.upper, rate) for one, rate in ends))
        safe = self._settings.resolved().ladder.safe_command
        travels = (math.nan if safe is None else safe,) * len(NAMES)
        self.safe_command = from_array(model.commands(travels))

    def watch(self, plausibility: PlausibilitySettings) -> None:
        """Restart the monitor of the model error with these settings."""
        self._plausibility = plausibility
        self._watch = model_watch(plausibility, self._settings, self.tip.dt)

    def begin(self, now: PhaseInput, past: Past) -> None:
        """Wait for the first usable angle."""
        del now, past
        self._started = False
        self.watch(self._plausibility)

    def step(self, now: PhaseInput) -> Decision:
        """Hold until there is an angle, of two axes both, then execute one step of the controller."""
        if not self._started:
            if not is_known(now.angle_deg):
                return Decision(now.held, "hold", "waits for an angle")
            self.tip.reset(now.angle_deg, now.held)
            self._started = True
        else:
            for _ in range(now.skipped):
                self.tip.skip()
        command = self.tip.step(now.angle_deg, LATE if now.late or now.skipped else "")
        if self.frame is None:
            control = self.tip.snapshot().control
            due_deg = math.nan if control is None else control.due
        else:
            due_deg = from_array(self.tip.state().reference_deg)
        return decision_of(command, due_deg, self._watch)
