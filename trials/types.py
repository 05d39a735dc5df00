"""Types that all rooms use: arrays, time first everywhere, and what is told about a long computation."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Vec = NDArray[np.float64]
"""One number a sample or a parameter (T,); also where the axes are named at the place."""

Mat = NDArray[np.float64]
"""Rows by columns, such as samples by parameters (T, P)."""

Mask = NDArray[np.bool_]
"""Whether each sample counts (T,)."""

Index = NDArray[np.intp]
"""Numbers of samples or rows (N,)."""


class Progress(Protocol):
    """What a long computation calls as it goes on: steps done, steps in all, and what is being done."""

    def __call__(self, done: float, total: float, note: str = "", /) -> None: ...


def no_progress(done: float, total: float, note: str = "", /) -> None:
    """A `Progress` that shows nothing."""
