"""Phases of a run that depend on the measured angle: limits of the angle, a climb in steps, a dash at full rate."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.phases import Decision, Past, Phase, PhaseInput
from hystmpc.rig.experiment.record import Recorded
from hystmpc.rig.safety.intake import SensorSettings
from hystmpc.rig.safety.plausibility import SMOOTH_S, MotionWatch
from hystmpc.rig.safety.ramp import stop_commands, waypoint_commands
from hystmpc.trials.types import Vec

MEDIAN = 3
"""Angles whose median is believed: one outlier is no angle."""

ANGLE_MARGIN = 0.02
"""Share of the angle limits by which the tip may pass them in motion, before the run is stopped."""

HOLD_S = 0.6
"""Rest at every step of the climb, at least [s]."""

_SETTLES_S = 2.5  # longest further rest [s]
_WINDOW_S = 0.2  # window of the test for rest [s]
_SETTLED = 0.1  # greatest motion at rest, as a share of the step
_CAUTION = 1.5  # factor on the steepest slope so far, for the next step
_LEAST_STEP = 0.25  # shortest step, as a share of a full one
_STILL = 0.45  # share of the motion watch's travel
_DASH_SHARE, _DASH_S = 0.5, 0.6  # of the range, and of a second at the greatest rate
_FOLLOWS = 2  # samples by which the device may lag behind the command
_CAREFUL = 0.9  # share of the measured rate of a device that does not follow


@dataclass(frozen=True)
class ClimbResult:
    """Result of a climb: reached command and angle, and the reason of its end."""

    end: float  # farthest command at which the tip rested within its limits
    angle_deg: float  # at that command [deg], NaN if it never left the start
    start_deg: float  # at the start [deg]
    why: str  # end of the climb, in words
    still: float = 0.0  # longest travel of the command, both ways, in which the tip did not move


@final
class Bounded(Phase):
    """Safety wrapper of a phase: stop if the median of three angles exceeds the limits by 2 % of their range.

    The command's range is measured at rest; a device that overshoots in a fast motion goes farther. Angles count as
    shown, even outside the sensor's range and faster than plausible: those are beyond the limits, not missing.

    Args:
        angle_limits: of the tip [deg]; None for the range of the sensor.
    """

    def __init__(self, phase: Phase, angle_limits: tuple[float, float] | None, sensor: SensorSettings) -> None:
        self.name, self._phase = phase.name, phase
        self._which = "commission.angle_limits_deg" if angle_limits else "the range of the sensor"
        low, high = angle_limits or (sensor.lower_deg, sensor.upper_deg)
        margin = ANGLE_MARGIN * (high - low)
        self._low, self._high = low - margin, high + margin
        self._recent: deque[float] = deque(maxlen=MEDIAN)

    @property
    def closed_loop(self) -> bool:
        return self._phase.closed_loop

    def begin(self, now: PhaseInput, past: Past) -> None:
        self._recent.clear()
        self._phase.begin(now, past)

    def step(self, now: PhaseInput) -> Decision:
        """Decision of the wrapped phase, or a fault beyond the limits."""
        decision = self._phase.step(now)
        keep_shown(self._recent, now)
        angle = float(np.median(self._recent)) if len(self._recent) == MEDIAN else math.nan
        if math.isnan(angle) or self._low <= angle <= self._high:
            return decision
        return replace(decision, u=now.held, fault=f"the angle is {angle:.2f} deg, beyond {self._which}")


def keep_shown(recent: deque[float], now: PhaseInput) -> None:
    """Append the angle of this sample, usable or not, if there is one."""
    shown = now.angle_deg if math.isfinite(now.angle_deg) else now.shown_deg
    if math.isfinite(shown):
        recent.append(shown)


@final
class Climb(Phase):
    """Phase that climbs from the held command towards `end` in ramps with rests, and back, within the angle limits.

    A step is taken only with a usable angle. The first one is a quarter; each is made smaller where 1.5 times the
    steepest slope so far would lead beyond the limits. An angle beyond them on the way turns the motion back at once;
    the farthest command of an earlier rest counts. A tip that has moved and then stays for 45 % of the travel that the
    motion watch allows (`plausibility.travel`) ends the climb at its last motion. A step is judged at rest: a lagging
    device gets time.

    Args:
        bench: rate, ramps and hard limits.
        angle_limits: of the tip [deg].
        steps: into which the way is divided.
        widen: whether a tip that rests beyond its limits at the start widens them; otherwise the climb ends there.
    """

    name = "climb"

    def __init__(
        self, bench: BenchSettings, end: float, angle_limits: tuple[float, float], steps: int, widen: bool = False
    ) -> None:
        self._bench, self._end, self._limits, self._steps, self._widen = bench, end, angle_limits, steps, widen
        self._plan: deque[float] = deque()
        self._recent: deque[float] = deque(maxlen=MEDIAN)
        self._start = self._at = self._target = math.nan
        self._start_deg = self._at_deg = math.nan
        self._moved = self._moved_deg = math.nan
        self._slope = 0.0
        self._back = self._stirred = False
        watch, sensor = bench.plausibility, bench.sensor
        span, range_deg = bench.limits.upper - bench.limits.lower, sensor.upper_deg - sensor.lower_deg
        self._moves = watch.moves_of(range_deg)
        self._travel = watch.travel_of(span, onward=True) if watch.watch_motion else math.inf
        smoothed = watch.model_copy(update={"travel_s": SMOOTH_S})  # the command is averaged as the angle is
        self._watch, self._still = MotionWatch(smoothed, span, range_deg), 0.0
        window = max(round(_WINDOW_S / bench.dt_s), 1)
        self._settling: deque[float] = deque(maxlen=2 * window)
        self._samples = self._waited = 0
        self._result = ClimbResult(math.nan, math.nan, math.nan, "it was not finished")

    def begin(self, now: PhaseInput, past: Past) -> None:
        """Begin with a rest for the angle at the start."""
        del past
        self._start = self._at = self._target = now.held
        self._plan = deque(self._way(now.held, now.held))

    def step(self, now: PhaseInput) -> Decision:
        """Next command of the present step, of the next step, or of the return."""
        keep_shown(self._recent, now)
        self._settling.append(now.angle_deg)
        self._samples += 1
        self._watch.judge(now.angle_deg, now.held, round(1e9 * self._samples * self._bench.dt_s))
        self._still = max(self._still, self._watch.still)
        angle = float(np.median(self._recent)) if self._recent else math.nan
        if not self._back and math.isfinite(self._start_deg) and not self._limits[0] <= angle <= self._limits[1]:
            self._turn(now, f"the angle reached {angle:.2f} deg")
        if not self._plan and not self._back:
            self._rested(now, angle)
        u = self._plan.popleft() if self._plan else now.held
        return Decision(u, self.name, finished=self._back and not self._plan)

    @property
    def result(self) -> ClimbResult:
        """Farthest command, its angle, and the reason of the end."""
        return replace(self._result, still=self._still)

    def _settles(self, angle: float) -> bool:
        """Whether the tip still moves after a step within the longest rest."""
        if math.isnan(self._start_deg):
            return False
        half = len(self._settling) // 2
        before, after = np.split(np.array(self._settling)[-2 * half :], 2)
        moves_deg, moved_deg = abs(np.mean(after) - np.mean(before)), abs(angle - self._at_deg)
        self._waited += 1
        moves = moved_deg > self._moves and moves_deg > _SETTLED * moved_deg
        return bool(moves) and self._waited * self._bench.dt_s < _SETTLES_S

    def _rested(self, now: PhaseInput, angle: float) -> None:
        """Evaluate the finished step and plan the next one; without an angle, wait."""
        if not math.isfinite(now.angle_deg) or len(self._recent) < MEDIAN or self._settles(angle):
            return None
        self._waited = 0
        if math.isnan(self._start_deg):
            self._start_deg = angle
            if self._widen:
                low, high = self._limits
                margin = ANGLE_MARGIN * (high - low)
                self._limits = min(low, angle - margin), max(high, angle + margin)
        elif self._target != self._at:
            slope = (angle - self._at_deg) / (self._target - self._at)
            self._slope = max(self._slope, slope, key=abs)
        self._at, self._at_deg = self._target, angle
        if math.isnan(self._moved_deg) or abs(angle - self._moved_deg) >= self._moves:
            self._stirred = self._stirred or not math.isnan(self._moved_deg)
            self._moved, self._moved_deg = self._at, angle
        elif self._stirred and abs(self._at - self._moved) >= _STILL * self._travel:
            still = f"the angle stayed at {angle:.2f} deg from {self._moved:.4g} to {self._at:.4g}"
            self._at, self._at_deg = self._moved, self._moved_deg
            return self._turn(now, still)
        if not self._limits[0] <= angle <= self._limits[1]:
            return self._turn(now, f"the tip rests at {angle:.2f} deg, beyond its limits")
        if self._at == self._end:
            return self._turn(now, "the limit of the command")
        step = self._next_step(angle)
        if step == 0.0:
            return self._turn(now, f"the angle is {angle:.2f} deg, near its limit")
        self._target = self._at + step
        self._plan = deque(self._way(now.held, self._target))
        return None

    def _next_step(self, angle: float) -> float:
        """Size of the next step: whole, shortened near the limits, 0 if little remains."""
        whole, left = (self._end - self._start) / self._steps, self._end - self._at
        if self._at == self._start:
            return _LEAST_STEP * whole  # the slope is still unknown
        step = whole if abs(left) > 1.2 * abs(whole) else left
        move = _CAUTION * self._slope * step
        room = max(self._limits[1] - angle if move > 0 else angle - self._limits[0], 0.0)
        if abs(move) > room:
            step *= room / abs(move)
        return step if abs(step) >= _LEAST_STEP * min(abs(whole), abs(left)) else 0.0

    def _turn(self, now: PhaseInput, why: str) -> None:
        """Begin the return and set the result."""
        self._back = True
        self._result = ClimbResult(self._at, self._at_deg, self._start_deg, why)
        bench = self._bench
        back = stop_commands(now.held, now.velocity, self._start, bench.ramps, bench.overshoot, bench.dt_s)
        self._plan = deque([*back.tolist(), *self._way(self._start, self._start)])

    def _way(self, held: float, to: float) -> list[float]:
        return waypoint_commands(held, [to], [HOLD_S], self._bench.ramps, self._bench.dt_s).tolist()


def climb_seconds(bench: BenchSettings, end: float, steps: int) -> float:
    """Duration of a climb to `end` and of the return [s]."""
    safe = bench.safe_command
    stops = [*np.linspace(safe, end, steps + 2).tolist(), safe]
    return waypoint_commands(safe, stops, [HOLD_S] * len(stops), bench.ramps, bench.dt_s).size * bench.dt_s


@final
class Dash(Recorded):
    """Phase that dashes over half of the distance to `end` and back, for at most 0.6 s at the greatest rate.

    It measures the rate of a device that reports its command.
    """

    def __init__(self, bench: BenchSettings, end: float) -> None:
        safe, rate, dt = bench.safe_command, bench.limits.rate_per_s, bench.dt_s
        span = math.copysign(min(_DASH_SHARE * abs(end - safe), _DASH_S * rate), end - safe)
        moving = max(math.ceil(abs(span) / (rate * dt) - 1e-9), 1)
        way = safe + span * np.minimum(np.arange(moving + 1) * rate * dt / abs(span), 1.0)
        rest = round(2 * HOLD_S / dt)
        there, back = np.append(way, np.full(rest, way[-1])), np.append(way[::-1], np.full(rest, safe))
        super().__init__("dash", np.append(there, back), dt)
        self._there, self._span, self._bench = there, span, bench

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return len(self._commands) * self._bench.dt_s

    @property
    def tells(self) -> bool:
        """Whether the device reports its held command."""
        return bool(np.isfinite(self.reported).any())

    @property
    def rate_per_s(self) -> float:
        """Usable rate: the limit if the device followed it or reports nothing, else 90 % of the measured rate."""
        limit = self._bench.limits.rate_per_s
        sent, reported = self._there, np.array(self.reported[: self._there.size])
        if not np.isfinite(reported).any():
            return limit
        lasts, wanted = _ten_to_ninety(reported, sent[0], self._span), _ten_to_ninety(sent, sent[0], self._span)
        if math.isnan(lasts):  # it did not reach nine tenths of the travel
            known = reported[np.isfinite(reported)]
            moved = float(np.abs(known - sent[0]).max())
            return _CAREFUL * min(limit, max(moved / (sent.size * self._bench.dt_s), 0.01 * limit))
        if lasts <= wanted + _FOLLOWS:
            return limit
        return _CAREFUL * min(limit, 0.8 * abs(self._span) / (lasts * self._bench.dt_s))


def _ten_to_ninety(values: Vec, start: float, span: float) -> float:
    """Rise time from 10 % to 90 % of the travel [samples]; NaN if 90 % is not reached."""
    share = (values - start) / span
    early, late = np.flatnonzero(share >= 0.1 - 1e-9), np.flatnonzero(share >= 0.9 - 1e-9)
    return float(late[0] - early[0]) if late.size else math.nan
