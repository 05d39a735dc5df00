"""What may stand for a recording: signals that are read rightly, and an angle that was measured."""

from __future__ import annotations

from .check import require_sound
from .errors import LogError
from .trial import Trial

SEPARATION_COLUMN = "separation_deg"
"""A column that no recording has, by which a motion that a diagnosis has proposed is told from a log."""


def require_recorded(trial: Trial) -> None:
    """Refuse a trial that nothing can be learned from: a proposed motion, or signals that are read wrongly.

    Raises:
        LogError: if its angle is the one that a diagnosis expects, or `check` finds time in
            another unit, codes or jumps, see `require_sound`.
    """
    if SEPARATION_COLUMN in trial.channels:
        raise LogError(f"{trial.source}: is a motion proposed by a diagnosis, expected what was recorded on it")
    require_sound(trial)
