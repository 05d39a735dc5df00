"""The picture in the README: the inverse and the linearised controller along the point-to-point motion of the demo.

Run: hystmpc demo --out demo && python benchmarks/readme_figure.py demo docs/figures/demo.png
"""

from __future__ import annotations

import sys
from pathlib import Path

from hystmpc.sim.results import load_results
from hystmpc.trials.report import COMMAND, MEASURED, MODEL, REFERENCE, new_figure

SHOWN = {
    "pid": (COMMAND, "PID, tuned on this plant"),
    "inverse": (MODEL, "inverse"),
    "linearised_mpc": (MEASURED, "linearised MPC"),
}


def main() -> None:
    """Draw angle and error over time."""
    source, target = map(Path, sys.argv[1:3])
    runs = {result.controller: result for result in load_results(source).of_motion("point_to_point")}
    with new_figure(8.0, 4.2) as figure:
        angle, error = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        first = next(iter(runs.values())).run.log
        angle.plot(first.time_s, first.reference_deg, color=REFERENCE, lw=2.5, label="reference")
        for name, (colour, label) in SHOWN.items():
            result = runs[name]
            angle.plot(result.run.log.time_s, result.run.true_deg, color=colour, lw=1.1, label=label)
            error.plot(
                result.run.log.time_s,
                result.run.error_deg,
                color=colour,
                lw=1.1,
                label=f"RMSE {result.metrics.rmse_deg:.2f} deg",
            )
        angle.set_ylabel("tip angle [deg]")
        angle.legend(ncols=2, loc="lower right")
        error.set(xlabel="time [s]", ylabel="error [deg]")
        error.legend(ncols=3, loc="lower right")
        target.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(target, dpi=150)


if __name__ == "__main__":
    main()
