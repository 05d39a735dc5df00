"""Jitter of the machine without any work: a loop that sleeps until each period's end on the monotonic clock.

    python lab/benchmarks/bare_loop.py [--rate 250] [--seconds 120] [--busy 0.001] [--priority 80] [--out WAKE_UPS.npy]

Late wake-ups here come from other processes, the hypervisor or the kernel. With `--busy` the loop spins for that time
[s] in every period, and the lateness of the end of spinning counts, since a hypervisor takes only busy cores away.
It runs for the given seconds or until SIGTERM; with a priority, under SCHED_FIFO and with locked memory. Exit code 1
if a period was missed.
"""

from __future__ import annotations

import sys
import time
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from kit import asked

from hystmpc.rig.realtime import MonotonicClock, SchedulingSettings, scheduled
from hystmpc.rig.safety.stop import StopFlag, stopping_on_signals
from hystmpc.trials.types import Vec


@dataclass(frozen=True)
class Floor:
    """Lateness statistics of the sleeping loop.

    Attributes:
        late: number of those later than one period.
        p99_s, greatest_s: lateness [s]; NaN without any wake-up.
    """

    wake_ups: int
    late: int
    p99_s: float
    greatest_s: float


def sleep_on(rate_hz: float, seconds: float, flag: StopFlag, busy_s: float = 0.0) -> Vec:
    """Wall clock [s] and lateness [s] of every wake-up or end of spinning (N, 2); missed periods are skipped."""
    clock, period_ns, busy_ns = MonotonicClock(spin_s=0.0), round(1e9 / rate_hz), round(1e9 * busy_s)
    seen = array("d")
    start = deadline = clock.now_ns()
    while not flag.cause and 1e-9 * (deadline - start) < seconds:
        deadline += period_ns
        clock.wait_until(deadline)
        done = clock.now_ns() + busy_ns
        while busy_ns and clock.now_ns() < done:
            pass
        late_ns = clock.now_ns() - deadline
        seen.extend((time.time(), 1e-9 * late_ns))
        deadline += late_ns // period_ns * period_ns
    return np.array(seen).reshape(-1, 2)


def floor(wake_ups: Vec, rate_hz: float) -> Floor:
    """Statistics of wake-ups (N, 2)."""
    lateness = wake_ups[:, 1]
    if not lateness.size:
        return Floor(0, 0, float("nan"), float("nan"))
    late = int(np.count_nonzero(lateness > 1 / rate_hz))
    return Floor(lateness.size, late, float(np.quantile(lateness, 0.99)), float(lateness.max()))


def main() -> int:
    """Run the loop and print one line."""
    given = asked(
        __doc__,
        rate=(250.0, "periods a second"),
        seconds=(120.0, "how long"),
        busy=(0.0, "spin for so long in every period [s]"),
        priority={"type": int, "help": "of SCHED_FIFO, 1 to 99"},
        out={"type": Path, "help": "write wall clock and lateness of every wake-up here (.npy)"},
    )
    flag, wanted = StopFlag(), SchedulingSettings(priority=given.priority, lock_memory=given.priority is not None)
    with stopping_on_signals(flag), scheduled(wanted) as notes:
        print("\n".join(notes), end="\n" if notes else "", file=sys.stderr)
        print("ready", flush=True)
        wake_ups = sleep_on(given.rate, given.seconds, flag, given.busy)
    found = floor(wake_ups, given.rate)
    print(
        f"{found.wake_ups} wake-ups at {given.rate:g} Hz: {found.late} later than a period, "
        f"p99 {1e3 * found.p99_s:.2f} ms, greatest {1e3 * found.greatest_s:.2f} ms late"
    )
    if given.out is not None:
        np.save(given.out, wake_ups)
    return int(found.late > 0)


if __name__ == "__main__":
    sys.exit(main())
