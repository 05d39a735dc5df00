"""What may stand for a recording: time in seconds, and an angle that was measured."""

from __future__ import annotations

from .check import require_seconds
from .errors import LogError
from .trial import Trial

SEPARATION_COLUMN = "separation_deg"
"""A column that no recording has, by which a motion that a diagnosis has proposed is told from a log."""


def require_recorded(trial: Trial) -> None:
    """Refuse a trial that nothing can be learned from: a proposed motion, or time in milliseconds.

    Raises:
        LogError: if its angle is the one that a diagnosis expects, or its samples are a second or more apart.
    """
    if SEPARATION_COLUMN in trial.channels:
        raise LogError(f"{trial.source}: is a motion proposed by a diagnosis, expected what was recorded on it")
    require_seconds(trial)
