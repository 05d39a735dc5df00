"""Did the first flexure leave a set? Told from two rests at one command, one before it and one after it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from .clock_shift import DELAY_S
from .segments import Segments
from .trial import Trial
from .types import Vec

SAME = 0.005
"""Share of the command's range within which two rests are at one command."""

LEAST_SET = 0.02
"""Share of the angle's range below which a change is none; three times the noise of an electromagnetic tracker."""

_LEAST_NOISES = 4.0  # standard errors
_BENDS = 0.2  # of the range of the angle: less of a first flexure does not tell which way the angle goes
_SAME_READING = 1e-6  # of the range of the angle
_TAIL = 0.5  # of a rest, at its end: what is looked at
_CREEP = 0.5  # of the bend: the most that creep adds
_FULL_LOOP = 1.2  # of the half-way gap, by which the gap at the start is greater if plays from rest are not its cause


class Verdict(StrEnum):
    """What can be said."""

    NONE = "none"  # the angle came back
    SET = "set"  # it did not, and no play that begins at rest explains that
    SET_OR_PLAY = "set or play"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Rest:
    """The end of a hold of the command.

    Attributes:
        start, stop: samples of the hold.
        command: during it.
        angle: a recorded one of its end, their median.
        error: standard error of that angle.
        drift: speed of the angle there, its standard error on top [angle/s].
    """

    start: int
    stop: int
    command: float
    angle: float
    error: float
    drift: float


@dataclass(frozen=True)
class FirstFlexure:
    """What two rests at one command say.

    Attributes:
        verdict: on the set.
        before, after: the two rests; None where there are none.
        why: of an unknown verdict.
    """

    verdict: Verdict
    before: Rest | None = None
    after: Rest | None = None
    why: str = ""

    @property
    def change(self) -> float:
        """Angle after less angle before; 0 without two rests."""
        return self.after.angle - self.before.angle if self.before and self.after else 0.0


def first_flexure(trial: Trial, parts: Segments) -> FirstFlexure:
    """Compare the angle at rest before the first flexure with that at the same command, at rest, after it.

    The angle has to stand still in both, so that lag, drift and creep are no set. Creep of time constant tau that
    drifts by d is still off by d tau, and not by more than 0.5 T / tau of the bend if it had the time T to grow; for no
    tau that is more than sqrt(0.5 d T bend).

    A play leaves the angle above where it began, if the flexure was upwards and came back from there, whatever the
    play: a change the other way is a set. Of a change this way, the gap between the way there and the way back tells:
    of plays that begin between their middle and the side of the flexure it is never wider at the start than half-way.
    Plays begin so where the command begins at zero, the end of its range. Anywhere else it is a set, or a play that
    began elsewhere.

    Args:
        trial: uniformly sampled.
        parts: its segments.
    """
    if not parts.reversals.size:
        return FirstFlexure(Verdict.UNKNOWN, why="the command never turns back")
    top, u = int(parts.reversals[0]), trial.command
    span = float(np.ptp(u))
    steps = np.abs(np.diff(trial.angle))
    grain = 2 * float(steps[steps > _SAME_READING * np.ptp(trial.angle)].min(initial=float(np.ptp(trial.angle))))
    rests = [rest(trial, start, stop, grain) for start, stop in parts.holds]
    early = [r for r in rests if r.start < top and abs(r.command - u[top]) > SAME * span]
    if not early:
        return FirstFlexure(Verdict.UNKNOWN, why="the command does not rest before it")
    before = early[0]
    again = [r for r in rests if r.start > top and abs(r.command - before.command) <= SAME * span]
    why = f"the command does not rest again at {before.command:.4g} {trial.units.command}, where it began"
    found = FirstFlexure(Verdict.UNKNOWN, before, why=why)
    for after in again:
        found = _compared(trial, before, after, top)
        if found.verdict is not Verdict.UNKNOWN:
            break
    return found


def _compared(trial: Trial, before: Rest, after: Rest, top: int) -> FirstFlexure:
    """What these two rests say."""
    bend, change = float(np.ptp(trial.angle)), abs(after.angle - before.angle)
    elapsed, moved = trial.t[after.stop - 1] - trial.t[before.stop - 1], trial.t[after.start] - trial.t[before.stop - 1]
    drift = max(before.drift, after.drift)
    creeping = max(drift * float(elapsed), float(np.sqrt(_CREEP * drift * moved * bend)))
    if change <= max(LEAST_SET * bend, _LEAST_NOISES * float(np.hypot(before.error, after.error))):
        return FirstFlexure(Verdict.NONE, before, after)
    if change <= creeping:
        why = "the angle had not come to rest in the holds, or is too noisy there"
        return FirstFlexure(Verdict.UNKNOWN, before, after, why)
    return FirstFlexure(_set_or_play(trial, before, after, top), before, after)


def rest(trial: Trial, start: int, stop: int, grain: float = 0.0) -> Rest:
    """The end of a hold; `grain` is what an angle may drift by that is always read the same."""
    first = stop - max(2, round((stop - start) * _TAIL))
    first = max(first, start)
    t, y = trial.t[first:stop], trial.angle[first:stop]
    median = float(np.partition(y, y.size // 2)[y.size // 2])
    moment = t - t.mean()
    power = float(moment @ moment)
    slope = float(moment @ y) / power if power > 0 else 0.0
    grain = grain if float(np.ptp(y)) <= _SAME_READING * float(np.ptp(trial.angle)) else 0.0
    noise, seconds = float(np.std(y - y.mean() - slope * moment)), float(np.ptp(t)) or trial.dt
    error = noise / np.sqrt(power) if power > 0 else 0.0
    return Rest(
        start,
        stop,
        float(np.median(trial.command[start:stop])),
        median,
        noise / y.size**0.5 + grain / 8,
        abs(slope) + error + grain / seconds,
    )


def _set_or_play(trial: Trial, before: Rest, after: Rest, top: int) -> Verdict:
    """Whether no play explains a change."""
    u, y = trial.command, trial.angle
    span, change = float(np.ptp(u)), after.angle - before.angle
    way = y[before.stop : top + 1 + round(DELAY_S / trial.dt)] - before.angle
    farthest = float(way[np.argmax(np.abs(way))])
    if abs(farthest) < _BENDS * float(np.ptp(y)):
        return Verdict.SET_OR_PLAY
    out, rises = float(np.sign(u[top] - before.command)), float(np.sign(farthest))
    if change * rises < 0:
        beyond = float((out * (u[top : after.start + 1] - before.command)).min()) < -SAME * span
        return Verdict.SET_OR_PLAY if beyond else Verdict.SET
    at_end = min(abs(before.command - u.min()), abs(before.command - u.max())) <= SAME * span
    if not at_end or abs(before.command) > SAME * span:
        return Verdict.SET_OR_PLAY
    half = 0.5 * (before.command + float(u[top]))
    there, back = _at(u, y, before.stop - 1, top, half), _at(u, y, top, after.start, half)
    if there is None or back is None:
        return Verdict.SET_OR_PLAY
    gap = (back - there) * rises
    steeper = max(1.0, _steeper(there, back, before, after, float(y[top])))
    return Verdict.SET if abs(change) > _FULL_LOOP * steeper * max(gap, 0.0) else Verdict.SET_OR_PLAY


def _steeper(there: float, back: float, before: Rest, after: Rest, top: float) -> float:
    """Slope of the first half of the flexure over that of the second one: a curved device has gaps in proportion."""
    middle, start = 0.5 * (there + back), 0.5 * (before.angle + after.angle)
    far = abs(top - middle)
    return abs(middle - start) / far if far > 0 else np.inf


def _at(u: Vec, y: Vec, start: int, stop: int, level: float) -> float | None:
    """Angle where the command first passes a level between two samples; None where it does not."""
    side = u[start : stop + 1] >= level
    passed = np.flatnonzero(side[1:] != side[:-1])
    if not passed.size:
        return None
    k = start + int(passed[0])
    share = (level - u[k]) / (u[k + 1] - u[k])
    return float(y[k] + share * (y[k + 1] - y[k]))
