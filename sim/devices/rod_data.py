"""The motions of S2 recorded on the rod device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .quantities import to_plain
from .rod_recorder import RodRecorder
from .s2_data import S2Settings


@dataclass(frozen=True)
class RodSettings:
    """What is recorded on the rod, and how.

    Attributes:
        recorder: the bench with the rod.
        motions: which motions of S2, and how many; its own recorder, that of the tendon catheter, is not used.
    """

    recorder: RodRecorder = field(default_factory=RodRecorder)
    motions: S2Settings = field(default_factory=S2Settings)

    def plain(self) -> dict[str, Any]:
        """As plain data for the manifest."""
        motions: Mapping[str, Any] = to_plain(self.motions)
        kept = {name: value for name, value in motions.items() if name != "recorder"}
        return {"recorder": to_plain(self.recorder), "motions": kept}
