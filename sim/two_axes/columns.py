"""Columns of the log of two axes: one for each axis, named as the layout `two-axes` has them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from hystmpc.trials.types import Vec

Column = Vec | Sequence[str]
_AXES = ("x", "y")
_PART = re.compile(r"(command|angle|true_angle|reference|predicted|disturbance|held_before)_(x|y)(_\w+)?")


def apart(columns: Mapping[str, Column]) -> dict[str, Column]:
    """Columns (N,) of columns (N,) and (N, 2): `angle_deg` (N, 2) becomes `angle_x_deg` and `angle_y_deg`."""
    made: dict[str, Column] = {}
    for name, values in columns.items():
        if not isinstance(values, np.ndarray) or values.ndim == 1:
            made[name] = values
            continue
        stem, _, unit = (name, "", "") if name == "held_before" else name.rpartition("_")
        for part, column in zip(_AXES, values.T, strict=True):
            made[f"{stem}_{part}_{unit}".removesuffix("_")] = column
    return made


def together(columns: Mapping[str, Column]) -> dict[str, Column]:
    """Inverse of `apart`."""
    parts: dict[str, list[Vec]] = {}
    made: dict[str, Column] = {}
    for name, values in columns.items():
        match = _PART.fullmatch(name)
        if match is None:
            made[name] = values
        else:
            parts.setdefault(f"{match[1]}{match[3] or ''}", []).append(np.asarray(values, dtype=np.float64))
    return made | {name: np.stack(several, axis=1) for name, several in parts.items()}
