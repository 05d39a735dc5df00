"""A reference from a CSV file with the columns time_s and angle_deg."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import TrajectoryError

from .trajectory import Sampled

COLUMNS = ("time_s", "angle_deg")


def read_sampled(path: Path | str) -> Sampled:
    """Read a sampled reference; further columns are left aside.

    Raises:
        TrajectoryError: naming file and row, if the file cannot be read, a column is missing, a value is not a
            number, or the samples are not a trajectory.
    """
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            header, *rows = list(csv.reader(file)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TrajectoryError(f"{path}: cannot be read ({error}), expected a CSV file") from None
    names = [name.strip() for name in header]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise TrajectoryError(f"{path}: no column {missing[0]}, available: {', '.join(names) or 'none'}")
    places = [names.index(name) for name in COLUMNS]
    values = [_numbers(row, places, f"{path}: row {k}") for k, row in enumerate(rows, start=2) if row]
    try:
        return Sampled(*np.array(values, dtype=np.float64).reshape(-1, 2).T)
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error}") from None


def _numbers(row: list[str], places: list[int], where: str) -> list[float]:
    """Numbers at the given places of one row."""
    numbers = []
    for place, name in zip(places, COLUMNS, strict=True):
        text = row[place] if place < len(row) else ""
        try:
            numbers.append(float(text))
        except ValueError:
            raise TrajectoryError(f"{where}: {name} is {text!r}, expected a number") from None
    return numbers
