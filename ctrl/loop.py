"""The closed loop on a simulated clock: protocols of controller and plant, the loop, its log."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from hystmpc.trials.brief import brief
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .command import Command
from .frames import Frame, Viewer

S = TypeVar("S")


class Controller(Protocol[S]):
    """State in, state out: `step` never raises and never returns a command beyond the limits."""

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        ...

    @property
    def horizon(self) -> int:
        """Number of reference samples that `step` looks at, at least 1."""
        ...

    def init(self, y: float, u: float) -> S:
        """State at rest, with measured angle `y` [deg] and the command `u` that the device holds."""
        ...

    def step(self, state: S, y: float, reference: Vec) -> tuple[Command, S]:
        """One sample.

        Args:
            state: what `init` or the last `step` returned.
            y: measured tip angle [deg]; not-a-number where the measurement is missing.
            reference: wanted tip angles [deg] at the ends of this and the next samples, shape (H,).
        """
        ...

    def measure(self, state: S, y: float, age: float) -> S:
        """The state with a frame of `age` samples before the next step that shows `y` [deg].

        Raises:
            ControllerError: if the frame cannot be used.
        """
        ...


class Plant(Protocol):
    """A device, simulated or real; the only place where state may be hidden."""

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
        """Leave the device in its safe state."""
        ...


@dataclass(frozen=True)
class LoopSample:
    """One closed-loop sample; all angles belong to its end."""

    time_s: float  # end of the sample
    reference_deg: float  # wanted angle
    measured_deg: float  # measured angle; NaN where no frame has come
    command: Command  # what was sent at the beginning of the sample


@dataclass(frozen=True, eq=False)
class LoopLog:
    """A closed-loop run, one row per sample (N,); all angles belong to the end of the sample.

    Attributes:
        time_s: end of the sample.
        reference_deg, measured_deg, predicted_deg: wanted, measured, predicted angle; NaN where no frame of an
            intermittent sensor has come, and without a prediction.
        command: command sent.
        disturbance_deg: estimated output disturbance.
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
        """Execution time of every step, all stages."""
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
    """Run `steps` samples as fast as they come and leave the plant stopped, whatever happens.

    After a keyboard interrupt the log holds what there is.

    Args:
        controller, plant: of equal sample time.
        reference: preview (H,) [deg] from the end of sample k on, for k = 0, 1, ...
        u_start: the command that the plant holds after its reset.
        on_sample: called after every sample, for progress and live logs.
        viewer: the sensor, where it is not the plant's own: steps get NaN, and frames that have arrived are measured.

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
                samples.append(LoopSample((k + 1) * plant.dt, float(preview[0]), shown, command))
                if on_sample is not None:
                    on_sample(samples[-1])
        except KeyboardInterrupt:
            interrupted = True
        finally:
            plant.stop()
    return _log(samples, interrupted)


def _viewed(controller: Controller[S], state: S, k: int, frames: Sequence[Frame]) -> tuple[float, S]:
    """The angle of the frame taken last among those that are used [deg], NaN where there is none, and the state then.

    A frame that the controller cannot use, since it is too old or wants no frames, changes nothing.
    """
    shown, newest_s = math.nan, -math.inf
    for frame in frames:
        with suppress(ControllerError):
            state = controller.measure(state, frame.angle_deg, k - frame.taken_s / controller.dt)
            if frame.taken_s > newest_s:
                shown, newest_s = frame.angle_deg, frame.taken_s
    return shown, state


def _log(samples: list[LoopSample], interrupted: bool) -> LoopLog:
    commands = [sample.command for sample in samples]
    stages = dict.fromkeys(stage for command in commands for stage in command.timing.stages)
    return LoopLog(
        time_s=np.array([s.time_s for s in samples]),
        reference_deg=np.array([s.reference_deg for s in samples]),
        measured_deg=np.array([s.measured_deg for s in samples]),
        predicted_deg=np.array([c.predicted[0] if c.predicted.size else np.nan for c in commands]),
        command=np.array([c.u for c in commands]),
        disturbance_deg=np.array([c.disturbance for c in commands]),
        source=tuple(str(c.source) for c in commands),
        status=tuple(c.status for c in commands),
        stage_s={stage: np.array([c.timing.stages.get(stage, 0.0) for c in commands]) for stage in stages},
        interrupted=interrupted,
    )
