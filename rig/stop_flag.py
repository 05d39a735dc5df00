"""How a run is asked from outside to end."""

from __future__ import annotations

from typing import final


@final
class StopFlag:
    """Set by a signal or another thread, looked at once a sample; the first cause stays."""

    def __init__(self) -> None:
        self.cause = ""

    def set(self, cause: str) -> None:
        """Ask for a safe stop."""
        self.cause = self.cause or cause
