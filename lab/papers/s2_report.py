"""Page of the study of S2 with figures: device (5, 6), training motion (7), errors (8), examples (9)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.models.chain import Chain
from hystmpc.models.identify.chain_fit import OperatorFitSettings, fit_chain
from hystmpc.models.identify.chain_kinds import backlash_starts
from hystmpc.models.maps import QuadraticMap
from hystmpc.models.stages import prepared
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.report import (
    MEASURED,
    MODEL,
    PALETTE,
    REFERENCE,
    Heading,
    Paragraph,
    Piece,
    Plot,
    Report,
    new_figure,
)
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..page import StudyTable
from .job import JobResult, PaperOutcome, Splits, title_of
from .printed import COLOURS, DEVICE_LINE, S2_FNN_BIAS_DEG, jobs_pieces, jobs_table, paper_set_up
from .s2_tables import (
    BASELINE,
    MOTION_NAMES,
    MOTIONS,
    UNITS,
    Matched,
    cross_table,
    errors_table,
    long_table,
    matched,
    order_table,
    relative_table,
    split_tested_on,
    symbols_table,
    trials_table,
    wilcoxon_table,
    window_table,
)

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
    """Figure 7: a network trained on each motion, on a trial of each; None if one of them is missing."""
    models = {motion: _trained_on(outcome, motion, preset, kind) for motion in MOTIONS}
    found = {MOTION_NAMES[motion]: result for motion, result in models.items() if result is not None}
    if len(found) < len(MOTIONS):
        return None
    with new_figure(7.0, 5.0) as figure:
        rows = figure.subplots(len(MOTIONS), 1)
        for axes, motion in zip(rows, MOTIONS, strict=True):
            trial = median_trial(outcome, motion, next(r for r in models.values() if r))
            axes.plot(trial.t, trial.angle, label="device", **DEVICE_LINE)
            for (name, result), colour in zip(found.items(), COLOURS, strict=False):
                axes.plot(trial.t, outcome.free_run(result.job, trial).theta, color=colour, label=f"trained on {name}")
            axes.set(ylabel="tip angle [deg]", title=f"{trial.source} ({MOTION_NAMES[motion]})")
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _trained_on(outcome: PaperOutcome, motion: str, preset: str, kind: str) -> JobResult | None:
    split = [split_tested_on(motion)]
    return outcome.better(split, stage="main", kind=kind, direction="forward", preset=preset, train=motion)


def median_trial(outcome: PaperOutcome, motion: str, judge: JobResult) -> Trial:
    """Test trial with the median error of the judge, as a typical example."""
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
    for kind, colour in zip(kinds, COLOURS, strict=False):
        run = outcome.free_run(view.results[kind].job, trial)
        above.plot(trial.t, run.theta, color=colour, linewidth=0.9, label=title_of(kind))
        below.plot(trial.t, run.theta - run.trial.angle, color=colour, linewidth=0.8)
    above.plot(
        trial.t, trial.command if view.direction == "inverse" else trial.angle, zorder=0, label="device", **DEVICE_LINE
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
    """Fit both maps on the training trials and run them over the test trials; None if trials have no Y."""
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
    """Trial with Y in place of the angle, for the fit of the direct map."""
    return Trial(trial.t, trial.command, _y(trial), {}, trial.units, trial.source)


def _backlash(trials: list[Trial] | tuple[Trial, ...]) -> Chain:
    return fit_chain(backlash_starts(trials), trials, OperatorFitSettings(seed=1)).chain


def _run(chain: Chain, trial: Trial) -> Vec:
    """Free run (T,) from rest at the trial's first sample."""
    rest = chain.rest(float(trial.angle[0]), float(trial.command[0]), chain.values)
    return prepared(chain.operators, trial.dt).run(np.array(rest).reshape(1, -1), trial.command[None])[0][0]


_FIGURE_9 = ("fnn", "hb2", "fnn_hib")


def s2_report(outcome: PaperOutcome) -> tuple[Report, list[StudyTable]]:
    """Page of the study, and all tables that are written as CSV."""
    views = matched(outcome)
    sections = [*_overview(outcome, views), *_device(outcome), *_training(outcome), *_details(views)]
    pieces = [piece.piece if isinstance(piece, StudyTable) else piece for piece in sections if _is_shown(piece)]
    tables = [piece for piece in sections if isinstance(piece, StudyTable)]
    page = Report(
        "Study of S2: forward and inverse maps of a tendon catheter",
        (*paper_set_up(outcome), *pieces, *jobs_pieces(outcome)),
        "simulated device, beside what the paper prints",
    )
    return page, [*tables, long_table(outcome), jobs_table(outcome)]


def _is_shown(piece: Piece | StudyTable) -> bool:
    return not isinstance(piece, StudyTable) or piece.shown


def _overview(outcome: PaperOutcome, views: list[Matched]) -> Iterator[Piece | StudyTable]:
    """Pieces of Figure 8 and Table I."""
    yield Heading("Errors by model (Figure 8)")
    for preset in outcome.presets:
        here = [view for view in views if view.preset == preset]
        if here:
            caption = (
                f"Simulated, preset {preset}: mean (bar) and standard deviation (line) of the RMSE over the test "
                "trials; the number is the greatest absolute error. Trained on the motion that is tested."
            )
            yield Plot(errors_figure(here), caption)
    for view in views:
        yield order_table(view)
        relative = relative_table(view)
        if relative is not None:
            yield relative
    yield from _bias(views)
    yield Heading("Which models differ (Table I)")
    for preset in outcome.presets:
        for motion in MOTIONS:
            table = symbols_table(outcome, preset, motion)
            if table is not None:
                yield table


def _bias(views: list[Matched]) -> Iterator[Piece]:
    """Piece on the loop's size in the errors of the FNN."""
    for view in views:
        if view.direction == "forward" and BASELINE in view.results:
            up, down = branch_bias(view)
            yield Paragraph(
                f"The FNN on {MOTION_NAMES[view.motion]} (simulated, preset {view.preset}): mean error {up:+.2f} deg "
                f"while the command rises, {down:+.2f} deg while it falls; in the paper it overestimates a rising "
                f"angle by {S2_FNN_BIAS_DEG[view.motion]} deg and underestimates a falling one by as much."
            )


def branch_bias(view: Matched) -> tuple[float, float]:
    """Mean error of the FNN over all samples at which the command rises, and falls [deg]."""
    rising, falling = [], []
    for trial in view.outcome.drawn[split_tested_on(view.motion)]:
        error = (view.outcome.free_run(view.results[BASELINE].job, trial).theta - trial.angle)[1:]
        change = np.diff(trial.command)
        rising.append(error[change > 0])
        falling.append(error[change < 0])
    return float(np.mean(np.concatenate(rising))), float(np.mean(np.concatenate(falling)))


def _device(outcome: PaperOutcome) -> Iterator[Piece | StudyTable]:
    """Pieces of Figures 5 and 6."""
    loops = hysteresis_figure(outcome.drawn)
    if loops is not None:
        yield Heading("Hysteresis of the device (Figure 5)")
        yield Plot(
            loops,
            "Simulated: (a) tip angle over tendon displacement for decaying sinusoids of five frequencies, (b) over "
            "tension, (c) of equal trials. In the paper amplitudes fall slightly with frequency, and loops are "
            "smoother over displacement than over tension.",
        )
    try:
        found = tip_mapping(outcome.drawn)
    except HystmpcError as error:
        yield Paragraph(f"Figure 6 is missing: {error}")
        return
    if found is not None:
        yield Heading("Direct and composite map to the tip (Figure 6)")
        yield Plot(
            tip_mapping_figure(found),
            f"Simulated, {found.trial.source}: the tip's Y by a backlash directly, and by a backlash to the angle and "
            f"a parabola. Mean RMSE over the test trials: direct {found.direct_rmse_mm:.3f} mm, composite "
            f"{found.composite_rmse_mm:.3f} mm; in the paper the composite map is the more accurate one.",
        )


def _training(outcome: PaperOutcome) -> Iterator[Piece | StudyTable]:
    """Pieces of Figure 7, the cross table and the window study."""
    yield Heading("Training motion against test motion (Figure 7)")
    for preset in outcome.presets:
        figure = training_motion_figure(outcome, preset)
        if figure is not None:
            yield Plot(
                figure, f"Simulated: LSTM, preset {preset}, trained on either motion, on the median test trial of each."
            )
        for direction in outcome.settings.directions:
            table = cross_table(outcome, direction, preset)
            if table is not None:
                yield table
    windows = window_table(outcome)
    if windows is not None:
        yield Heading("Length of the training windows")
        yield windows


def _details(views: list[Matched]) -> Iterator[Piece | StudyTable]:
    """Pieces of Figure 9 and of every table."""
    for preset in dict.fromkeys(view.preset for view in views):
        here = {view.direction: view for view in views if view.preset == preset and view.motion == "p2p"}
        figure = example_figure(here, _FIGURE_9) if here else None
        if figure is not None:
            yield Heading("Example trial (Figure 9)")
            caption = f"Simulated, preset {preset}: the point-to-point test trial of the first model's median error."
            yield Plot(figure, caption)
    for view in views:
        yield Heading(f"Details: {view.where}")
        for table in (errors_table(view), wilcoxon_table(view), trials_table(view)):
            if table is not None:
                yield table
