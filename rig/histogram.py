"""Histograms of times, filled by a control thread without memory allocation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import ConfigError

BINS = 400


@dataclass(frozen=True)
class TimingSummary:
    """Statistics of one measured time [s]; quantiles are upper edges of their bins, NaN without a sample."""

    count: int  # samples
    mean_s: float
    greatest_s: float
    median_s: float
    p99_s: float
    p999_s: float


@final
class Histogram:
    """Counts of times from 0 to `span_s` in equal bins; larger times count in the last one.

    Raises:
        ConfigError: if the span is not positive.
    """

    def __init__(self, span_s: float) -> None:
        if not (math.isfinite(span_s) and span_s > 0):
            raise ConfigError(f"histogram: got a span of {span_s} s, expected a positive number")
        self._width = span_s / BINS
        self._counts = [0] * BINS  # a list: adding to one of its items is faster than to an array's
        self._count, self._sum, self._greatest = 0, 0.0, 0.0

    def add(self, seconds: float) -> None:
        """Count one time; a negative one counts as 0."""
        seconds = max(seconds, 0.0)
        self._counts[min(int(seconds / self._width), BINS - 1)] += 1
        self._count += 1
        self._sum += seconds
        self._greatest = max(self._greatest, seconds)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Counts per bin (BINS,)."""
        return np.array(self._counts, dtype=np.int64)

    @property
    def edges_s(self) -> NDArray[np.float64]:
        """Edges of the bins (BINS + 1,) [s]."""
        return self._width * np.arange(BINS + 1, dtype=np.float64)

    def quantile(self, share: float) -> float:
        """Upper edge of the bin of a quantile [s], not above the greatest time; NaN without a sample."""
        if not self._count:
            return math.nan
        k = int(np.searchsorted(np.cumsum(self._counts), share * self._count))
        return self._greatest if k >= BINS - 1 else min(self._width * (k + 1), self._greatest)

    def summary(self) -> TimingSummary:
        """Count, mean, maximum and quantiles."""
        mean = self._sum / self._count if self._count else math.nan
        greatest = self._greatest if self._count else math.nan
        return TimingSummary(self._count, mean, greatest, self.quantile(0.5), self.quantile(0.99), self.quantile(0.999))


@final
class Timings:
    """Period, execution time and wake-up jitter of a loop, with its deadline misses.

    Raises:
        ConfigError: if it is not positive.
    """

    def __init__(self, dt_s: float) -> None:
        self.period, self.execution, self.jitter = (Histogram(2 * dt_s) for _ in range(3))
        self.missed = 0
        self.skipped = 0

    def as_dict(self) -> dict[str, object]:
        """Plain data for `timing.json`."""
        parts = {"period": self.period, "execution": self.execution, "jitter": self.jitter}
        data: dict[str, object] = {"missed": self.missed, "skipped": self.skipped}
        for name, histogram in parts.items():
            filled = np.flatnonzero(histogram.counts)
            data[name] = {
                "summary": {k: None if v != v else v for k, v in vars(histogram.summary()).items()},
                "bin_s": float(histogram.edges_s[1]),
                "counts": {int(k): int(histogram.counts[k]) for k in filled},
            }
        return data
