"""A rig with slow dynamics and little hysteresis: `fit auto` on two thirds of a log, scored on the last third.

Run: python benchmarks/fatigue_rig.py part_1.csv

The log is of github.com/decargroup/system_norm_koopman (MIT), laid out as in examples/fatigue_rig.yaml.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.read import read_trials

LAYOUT = str(Path(__file__).parents[1] / "examples/fatigue_rig.yaml")
RATE_HZ = 25.0


def main() -> None:
    """What was chosen, what each part buys, and the error on withheld time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    (whole,) = read_trials(parser.parse_args().log, LAYOUT, rate_hz=RATE_HZ)
    cut = 2 * len(whole) // 3
    found = kind_named("auto").fit([whole.select(0, cut)], FitRequest("best"))
    print(found.report)
    for row in found.parts.rows if found.parts else ():
        print(f"  {row.part:12s} {row.form:40s} {row.without_deg:8.4f} mm without, {row.with_deg:8.4f} mm with it")
    if found.simulator is not None:
        error = (evaluate(ChainModel(found.simulator), whole).theta - whole.angle)[cut:]
        print(f"last third: RMSE {np.sqrt(np.mean(error**2)):.3f} mm, without its offset {np.std(error):.3f} mm")
        print(f"            standard deviation of the response {np.std(whole.angle[cut:]):.3f} mm")


if __name__ == "__main__":
    main()
