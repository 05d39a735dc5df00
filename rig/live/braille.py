"""Curves in text: every character is a field of 2 by 4 dots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from hystmpc.trials.types import Vec

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_EMPTY = 0x2800


def limits_of(*curves: Vec, least_span: float) -> tuple[float, float]:
    """Lowest and highest value of all curves, at least `least_span` apart; 0 and 1 where nothing is finite."""
    values = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    missing = max(least_span - (high - low), 0.0) / 2
    return low - missing, high + missing


def raster(t: Vec, y: Vec, low: float, high: float, width: int, height: int) -> NDArray[np.int64]:
    """Dots of one curve as character codes, (height, width); 0 where there is none.

    Args:
        t, y: the curve, (T,); values that are not finite leave a hole.
        low, high: of the vertical axis.
        width, height: of the field [characters].
    """
    cells = np.zeros((height, width), dtype=np.int64)
    known = np.isfinite(y) & np.isfinite(t)
    if not known.any() or not t[-1] > t[0]:
        return cells
    x = ((t[known] - t[0]) / (t[-1] - t[0]) * (2 * width - 1)).round().astype(int)
    level = np.clip((y[known] - low) / max(high - low, 1e-12), 0, 1)
    row = ((1 - level) * (4 * height - 1)).round().astype(int)
    np.bitwise_or.at(cells, (row // 4, np.clip(x, 0, 2 * width - 1) // 2), _DOTS[row % 4, x % 2])
    return cells


def curves(fields: list[tuple[NDArray[np.int64], str]]) -> Text:
    """Rasters over each other as text; of several in one character the last one gives the colour."""
    text = Text(no_wrap=True)
    height, width = fields[0][0].shape
    for row in range(height):
        for column in range(width):
            code, colour = 0, ""
            for cells, name in fields:
                if cells[row, column]:
                    code, colour = code | int(cells[row, column]), name
            text.append(chr(_EMPTY + code) if code else " ", colour)
        text.append("\n" if row < height - 1 else "")
    return text


def bar(value: float, low: float, high: float, width: int) -> str:
    """A value between two limits as a bar of `width` characters, in eighths of a character."""
    share = min(max((value - low) / max(high - low, 1e-12), 0.0), 1.0) if np.isfinite(value) else 0.0
    eighths = round(share * 8 * width)
    full = "█" * (eighths // 8) + (" ▏▎▍▌▋▊▉"[eighths % 8] if eighths % 8 else "")
    return full.ljust(width, "·")


def columns_of(counts: NDArray[np.int64], width: int) -> str:
    """A histogram as one line of `width` characters; the height is the logarithm of the count."""
    groups = np.array([part.sum() for part in np.array_split(counts, width)], dtype=np.float64)
    if not groups.any():
        return " " * width
    levels = np.ceil(8 * np.log1p(groups) / np.log1p(groups.max())).astype(int)
    return "".join(" ▁▂▃▄▅▆▇█"[level] for level in levels)
