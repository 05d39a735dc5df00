"""Identification of the rod device on recorded logs: one parameter set for all, compared with the measured loops.

    python lab/benchmarks/rod_fit.py LOG.csv ... [--out FOLDER] [--seed 0] [--starts 2] [--check]

Every log is run freely from its command alone, from a virgin device: the logs begin before the first flexure. One
number a log is its own: how much more or less its tendon was pulled beforehand (`--shared-start` leaves that out).
Forces cannot be told from command and angle, only their ratios: the rod's stiffness is held, see
docs/reference/devices.md.
`--check` shows the parameters that the package ships: only the logs' own pulls are looked for.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
from kit import asked, show
from rich.progress import Progress
from scipy.optimize import least_squares, minimize_scalar

from hystmpc.trials.read import read_trials
from hystmpc.trials.report import MEASURED, MODEL, new_figure, style
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Vec
from hystmpc_lab.devices.rod import RodCatheter, RodParameters

FREE: dict[str, tuple[float, float]] = {  # searched between; in logarithms where the lower bound is positive
    "rest_deg": (-30.0, 40.0),
    "offset_mm": (0.5, 6.0),
    "shaft_n_per_mm": (0.5, 100.0),
    "rod_n_per_mm": (2.0, 2000.0),
    "pretension_mm": (-1.0, 8.0),
    "friction": (0.05, 0.4),
    "shaft_bend_deg": (30.0, 720.0),
    "shaft_drag_n": (0.01, 30.0),
    "rod_drag_n": (0.01, 30.0),
    "fast_share": (0.002, 1.0),
    "fast_s": (0.03, 3.0),
    "slow_share": (0.002, 1.0),
    "slow_s": (1.0, 100.0),
    "set_share": (0.0, 0.5),
}
START_MM = (-0.5, 0.5)
_ITERATIONS = 40


def decoded(x: Vec, start: RodParameters) -> RodParameters:
    """Parameters at a point of the unit cube."""
    values = {}
    for u, (name, (low, high)) in zip(x, FREE.items(), strict=False):
        values[name] = float(low * (high / low) ** u if low > 0 else low + (high - low) * u)
    return replace(start, **values)


def encoded(p: RodParameters) -> Vec:
    """Point of the unit cube for given parameters."""
    x = []
    for name, (low, high) in FREE.items():
        value = min(max(getattr(p, name), low), high)
        x.append(np.log(value / low) / np.log(high / low) if low > 0 else (value - low) / (high - low))
    return np.array(x)


def free_run(p: RodParameters, trial: Trial, start_mm: float) -> Vec:
    """Angles (T,) [deg] of a virgin device with `start_mm` of additional initial pull."""
    device = RodCatheter(replace(p, pretension_mm=p.pretension_mm + start_mm))
    return device.advance(device.virgin(), trial.command, trial.dt, np.random.default_rng(0)).angle


def split(x: Vec, trials: Sequence[Trial], base: RodParameters) -> tuple[RodParameters, Vec]:
    """Parameters, and the initial pull of each trial [mm], at a point of the search."""
    own = START_MM[0] + (START_MM[1] - START_MM[0]) * x[len(FREE) :] if x.size > len(FREE) else np.zeros(len(trials))
    return decoded(x, base), own - own.mean()


def identify(trials: Sequence[Trial], seed: int, starts: int, own_starts: bool) -> tuple[RodParameters, Vec]:
    """Bounded least squares from the shipped parameters and from seeded points about them."""
    base, random = RodParameters(), np.random.default_rng(seed)
    centre = np.concatenate([encoded(base), np.full(len(trials) if own_starts else 0, 0.5)])
    points = [centre, *(np.clip(centre + random.normal(0, 0.12, centre.size), 0.02, 0.98) for _ in range(starts - 1))]
    weights = [1 / np.sqrt(len(trial)) for trial in trials]  # each log counts the same
    best, lowest = centre, np.inf
    with Progress(transient=True) as bar:
        task = bar.add_task("identify", total=starts * _ITERATIONS * (centre.size + 1))

        def residuals(x: Vec) -> Vec:
            bar.advance(task)
            p, own = split(x, trials, base)
            return np.concatenate(
                [w * (free_run(p, t, s) - t.angle) for t, w, s in zip(trials, weights, own, strict=True)]
            )

        for point in points:
            point = np.clip(point, 1e-4, 1 - 1e-4)
            found = least_squares(residuals, point, bounds=(0, 1), diff_step=1e-4, max_nfev=_ITERATIONS)
            bar.console.print(f"start: {np.sqrt(2 * found.cost / len(trials)):.3f} deg, {found.message}")
            if found.cost < lowest:
                best, lowest = found.x, found.cost
    return split(best, trials, base)


def pull(p: RodParameters, trial: Trial) -> float:
    """Additional initial pull of the tendon before this log [mm], by least squares."""
    found = minimize_scalar(
        lambda s: float(np.sum((free_run(p, trial, s) - trial.angle) ** 2)),
        bounds=START_MM,
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(found.x)


def rmse(p: RodParameters, trial: Trial, start_mm: float) -> tuple[float, float]:
    """Root mean square error [deg] of the whole log, and from the first reversal of the command on."""
    error = free_run(p, trial, start_mm) - trial.angle
    later = error[int(np.argmax(trial.command)) :]
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(later**2)))


def report(p: RodParameters, trials: Sequence[Trial], own: Vec) -> None:
    """Print one row a log."""
    rows = [rmse(p, trial, start) for trial, start in zip(trials, own, strict=True)]
    shown = [
        (Path(trial.source).stem, f"{start:+.3f}", *(f"{value:.3f}" for value in row))
        for trial, start, row in zip(trials, own, rows, strict=True)
    ]
    mean = ("mean", "", *(f"{value:.3f}" for value in np.mean(rows, axis=0)))
    columns = ("log", "own pull [mm]", "RMSE", "from the first reversal on")
    show(columns, [*shown, mean], "rod device against recorded logs, free run [deg]", width=100)


def draw(p: RodParameters, trials: Sequence[Trial], own: Vec, folder: Path) -> None:
    """Draw recorded and simulated loops, one panel a log, as SVG and PNG."""
    rows = -(-len(trials) // 3)
    with new_figure(7.2, 0.5 + 2.4 * rows) as figure:
        grid = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, trial, start in zip(grid, trials, own, strict=False):
            axes.plot(trial.command, trial.angle, color=MEASURED, linewidth=0.9, label="recorded")
            axes.plot(trial.command, free_run(p, trial, start), color=MODEL, linewidth=0.9, label="rod device")
            name = Path(trial.source).stem.replace("_", " ").replace("0p", "0.").replace("hz", " Hz")
            axes.set_title(name, fontsize=8.5)
            axes.text(0.97, 0.05, f"RMSE {rmse(p, trial, start)[0]:.2f}°", transform=axes.transAxes, ha="right")
        for axes in grid[len(trials) :]:
            axes.remove()
        grid[0].legend(loc="upper left")
        figure.supxlabel("tendon displacement [mm]", fontsize=9.0)
        figure.supylabel("tip angle [deg]", fontsize=9.0)
    folder.mkdir(parents=True, exist_ok=True)
    with style():
        for suffix in ("svg", "png"):
            figure.savefig(folder / f"rod_loops.{suffix}")


def main() -> None:
    given = asked(
        __doc__,
        logs={"place": True, "nargs": "+", "type": Path},
        layout=("auto", "layout of the logs"),
        rate_hz=25.0,
        out={"type": Path, "help": "folder for figure and parameters"},
        seed=0,
        starts=(2, "points from which is searched"),
        shared_start=(False, "no number of a log's own"),
        check=(False, "the shipped parameters instead of a search"),
    )
    trials = [resample(trial, given.rate_hz) for trial in read_trials(given.logs, given.layout)]
    if given.check:
        p, own = RodParameters(), np.zeros(len(trials))
        if not given.shared_start:
            own = np.array([pull(p, trial) for trial in trials])
    else:
        p, own = identify(trials, given.seed, given.starts, not given.shared_start)
    report(p, trials, own)
    changed = {f.name: asdict(p)[f.name] for f in fields(p) if f.name in FREE}
    print(json.dumps(changed, indent=2))
    if given.out:
        draw(p, trials, own, given.out)
        (given.out / "rod_parameters.json").write_text(json.dumps(asdict(p), indent=2) + "\n")


if __name__ == "__main__":
    main()
