"""Segments of a trial by the motion of its command: loading, unloading, hold; turning points; the first flexure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from .clocks import runs
from .errors import LogError
from .trial import Trial, require_uniform
from .types import Index, Vec


class Motion(IntEnum):
    """Motion of the command at a sample: loading, unloading or hold."""

    UNLOADING = -1
    HOLD = 0
    LOADING = 1


@dataclass(frozen=True)
class SegmentRule:
    """Thresholds of the segmentation, relative to the range of the command: independent of its scale and offset.

    Attributes:
        reversal: least share of the range by which the command comes back at a turn; less is noise.
        hold_band: share of the range within which the command stays during a hold ...
        hold_s: ... for at least this long [s]; the crest of a slow sine is shorter.
    """

    reversal: float = 0.01
    hold_band: float = 0.001
    hold_s: float = 0.6


@dataclass(frozen=True, eq=False)
class Segments:
    """Segmentation of one trial of T samples."""

    labels: NDArray[np.int8]  # a `Motion` per sample, (T,) int8
    reversals: Index  # samples at which the command turns: the last of each extreme, increasing

    def runs(self, motion: Motion) -> list[tuple[int, int]]:
        """Start and stop (exclusive) of every uninterrupted run of one motion."""
        starts, stops = runs(self.labels == motion)
        return list(zip(starts.tolist(), stops.tolist(), strict=True))

    @property
    def holds(self) -> list[tuple[int, int]]:
        """Start and stop (exclusive) of every hold."""
        return self.runs(Motion.HOLD)


DEFAULT_RULE = SegmentRule()


def segment(trial: Trial, rule: SegmentRule = DEFAULT_RULE) -> Segments:
    """Label every sample of a uniformly sampled trial.

    A sample belongs to the motion that led to it; a command that never moves is one hold. For an inverse trial, the
    device's command is used, not the exchanged one.

    Raises:
        LogError: if the sampling is not uniform.
    """
    dt = require_uniform(trial)
    command = _device_command(trial)
    span = float(np.ptp(command))
    direction, reversals = turning_points(command, rule.reversal * span)
    labels = np.zeros(len(trial), dtype=np.int8)
    if direction:
        pieces = np.diff(np.concatenate(([0], reversals + 1, [len(trial)])))
        labels = np.repeat(direction * (-1) ** np.arange(pieces.size), pieces).astype(np.int8)
    band = rule.hold_band * span
    held = _held(command, round(rule.hold_s / dt) + 1, band)
    # Two holds may meet without a sample between them: the first sample of the later one then counts as the move.
    meets = held & np.roll(held, 1) & (np.abs(np.diff(command, prepend=command[0])) > band)
    labels[held & ~meets] = Motion.HOLD
    return Segments(labels, reversals)


def first_flexure_end(trial: Trial) -> int:
    """First turning point of the command, at which the first flexure ends, which differs from all later ones.

    Raises:
        LogError: if the command never turns, or the sampling is not uniform.
    """
    require_uniform(trial)
    command = _device_command(trial)
    _, reversals = turning_points(command, DEFAULT_RULE.reversal * float(np.ptp(command)))
    if not reversals.size:
        unit = trial.units.angle if trial.inverted else trial.units.command
        raise LogError(
            f"{trial.source}: the command never turns back (it runs from {command[0]:g} to "
            f"{command[-1]:g} {unit}), expected a reversal that ends the first flexure"
        )
    return int(reversals[0])


def _device_command(trial: Trial) -> Vec:
    return trial.angle if trial.inverted else trial.command


def turning_points(command: Vec, threshold: float) -> tuple[int, Index]:
    """First direction (+1, -1, 0 if none) and the samples at which the command turns by more than `threshold`."""
    values = command.tolist()
    highest = lowest = 0
    first = direction = 0
    turns: list[int] = []
    for k, value in enumerate(values):
        if direction >= 0 and value >= values[highest]:
            highest = k
        if direction <= 0 and value <= values[lowest]:
            lowest = k
        fell, rose = values[highest] - value > threshold, value - values[lowest] > threshold
        if direction >= 0 and fell:
            turns += [highest] if direction else []
            direction, lowest = -1, k
        elif direction <= 0 and rose:
            turns += [lowest] if direction else []
            direction, highest = 1, k
        first = first or direction
    return first, np.array(turns, dtype=np.intp)


def _held(command: Vec, window: int, band: float) -> NDArray[np.bool_]:
    """Mask of the samples in any window of `window` samples in which the command stays within `band`."""
    if window > command.size:
        return np.zeros(command.size, dtype=np.bool_)
    stretches = np.lib.stride_tricks.sliding_window_view(command, window)
    starts = np.flatnonzero(stretches.max(axis=1) - stretches.min(axis=1) <= band)
    change = np.zeros(command.size + 1, dtype=np.intp)
    change[starts] += 1
    change[starts + window] -= 1
    return np.cumsum(change[:-1]) > 0
