"""Cost of a closed-loop run and what a second process brings: one sweep, done with one worker and with two.

    python lab/benchmarks/sweep_scaling.py                 # 1,000 runs of 60 s at 25 Hz, with one worker and with two
    python lab/benchmarks/sweep_scaling.py --runs 60       # a quick look, with the time that 1,000 would take

Linearised MPC with the backlash model on the simulated tendon catheter, whose lag and width differ from run to run.
Processor time is what a run costs on a core of its own, wall time what it took beside whatever else ran. Where workers
are busy all the time and this process costs next to nothing, free cores give runs in proportion to their number.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.sim.jobs import Processes, backend_for
from hystmpc.sim.sweep.run import run_sweep
from hystmpc.sim.sweep.settings import SweepSettings, with_base
from hystmpc.sim.sweep.table import numbers, table_of

STUDY: dict[str, Any] = {
    "plant": {"simulator": "builtin:tendon-catheter", "noise_deg": 0.15},
    "model": "builtin:backlash",
    "actuator_lag_s": 0.08,
    "motions": {
        "scan": {
            "kind": "scan_sinusoid",
            "start_deg": 29,
            "centre_deg": 58,
            "amplitude_deg": 18,
            "frequency_hz": 0.2,
            "cycles": 11.5,
        }
    },
    "controllers": {"linearised_mpc": {"kind": "linearised_mpc"}},
}
DRAW = {
    "plant.lag_s": {"uniform": [0.02, 0.15]},
    'plant.mismatch."prandtl_ishlinskii.alpha"': {"uniform": [0.8, 1.3]},
}


def main() -> None:
    """Print a line for every number of workers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000, help="closed-loop runs")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="numbers of processes")
    parser.add_argument("--cluster", help="Dask scheduler instead of a process pool")
    arguments = parser.parse_args()
    print(f"{arguments.runs} runs of linearised MPC on builtin:backlash, {os.cpu_count()} cores, ", end="")
    print(f"load of the machine {os.getloadavg()[0]:.1f} before")
    print(
        "workers  wall [min]  ratio  cpu a run [s]  wall a run in the worker [s]  workers busy  this process [ms a run]"
    )
    first = None
    for workers in arguments.workers:
        cost = measured(arguments.runs, workers, arguments.cluster)
        first = first or cost
        print(
            f"{workers:7d}  {cost.wall_s / 60:10.2f}  {first.wall_s / cost.wall_s:5.2f}  {cost.cpu_s:13.3f}  "
            f"{cost.inside_s:28.3f}  {cost.busy:12.2f}  {1e3 * cost.ours_s:23.1f}",
            flush=True,
        )
        minutes = 1000 * (cost.cpu_s / workers + cost.ours_s / os.cpu_count()) / 60
        print(f"         1000 runs on {workers} cores that do nothing else: about {minutes:.1f} min")


@dataclass(frozen=True)
class Cost:
    """What a sweep cost.

    Attributes:
        wall_s: of the whole.
        cpu_s: median processor time of a run in its worker.
        inside_s: median wall time of a run in its worker.
        busy: share of the workers' time between the first result and the last in which they had a run in hand.
        ours_s: processor time of the process that plans and collects, a run.
    """

    wall_s: float
    cpu_s: float
    inside_s: float
    busy: float
    ours_s: float


def measured(runs: int, workers: int, cluster: str | None) -> Cost:
    """Do the sweep once."""
    data = {"base": STUDY, "draw": DRAW, "count": runs, "draw_seed": 1}
    settings = with_base(SweepSettings.parse(data), Path("sweep.yaml"))
    ends: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "sweep"
        # A pool of one as well, so that both numbers pay for the hand-over.
        backend = backend_for(workers, cluster) if cluster or workers > 1 else Processes(1)
        start, ours = time.perf_counter(), time.process_time()
        run_sweep(settings, out, backend, lambda done, total, note: ends.append(time.perf_counter()))
        wall, ours = time.perf_counter() - start, time.process_time() - ours
        table = table_of(out, ["wall_s", "cpu_s"])
    inside, cpu = numbers(table, "wall_s"), numbers(table, "cpu_s")
    # The first run of every worker opens and compiles; between the first end and the last, runs - workers were done.
    steady = float(np.median(inside)) * (runs - workers) / (workers * (ends[-1] - ends[workers - 1]))
    return Cost(wall, float(np.median(cpu)), float(np.median(inside)), min(steady, 1.0), ours / runs)


if __name__ == "__main__":
    main()
