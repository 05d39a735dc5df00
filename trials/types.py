"""Types that all rooms use: arrays with time as first axis, and the progress of a long computation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
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


def parts(progress: Progress | None, seconds: Sequence[float]) -> tuple[Progress, ...]:
    """The progress of each part, in units of the whole: a bar's time left is then that of all of them.

    Args:
        progress: of the whole; None where nobody looks.
        seconds: expected time of each part, in their order; only their ratios matter.
    """
    total = sum(seconds)

    def part(before: float, own: float) -> Progress:
        def told(done: float, steps: float, note: str = "", /) -> None:
            if progress is not None:
                progress(before + own * min(done / max(steps, 1e-9), 1.0), total, note)

        return told

    starts = [0.0, *accumulate(seconds)][:-1]
    return tuple(part(before, own) for before, own in zip(starts, seconds, strict=True))
