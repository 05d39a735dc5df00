"""Timing in turns: what is compared runs alternately, so that a machine's moods meet all alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from hystmpc.trials.errors import ConfigError


@dataclass(frozen=True)
class Job:
    """Something to be timed: its name and one call of it."""

    name: str
    run: Callable[[], object]


@dataclass(frozen=True)
class Effort:
    """How long each section is measured.

    Attributes:
        rounds: turns; in each, every job runs once or, where it is short, in a burst.
        burst_s: time of a burst [s].
        burst_most: most calls in a burst.

    Raises:
        ConfigError: if a value is not positive.
    """

    rounds: int
    burst_s: float
    burst_most: int

    def __post_init__(self) -> None:
        if not (self.rounds > 0 and self.burst_s > 0 and self.burst_most > 0):
            raise ConfigError(f"bench: got {self}, expected values > 0")


@dataclass(frozen=True, eq=False)
class Times:
    """Durations of single calls [s], shape (R,), R >= 1."""

    seconds: NDArray[np.float64]

    @property
    def median_s(self) -> float:
        """Median [s]."""
        return float(np.median(self.seconds))

    @property
    def p99_s(self) -> float:
        """99th percentile [s]; close to the maximum where there are fewer than a hundred calls."""
        return float(np.percentile(self.seconds, 99))

    @property
    def least_s(self) -> float:
        """Shortest call [s]."""
        return float(np.min(self.seconds))


@final
class Clock:
    """Times jobs in turns and remembers whether the keyboard ended it.

    Args:
        effort: how long.
        on_round: called after every turn.
    """

    def __init__(self, effort: Effort, on_round: Callable[[], None] | None = None) -> None:
        self._effort = effort
        self._on_round = on_round
        self._pools = ThreadpoolController()
        self.interrupted = False

    def measure(self, jobs: Sequence[Job], threads: int = 1) -> Mapping[str, Times]:
        """Times by name; after Ctrl-C those of the jobs that have run by then.

        Every job is called twice before it counts: to compile and warm up, and to see how long it takes. The order
        moves on by one from turn to turn. The first call of a burst pays for the caches that the job before has filled
        and does not count; a job too long for bursts counts always.

        Args:
            jobs: with different names.
            threads: of BLAS and OpenMP in this process.
        """
        samples: dict[str, list[float]] = {job.name: [] for job in jobs}
        with self._pools.limit(limits=threads):
            try:
                bursts = [self._burst(job) for job in jobs]
                for turn in range(self._effort.rounds):
                    for k in np.roll(np.arange(len(jobs)), -turn):
                        samples[jobs[k].name] += _timed(jobs[k], bursts[k])
                    if self._on_round is not None:
                        self._on_round()
            except KeyboardInterrupt:
                self.interrupted = True
        return {name: Times(np.array(seconds)) for name, seconds in samples.items() if seconds}

    def _burst(self, job: Job) -> int:
        job.run()
        once = _once(job)
        return int(min(max(self._effort.burst_s / max(once, 1e-9), 1), self._effort.burst_most))


def _timed(job: Job, count: int) -> list[float]:
    if count > 1:
        job.run()
    return [_once(job) for _ in range(count)]


def _once(job: Job) -> float:
    since = perf_counter()
    job.run()
    return perf_counter() - since
