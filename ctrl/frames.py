"""Simulated angle sensors: continuous, none, and an imaging system whose frames come now and then and late."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, final

import numpy as np
from pydantic import Field

from hystmpc.trials.config import NotNegative, Settings

_OLDEST_S, _GAP_S = 1.0, 2.0  # what a controller is told at least
_JITTERS, _PERIODS = 4.0, 5.0  # so late, and so many frames lost in a row, is still usual


class ContinuousSensorSettings(Settings):
    """An angle in every sample, as the plant measures it."""

    kind: Literal["continuous"] = "continuous"

    def told(self) -> Mapping[str, Any]:
        """What a controller's block `estimator` should say of this sensor."""
        return {}


class NoSensorSettings(Settings):
    """No angle at all: the angle of the rest before the first sample is declared."""

    kind: Literal["none"] = "none"

    def told(self) -> Mapping[str, Any]:
        """What a controller's block `estimator` should say of this sensor."""
        return {"sensor": "none"}


class ImagingSettings(Settings):
    """Frames of an imaging system.

    Attributes:
        rate_hz: frames per second.
        latency_s: from the exposure of a frame to its angle [s].
        jitter_s: standard deviation of the latency, which is never below zero [s]; frames may overtake each other.
        dropout_share: share of the frames that never come.
        noise_deg: standard deviation of the angle of a frame [deg].
    """

    kind: Literal["intermittent"] = "intermittent"
    rate_hz: Annotated[float, Field(ge=0.2, le=100)] = 5.0
    latency_s: Annotated[float, Field(ge=0, le=2)] = 0.2
    jitter_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    dropout_share: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    noise_deg: NotNegative = 0.0

    def told(self) -> Mapping[str, Any]:
        """What a controller's block `estimator` should say of this sensor."""
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
class Frame:
    """An angle [deg], when it was taken and when it arrives [s]."""

    angle_deg: float
    taken_s: float
    arrives_s: float


@dataclass(frozen=True)
class Imaging:
    """An imaging system in the course of a run; frame n = 0, 1, ... is taken at n / rate_hz.

    Frame 0 shows the rest before the run and is known when the run begins. What is random in frame n follows from the
    seed and n alone.

    Attributes:
        time_s, angle_deg: the device now.
        newest: the frame taken last among those that have arrived.
        coming: number of the next frame.
        under_way: frames that have been taken and have not arrived.
    """

    settings: ImagingSettings
    seed: int
    time_s: float
    angle_deg: float
    newest: Frame
    coming: int = 1
    under_way: tuple[Frame, ...] = ()

    @classmethod
    def at_rest(cls, settings: ImagingSettings, seed: int, angle_deg: float) -> Imaging:
        """At time 0, the device at rest at `angle_deg` [deg]."""
        return cls(settings, seed, 0.0, angle_deg, _frame(settings, seed, 0, angle_deg))

    def later(self, time_s: float, angle_deg: float) -> tuple[tuple[Frame, ...], Imaging]:
        """Frames that have arrived until `time_s` [s], in the order of arrival, and the imaging system then.

        Args:
            angle_deg: of the device then [deg]; between two calls it moves evenly.
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


def _frame(settings: ImagingSettings, seed: int, number: int, angle_deg: float) -> Frame:
    """Frame `number` of a device at `angle_deg` [deg]; one that is lost never arrives."""
    random, taken_s = np.random.default_rng((seed, number)), number / settings.rate_hz
    lost = random.random() < settings.dropout_share
    noise, jitter = random.standard_normal(2).tolist()
    late_s = math.inf if lost else max(0.0, settings.latency_s + settings.jitter_s * jitter)
    return Frame(angle_deg + settings.noise_deg * noise, taken_s, taken_s + late_s)


@final
class Viewer:
    """A sensor that is not continuous before a device, for one run.

    Args:
        angle: of the device now [deg].
    """

    def __init__(self, settings: NoSensorSettings | ImagingSettings, seed: int, angle: Callable[[], float]) -> None:
        self._settings, self._seed, self._angle = settings, seed, angle
        self._imaging: Imaging | None = None

    def start(self) -> float:
        """The angle at which the device rests [deg]: declared without a sensor, else that of the first frame."""
        angle = self._angle()
        if isinstance(self._settings, NoSensorSettings):
            return angle
        self._imaging = Imaging.at_rest(self._settings, self._seed, angle)
        return self._imaging.newest.angle_deg

    def arrived(self, time_s: float) -> tuple[Frame, ...]:
        """Frames that have arrived since the last call, until `time_s` [s] after the start, in order of arrival."""
        if self._imaging is None:
            return ()
        frames, self._imaging = self._imaging.later(time_s, self._angle())
        return frames
