"""Columns of a table in memory: numbers as arrays, texts as lists."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.types import Vec

Column = Vec | list[str | None]


def as_column(values: Sequence[Any], kind: str) -> Column:
    """Numbers as an array (N,), NaN where there is none; texts as they are."""
    if kind == "text":
        return [None if value is None else str(value) for value in values]
    return np.array([math.nan if value is None else float(value) for value in values], dtype=np.float64)


def numbers(table: Mapping[str, Column], name: str) -> Vec:
    """A column of numbers (N,)."""
    return np.asarray(table[name], dtype=np.float64)


def texts(table: Mapping[str, Column], name: str) -> list[str]:
    """A column as texts, numbers to six digits, empty ones as nothing."""
    return [
        "" if value is None else value if isinstance(value, str) else f"{float(value):.6g}" for value in table[name]
    ]


def chosen(table: Mapping[str, Column], rows: NDArray[np.bool_]) -> dict[str, Column]:
    """Some rows of a table.

    Args:
        table: columns (N,).
        rows: which, (N,).
    """
    where = np.flatnonzero(rows)
    return {name: c[where] if isinstance(c, np.ndarray) else [c[k] for k in where] for name, c in table.items()}
