"""A table of a study: shown in the report and written as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hystmpc.trials.files import write_atomically
from hystmpc.trials.report import Table

Cell = str | int | float
NOTHING = "-"


@dataclass(frozen=True)
class StudyTable:
    """Rows of one table; floats are shown to four digits and written in full.

    Attributes:
        caption: what it shows, and whether its numbers are simulated, real or printed in a paper.
    """

    name: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str
    shown: bool = True

    @property
    def piece(self) -> Table:
        """The table of the report."""
        return Table(self.columns, self.rows, f"{self.caption} ({self.name}.csv)")

    @property
    def csv(self) -> str:
        """Comma-separated text."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)
        return out.getvalue()

    def save(self, folder: Path) -> Path:
        """Write `tables/<name>.csv` below the study's folder."""
        return write_atomically(folder / "tables" / f"{self.name}.csv", self.csv)


def other_study(wanted: str, earlier: Any) -> str:
    """Why a folder with these earlier settings does not belong to a study; empty where it does."""
    found = earlier.get("study") if isinstance(earlier, dict) else None
    return "" if found == wanted else f"holds a run of {found or 'something else'}, expected one of study {wanted}"
