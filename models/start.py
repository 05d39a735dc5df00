"""Start of a recorded trial: at rest at its first command and angle, or in motion at an estimated state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from hystmpc.trials.types import Mask, Vec

from .contract.metadata import Range

STILL = 0.002  # share of the command's range below which a command is at rest
_LOOK_S, _NOISE_S, _LONG_S, _MEAN_S = 0.04, 0.6, 5.0, 1.0
_NO_WAY = 1e-4  # travel in an interval that counts as none, as share of the command's range
_SLOW = 0.005  # share of the greatest speed that counts as zero
_EARLIER, _LATER = 0.25, 0.5  # intervals by which a motion from rest may have begun before or after the first sample
_LITTLE = 0.01  # share of the range below which a motion begins slowly
_FOLLOWS = 2.0  # allowed motion of the angle relative to that of the command, both as shares of their ranges
_SURE, _SCATTER = 3.0, 5.0  # standard errors of a drift, and standard deviations of a command's noise
_SEEN = 0.1  # share of the command's range within which an extreme counts as visited
_LEAST_S, _LEAST_SHARE, _MOST_SHARE = 3.0, 0.1, 0.5

Box = tuple[Range, Range]
"""Commands and angles among which the start of a trial is searched."""
Runs = Callable[[Vec, Vec, Vec], Vec]
"""Free runs (N, T) from rests at commands (N,) and angles (N,) over commands (N, T)."""


@dataclass(frozen=True)
class TrialStart:
    """Start of a free run over a trial.

    Attributes:
        command, angle: of the rest before the first sample [command unit], [deg]. For a trial that begins in motion:
            the rest that best explains its first samples, after an estimate by a model.
        lead: first samples that are used to estimate the state and are not scored; 0 for a trial that begins at rest.
        approach: commands between that rest and the first sample, for a trial that begins in motion.
    """

    command: float
    angle: float
    lead: int = 0
    approach: tuple[float, ...] = field(default=(), repr=False)

    @property
    def at_rest(self) -> bool:
        """Whether the trial begins at rest."""
        return self.lead == 0


def trial_start(command: Vec, angle: Vec, dt_s: float, inverted: bool = False) -> TrialStart:
    """Start of a trial, from its samples alone.

    It begins at rest where the command has no speed at the first sample, and the angle is constant while the command
    is. The device then rests at the mean of the samples before the command has moved, of at most one second: noise of a
    single sample would stay in wide plays. Any other trial begins in motion, and its first samples do not determine the
    state of the device. They are not scored until the command has been near both of its ends, for at most half of the
    trial.

    Args:
        command, angle: (T,).
        inverted: whether these are those of an inverse map, which starts at its first sample.
    """
    span = float(np.ptp(command))
    if inverted or span == 0.0 or command.size < 4:
        return TrialStart(float(command[0]), float(angle[0]))
    held, still, slow, moves = _still(command, span, dt_s)
    held, still = (min(count, round(_MEAN_S / dt_s) + 1) for count in (held, still))
    stop, seen = _averaged(angle, held, still, dt_s), min(slow, round(_LONG_S / dt_s) + 1)
    start = TrialStart(float(np.mean(command[:stop])), float(np.mean(angle[:stop])))
    share = STILL + _FOLLOWS * float(np.ptp(command[:seen])) / span
    if moves or _drifts(angle[:seen], share * float(np.ptp(angle))):
        return replace(start, lead=_lead(command, span, dt_s))
    return start


def estimated_start(start: TrialStart, command: Vec, angle: Vec, dt_s: float, box: Box, runs: Runs) -> TrialStart:
    """Start with which a model best explains the samples that are not scored.

        min_(u, y, e)  sum_{k < lead} w_k (theta_k(u, y, e) - y_k)^2,   w_k = (k / lead)^2

    over a grid that shrinks around its best point. The device is assumed to rest at u with angle y, then to move to e
    and from there to the first sample, at the speed of the trial. This covers the memory of a creep, the offset of
    plays wider than the motion, the branch of the loop and a lag in progress. The last samples before the scored ones
    count most.

    Args:
        command, angle: measured (T,).
        box: ranges that are searched; the trial's samples lie within.
    """
    if start.at_rest:
        return start
    seen, lead = angle[: start.lead], start.lead
    weights = (np.arange(1, lead + 1) / lead) ** 2
    low, high = (np.array([*ends, turn]) for ends, turn in zip(zip(*_ends(box), strict=True), (0.0, 1.0), strict=True))
    reach, best, least = high - low, np.array([start.command, start.angle, 0.5]), np.inf

    def angles(points: Vec) -> Vec:
        ways = np.array([_approach(u, turn, command, box[0], dt_s) for u, _, turn in points])
        plans = np.hstack([ways, np.tile(command[:lead], (len(points), 1))])
        return runs(points[:, 0], points[:, 1], plans)[:, ways.shape[1] :]

    same = angles(np.array([[start.command, y, 0.5] for y in (low[1], high[1])]))
    if np.array_equal(same[0], same[1]):
        reach[1] = 0.0  # a network starts alike at any angle
    for k in range(_ROUNDS):
        axes = [
            np.linspace(-1.0, 1.0, count if width else 1) * width
            for count, width in zip(_POINTS[k > 0], reach, strict=True)
        ]
        grid = np.clip(best + np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3), low, high)
        grid = np.vstack([best, np.unique(grid, axis=0)])
        costs = np.nan_to_num((angles(grid) - seen) ** 2 @ weights, nan=np.inf)
        chosen = int(np.argmin(costs))
        if costs[chosen] < least:
            best, least = grid[chosen], costs[chosen]
        reach = reach * _ZOOM[k > 0]
    u, y, turn = best.tolist()
    way = _approach(u, turn, command, box[0], dt_s)
    return replace(start, command=u, angle=y, approach=tuple(way.tolist()))


_ROUNDS, _POINTS, _ZOOM = 10, ((17, 17, 7), (7, 7, 5)), (0.15, 0.45)
_APPROACH_S, _LAST_WAY_S = 4.0, 3.0


def _ends(box: Box) -> tuple[tuple[float, float], tuple[float, float]]:
    return (box[0].lower, box[0].upper), (box[1].lower, box[1].upper)


def _approach(rest: float, turn: float, command: Vec, box: Range, dt_s: float) -> Vec:
    """Commands from a rest to just before the first sample; `turn`: share of the last travel to the end of the box."""
    look, count = max(round(_LOOK_S / dt_s), 1), max(round(_APPROACH_S / dt_s), 2)
    speed = float(command[look] - command[0]) / look
    end = box.lower if speed > 0 else box.upper
    away = turn * abs(float(command[0]) - end)
    steps = min(away / abs(speed) if speed else np.inf, _LAST_WAY_S / dt_s)
    last = float(command[0]) - np.sign(speed or 1.0) * away * np.arange(1, int(steps) + 1) / max(steps, 1.0)
    turned = last[-1] if last.size else float(command[0])
    return np.concatenate([np.linspace(rest, turned, count - last.size, endpoint=False), last[::-1]])


def search_box(command: Range, angle: Range) -> Box:
    """Ranges of the rest command and angle in the search: a little wider than those of the trials."""
    w, h = 0.25 * (command.upper - command.lower), 0.1 * (angle.upper - angle.lower)
    return (
        Range(lower=command.lower - w, upper=command.upper + w),
        Range(lower=angle.lower - h, upper=angle.upper + h),
    )


def motion_line(name: str, start: TrialStart, dt_s: float) -> str:
    """Sentence on a trial that begins in motion."""
    return (
        f"{name} begins in motion: its first {start.lead * dt_s:.3g} s are used to find the state of the device and "
        "are not scored"
    )


def _averaged(angle: Vec, held: int, still: int, dt_s: float) -> int:
    """Number of samples whose mean is the angle at rest; those of a little travel count unless it moves the angle."""
    moved = abs(float(np.mean(angle[:still]) - np.mean(angle[:held])))
    sure = _SURE * _noise(angle[: round(_NOISE_S / dt_s) + 6]) / held**0.5
    return still if moved <= sure else held


def _still(command: Vec, span: float, dt_s: float) -> tuple[int, int, int, bool]:
    """Samples before the command has moved at all, has moved, and by more than a little; and whether it is in motion.

    Its initial speed follows from the parabola through three samples, v = (3 d_1 - d_2) / 2, d_1, d_2: travels.
    """
    look = max(round(_LOOK_S / dt_s), 1)
    noise = _SCATTER * _noise(command[: round(_NOISE_S / dt_s) + 6])
    away = np.abs(command - command[0])
    held, still, slow = (max(_first(away > share * span + noise), 1) for share in (_NO_WAY, STILL, _LITTLE))
    before, after = np.diff(command[: 2 * look + 1 : look]).tolist()
    change = abs(after - before)
    speed = 0.5 * (3.0 * before - after) * (1.0 if after > before else -1.0)
    room = _NO_WAY * span + _SLOW * float(np.max(np.abs(command[look:] - command[:-look]))) + noise
    return held, still, slow, not (-_LATER * change - room <= speed <= _EARLIER * change + room)


def _first(happens: Mask) -> int:
    """First index of a true value; the length where there is none."""
    return int(np.argmax(happens)) if happens.any() else happens.size


def _noise(signal: Vec) -> float:
    """Standard deviation of white noise on a smooth signal, from its third differences; steps do not count."""
    if signal.size < 6:
        return 0.0
    return float(np.median(np.abs(np.diff(signal, 3)))) / (0.6745 * 20.0**0.5)


def _drifts(signal: Vec, little: float) -> bool:
    """Whether a signal at rest moves along a straight line, significantly and by more than a little."""
    if signal.size < 5:
        return False
    t = np.arange(signal.size) - 0.5 * (signal.size - 1)
    slope = float(t @ signal) / float(t @ t)
    left = signal - signal.mean() - slope * t
    error = np.sqrt(float(left @ left) / (signal.size - 2) / float(t @ t))
    moved = abs(slope) * (signal.size - 1)
    return moved > max(little, _SURE * float(error) * (signal.size - 1))


def _lead(command: Vec, span: float, dt_s: float) -> int:
    """Samples until the command has been near both of its ends: after that no narrower play remembers its start."""
    near = _SEEN * span
    ends = (command >= command.max() - near, command <= command.min() + near)
    visited = max(int(np.argmax(end)) for end in ends) + 1
    least = max(_LEAST_S / dt_s, _LEAST_SHARE * command.size)
    return int(min(max(visited, round(least)), _MOST_SHARE * command.size))
