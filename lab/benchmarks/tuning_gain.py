"""What tuning brings on plants that it has not seen, and how much that depends on the seed.

    python lab/benchmarks/tuning_gain.py                                     # five seeds of examples/tune.yaml
    python lab/benchmarks/tuning_gain.py --seeds 3 --set trials=25 plants.count=6 held_out.count=12

Every seed draws its own plants to search on, its own held-out plants and its own search.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from hystmpc.sim.jobs import backend_for
from hystmpc.sim.tuning.run import run_tuning
from hystmpc.sim.tuning.settings import load_tuning

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "tune.yaml"


def main() -> None:
    """Print a line a seed, and mean and deviation over them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", nargs="?", type=Path, default=EXAMPLE, help="a tuning (YAML)")
    parser.add_argument("--seeds", type=int, default=5, help="how many")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--set", nargs="*", default=[], dest="overrides", help="changes such as trials=25")
    arguments = parser.parse_args()
    print("held-out plants; objective and errors [deg], gain with its 90 % interval over plants")
    print("seed  objective given  tuned  gain [%]        interval  better  mean error given  tuned  worst given  tuned")
    gains = []
    for seed in range(arguments.seeds):
        drawn = [f"seed={seed}", f"plants.seed={2 * seed + 1}", f"held_out.seed={2 * seed + 2}"]
        settings = load_tuning(arguments.config, [*arguments.overrides, *drawn])
        with tempfile.TemporaryDirectory() as folder:
            check = run_tuning(settings, Path(folder) / "tune", backend_for(arguments.jobs)).check
        (_, given, mean, worst, *_), (_, tuned, mean_tuned, worst_tuned, *_) = check.rows()
        low, high = check.interval()
        gains.append(100 * check.gain)
        print(
            f"{seed:4d}  {given:15.3f}  {tuned:5.3f}  {gains[-1]:8.1f}  {100 * low:6.1f}..{100 * high:6.1f}  "
            f"{check.better:3d}/{len(check.given)}  {mean:16.3f}  {mean_tuned:5.3f}  {worst:11.3f}  {worst_tuned:5.3f}",
            flush=True,
        )
    spread = np.std(gains, ddof=1) if len(gains) > 1 else float("nan")
    print(
        f"gain over {len(gains)} seeds: mean {np.mean(gains):.1f} %, deviation {spread:.1f} %, least {min(gains):.1f} %"
    )


if __name__ == "__main__":
    main()
