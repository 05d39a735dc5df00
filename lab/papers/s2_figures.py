"""Figures of the study of S2: the device (5, 6), training motion (7), errors (8), example trials (9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.models.chain import Chain
from hystmpc.models.identify.chain_fit import OperatorFitSettings, fit_chain
from hystmpc.models.identify.chain_kinds import backlash_starts
from hystmpc.models.kernels.chain_kernels import compile_step
from hystmpc.models.maps import QuadraticMap
from hystmpc.trials.report import ACCENTS, COMMAND, MEASURED, MODEL, PALETTE, REFERENCE, new_figure
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .job import Splits
from .result import JobResult, PaperOutcome, title_of
from .s2_plan import MOTION_NAMES, MOTIONS, UNITS, Matched, split_tested_on

_DEVICE: Any = {"color": REFERENCE, "linewidth": 2.2, "alpha": 0.5}
_COLOURS = (MODEL, MEASURED, COMMAND, *ACCENTS)
FREQUENCY, REPEATS = "frequency", "repeatability"
TENSION, TIP_Y = "tension_n", "y_mm"


def errors_figure(views: Sequence[Matched]) -> Figure:
    """Figure 8: mean and standard deviation of the RMSE as bar and line, the greatest error as a number above."""
    directions = list(dict.fromkeys(view.direction for view in views))
    with new_figure(7.0, 2.6 * len(directions)) as figure:
        grid = figure.subplots(len(directions), len(MOTIONS), squeeze=False)
        for axes in grid.ravel():
            axes.set_visible(False)
        for view in views:
            axes = grid[directions.index(view.direction)][MOTIONS.index(view.motion)]
            axes.set_visible(True)
            _bars(axes, view)
    return figure


def _bars(axes: Axes, view: Matched) -> None:
    unit, names = UNITS[view.direction], [title_of(kind) for kind in view.results]
    rmse = [view.errors(kind) for kind in view.results]
    means, spreads = [float(np.mean(e)) for e in rmse], [float(np.std(e)) for e in rmse]
    axes.bar(
        range(len(names)), means, yerr=spreads, color=MEASURED, width=0.7, error_kw={"elinewidth": 0.8, "capsize": 2}
    )
    top = max(mean + spread for mean, spread in zip(means, spreads, strict=True))
    for k, kind in enumerate(view.results):
        largest = float(np.max(view.errors(kind, "max_abs_error_deg")))
        axes.annotate(
            f"{largest:.2g}", (k, means[k] + spreads[k]), (0, 2), textcoords="offset points", ha="center", fontsize=7
        )
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
    axes.set(ylabel=f"RMSE [{unit}]", title=f"{view.direction}, {MOTION_NAMES[view.motion]}", ylim=(0, 1.12 * top))
    axes.grid(visible=False, axis="x")


def training_motion_figure(outcome: PaperOutcome, preset: str, kind: str = "lstm") -> Figure | None:
    """Figure 7: a network trained on either motion, on a trial of each; None if one of them is missing."""
    models = {motion: _trained_on(outcome, motion, preset, kind) for motion in MOTIONS}
    found = {MOTION_NAMES[motion]: result for motion, result in models.items() if result is not None}
    if len(found) < len(MOTIONS):
        return None
    with new_figure(7.0, 5.0) as figure:
        rows = figure.subplots(len(MOTIONS), 1)
        for axes, motion in zip(rows, MOTIONS, strict=True):
            trial = median_trial(outcome, motion, next(r for r in models.values() if r))
            axes.plot(trial.t, trial.angle, label="device", **_DEVICE)
            for (name, result), colour in zip(found.items(), _COLOURS, strict=False):
                axes.plot(trial.t, outcome.free_run(result.job, trial).theta, color=colour, label=f"trained on {name}")
            axes.set(ylabel="tip angle [deg]", title=f"{trial.source} ({MOTION_NAMES[motion]})")
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _trained_on(outcome: PaperOutcome, motion: str, preset: str, kind: str) -> JobResult | None:
    split = [split_tested_on(motion)]
    return outcome.better(split, stage="main", kind=kind, direction="forward", preset=preset, train=motion)


def median_trial(outcome: PaperOutcome, motion: str, judge: JobResult) -> Trial:
    """The test trial on which the judge's error is the median: neither the best nor the worst example."""
    split = split_tested_on(motion)
    order = np.argsort(judge.figures("rmse_deg", [split]), kind="stable")
    return outcome.drawn[split][int(order[len(order) // 2])]


def example_figure(views: Mapping[str, Matched], kinds: Sequence[str]) -> Figure | None:
    """Figure 9: models on one point-to-point trial, output above and error below, a column a direction."""
    shown = {d: [kind for kind in kinds if kind in view.results] for d, view in views.items()}
    if not any(shown.values()):
        return None
    with new_figure(7.0, 4.4) as figure:
        grid = figure.subplots(2, len(views), sharex="col", squeeze=False, height_ratios=(3, 2))
        first = next(iter(views.values()))
        trial = median_trial(first.outcome, first.motion, next(iter(first.results.values())))
        for column, (direction, view) in enumerate(views.items()):
            _example(grid[0][column], grid[1][column], view, shown[direction], trial)
        figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _example(above: Axes, below: Axes, view: Matched, kinds: Sequence[str], trial: Trial) -> None:
    outcome, unit = view.outcome, UNITS[view.direction]
    for kind, colour in zip(kinds, _COLOURS, strict=False):
        run = outcome.free_run(view.results[kind].job, trial)
        above.plot(trial.t, run.theta, color=colour, linewidth=0.9, label=title_of(kind))
        below.plot(trial.t, run.theta - run.trial.angle, color=colour, linewidth=0.8)
    above.plot(
        trial.t, trial.command if view.direction == "inverse" else trial.angle, zorder=0, label="device", **_DEVICE
    )
    below.axhline(0.0, color=REFERENCE, linewidth=0.6)
    what = "tip angle" if view.direction == "forward" else "displacement"
    above.set(title=f"{view.direction}: {trial.source}", ylabel=f"{what} [{unit}]")
    below.set(xlabel="time [s]", ylabel=f"error [{unit}]")


def hysteresis_figure(splits: Splits) -> Figure | None:
    """Figure 5: angle over displacement and over tension at several frequencies, and of equal trials; None without."""
    if FREQUENCY not in splits or REPEATS not in splits:
        return None
    with new_figure(7.0, 3.0) as figure:
        axes = figure.subplots(1, 3, sharey=True)
        for trial, colour in zip(splits[FREQUENCY], PALETTE * 2, strict=False):
            name, style = _name(trial), {"color": colour, "linewidth": 0.7}
            axes[0].plot(trial.command, trial.angle, label=name, **style)
            if TENSION in trial.channels:
                axes[1].plot(trial.channels[TENSION], trial.angle, **style)
        for trial, colour in zip(splits[REPEATS], PALETTE * 2, strict=False):
            axes[2].plot(trial.command, trial.angle, color=colour, linewidth=0.6)
        for axis, title, label in zip(
            axes,
            ("(a) by frequency", "(b) over tension", "(c) equal trials, 0.5 Hz"),
            ("displacement [mm]", "tension [N]", "displacement [mm]"),
            strict=True,
        ):
            axis.set(title=title, xlabel=label)
        axes[0].set_ylabel("tip angle [deg]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _name(trial: Trial) -> str:
    return trial.source.rpartition("/")[2].replace("p", ".").replace("hz", " Hz")


@dataclass(frozen=True, eq=False)
class TipMapping:
    """Direct and composite map to the tip's Y by a backlash, on one test trial (S2 Fig. 6).

    Attributes:
        direct: backlash from command to Y [mm], (T,).
        composite: backlash from command to angle, then a parabola [mm], (T,).
        direct_rmse_mm, composite_rmse_mm: mean over all test trials of the RMSE of Y.
    """

    trial: Trial
    direct: Vec
    composite: Vec
    direct_rmse_mm: float
    composite_rmse_mm: float


def tip_mapping(splits: Splits, motion: str = "p2p") -> TipMapping | None:
    """Fit both maps on the training trials and run them over the test trials; None where trials have no Y.

    Raises:
        FitError: if a fit fails.
    """
    training, tests = splits[f"{motion}/train"], splits[f"{motion}/test"]
    if any(TIP_Y not in trial.channels for trial in (*training, *tests)):
        return None
    to_angle, to_y = _backlash(training), _backlash([_as_y(trial) for trial in training])
    angle, y = (np.concatenate([values(t) for t in training]) for values in (lambda t: t.angle, _y))
    parabola = QuadraticMap.fit(angle, y)
    direct = [_run(to_y, _as_y(trial)) for trial in tests]
    composite = [parabola(_run(to_angle, trial)) for trial in tests]
    errors = [
        float(np.mean([np.sqrt(np.mean((run - _y(t)) ** 2)) for run, t in zip(runs, tests, strict=True)]))
        for runs in (direct, composite)
    ]
    return TipMapping(tests[0], direct[0], composite[0], *errors)


def tip_mapping_figure(found: TipMapping) -> Figure:
    """Figure 6(c): Y over time, measured and by both maps, and their errors."""
    with new_figure(7.0, 4.0) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        t, measured = found.trial.t, _y(found.trial)
        above.plot(t, measured, color=REFERENCE, linewidth=2.2, alpha=0.5, label="device")
        for run, name, colour in ((found.direct, "direct", MODEL), (found.composite, "composite", MEASURED)):
            above.plot(t, run, color=colour, label=name)
            _error(below, t, run - measured, colour)
        above.set_ylabel("tip Y [mm]")
        below.set(xlabel="time [s]", ylabel="error [mm]")
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _error(axes: Axes, t: Vec, error: Vec, colour: str) -> None:
    axes.plot(t, error, color=colour, linewidth=0.9)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6)


def _y(trial: Trial) -> Vec:
    return trial.channels[TIP_Y]


def _as_y(trial: Trial) -> Trial:
    """The trial with Y in the place of the angle: what the direct map is fitted to."""
    return Trial(trial.t, trial.command, _y(trial), {}, trial.units, trial.source)


def _backlash(trials: list[Trial] | tuple[Trial, ...]) -> Chain:
    return fit_chain(backlash_starts(trials), trials, OperatorFitSettings(seed=1)).chain


def _run(chain: Chain, trial: Trial) -> Vec:
    """Free run (T,) from rest at the trial's first sample."""
    kernels = compile_step(chain.transition)
    rest = chain.rest(float(trial.angle[0]), float(trial.command[0]), chain.values)
    theta = np.empty((1, len(trial)))
    state, commands = np.array(rest).reshape(1, -1), trial.command[None].copy()
    kernels.simulate(state, commands, chain.values, np.array([trial.dt]), kernels.step_constants, theta)
    return theta[0]
