"""How far a study has come, for progress bars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Tally:
    """How far a study has come.

    Attributes:
        done, total: jobs; those kept from before count as done.
        seconds_done, seconds_total: processor time by the estimate, kept jobs left out [s].
        note: the job that was finished last, empty at the start.
    """

    done: int
    total: int
    seconds_done: float
    seconds_total: float
    note: str = ""


Progress = Callable[[Tally], None]
