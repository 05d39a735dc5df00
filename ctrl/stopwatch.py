"""Time per stage of one step."""

from __future__ import annotations

from time import perf_counter
from typing import final


@final
class Stopwatch:
    """Laps of one step; the only clock a controller reads."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._since = perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on `stage` [s]."""
        now = perf_counter()
        self.stages[stage] = self.stages.get(stage, 0.0) + now - self._since
        self._since = now
