"""Simulated and replayed devices in this process, advanced by one sample for every command."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, final

import numpy as np
from pydantic import Field

from hystmpc.ctrl.loop import (
    AnySensorSettings,
    ContinuousSensorSettings,
    ImageFrame,
    Imaging,
    ImagingSettings,
    Plant,
    SimulatedSensor,
)
from hystmpc.trials.errors import ConfigError, LogError, did_you_mean
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Vec

from ..axes import PerAxis, each, from_array, together
from .transport import NO_INPUTS, Reading, RunContext, Transport, TransportBase


@final
class InputsOf:
    """Measured inputs of a simulated device at the present instant.

    Raises:
        ConfigError: if the device does not depend on an input of such a name.
    """

    def __init__(self, plant: Plant, names: Sequence[str]) -> None:
        self._plant: Any = plant
        self._names = tuple(names)
        known = getattr(plant, "inputs", NO_INPUTS) if names else NO_INPUTS
        if unknown := [name for name in names if name not in known]:
            raise ConfigError(f"inputs: the device has no input {unknown[0]!r}, {did_you_mean(unknown[0], known)}")

    @property
    def now(self) -> Mapping[str, float]:
        """Values by name."""
        if not self._names:
            return NO_INPUTS
        values = self._plant.inputs
        return {name: float(values[name]) for name in self._names}


@final
class SimulatedTransport(Transport):
    """Transport to a `Plant` in this process; its time is the number of commands, so it has no delay.

    Args:
        held: the command that the plant holds after its reset; of two axes a tuple.
        sensor: what is shown of its angle; a first frame shows the rest.
        inputs: names of the plant's measured inputs that a reading has.

    Raises:
        ConfigError: if the plant has another sample time, or does not depend on such an input.
    """

    def __init__(
        self,
        plant: Plant,
        dt_s: float,
        held: PerAxis,
        now_ns: Callable[[], int],
        sensor: AnySensorSettings | None = None,
        seed: int = 0,
        inputs: Sequence[str] = (),
    ) -> None:
        self._inputs = InputsOf(plant, inputs)
        if abs(plant.dt - dt_s) > 1e-9 * dt_s:
            raise ConfigError(f"simulated device: got a plant at {plant.dt} s, expected the loop's {dt_s} s")
        self._plant, self._held, self._now, self._dt_ns = plant, held, now_ns, round(1e9 * dt_s)
        self._angle, self._sequence = from_array(plant.reset()), 0
        self._read_ns: int | None = None
        self._continuous = sensor is None or isinstance(sensor, ContinuousSensorSettings)
        self._time_s, self._imaging, self._frames = 0.0, None, deque[ImageFrame]()
        if isinstance(sensor, ImagingSettings):
            self._imaging = Imaging.at_rest(sensor, seed, self._angle)
            self._frames.append(replace(self._imaging.newest, arrives_s=sensor.latency_s))

    @property
    def counters(self) -> Mapping[str, int]:
        return {}

    def read(self) -> Reading | None:
        """The angle at the end of the last sample: once after every command, and once a sample without one.

        Before it come the frames of the sample; where the sensor is not continuous, there is no angle then.
        """
        now = self._now()
        if self._frames:
            frame = self._frames.popleft()
            self._sequence += 1
            arrived_ns = now - round(1e9 * max(self._time_s - frame.arrives_s, 0.0))
            sent_ns = arrived_ns - round(1e9 * (frame.arrives_s - frame.taken_s))
            return Reading(frame.angle_deg, self._sequence, 0, sent_ns, arrived_ns, self._held, inputs=self._inputs.now)
        if self._read_ns is not None and now - self._read_ns < self._dt_ns // 2:
            return None
        self._read_ns, self._sequence = now, self._sequence + 1
        angle = self._angle if self._continuous else together([math.nan] * len(each(self._angle)))
        return Reading(angle, self._sequence, 0, now, now, self._held, inputs=self._inputs.now)

    def write(self, command: PerAxis) -> None:
        self._angle, self._held, self._read_ns = from_array(self._plant.apply(command)), command, None
        self._time_s += self._plant.dt
        if self._imaging is not None:
            frames, self._imaging = self._imaging.later(self._time_s, self._angle)
            self._frames.extend(frames)

    def greet(self) -> None:
        """No effect, since a simulated device always listens."""

    def stop(self, goodbye: bool = False) -> None:
        del goodbye
        self._plant.stop()


@final
class RecordedPlant:
    """Replay of recorded angles, one for every command; not-a-number after the end."""

    def __init__(self, angles_deg: Vec, dt_s: float) -> None:
        self._angles, self.dt, self._k = angles_deg.tolist(), dt_s, 0

    def reset(self) -> float:
        """Return to the first row; return its angle [deg]."""
        self._k = 0
        return self._angle()

    def apply(self, u: float) -> float:
        """Advance to the next row; return its angle [deg]."""
        del u
        self._k += 1
        return self._angle()

    def stop(self) -> None:
        """No effect."""

    def _angle(self) -> float:
        return self._angles[self._k] if self._k < len(self._angles) else math.nan


def recorded_plant(run: RunFolder, dt_s: float) -> tuple[RecordedPlant, float]:
    """Replay of a run folder, and the held command of its device.

    Raises:
        LogError: if its log lacks the columns of a run.
    """
    log = run.log()
    names = [name for name in log if name == "command" or name.startswith("command_")]
    if "angle_deg" not in log or not names:
        raise LogError(f"{run.path}: the log has columns {', '.join(log)}, expected angle_deg and command")
    angles, commands = (np.asarray(log[name], dtype=np.float64) for name in ("angle_deg", names[0]))
    sent = np.array([source != "wait" for source in log.get("source", angles)])  # nothing moved while nothing was sent
    angles, commands = angles[sent], commands[sent]
    if not angles.size:
        raise LogError(f"{run.path}: got a run in which nothing was sent, expected commands")
    return RecordedPlant(angles, dt_s), float(commands[0])


class SimulatedSettings(TransportBase):
    """Transport `kind: simulated`: a device in this process; `plant` and `sensor` as in a simulation file.

    Attributes:
        plant: the device, as `plant` of a simulation file.
        sensor: what it measures: every sample, frames of an imaging system, or nothing.
        seed: of the sensor's noise.
    """

    in_process: ClassVar[bool] = True

    kind: Literal["simulated"]
    plant: dict[str, Any]
    sensor: SimulatedSensor = ContinuousSensorSettings()
    seed: int = Field(default=0, ge=0)

    @property
    def place(self) -> str:
        return self.kind

    def open(self, run: RunContext) -> Transport:
        plant, held = run.plants(self, run.dt_s)
        if (axes := len(each(held))) != run.conversion.axes:
            raise ConfigError(
                f"simulated device: got a plant of {axes} axes, expected {run.conversion.axes} as in limits"
            )
        return SimulatedTransport(plant, run.dt_s, held, run.now_ns, self.sensor, self.seed, run.inputs)


class ReplaySettings(TransportBase):
    """Transport `kind: replay`: the angles of a recorded run, one a sample, whatever the command.

    Attributes:
        run: folder of the recorded run.
    """

    in_process: ClassVar[bool] = True

    kind: Literal["replay"]
    run: Path

    @property
    def place(self) -> str:
        return self.kind

    def resolved(self, folder: Path) -> Self:
        return self.model_copy(update={"run": folder / self.run})

    def open(self, run: RunContext) -> Transport:
        plant, held = recorded_plant(RunFolder.open(self.run), run.dt_s)
        return SimulatedTransport(plant, run.dt_s, held, run.now_ns)
