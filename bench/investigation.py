"""The story of an investigation: its rounds, and what it left behind."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hystmpc.trials.brief import brief, in_brief

from .round_plan import Plan
from .round_verdict import DIAGNOSIS, Ending, Judged
from .stages import Figure, plain_numbers

FORMAT = "hystmpc-investigation/1"
FIRST = "first"
"""Folder of the first motions."""


@dataclass(frozen=True)
class RecordedRound:
    """What was recorded.

    Attributes:
        names: of the motions that were played; fewer than planned where the device time did not suffice.
        device_s: device time used since the beginning, motions that were cut short included [s].
    """

    names: tuple[str, ...]
    device_s: Figure


@dataclass(frozen=True)
class Round:
    """One round of an investigation.

    Attributes:
        number: from 1.
        plan: what was to be recorded, and why.
        recorded: what was.
        judged: the verdict on all trials so far.
    """

    number: int
    plan: Plan
    recorded: RecordedRound
    judged: Judged
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Investigated:
    """What an investigation left behind.

    Attributes:
        folder: of the run.
        rounds: in their order, one at least.
        ended, why: what ended it, and that in one sentence.
        model: simulator that was judged.
        fixed: that with the effects found; None where the diagnosis made none.
        report: the page.
        device_s: device time used, motions that were cut short included [s].
        budget_s: device time allowed [s].
    """

    folder: Path
    rounds: tuple[Round, ...]
    ended: Ending
    why: str
    model: Path
    fixed: Path | None
    report: Path
    device_s: float
    budget_s: float

    def __repr__(self) -> str:
        last = self.verdict
        return in_brief(self, f"{last.verdict} after {len(self.rounds)} rounds, {self.device_s:.4g} s: {last.reason}")

    @property
    def verdict(self) -> Judged:
        """The last round's."""
        return self.rounds[-1].judged

    def as_json(self) -> dict[str, Any]:
        """The form `hystmpc-investigation/1`: plain dicts, lists, numbers and strings."""
        last = self.verdict
        return {
            "format": FORMAT,
            "verdict": last.verdict,
            "effects": list(last.effects),
            "ambiguity": [list(names) for names in last.ambiguity],
            "reason": last.reason,
            "ended": self.ended,
            "why": self.why,
            "device_s": round(self.device_s, 3),
            "budget_s": self.budget_s,
            "model": str(self.model),
            "corrected": None if self.fixed is None else self.fixed.relative_to(self.folder).as_posix(),
            "diagnosis": (round_folder(self.folder, len(self.rounds)) / "diagnose" / DIAGNOSIS)
            .relative_to(self.folder)
            .as_posix(),
            "rounds": plain_numbers([asdict(found) for found in self.rounds]),
        }


def round_folder(root: Path, number: int) -> Path:
    """Folder of a round."""
    return root / f"round-{number}"
