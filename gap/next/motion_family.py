"""Family of motions with numbers to choose: ramps with holds and one burst of sines, within limits by construction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .motion_menu import RATE_SHARE, REST_S, TEMPLATES, Leg, MenuMotion, MotionTemplate, SineBurst, sampled_burst

LEGS = 6
"""Ramps of a motion, each with a hold."""

SIZE = 3 * LEGS + 4
"""Numbers of a motion, each between 0 and 1."""

_BURST_AFTER = 3  # legs
_SLOWEST, _HOLD_S = 0.03, (0.05, 20.0)  # of the allowed rate; shortest and longest hold, logarithmic
_BURST_S, _HZ, _RATIO, _SINE = (0.3, 10.0), (0.3, 4.0), (1.0, 3.0), 0.25  # duration, frequency, second one, amplitude
_NO_BURST_S = 1.0  # a shorter burst is left out


@dataclass(frozen=True)
class MotionFamily:
    """Every motion: rest, three ramps with holds, a burst of two sines, three ramps with holds, back, rest.

    A motion is told by numbers x (22,) in [0, 1]: of each ramp the target (share of the range, counted from the end of
    the range that is nearer to the safe command), the speed (3 to 100 % of the allowed rate, logarithmic) and the hold
    (0.05 to 20 s, logarithmic); of the burst the amplitude, the frequency, the ratio of the second frequency, and the
    duration. A motion that would last too long is played faster: its ways up to the allowed rate, holds and burst
    shorter; if that is not enough, it reaches less far.

    Attributes:
        limits: box and rate of the command [mm or bar, and per second].
        dt: sample time [s].
        safe: command at which a motion begins and ends.
        longest_s: duration that no motion exceeds [s].

    Raises:
        TrajectoryError: if the sample time or the duration is not positive, or the safe command lies outside.
    """

    limits: CommandLimits
    dt: float
    safe: float
    longest_s: float

    def __post_init__(self) -> None:
        times = math.isfinite(self.dt) and self.dt > 0 and self.longest_s >= 4 * REST_S
        if not (times and self.limits.lower <= self.safe <= self.limits.upper):
            raise TrajectoryError(
                f"motion family: got dt {self.dt} s, at most {self.longest_s} s, safe command {self.safe}, expected "
                f"dt > 0, at least {4 * REST_S:g} s, a command within {self.limits}"
            )

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Ends of the range, the one nearer to the safe command first."""
        low, high = self.limits.lower, self.limits.upper
        return (low, high) if self.safe - low <= high - self.safe else (high, low)

    def motion(self, x: Vec, name: str, purpose: str = "") -> MenuMotion:
        """The motion of numbers x (22,)."""
        numbers = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
        legs, burst = numbers[: 3 * LEGS].reshape(LEGS, 3), numbers[3 * LEGS :]
        near, far = self._ends
        stops = near + legs[:, 0] * (far - near)
        rate = RATE_SHARE * self.limits.rate
        sine_s = _between(_BURST_S, burst[3])
        sine_s = sine_s if sine_s >= _NO_BURST_S else 0.0
        holds = np.array([_between(_HOLD_S, h) for h in legs[:, 2]])
        speeds = rate * np.array([_between((_SLOWEST, 1.0), v) for v in legs[:, 1]])
        room = self.longest_s - 2 * REST_S - 2 * self.dt
        stops, ways, holds, sine_s = _shortened(self.safe, stops, speeds, holds, sine_s, rate, room)
        pieces, at, start = [(np.array([0.0, REST_S]), np.array([self.safe, self.safe]))], self.safe, REST_S
        for k in range(LEGS):
            pieces.append((start + np.array([0.0, ways[k], ways[k] + holds[k]]), np.array([at, stops[k], stops[k]])))
            at, start = float(stops[k]), start + float(ways[k] + holds[k])
            if k + 1 == _BURST_AFTER and sine_s:
                hz = _between(_HZ, burst[1])
                part = SineBurst((hz, hz * _between(_RATIO, burst[2])), _SINE * float(burst[0]), sine_s)
                t, u = sampled_burst(part, at, abs(far - near), rate, self.dt)
                pieces.append((start + t, u))
                start += sine_s
        back = abs(self.safe - at) / rate
        pieces.append((start + np.array([0.0, back, back + REST_S]), np.array([at, self.safe, self.safe])))
        knots, values = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
        samples = int(np.floor(knots[-1] / self.dt)) + 1
        t = np.arange(samples, dtype=np.float64) * self.dt
        asked = np.clip(np.interp(t, knots, values), self.limits.lower, self.limits.upper)
        command = np.append(asked, self.safe)
        return MenuMotion(name, purpose, self.dt * np.arange(samples + 1, dtype=np.float64), command)

    @cached_property
    def starts(self) -> dict[str, Vec]:
        """Numbers (22,) of the motions of the menu: of each its first six ramps and its first burst."""
        return {template.name: self._numbers_of(template) for template in TEMPLATES}

    def slower(self, x: Vec, factor: float) -> Vec:
        """Numbers (22,) of the same motion with all ramps slower by a factor below one, at 3 % of the rate at least."""
        legs = x[: 3 * LEGS].reshape(LEGS, 3).copy()
        legs[:, 1] = np.maximum(legs[:, 1] + math.log(factor) / math.log(1 / _SLOWEST), 0.0)
        return np.concatenate([legs.ravel(), x[3 * LEGS :]])

    def _numbers_of(self, template: MotionTemplate) -> Vec:
        bursts = [part for part in template.parts if isinstance(part, SineBurst)]
        at = template.parts.index(bursts[0]) if bursts else len(template.parts)
        before = [part for part in template.parts[:at] if isinstance(part, Leg)]
        after = [part for part in template.parts[at:] if isinstance(part, Leg)][:_BURST_AFTER]
        rest = Leg(0.0, _HOLD_S[0], 1.0)
        if bursts:
            before = ([rest] * _BURST_AFTER + before)[-_BURST_AFTER:]
        legs = [*before, *after][:LEGS]
        rate, reach = RATE_SHARE * self.limits.rate, self.limits.upper - self.limits.lower
        rows = []
        for leg in legs + [rest] * (LEGS - len(legs)):
            speed = min(leg.speed, reach / (rate * leg.stroke_s)) if leg.stroke_s else leg.speed
            rows += [leg.target, _share((_SLOWEST, 1.0), speed), _share(_HOLD_S, max(leg.hold_s, _HOLD_S[0]))]
        if not bursts:
            return np.array([*rows, 0.3, 0.5, 0.5, 0.0])
        hz, most = bursts[0].frequencies_hz, max(bursts[-1].frequencies_hz[-1], bursts[0].frequencies_hz[0])
        tail = (_share(_HZ, hz[0]), _share(_RATIO, most / hz[0]), _share(_BURST_S, bursts[0].duration_s))
        return np.clip(np.array([*rows, bursts[0].amplitude / _SINE, *tail]), 0.0, 1.0)


def _shortened(
    safe: float, stops: Vec, speeds: Vec, holds: Vec, sine_s: float, rate: float, room: float
) -> tuple[Vec, Vec, Vec, float]:
    """Stops, durations of the ways and holds (LEGS,) [s], and of the burst [s], that together take at most `room`."""

    def least(s: Vec) -> tuple[Vec, float]:
        ways = np.abs(np.diff(s, prepend=safe)) / rate
        return ways, float(ways.sum()) + abs(safe - float(s[-1])) / rate

    quickest, needed = least(stops)
    if needed > 0.9 * room:
        stops = safe + 0.9 * room / needed * (stops - safe)
        quickest, needed = least(stops)
    ways = np.maximum(np.abs(np.diff(stops, prepend=safe)) / speeds, quickest)
    more = float((ways - quickest).sum() + holds.sum()) + sine_s
    share = min(1.0, (room - needed) / more) if more > 0 else 1.0
    return stops, quickest + share * (ways - quickest), share * holds, share * sine_s


def _between(ends: tuple[float, float], share: float) -> float:
    return float(ends[0] * (ends[1] / ends[0]) ** share)


def _share(ends: tuple[float, float], value: float) -> float:
    return float(np.clip(math.log(value / ends[0]) / math.log(ends[1] / ends[0]), 0.0, 1.0))
