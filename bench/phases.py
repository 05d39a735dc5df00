"""Phases of a run that depend on the measured angle: limits of the angle, a climb in steps, a dash at full rate."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.rig.axes import PerAxis, each, in_words, is_known, of_axis, spread, together
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
    """Result of a climb: reached command and angle, and the reason of its end; of two axes pairs of both."""

    end: PerAxis  # farthest command at which the tip rested within its limits
    angle_deg: PerAxis  # at that command [deg], NaN if it never left the start
    start_deg: PerAxis  # at the start [deg]
    why: str  # end of the climb, in words
    still: float = 0.0  # longest travel of the command, both ways, in which the tip did not move
    share: float = 0.0  # part of the way to the wanted end that was reached, 0 to 1


class RecentAngles:
    """The newest angles of every axis, usable or not, and whether their medians are within limits.

    Args:
        limits: of each angle [deg].
    """

    def __init__(self, limits: Sequence[tuple[float, float]]) -> None:
        self.limits = list(limits)
        self._recent: list[deque[float]] = [deque(maxlen=MEDIAN) for _ in limits]

    def keep(self, now: PhaseInput) -> None:
        """Add the angles of a sample."""
        axes = len(self._recent)
        angles, shown = spread(now.angle_deg, axes), spread(now.shown_deg, axes)
        for recent, angle, seen in zip(self._recent, angles, shown, strict=True):
            value = angle if math.isfinite(angle) else seen
            if math.isfinite(value):
                recent.append(value)

    def clear(self) -> None:
        """Forget all of them."""
        for recent in self._recent:
            recent.clear()

    @property
    def medians(self) -> Vec:
        """Median of each axis (A,) [deg]; NaN of an axis that has fewer than three."""
        return np.array([float(np.median(r)) if len(r) == MEDIAN else math.nan for r in self._recent])

    def beyond(self, angles: Vec) -> int | None:
        """First axis whose angle (A,) is beyond its limits; None for none, and of not-a-number."""
        ends = zip(angles.tolist(), self.limits, strict=True)
        return next((i for i, (angle, (low, high)) in enumerate(ends) if angle < low or angle > high), None)


@final
class Bounded(Phase):
    """Safety wrapper of a phase: stop if the median of three angles exceeds the limits by 2 % of their range.

    The command's range is measured at rest; a device that overshoots in a fast motion goes farther. Angles count as
    shown, even outside the sensor's range and faster than plausible: those are beyond the limits, not missing. Of two
    axes each angle has these limits.

    Args:
        angle_limits: of the tip [deg]; None for the range of the sensor.
        axes: number of angles.
    """

    def __init__(
        self, phase: Phase, angle_limits: tuple[float, float] | None, sensor: SensorSettings, axes: int = 1
    ) -> None:
        self.name, self._phase = phase.name, phase
        self._which = "commission.angle_limits_deg" if angle_limits else "the range of the sensor"
        low, high = angle_limits or (sensor.lower_deg, sensor.upper_deg)
        margin = ANGLE_MARGIN * (high - low)
        self._recent = RecentAngles([(low - margin, high + margin)] * axes)

    @property
    def closed_loop(self) -> bool:
        return self._phase.closed_loop

    def begin(self, now: PhaseInput, past: Past) -> None:
        self._recent.clear()
        self._phase.begin(now, past)

    def step(self, now: PhaseInput) -> Decision:
        """Decision of the wrapped phase, or a fault beyond the limits."""
        decision = self._phase.step(now)
        self._recent.keep(now)
        angles = self._recent.medians
        axis = self._recent.beyond(angles)
        if axis is None:
            return decision
        text = f"the angle is {angles[axis]:.2f} deg, beyond {self._which}"
        return replace(decision, u=now.held, fault=of_axis(text, axis, angles.size))


@final
class Climb(Phase):
    """Phase that climbs from the held command towards `end` in ramps with rests, and back, within the angle limits.

    A step is taken only with a usable angle. The first one is a quarter; each is made smaller where 1.5 times the
    steepest slope so far would lead beyond the limits. An angle beyond them on the way turns the motion back at once;
    the farthest command of an earlier rest counts. A tip that has moved and then stays for 45 % of the travel that the
    motion watch allows (`plausibility.travel`) ends the climb at its last motion. A step is judged at rest: a lagging
    device gets time.

    Of two axes the commands go along the line to `end`, and both angles have the limits. The tip moves if an angle
    moves whose command does.

    Args:
        bench: rate, ramps and hard limits.
        end: where to climb to, from the safe command.
        angle_limits: of the tip [deg], of both angles of two axes.
        steps: into which the way is divided.
        widen: whether a tip that rests beyond its limits at the start widens them; otherwise the climb ends there.
    """

    name = "climb"

    def __init__(
        self, bench: BenchSettings, end: PerAxis, angle_limits: tuple[float, float], steps: int, widen: bool = False
    ) -> None:
        self._bench, self._steps, self._widen = bench, steps, widen
        self._ends, self._lead, self._moving = each(end), leading(bench, end), moving_axes(bench, end)
        axes = len(self._ends)
        self._end: float = self._ends[self._lead]
        self._plan: deque[float] = deque()  # commands of the axis that leads
        self._recent = RecentAngles([angle_limits] * axes)
        self._base: tuple[float, ...] = (math.nan,) * axes
        self._start = self._at = self._target = self._moved = math.nan
        self._start_deg = self._at_deg = self._moved_deg = np.full(axes, math.nan)
        self._slope = np.zeros(axes)
        self._back = self._stirred = False
        watch, sensor, limits = bench.plausibility, bench.sensor, bench.axes_limits[self._lead]
        span, range_deg = limits.upper - limits.lower, sensor.upper_deg - sensor.lower_deg
        self._moves = watch.moves_of(range_deg)
        self._travel = watch.travel_of(span, onward=True) if watch.watch_motion else math.inf
        smoothed = watch.model_copy(update={"travel_s": SMOOTH_S})  # the command is averaged as the angle is
        self._watch, self._still = MotionWatch(smoothed, span, range_deg), 0.0
        window = max(round(_WINDOW_S / bench.dt_s), 1)
        self._settling: deque[tuple[float, ...]] = deque(maxlen=2 * window)
        self._samples = self._waited = 0
        nothing = together([math.nan] * axes)
        self._result = ClimbResult(nothing, nothing, nothing, "it was not finished")

    def begin(self, now: PhaseInput, past: Past) -> None:
        """Begin with a rest for the angle at the start."""
        del past
        self._base = each(now.held)
        self._start = self._at = self._target = self._base[self._lead]
        self._plan = deque(self._way(self._start, self._start))

    def step(self, now: PhaseInput) -> Decision:
        """Next command of the present step, of the next step, or of the return."""
        angles, held = spread(now.angle_deg, len(self._ends)), each(now.held)[self._lead]
        self._recent.keep(now)
        self._settling.append(angles)
        self._samples += 1
        self._watch.judge(angles[self._lead], held, round(1e9 * self._samples * self._bench.dt_s))
        self._still = max(self._still, self._watch.still)
        medians = self._recent.medians
        begun, beyond = math.isfinite(self._start_deg[0]), self._recent.beyond(medians)
        if not self._back and begun and beyond is not None:
            self._turn(now, self._said(f"the angle reached {medians[beyond]:.2f} deg", beyond))
        if not self._plan and not self._back:
            self._rested(now, medians)
        u = self._along(self._plan.popleft()) if self._plan else now.held
        return Decision(u, self.name, finished=self._back and not self._plan)

    @property
    def result(self) -> ClimbResult:
        """Farthest command, its angle, and the reason of the end."""
        return replace(self._result, still=self._still)

    def _along(self, u: float) -> PerAxis:
        """Commands on the line to the end, by that of the axis that leads."""
        start, way = self._base[self._lead], self._end - self._base[self._lead]
        share = (u - start) / way if way else 0.0
        line = zip(self._base, self._ends, strict=True)
        return together(u if i == self._lead else a + share * (b - a) for i, (a, b) in enumerate(line))

    def _said(self, text: str, axis: int) -> str:
        return of_axis(text, axis, len(self._ends))

    def _settles(self, angles: Vec) -> bool:
        """Whether the tip still moves after a step within the longest rest."""
        if math.isnan(self._start_deg[0]):
            return False
        half = len(self._settling) // 2
        before, after = np.split(np.array(self._settling)[-2 * half :], 2)
        moves_deg, moved_deg = np.abs(after.mean(axis=0) - before.mean(axis=0)), np.abs(angles - self._at_deg)
        self._waited += 1
        moves = ((moved_deg > self._moves) & (moves_deg > _SETTLED * moved_deg))[self._moving].any()
        return bool(moves) and self._waited * self._bench.dt_s < _SETTLES_S

    def _rested(self, now: PhaseInput, angles: Vec) -> None:
        """Evaluate the finished step and plan the next one; without an angle, wait."""
        if not is_known(now.angle_deg) or np.isnan(angles).any() or self._settles(angles):
            return None
        self._waited = 0
        if math.isnan(self._start_deg[0]):
            self._start_deg = angles
            if self._widen:
                self._widened(angles)
        elif self._target != self._at:
            slope = (angles - self._at_deg) / (self._target - self._at)
            self._slope = np.where(np.abs(slope) > np.abs(self._slope), slope, self._slope)
        self._at, self._at_deg = self._target, angles
        first = math.isnan(self._moved_deg[0])
        if first or (np.abs(angles - self._moved_deg) >= self._moves)[self._moving].any():
            self._stirred = self._stirred or not first
            self._moved, self._moved_deg = self._at, angles
        elif self._stirred and abs(self._at - self._moved) >= _STILL * self._travel:
            stayed = in_words(together(angles[self._moving].tolist()), ".2f")
            still = f"the angle stayed at {stayed} deg from {self._moved:.4g} to {self._at:.4g}"
            self._at, self._at_deg = self._moved, self._moved_deg
            return self._turn(now, still)
        if (beyond := self._recent.beyond(angles)) is not None:
            return self._turn(now, self._said(f"the tip rests at {angles[beyond]:.2f} deg, beyond its limits", beyond))
        if self._at == self._end:
            return self._turn(now, "the limit of the command")
        step, bound = self._next_step(angles)
        if step == 0.0:
            return self._turn(now, self._said(f"the angle is {angles[bound]:.2f} deg, near its limit", bound))
        self._target = self._at + step
        self._plan = deque(self._way(each(now.held)[self._lead], self._target))
        return None

    def _widened(self, angles: Vec) -> None:
        """Widen the limits of a tip that rests beyond them at the start."""
        for i, (low, high) in enumerate(self._recent.limits):
            margin, angle = ANGLE_MARGIN * (high - low), float(angles[i])
            self._recent.limits[i] = min(low, angle - margin), max(high, angle + margin)

    def _next_step(self, angles: Vec) -> tuple[float, int]:
        """Size of the next step, and the axis that bounds it: whole, shortened near the limits, 0 if little remains."""
        whole, left = (self._end - self._start) / self._steps, self._end - self._at
        if self._at == self._start:
            return _LEAST_STEP * whole, 0  # the slope is still unknown
        wanted = step = whole if abs(left) > 1.2 * abs(whole) else left
        bound = self._lead
        for i, (low, high) in enumerate(self._recent.limits):
            move = _CAUTION * float(self._slope[i]) * wanted
            room = max(high - float(angles[i]) if move > 0 else float(angles[i]) - low, 0.0)
            if abs(move) > room:
                shorter = wanted * (room / abs(move))
                step, bound = (shorter, i) if abs(shorter) < abs(step) else (step, bound)
        return (step if abs(step) >= _LEAST_STEP * min(abs(whole), abs(left)) else 0.0), bound

    def _turn(self, now: PhaseInput, why: str) -> None:
        """Begin the return and set the result."""
        self._back = True
        way = self._end - self._start
        share = (self._at - self._start) / way if way else 0.0
        ends = together(self._at_deg.tolist()), together(self._start_deg.tolist())
        self._result = ClimbResult(self._along(self._at), *ends, why, share=share)
        bench, held, speed = self._bench, each(now.held)[self._lead], each(now.velocity)
        velocity = speed[self._lead] if len(speed) > self._lead else speed[0]
        back = stop_commands(held, velocity, self._start, bench.ramps, bench.overshoot, bench.dt_s)
        self._plan = deque([*back.tolist(), *self._way(self._start, self._start)])

    def _way(self, held: float, to: float) -> list[float]:
        return waypoint_commands(held, [to], [HOLD_S], self._bench.ramps, self._bench.dt_s).tolist()


def moving_axes(bench: BenchSettings, end: PerAxis) -> list[int]:
    """Axes whose commands differ between the safe command and `end`."""
    return [i for i, (a, b) in enumerate(zip(each(bench.safe_command), each(end), strict=True)) if a != b]


def leading(bench: BenchSettings, end: PerAxis) -> int:
    """Axis of the longest way from the safe command to `end`."""
    ways = [abs(b - a) for a, b in zip(each(bench.safe_command), each(end), strict=True)]
    return ways.index(max(ways))


def climb_seconds(bench: BenchSettings, end: PerAxis, steps: int) -> float:
    """Duration of a climb to `end` and of the return [s]."""
    lead = leading(bench, end)
    safe, top = each(bench.safe_command)[lead], each(end)[lead]
    stops = [*np.linspace(safe, top, steps + 2).tolist(), safe]
    return waypoint_commands(safe, stops, [HOLD_S] * len(stops), bench.ramps, bench.dt_s).size * bench.dt_s


def placed(bench: BenchSettings, axis: int, commands: Vec) -> Vec:
    """Commands (N,) of one axis as those of the device: (N, 2) of two axes, the other one at the safe command."""
    safe = each(bench.safe_command)
    if len(safe) == 1:
        return commands
    made = np.tile(np.array(safe), (commands.size, 1))
    made[:, axis] = commands
    return made


@final
class Dash(Recorded):
    """Phase that dashes over half of the distance to `end` and back, for at most 0.6 s at the greatest rate.

    It measures the rate of a device that reports its command. Of two axes one moves, and the other one rests.
    """

    def __init__(self, bench: BenchSettings, end: PerAxis) -> None:
        self._axis = axis = leading(bench, end)
        safe, rate, dt = each(bench.safe_command)[axis], bench.axes_limits[axis].rate, bench.dt_s
        end = each(end)[axis]
        span = math.copysign(min(_DASH_SHARE * abs(end - safe), _DASH_S * rate), end - safe)
        moving = max(math.ceil(abs(span) / (rate * dt) - 1e-9), 1)
        way = safe + span * np.minimum(np.arange(moving + 1) * rate * dt / abs(span), 1.0)
        rest = round(2 * HOLD_S / dt)
        there, back = np.append(way, np.full(rest, way[-1])), np.append(way[::-1], np.full(rest, safe))
        super().__init__("dash", placed(bench, axis, np.append(there, back)), dt)
        self._there, self._span, self._bench = there, span, bench

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return len(self._commands) * self._bench.dt_s

    @property
    def tells(self) -> bool:
        """Whether the device reports its held command."""
        return bool(np.isfinite(self._reported).any())

    @property
    def _reported(self) -> Vec:
        """What the device says it holds of the axis that moves (N,)."""
        axes = len(self._bench.axes_limits)
        return np.array([spread(one, axes)[self._axis] for one in self.reported])

    @property
    def rate_per_s(self) -> float:
        """Usable rate: the limit if the device followed it or reports nothing, else 90 % of the measured rate."""
        limit = self._bench.axes_limits[self._axis].rate
        sent, reported = self._there, self._reported[: self._there.size]
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
