"""Recorded devices of more than two tendons: free runs of a model of two axes on what the fit has not seen.

    python lab/benchmarks/tendons.py [--continuum train.csv] [--trunk FOLDER] [--kinds pi auto]

`--continuum` is a robot of three segments with three tendons each, a row every 0.57 s; the last quarter of its rows is
withheld. Errors are distances of the tip [mm], of an arc whose length fits the rows seen, and by a fitted quadratic
map. Beside them stand a line and a quadratic polynomial from the nine tendons to the tip, without memory. `--trunk` is
a soft trunk with six motors under two payloads; the last two fifths of each log are withheld, and the payload is an
input. Errors are those of both angles together [deg].
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from kit import asked, show
from numpy.typing import NDArray

from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.maps import TipMap
from hystmpc.models.two_axes.evaluate import evaluate_two_axes
from hystmpc.models.two_axes.identify import TwoAxisFit, fit_two_axes
from hystmpc.trials.axes import both_axes
from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.read import read_trials
from hystmpc.trials.tip import tip_from_angles
from hystmpc.trials.trial import Trial

Vec = NDArray[np.float64]
ROW_S, TRUNK_S, TRUNK_HZ = 0.57, 0.01, 25.0
LENGTHS_MM = np.arange(150.0, 260.0, 0.5)


def mapping(commands: Sequence[str], unit: str, tip: dict[str, Any], rate_hz: float) -> LogMapping:
    """Mapping of a log of these commands and the position of a tip, whose rows are evenly spaced."""
    first, *others = commands
    further = {f"command_{k}": {"signal": name, "hold": True} for k, name in enumerate(others, 2)}
    signal = {"signal": first, "unit": unit}
    return LogMapping.parse({"command": signal, "tip": tip, "channels": further, "rate_hz": rate_hz})


def withheld(trial: Trial, share: float) -> tuple[Trial, Trial]:
    """The beginning of a trial, and its last share."""
    cut = round((1 - share) * len(trial))
    return trial.select(0, cut), trial.select(cut)


def continuum(file: Path, kinds: Sequence[str]) -> None:
    """Table of the robot of three segments."""
    names, tip = [f"servo_{k}_mm" for k in range(1, 10)], {axis: f"tip_{axis}" for axis in "xyz"}
    (trial,) = both_axes(read_trials(file, mapping(names, "mm", tip, 1 / ROW_S), rate_hz=1 / ROW_S)) or []
    table = np.genfromtxt(file, delimiter=",", names=True, encoding="utf-8")
    positions = np.stack([table[f"tip_{axis}"] for axis in "xyz"], axis=1)
    seen, test = withheld(trial, 0.25)
    at, later = positions[: len(seen)], positions[len(seen) :]
    length = min(LENGTHS_MM, key=lambda mm: distance(tip_from_angles(seen.angles, mm), at))
    rows = []
    for name, columns in (("line", linear), ("quadratic", quadratic)):
        weights = np.linalg.lstsq(columns(seen.commands), at, rcond=None)[0]
        rows.append([f"{name}, no memory", f"{distance(columns(test.commands) @ weights, later):.1f}", "-"])
        weights = np.linalg.lstsq(columns(seen.commands), seen.angles, rcond=None)[0]
        angles = columns(test.commands) @ weights
        rows.append([f"{name} to the angles", f"{distance(tip_from_angles(angles, length), later):.1f}", "-"])
    for kind in kinds:
        fit = fit_two_axes(kind_named(kind), [seen], FitRequest())
        run = evaluate_two_axes(fit.model, test)
        for name, shape in (("arc", length), ("quadratic map", TipMap.of_plane(seen.angles, at))):
            error = distance(tip_from_angles(run.theta, shape), later)
            rows.append([f"{kind}, {name}: {parts(fit)}", f"{error:.1f}", joint(fit)])
    show(["model", "mean error of the tip [mm]", "joined by"], rows, f"withheld rows, arc of {length:g} mm")


def linear(u: Vec) -> Vec:
    """Columns (T, 1 + n) of a line."""
    return np.column_stack([np.ones(len(u)), u])


def quadratic(u: Vec) -> Vec:
    """Columns of a quadratic polynomial."""
    pairs = [u[:, i] * u[:, j] for i in range(u.shape[1]) for j in range(i, u.shape[1])]
    return np.column_stack([linear(u), *pairs])


def distance(tips: Vec, others: Vec) -> float:
    """Mean distance of two rows of positions (T, 3) [mm]."""
    return float(np.mean(np.linalg.norm(tips - others, axis=1)))


def parts(fit: TwoAxisFit) -> str:
    """Operators of both axes."""
    return "; ".join(" + ".join(o.name for o in axis.chain.operators) for axis in fit.model.axes)


def joint(fit: TwoAxisFit) -> str:
    """What joins the axes, beside the pulls of the tendons."""
    return fit.joint + (" and shared friction" if fit.model.cross_friction is not None else "")


def trunk(folder: Path, kinds: Sequence[str]) -> None:
    """Table of the soft trunk under two payloads."""
    logs = [of_trunk(folder, grams) for grams in (0, 100)]
    seen, tests = zip(*(withheld(trial, 0.4) for trial in logs), strict=True)
    plain = [[bare(trial) for trial in part] for part in (seen, tests)]
    rows = []
    for kind in kinds:
        known = list(seen) if kind == "auto" else plain[0]
        both = fit_two_axes(kind_named(kind), known, FitRequest())
        each = [fit_two_axes(kind_named(kind), [trial], FitRequest()) for trial in plain[0]]
        for k, test in enumerate(tests):
            models = both.model, each[k].model, each[1 - k].model
            errors = [evaluate_two_axes(m, test if m.inputs else bare(test)).errors.rmse_deg for m in models]
            numbers = [f"{error:.2f}" for error in errors]
            rows.append([f"{kind}, {test.source}: {parts(both)}", *numbers, f"{errors[0] / errors[1]:.2f}"])
    show(["model", "payload as an input", "fitted there", "fitted to the other", "over fitted there"], rows, width=200)


def of_trunk(folder: Path, grams: int) -> Trial:
    """Log of the trunk under a payload, which hangs along -y from its base at x = .1 m, z = .105 m."""
    commands, positions = (
        np.genfromtxt(folder / name, delimiter=",", names=True) for name in ("commands.csv", f"payload_{grams}g.csv")
    )
    count, names = min(len(commands), len(positions)), [f"u{k}" for k in range(1, 7)]
    table = np.column_stack(
        [*(commands[name][:count] for name in names), *(positions[c][:count] for c in ("x3", "z3", "y3"))]
    )
    tip = {
        "x": {"signal": "x", "scale": 1e3, "offset": -100.0},
        "y": {"signal": "z", "scale": 1e3, "offset": -105.0},
        "z": {"signal": "y", "scale": -1e3},
    }
    with TemporaryDirectory() as made:
        file = Path(made) / f"{grams}g.csv"
        np.savetxt(file, table, delimiter=",", header=",".join([*names, "x", "z", "y"]), comments="")
        (trial,) = both_axes(read_trials(file, mapping(names, "deg", tip, 1 / TRUNK_S), rate_hz=TRUNK_HZ)) or []
    inputs = {"payload_g": np.full(len(trial), float(grams))}
    return Trial(trial.t, trial.commands, trial.angles, units=trial.units, source=f"{grams} g", inputs=inputs)


def bare(trial: Trial) -> Trial:
    """The trial without its input."""
    return Trial(trial.t, trial.commands, trial.angles, units=trial.units, source=trial.source)


def main() -> None:
    given = asked(
        __doc__, continuum={"type": Path, "help": "file"}, trunk={"type": Path, "help": "folder"},
        kinds={"nargs": "+", "default": ["pi", "auto"]},
    )  # fmt: skip
    if given.continuum is not None:
        continuum(given.continuum, given.kinds)
    if given.trunk is not None:
        trunk(given.trunk, given.kinds)


if __name__ == "__main__":
    main()
