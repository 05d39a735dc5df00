"""Closed loop on a simulated clock: interfaces of controller and plant, simulated angle sensors, loop and log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Protocol, TypeVar, final

import numpy as np
from pydantic import Field
from threadpoolctl import threadpool_limits

from hystmpc.trials.brief import brief
from hystmpc.trials.config import NotNegative, Settings
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .command import Command

_OLDEST_S, _GAP_S = 1.0, 2.0  # least values for a controller
_JITTERS, _PERIODS = (
    4.0,
    5.0,
)  # a delay of so many standard deviations, or so many successive lost frames, is still usual


class SimulatedSensorSettings(Settings):
    """Base class of the settings of simulated sensors."""

    def estimator_keys(self) -> Mapping[str, Any]:
        """Return the keys of a controller's block `estimator` that follow from this sensor."""
        return {}


class ContinuousSensorSettings(SimulatedSensorSettings):
    """Continuous sensor: the plant's angle in every sample."""

    kind: Literal["continuous"] = "continuous"


class NoSensorSettings(SimulatedSensorSettings):
    """No sensor; the angle at rest before the first sample is declared."""

    kind: Literal["none"] = "none"

    def estimator_keys(self) -> Mapping[str, Any]:
        return {"sensor": "none"}


class ImagingSettings(SimulatedSensorSettings):
    """Imaging system that measures the angle in frames.

    Attributes:
        rate_hz: frames per second.
        latency_s: from the exposure of a frame to its angle [s].
        jitter_s: standard deviation of the latency, which is never below zero [s]; frames may overtake each other.
        dropout_share: share of lost frames.
        noise_deg: standard deviation of the angle of a frame [deg].
    """

    kind: Literal["intermittent"] = "intermittent"
    rate_hz: Annotated[float, Field(ge=0.2, le=100)] = 5.0
    latency_s: Annotated[float, Field(ge=0, le=2)] = 0.2
    jitter_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    dropout_share: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    noise_deg: NotNegative = 0.0

    def estimator_keys(self) -> Mapping[str, Any]:
        oldest = self.latency_s + _JITTERS * self.jitter_s
        times = {
            "oldest_frame_s": max(_OLDEST_S, oldest),
            "longest_gap_s": max(_GAP_S, oldest + _PERIODS / self.rate_hz),
        }
        noise = {"sensor_sigma_deg": self.noise_deg} if self.noise_deg else {}
        return {"sensor": "intermittent", **times, **noise}


AnySensorSettings = ContinuousSensorSettings | NoSensorSettings | ImagingSettings
SimulatedSensor = Annotated[AnySensorSettings, Field(discriminator="kind")]


@dataclass(frozen=True)
class ImageFrame:
    """Angle in a frame [deg], with the times of exposure and arrival [s]."""

    angle_deg: float
    taken_s: float
    arrives_s: float


@dataclass(frozen=True)
class Imaging:
    """State of an imaging system during a run; frame n = 0, 1, ... is taken at n / rate_hz.

    Frame 0 shows the rest before the run and is known at its start. Random numbers of frame n depend on seed and n
    alone.

    Attributes:
        time_s, angle_deg: present time and angle of the device.
        newest: the frame taken last among those that have arrived.
        under_way: frames that have been taken and have not arrived.
    """

    settings: ImagingSettings
    seed: int
    time_s: float
    angle_deg: float
    newest: ImageFrame
    coming: int = 1
    under_way: tuple[ImageFrame, ...] = ()

    @classmethod
    def at_rest(cls, settings: ImagingSettings, seed: int, angle_deg: float) -> Imaging:
        """Return the imaging system at time 0, the device at rest at `angle_deg` [deg]."""
        return cls(settings, seed, 0.0, angle_deg, _frame(settings, seed, 0, angle_deg))

    def later(self, time_s: float, angle_deg: float) -> tuple[tuple[ImageFrame, ...], Imaging]:
        """Return the frames that arrive until `time_s` [s], in the order of arrival, and the imaging system then.

        Args:
            angle_deg: of the device then [deg]; its velocity is constant between two calls.
        """
        new, coming = [], self.coming
        while (taken_s := coming / self.settings.rate_hz) <= time_s:
            share = (taken_s - self.time_s) / (time_s - self.time_s) if time_s > self.time_s else 1.0
            angle = self.angle_deg + share * (angle_deg - self.angle_deg)
            new.append(_frame(self.settings, self.seed, coming, angle))
            coming += 1
        known = sorted((*self.under_way, *new), key=lambda frame: frame.arrives_s)
        arrived = tuple(frame for frame in known if frame.arrives_s <= time_s)
        left = tuple(frame for frame in known[len(arrived) :] if math.isfinite(frame.arrives_s))
        newest = max((self.newest, *arrived), key=lambda frame: frame.taken_s)
        return arrived, replace(self, time_s=time_s, angle_deg=angle_deg, newest=newest, coming=coming, under_way=left)


def _frame(settings: ImagingSettings, seed: int, number: int, angle_deg: float) -> ImageFrame:
    """Frame `number` of a device at `angle_deg` [deg]; a lost one never arrives."""
    random, taken_s = np.random.default_rng((seed, number)), number / settings.rate_hz
    lost = random.random() < settings.dropout_share
    noise, jitter = random.standard_normal(2).tolist()
    late_s = math.inf if lost else max(0.0, settings.latency_s + settings.jitter_s * jitter)
    return ImageFrame(angle_deg + settings.noise_deg * noise, taken_s, taken_s + late_s)


@final
class Viewer:
    """Simulated intermittent sensor, or none, for one run; `angle` returns the present angle of the device [deg]."""

    def __init__(self, settings: NoSensorSettings | ImagingSettings, seed: int, angle: Callable[[], float]) -> None:
        self._settings, self._seed, self._angle = settings, seed, angle
        self._imaging: Imaging | None = None

    def start(self) -> float:
        """Return the angle at which the device rests [deg]: declared without a sensor, else that of the first frame."""
        angle = self._angle()
        if isinstance(self._settings, NoSensorSettings):
            return angle
        self._imaging = Imaging.at_rest(self._settings, self._seed, angle)
        return self._imaging.newest.angle_deg

    def arrived(self, time_s: float) -> tuple[ImageFrame, ...]:
        """Return the frames arrived since the last call, until `time_s` [s] after the start, in order."""
        if self._imaging is None:
            return ()
        frames, self._imaging = self._imaging.later(time_s, self._angle())
        return frames


S = TypeVar("S")


class Controller(Protocol[S]):
    """Controller with explicit state: `step` never raises and never returns a command beyond the limits."""

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        ...

    @property
    def horizon(self) -> int:
        """Number of reference samples that `step` uses, at least 1."""
        ...

    def init(self, y: float, u: float) -> S:
        """Return the state at rest, with measured angle `y` [deg] and the command `u` that the device holds."""
        ...

    def step(self, state: S, y: float, reference: Vec) -> tuple[Command, S]:
        """Compute the command of one sample, and the next state.

        Args:
            y: measured tip angle [deg]; not-a-number where the measurement is missing.
            reference: reference tip angles [deg] at the ends of this and the next samples, shape (H,).
        """
        ...

    def measure(self, state: S, y: float, age: float) -> S:
        """Measurement update with angle `y` [deg] of a frame taken `age` samples before the next step.

        Raises:
            ControllerError: if the frame cannot be used.
        """
        ...


class Plant(Protocol):
    """Simulated or real device; only the plant may have hidden state."""

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        ...

    def reset(self) -> float:
        """Bring the device to rest and return the measured tip angle [deg]."""
        ...

    def apply(self, u: float) -> float:
        """Apply command `u` [mm or bar] for one sample and return the tip angle measured at its end [deg]."""
        ...

    def stop(self) -> None:
        """Bring the device to its safe state."""
        ...


@dataclass(frozen=True)
class LoopSample:
    """One closed-loop sample; all angles belong to its end, and are (2,) of two axes."""

    time_s: float
    reference_deg: float
    measured_deg: float  # NaN where no frame has come
    command: Command  # sent at the beginning of the sample


@dataclass(frozen=True, eq=False)
class LoopLog:
    """Log of a closed-loop run, one row per sample (N,); all angles belong to the end of the sample.

    Of two axes, angles are (N, 2) and commands (N, n).

    Attributes:
        reference_deg, measured_deg, predicted_deg: angles; NaN before the first frame, and without a prediction.
        source, status: of every command.
        stage_s: time per stage, shape (N,) each; zero where a stage did not run.
        interrupted: whether the run was ended by the keyboard.
    """

    time_s: Vec
    reference_deg: Vec
    measured_deg: Vec
    predicted_deg: Vec
    command: Vec
    disturbance_deg: Vec
    source: tuple[str, ...]
    status: tuple[str, ...]
    stage_s: dict[str, Vec]
    interrupted: bool
    __repr__ = brief

    @property
    def step_s(self) -> Vec:
        """Execution time of every step, sum of all stages."""
        return np.sum(list(self.stage_s.values()), axis=0) if self.stage_s else np.zeros_like(self.time_s)


def run_loop(
    controller: Controller[S],
    plant: Plant,
    reference: Callable[[int], Vec],
    steps: int,
    *,
    u_start: float = 0.0,
    on_sample: Callable[[LoopSample], None] | None = None,
    viewer: Viewer | None = None,
) -> LoopLog:
    """Run `steps` samples of the closed loop as fast as possible, and stop the plant at the end, also after an error.

    After a keyboard interrupt the log holds the finished samples. Controller, plant and reference of two axes have
    arrays in place of numbers.

    Args:
        reference: preview (H,) [deg] from the end of sample k on, for k = 0, 1, ...
        u_start: the command that the plant holds after its reset.
        on_sample: called after every sample, for progress and live logs.
        viewer: simulated sensor in place of the plant's own: steps get NaN, and arrived frames are measured.

    Raises:
        ControllerError: if the sample times of controller and plant differ.
    """
    if abs(controller.dt - plant.dt) > 1e-9 * plant.dt:
        raise ControllerError(f"loop: got a controller at {controller.dt} s and a plant at {plant.dt} s, expected one")
    samples: list[LoopSample] = []
    interrupted = False
    with threadpool_limits(limits=1):  # a second BLAS thread only adds latency to matrices this small
        try:
            y = plant.reset()
            y = y if viewer is None else viewer.start()
            state = controller.init(y, u_start)
            for k in range(steps):
                preview = reference(k)
                command, state = controller.step(state, y, preview)
                y = shown = plant.apply(command.u)
                if viewer is not None:
                    y, (shown, state) = math.nan, _viewed(controller, state, k + 1, viewer.arrived((k + 1) * plant.dt))
                wanted = float(preview[0]) if preview.ndim == 1 else preview[0]
                samples.append(LoopSample((k + 1) * plant.dt, wanted, shown, command))
                if on_sample is not None:
                    on_sample(samples[-1])
        except KeyboardInterrupt:
            interrupted = True
        finally:
            plant.stop()
    return _log(samples, interrupted)


def _viewed(controller: Controller[S], state: S, k: int, frames: Sequence[ImageFrame]) -> tuple[float, S]:
    """Angle of the newest frame used [deg], NaN without one, and the controller's state after all usable frames."""
    shown, newest_s = math.nan, -math.inf
    for frame in frames:
        with suppress(ControllerError):
            state = controller.measure(state, frame.angle_deg, k - frame.taken_s / controller.dt)
            if frame.taken_s > newest_s:
                shown, newest_s = frame.angle_deg, frame.taken_s
    return shown, state


def _log(samples: list[LoopSample], interrupted: bool) -> LoopLog:
    commands = [sample.command for sample in samples]
    unknown = np.full(np.shape(samples[0].measured_deg), np.nan) if samples else np.nan
    stages = dict.fromkeys(stage for command in commands for stage in command.timing.stages)
    return LoopLog(
        time_s=np.array([s.time_s for s in samples]),
        reference_deg=np.array([s.reference_deg for s in samples]),
        measured_deg=np.array([s.measured_deg for s in samples]),
        predicted_deg=np.array([c.predicted[0] if c.predicted.size else unknown for c in commands]),
        command=np.array([c.u for c in commands]),
        disturbance_deg=np.array([c.disturbance for c in commands]),
        source=tuple(str(c.source) for c in commands),
        status=tuple(c.status for c in commands),
        stage_s={stage: np.array([c.timing.stages.get(stage, 0.0) for c in commands]) for stage in stages},
        interrupted=interrupted,
    )
