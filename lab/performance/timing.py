"""Timing in turns, so that other load on the machine meets all jobs alike; settings of a benchmark."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.trials.errors import ConfigError

# Effort is measured from the inverse plan, which peers do not have: without it all solve the same problem.
WEIGHTS = WeightsSettings(effort=0.0)


@dataclass(frozen=True)
class TimedCall:
    """Something to be timed: its name and one call of it."""

    name: str
    run: Callable[[], object]


@dataclass(frozen=True)
class Effort:
    """Measuring effort of each section.

    Attributes:
        rounds: turns; in each, every job runs once or, where it is short, in a burst.
        burst_s: time of a burst [s].
        burst_most: most calls in a burst.
        longest_s: a section ends after this time even if turns are left, as on a machine that is busy otherwise [s].

    Raises:
        ConfigError: if a value is not positive.
    """

    rounds: int
    burst_s: float
    burst_most: int
    longest_s: float = 30.0

    def __post_init__(self) -> None:
        if not (self.rounds > 0 and self.burst_s > 0 and self.burst_most > 0 and self.longest_s > 0):
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


def thread_limit(count: int) -> AbstractContextManager[object]:
    """Threads of the BLAS and OpenMP libraries that are loaded by now, while the block lasts."""
    return ThreadpoolController().limit(limits=count)


@final
class Clock:
    """Times jobs in turns and remembers whether the keyboard ended it."""

    def __init__(self, effort: Effort, on_round: Callable[[int], None] | None = None) -> None:
        self._effort = effort
        self._on_round = on_round
        self.interrupted = False

    def measure(self, jobs: Sequence[TimedCall], threads: int = 1) -> Mapping[str, Times]:
        """Times by name; after Ctrl-C those of the jobs that have run by then.

        Every job is called before it counts: to compile and warm up, and to see how long it takes. The order
        moves on by one from turn to turn. The first call of a burst pays for the caches that the job before has filled
        and does not count; a job too long for bursts counts always.

        Args:
            threads: of BLAS and OpenMP in this process.
        """
        samples: dict[str, list[float]] = {job.name: [] for job in jobs}
        try:
            for job in jobs:
                job.run()
            with thread_limit(threads):  # by now every library is loaded
                self._take_turns(jobs, samples)
        except KeyboardInterrupt:
            self.interrupted = True
        return {name: Times(np.array(seconds)) for name, seconds in samples.items() if seconds}

    def _take_turns(self, jobs: Sequence[TimedCall], samples: dict[str, list[float]]) -> None:
        until = perf_counter() + self._effort.longest_s
        bursts = [self._burst(job) for job in jobs]
        for turn in range(self._effort.rounds):
            for place in range(len(jobs)):
                k = (place + turn) % len(jobs)
                samples[jobs[k].name] += _timed(jobs[k], bursts[k])
            last = perf_counter() > until
            if self._on_round is not None:
                self._on_round(self._effort.rounds - turn if last else 1)
            if last:
                break

    def _burst(self, job: TimedCall) -> int:
        once = min(_once(job), _once(job))  # one of them may have been interrupted by other work
        return int(min(max(self._effort.burst_s / max(once, 1e-9), 1), self._effort.burst_most))


def _timed(job: TimedCall, count: int) -> list[float]:
    if count > 1:
        job.run()
    return [_once(job) for _ in range(count)]


def _once(job: TimedCall) -> float:
    since = perf_counter()
    job.run()
    return perf_counter() - since


THOROUGH = Effort(rounds=25, burst_s=0.04, burst_most=25)


@dataclass(frozen=True)
class BenchSettings:
    """Sizes of what is measured.

    Attributes:
        hidden: cells in each of the network's two layers; the goals are for 64.
        horizon: H.
        samples: N of the sampling controller's peer and of the batched roll-outs.
    """

    hidden: int = 64
    horizon: int = 20
    samples: int = 256
    effort: Effort = THOROUGH

    def plain(self) -> dict[str, Any]:
        """As numbers for the report."""
        return asdict(self)


# The smallest run that still times everything at full size, in turns.
QUICK = BenchSettings(effort=Effort(rounds=3, burst_s=0.01, burst_most=5))
