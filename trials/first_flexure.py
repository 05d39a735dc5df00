"""Did the first flexure leave a set? Told from two rests at one command, one before it and one after it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from .segments import Segments
from .trial import Trial
from .types import Vec

SAME = 0.005
"""Share of the command's range within which two rests are at one command."""

LEAST_SET = 0.02
"""Share of the angle's range below which a change is none; three times the noise of an electromagnetic tracker."""

_LEAST_NOISES = 4.0  # standard errors
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
    tau that is more than sqrt(0.5 d T bend). A play leaves the angle above where it began, if the flexure was
    upwards, whatever the play: a change the other way is a set. Of a change this way, the gap between the way there
    and the way back tells: of plays that begin at rest and a command that begins at an end of its range, it is never
    wider at the start than half-way. Where the gap does not tell, it is a set, or a play that began elsewhere.

    Args:
        trial: uniformly sampled.
        parts: its segments.
    """
    if not parts.reversals.size:
        return FirstFlexure(Verdict.UNKNOWN, why="the command never turns back")
    top, u, y = int(parts.reversals[0]), trial.command, trial.angle
    span = float(np.ptp(u))
    rests = [rest(trial, start, stop) for start, stop in parts.holds]
    early = [r for r in rests if r.start < top and abs(r.command - u[top]) > SAME * span]
    if not early:
        return FirstFlexure(Verdict.UNKNOWN, why="the command does not rest before it")
    before = early[0]
    again = [r for r in rests if r.start > top and abs(r.command - before.command) <= SAME * span]
    if not again:
        why = f"the command does not rest again at {before.command:.4g} {trial.units.command}, where it began"
        return FirstFlexure(Verdict.UNKNOWN, before, why=why)
    after = min(again, key=lambda r: r.drift)
    change = abs(after.angle - before.angle)
    noise = _LEAST_NOISES * float(np.hypot(before.error, after.error))
    elapsed = float(trial.t[after.stop - 1] - trial.t[0])
    drift = max(before.drift, after.drift)
    creeping = max(drift * elapsed, float(np.sqrt(_CREEP * drift * elapsed * np.ptp(y))))
    least = max(LEAST_SET * float(np.ptp(y)), noise)
    if change <= least:
        return FirstFlexure(Verdict.NONE, before, after)
    if change <= creeping:
        why = "the angle had not come to rest in the holds, or is too noisy there"
        return FirstFlexure(Verdict.UNKNOWN, before, after, why)
    return FirstFlexure(_set_or_play(trial, before, after, top, span), before, after)


def rest(trial: Trial, start: int, stop: int) -> Rest:
    """The end of a hold."""
    first = stop - max(2, round((stop - start) * _TAIL))
    first = max(first, start)
    t, y = trial.t[first:stop], trial.angle[first:stop]
    median = float(np.partition(y, y.size // 2)[y.size // 2])
    moment = t - t.mean()
    power = float(moment @ moment)
    slope = float(moment @ y) / power if power > 0 else 0.0
    noise = float(np.std(y - y.mean() - slope * moment))
    error = noise / np.sqrt(power) if power > 0 else 0.0
    return Rest(
        start, stop, float(np.median(trial.command[start:stop])), median, noise / y.size**0.5, abs(slope) + error
    )


def _set_or_play(trial: Trial, before: Rest, after: Rest, top: int, span: float) -> Verdict:
    """Whether no play that begins at rest explains a change."""
    u, y = trial.command, trial.angle
    change = after.angle - before.angle
    out = float(np.sign(u[top] - before.command))
    rises = float(np.sign((y[top] - before.angle) * out)) * out  # of the angle, by the way to the first turn
    if change * rises < 0:
        return Verdict.SET
    at_end = min(abs(before.command - u.min()), abs(before.command - u.max())) <= SAME * span
    if not at_end:
        return Verdict.SET_OR_PLAY
    half = 0.5 * (before.command + float(u[top]))
    there, back = _at(u, y, before.stop - 1, top, half), _at(u, y, top, after.start, half)
    if there is None or back is None:
        return Verdict.SET_OR_PLAY
    gap = (back - there) * rises
    bend = max(1.0, _steeper(there, back, before, after, float(y[top])))
    return Verdict.SET if abs(change) > _FULL_LOOP * bend * max(gap, 0.0) else Verdict.SET_OR_PLAY


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
