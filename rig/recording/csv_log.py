"""Samples as rows of log.csv."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import final

from hystmpc.trials.layouts import CANONICAL

from ..sample import Sample
from .growing_file import GrowingFile


def stage_column(name: str) -> str:
    """Column of a stage's duration [s]."""
    return f"stage_{name.replace(' ', '_')}_s"


@final
class CsvLog:
    """Writes log.csv in canonical columns, then the rest of a sample.

    The last column is one character wide: a row that was cut off by a kill lacks it, and readers leave that row out.

    Args:
        path: a new file.
        command: name of the command's column, such as `command_mm`.
        stages: names of the stages that get a column; the first sample's where empty.

    Raises:
        OSError: if the file cannot be made.
    """

    def __init__(self, path: Path, command: str, stages: tuple[str, ...]) -> None:
        self._file = GrowingFile(path)
        self._command = command
        self._stages = stages
        self._text = io.StringIO()
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._begun = False

    def add(self, sample: Sample) -> None:
        """Collect one row; stages without a column are left to the MCAP log."""
        if not self._begun:
            self._begin(sample)
        spent = dict(sample.stages_s)
        self._rows.writerow(
            (
                repr(float(sample.t_s)),
                repr(float(sample.command)),
                repr(float(sample.measured_deg)),
                repr(float(sample.reference_deg)),
                repr(float(sample.predicted_deg)),
                repr(float(sample.period_s)),
                repr(float(sample.lateness_s)),
                int(sample.sequence),
                int(sample.wall_ns),
                *(repr(float(spent[name])) if name in spent else "" for name in self._stages),
                _cell(sample.source),
                _cell(sample.status),
                _cell(" ".join(sample.faults)),
                int(bool(sample.missed)),
            )
        )

    def flush(self) -> None:
        """Put whole rows on the disk.

        Raises:
            OSError: if the disk is full or fails.
        """
        self._file.write(self._text.getvalue().encode("utf-8", errors="replace"))
        self._text.seek(0)
        self._text.truncate()
        self._file.commit()

    def close(self) -> None:
        """End the file.

        Raises:
            OSError: if the disk fails.
        """
        self._file.close()

    def _begin(self, first: Sample) -> None:
        self._begun = True
        self._stages = self._stages or tuple(name for name, _ in first.stages_s)
        numbers = ("reference_deg", "predicted_deg", "period_s", "lateness_s", "sequence", "wall_ns")
        stages = map(stage_column, self._stages)
        header = (CANONICAL.time, self._command, CANONICAL.angle, *numbers, *stages)
        self._rows.writerow((*header, "source", "status", "faults", "missed"))


def one_line(text: str) -> str:
    """A text without line breaks and control characters, that a row stays a row."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in str(text)).split())


def _cell(text: str) -> str:
    """A text that no reader takes for a number or for a missing one: a column's first cell tells its kind."""
    line = one_line(text)
    try:
        float(line)
    except ValueError:
        return line or "-"
    return f"({line})"
