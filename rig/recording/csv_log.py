"""Samples as rows of log.csv, in a file that grows by whole commits."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path
from typing import final

from .sample import Sample


@final
class CsvLog:
    """Writes log.csv in canonical columns, then the rest of a sample.

    The last column is one character wide: a row that was cut off by a kill lacks it, and readers leave that row out.

    Args:
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
        s = sample
        numbers = *s.motion(self._command).values(), s.period_s, s.lateness_s
        stages = (repr(float(spent[name])) if name in spent else "" for name in self._stages)
        texts = _cell(s.source), _cell(s.status), _cell(" ".join(s.faults))
        counts = int(s.sequence), int(s.wall_ns)
        self._rows.writerow((*(repr(float(x)) for x in numbers), *counts, *stages, *texts, int(bool(s.missed))))

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
        numbers = (*first.motion(self._command), "period_s", "lateness_s", "sequence", "wall_ns")
        self._rows.writerow((*numbers, *map(stage_column, self._stages), "source", "status", "faults", "missed"))


@final
class GrowingFile:
    """Bytes are collected in memory and appended to the file by `commit`.

    After a commit the operating system holds the data: it survives the death of the process (kill -9), though not a
    power cut until the system writes it out or `close` does.

    Raises:
        OSError: if the file exists or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("xb", buffering=0)
        self._pending = bytearray()
        self._committed = 0

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Collect bytes."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Length of the file once everything is committed."""
        return self._committed + len(self._pending)

    def flush(self) -> None:
        """Nothing: only `commit` writes, so that a writer of some format cannot leave half a record on the disk."""

    def commit(self) -> None:
        """Append what was collected.

        Raises:
            OSError: if the disk is full or fails; the file then ends with the commit before.
        """
        rest = memoryview(bytes(self._pending))
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError:
            os.ftruncate(self._file.fileno(), self._committed)
            self._file.seek(self._committed)
            raise
        self._committed += len(self._pending)
        self._pending.clear()

    def close(self) -> None:
        """Let the disk have everything that was committed; what was not is lost.

        Raises:
            OSError: if the disk fails.
        """
        try:
            os.fsync(self._file.fileno())
        finally:
            self._file.close()


def stage_column(name: str) -> str:
    """Column of a stage's duration [s]."""
    return f"stage_{name.replace(' ', '_')}_s"


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
