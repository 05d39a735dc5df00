"""Endurance: many steps against their deadlines, resident memory, and the time to the first command.

    python lab/benchmarks/endurance.py [--steps 100000] [--rate 25 --rate 250] [--model builtin:lstm] [--realtime]

Steps follow each other at once, each against the deadline of its rate: 40 ms at 25 Hz, 4 ms at 250 Hz. With
`--realtime` they wait for the monotonic clock, and every step that ends after its period is a miss.
A planner sends the tip from one random target to the next. Exit code 1 if a deadline is missed, memory grows or exceeds
300 MB, the import takes longer than 1 s or the first command longer than 3 s. Run it on an idle machine. The stalls of
the machine are measured in the same run: every tenth second a bare loop spins without allocations or calls, and counts
the interruptions longer than a period.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from kit import asked, save, show
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from hystmpc.ctrl import TipController
from hystmpc.models.load import library_file
from hystmpc.models.simulator import load_simulator
from hystmpc.sim.plants.simulated import SimulatedPlant

RESIDENT_MB, GROWTH_MB, IMPORT_S, FIRST_COMMAND_S = 300.0, 5.0, 1.0, 3.0
_TARGETS_DEG = (35.0, 75.0)
_EVERY_S, _WATCHED_S = 10.0, 1.0  # between two looks at the machine, and how long a look takes
_WARM = 100  # steps before the first measurement of time and memory
_START = """
import time
begin = time.perf_counter()
from hystmpc.ctrl import TipController
imported = time.perf_counter()
tip = TipController.from_config({settings!r})
tip.set_target(50.0)
tip.step(40.0)
print(imported - begin, time.perf_counter() - begin)
"""


@dataclass(frozen=True)
class Endured:
    """Result of one run at one rate.

    Attributes:
        rate_hz, steps: rate that gives the deadline, and number of steps.
        misses: steps that took, or in real time ended, longer than a period.
        median_s, p99_s, greatest_s: duration of the step alone.
        stalls, watched_s, longest_stall_s: number of interruptions of a bare loop longer than a period, seconds of
            spinning, and the longest interruption.
        resident_mb, growth_mb: memory at the end, and its growth since the first steps.
        sources: number of steps by fallback level of the command.
    """

    rate_hz: float
    steps: int
    misses: int
    median_s: float
    p99_s: float
    greatest_s: float
    stalls: int
    watched_s: float
    longest_stall_s: float
    resident_mb: float
    growth_mb: float
    sources: dict[str, int]

    @property
    def passed(self) -> bool:
        """Whether no deadline was missed and memory stayed small and constant."""
        return self.misses == 0 and self.resident_mb <= RESIDENT_MB and self.growth_mb <= GROWTH_MB


def stalls(period: float, seconds: float) -> list[float]:
    """Interruptions of a bare loop longer than a period, within the given seconds of spinning [s]."""
    found = list[float]()
    begin = last = time.perf_counter()
    while last - begin < seconds:
        now = time.perf_counter()
        if now - last > period:
            found.append(now - last)
        last = now
    return found


def resident_mb() -> float:
    """Resident memory of this process [MB]; its maximum so far if the system reports no more."""
    status = Path("/proc/self/status")
    if status.exists():
        line = next(text for text in status.read_text(encoding="ascii").splitlines() if text.startswith("VmRSS"))
        return float(line.split()[1]) / 1024
    import resource  # POSIX only

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform != "darwin" else 1024**2)


def endure(settings: dict[str, Any], rate_hz: float, steps: int, realtime: bool) -> Endured:
    """Run the controller for the given steps on a simulated device, with a planner that sets targets."""
    tip = TipController.from_config(settings)
    device, rng = SimulatedPlant(load_simulator(library_file("tendon-catheter")), seed=1), np.random.default_rng(0)
    y, period = device.reset(), 1.0 / rate_hz
    took, sources = np.empty(steps), dict[str, int]()
    late, before, stood, watched = 0, 0.0, list[float](), 0
    with threadpool_limits(limits=1):
        due = looked = time.monotonic()
        for k in range(-_WARM, steps):
            if tip.state().done or k == -_WARM:
                tip.set_waypoints([float(rng.uniform(*_TARGETS_DEG))], [float(rng.uniform(0.0, 1.0))])
            if k == 0:
                gc.collect()
                gc.freeze()  # as the loop at the bench: existing objects are exempt from garbage collection
                before, due = resident_mb(), time.monotonic()
                looked = due
            if time.monotonic() - looked > _EVERY_S:
                stood += stalls(period, _WATCHED_S)
                watched += 1
                due = looked = time.monotonic()
            if realtime and k >= 0:
                time.sleep(max(0.0, due - time.monotonic()))
            since = time.perf_counter()
            command = tip.step(y)
            seconds = time.perf_counter() - since
            y = device.apply(command.u)
            if k < 0:
                continue
            took[k] = seconds
            sources[str(command.source)] = sources.get(str(command.source), 0) + 1
            due += period
            if realtime and time.monotonic() > due:
                late += 1
                due = time.monotonic()  # a miss is counted once; later steps are on time
    misses = late if realtime else int(np.sum(took > period))
    return _summary(rate_hz, took, misses, (stood, watched * _WATCHED_S), before, sources)


def start_times(settings: dict[str, Any]) -> tuple[float, float]:
    """Times of the import and of the first command in a new process [s]."""
    code = _START.format(settings=settings)
    words = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    return float(words[0]), float(words[1])


def _summary(
    rate_hz: float,
    took: NDArray[np.float64],
    misses: int,
    stood: tuple[list[float], float],
    before: float,
    sources: dict[str, int],
) -> Endured:
    after, (found, watched) = resident_mb(), stood
    times = float(np.median(took)), float(np.percentile(took, 99)), float(took.max())
    machine = len(found), watched, max(found, default=0.0)
    return Endured(rate_hz, took.size, misses, *times, *machine, after, after - before, sources)


_COLUMNS = (
    "rate [Hz]",
    "steps",
    "missed",
    "median [ms]",
    "p99",
    "greatest",
    "stalls of a bare loop",
    "resident [MB]",
    "grown by",
    "sources",
)


def _row(run: Endured) -> tuple[object, ...]:
    times = (f"{1e3 * value:.2f}" for value in (run.median_s, run.p99_s, run.greatest_s))
    sources = ", ".join(f"{name} {count}" for name, count in run.sources.items())
    machine = f"{run.stalls} in {run.watched_s:.0f} s, up to {1e3 * run.longest_stall_s:.1f} ms"
    memory = f"{run.resident_mb:.0f}", f"{run.growth_mb:.1f}"
    return f"{run.rate_hz:g}", run.steps, run.misses, *times, machine, *memory, sources


def main() -> int:
    """Print one row a rate and the start times; return 0 if all goals are reached."""
    given = asked(
        __doc__,
        steps=(100_000, "steps a rate"),
        rate={"type": float, "action": "append", "help": "deadline as a rate [Hz]; may be repeated"},
        model=("builtin:lstm", "model file or builtin:NAME"),
        kind=("linearised_mpc", "controller"),
        realtime=(False, "one step a period of the monotonic clock"),
        json={"type": Path, "help": "write the figures here"},
    )
    settings = {"model": given.model, "controller": {"kind": given.kind}}
    start_times(settings)  # the disk's files are read once
    imported, first = start_times(settings)
    runs = [endure(settings, rate, given.steps, given.realtime) for rate in given.rate or [25.0, 250.0]]
    show(_COLUMNS, map(_row, runs))
    print(f"import {imported:.2f} s, first command {first:.2f} s")
    save(given.json, {"import_s": imported, "first_command_s": first, "runs": [asdict(run) for run in runs]})
    return 0 if all(run.passed for run in runs) and imported <= IMPORT_S and first <= FIRST_COMMAND_S else 1


if __name__ == "__main__":
    sys.exit(main())
