"""Where the identification of an operator starts: lines read off the loading and unloading branches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import Motion, first_flexure_end, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..operators.hysteresis import Backlash
from ..operators.prandtl_ishlinskii import PrandtlIshlinskii


def backlash_starts(trials: Sequence[Trial]) -> list[Chain]:
    """The two regression lines, and lines of their common slope with wider and narrower gaps.

    Raises:
        FitError: if the angle does not rise with the command, or a branch is missing.
    """
    loading, unloading = branch(trials, Motion.LOADING), branch(trials, Motion.UNLOADING)
    slope = 0.5 * (loading[0] + unloading[0])
    middle = 0.5 * (loading[1] + unloading[1])
    widths = (0.5, 2.0)  # in degrees either side, small and large for a catheter of tens of degrees
    return [
        _lines(unloading, loading),
        *(_lines(np.array([slope, middle + width]), np.array([slope, middle - width])) for width in widths),
    ]


def prandtl_ishlinskii_starts(trials: Sequence[Trial], plays: int) -> list[Chain]:
    """Equal weights that share the mean slope, thresholds spread over 10, 30 and 80 % of the command's range.

    Raises:
        FitError: if the angle does not rise with the command, or a branch is missing.
    """
    loading, unloading = branch(trials, Motion.LOADING), branch(trials, Motion.UNLOADING)
    slope, offset = 0.5 * (loading + unloading)
    span = max(float(np.ptp(trial.command)) for trial in trials)
    share = slope / (plays + 1)
    return [
        Chain(PrandtlIshlinskii(share, (share,) * plays, reach * span / plays, 1e-3, offset))
        for reach in (0.1, 0.3, 0.8)
    ]


def branch(trials: Sequence[Trial], motion: Motion) -> Vec:
    """Slope [deg/cmd] and offset [deg] of the line through one branch after the first flexure.

    Raises:
        FitError: if too few samples move that way, or the angle falls as the command rises.
    """
    commands, angles = [], []
    for trial in trials:
        labels = segment(trial).labels
        # The first flexure runs below the later loading branch and would tilt the line.
        chosen = (labels == motion) & (np.arange(len(trial)) >= first_flexure_end(trial))
        commands.append(trial.command[chosen])
        angles.append(trial.angle[chosen])
    u, y = np.concatenate(commands), np.concatenate(angles)
    if u.size < 10 or np.ptp(u) == 0:
        raise FitError(f"{u.size} samples of {motion.name.lower()}, expected at least 10 that move")
    slope, offset = np.polyfit(u, y, 1)
    if slope <= 0:
        raise FitError(
            f"the angle falls with the command while {motion.name.lower()} ({slope:.4g} deg per unit), "
            "expected it to rise; turn the sign of one channel"
        )
    return np.array([slope, offset])


def _lines(unloading: Vec, loading: Vec) -> Chain:
    """A backlash of two lines (slope, offset)."""
    return Chain(Backlash(unloading[0], loading[0], unloading[1] / unloading[0], loading[1] / loading[0]))
