"""Measurements judged at receipt: age, sequence, plausibility. What fails is rejected and named, never believed."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import final

from pydantic import model_validator

from hystmpc.ctrl.limits import Count, Positive
from hystmpc.trials.config import Settings

from ..transports.sessions import NEW, REPLAYED, Order
from ..transports.transport import Reading
from .plausibility import DriveFollowing, MotionWatch

_S = 1e-9
_FORGET = 0.02  # share of an excess by which the least time of flight follows upwards: clocks drift apart


class SensorSettings(Settings):
    """Block `sensor`: what a plausible angle is, and when the sensor counts as dead.

    Attributes:
        lower_deg, upper_deg: plausible range.
        rate_limit_deg_s: greatest plausible change, counted from the last accepted angle.
        age_limit_s: an angle that is older at its use is stale.
        dead_after_s: time without an accepted angle after which the run is stopped safely.
        frozen_samples: an angle repeated to the last bit that often while the command moves means a frozen sensor;
            null for sensors so coarse that they do that.
        frozen_travel: how far the command has to travel meanwhile, in its unit.
        held_tolerance: how far what the device says it holds may lie beside all that was sent during `dead_after_s`,
            in the command's unit; null does not look. See `DriveFollowing`.
    """

    lower_deg: float
    upper_deg: float
    rate_limit_deg_s: Positive = 500.0
    age_limit_s: Positive = 0.1
    dead_after_s: Positive = 0.5
    frozen_samples: Count | None = 10
    frozen_travel: Positive = 0.3
    held_tolerance: Positive | None = 0.1

    @model_validator(mode="after")
    def _ordered(self) -> SensorSettings:
        if not self.lower_deg < self.upper_deg:
            raise ValueError(f"got lower_deg {self.lower_deg} and upper_deg {self.upper_deg}, expected lower < upper")
        if self.dead_after_s < self.age_limit_s:
            raise ValueError(f"got dead_after_s {self.dead_after_s}, expected at least age_limit_s {self.age_limit_s}")
        return self


@dataclass(frozen=True, slots=True)
class Seen:
    """What one sample saw.

    Attributes:
        angle_deg: the newest accepted angle, NaN where none is new.
        faults: names of what was rejected or missing.
        dead: why the run has to stop, empty while it has not.
        held: the command that the device holds, told by a new reading that is not stale, whatever its angle; NaN where
            there is none or the device does not listen to this session.
        follows: whether the device holds what it was sent lately; True where it does not tell.
    """

    angle_deg: float
    faults: tuple[str, ...]
    dead: str
    held: float = math.nan
    follows: bool = True


@final
class Intake:
    """Judges readings one after another.

    The age of an angle is the time since its receipt plus its excess time of flight: arrival less sender's stamp,
    less the least such difference seen. That needs no common clock, finds packets that queued on the way, and sees a
    sender's clock that jumps back as age, which is the safe side.

    Args:
        start_ns: monotonic time from which silence counts [ns].
        watch: compares commanded with measured motion; None does not.
    """

    def __init__(self, settings: SensorSettings, start_ns: int, watch: MotionWatch | None = None) -> None:
        self._settings, self._order, self._watch = settings, Order(), watch
        self._accepted_ns, self._angle = start_ns, math.nan
        self._flight_ns: float | None = None
        self._repeats, self._travel, self._command = 0, 0.0, math.nan
        self._followed = DriveFollowing(settings.held_tolerance, settings.dead_after_s)
        self._dead = ""
        self._held = math.nan
        self.counts: Counter[str] = Counter()

    def judge(self, readings: list[Reading], now_ns: int, command: float) -> Seen:
        """The newest plausible angle among what has arrived.

        Args:
            readings: in the order of arrival.
            now_ns: monotonic time now [ns].
            command: the command sent last; its travel tells a frozen sensor from a resting one. NaN before the first.
        """
        faults: list[str] = []
        angle = self._held = math.nan
        self._travel += abs(command - self._command) if math.isfinite(command - self._command) else 0.0
        self._command = command
        for reading in readings:
            fault = self._fault(reading, now_ns)
            if fault:
                faults.append(fault)
            else:
                angle = self._accept(reading)
        if math.isnan(angle) and not faults:
            faults.append("no-angle")
        follows, stray = self._followed.judge(self._held, command, now_ns)
        if not follows:
            faults.append("not-followed")
        self._dead = self._dead or stray or ("" if self._watch is None else self._watch.judge(angle, command, now_ns))
        silent_s = _S * (now_ns - self._accepted_ns)
        if not self._dead and silent_s > self._settings.dead_after_s:
            self._dead = f"sensor dead: no plausible angle for {silent_s:.2f} s ({', '.join(sorted(set(faults)))})"
        self.counts.update(faults)
        return Seen(angle, tuple(dict.fromkeys(faults)), self._dead, self._held, follows)

    @property
    def lost(self) -> int:
        """Measurements that were sent and never came."""
        return self._order.lost

    def _fault(self, reading: Reading, now_ns: int) -> str:
        verdict = self._order.judge(reading.session, reading.sequence)
        if verdict == REPLAYED:
            return verdict
        if verdict != NEW:
            self._dead = self._dead or "the device was restarted: what it holds now is not known"
            return "device-restarted"
        if self._age_s(reading, now_ns) > self._settings.age_limit_s:
            return "stale"
        self._held = reading.held if reading.listens else math.nan
        return self._implausible(reading)

    def _age_s(self, reading: Reading, now_ns: int) -> float:
        flight = float(reading.received_ns - reading.sent_ns)
        least = self._flight_ns
        self._flight_ns = least = flight if least is None or flight < least else least
        excess = flight - least
        if _S * excess <= self._settings.age_limit_s:
            self._flight_ns = least + _FORGET * excess
        return _S * (now_ns - reading.received_ns + excess)

    def _implausible(self, reading: Reading) -> str:
        settings, angle = self._settings, reading.angle_deg
        if not math.isfinite(angle):
            return "not-a-number"
        if not settings.lower_deg <= angle <= settings.upper_deg:
            return "out-of-range"
        elapsed_s = max(_S * (reading.received_ns - self._accepted_ns), 1e-3)
        if abs(angle - self._angle) > settings.rate_limit_deg_s * elapsed_s:
            return "jump"
        if angle != self._angle:
            self._repeats, self._travel = 0, 0.0
            return ""
        self._repeats += 1
        count = settings.frozen_samples
        frozen = count is not None and self._repeats >= count and self._travel >= settings.frozen_travel
        return "frozen" if frozen else ""

    def _accept(self, reading: Reading) -> float:
        self._accepted_ns, self._angle = reading.received_ns, reading.angle_deg
        return reading.angle_deg
