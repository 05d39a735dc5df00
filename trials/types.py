"""Common to all modules: arrays with time as first axis, their RMS, a first-order lag, progress of a computation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Vec = NDArray[np.float64]
"""Array with one number per sample or parameter (T,), or with other axes where stated."""

Mat = NDArray[np.float64]
"""Matrix, such as samples by parameters (T, P)."""

Mask = NDArray[np.bool_]
"""Mask of the samples that count (T,)."""

Index = NDArray[np.intp]
"""Numbers of samples or rows (N,)."""


def rms(values: Vec) -> float:
    """Root mean square of the finite ones of the values, of any shape; NaN without one."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def lagged(signal: Vec, keep: float) -> Vec:
    """Signal (T,) behind a first-order lag at rest at its first value: y_k = keep y_{k-1} + (1 - keep) u_k.

    `scipy.signal` has this too, and takes more than a second to import.
    """
    gained = ((1.0 - keep) * signal).tolist()
    rest = float(signal[0]) if signal.size else 0.0
    return np.array([*accumulate(gained, lambda y, u: keep * y + u, initial=rest)][1:], dtype=np.float64)


class Progress(Protocol):
    """Callback of a long computation: steps done, steps in all, and a note on the current step."""

    def __call__(self, done: float, total: float, note: str = "", /) -> None: ...


def parts(progress: Progress | None, seconds: Sequence[float]) -> tuple[Progress, ...]:
    """Progress callbacks of the parts of a computation, scaled by their expected times."""
    total = sum(seconds)

    def part(before: float, share: float) -> Progress:
        def report(done: float, steps: float, note: str = "", /) -> None:
            if progress is not None:
                progress(before + share * min(done / max(steps, 1e-9), 1.0), total, note)

        return report

    starts = [0.0, *accumulate(seconds)][:-1]
    return tuple(part(before, share) for before, share in zip(starts, seconds, strict=True))


def no_progress(done: float, total: float, note: str = "", /) -> None:
    """Progress callback without any effect."""
