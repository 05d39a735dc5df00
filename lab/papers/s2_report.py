"""The report of the study of S2."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.report import Heading, Paragraph, Piece, Plot, Report

from ..tables import StudyTable
from .common import jobs_pieces, jobs_table, set_up
from .printed import S2_FNN_BIAS_DEG
from .result import StudyOutcome
from .s2_figures import (
    errors_figure,
    example_figure,
    hysteresis_figure,
    tip_mapping,
    tip_mapping_figure,
    training_motion_figure,
)
from .s2_plan import BASELINE, MOTION_NAMES, MOTIONS, Matched, matched, split_tested_on
from .s2_tables import (
    cross_table,
    errors_table,
    long_table,
    order_table,
    relative_table,
    symbols_table,
    trials_table,
    wilcoxon_table,
    window_table,
)

_FIGURE_9 = ("fnn", "hb2", "fnn_hib")


def s2_report(outcome: StudyOutcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    views = matched(outcome)
    sections = [*_overview(outcome, views), *_device(outcome), *_training(outcome), *_details(views)]
    pieces = [piece.piece if isinstance(piece, StudyTable) else piece for piece in sections if _is_shown(piece)]
    tables = [piece for piece in sections if isinstance(piece, StudyTable)]
    page = Report(
        "Study of S2: forward and inverse maps of a tendon catheter",
        (*set_up(outcome), *pieces, *jobs_pieces(outcome)),
        "simulated device, beside what the paper prints",
    )
    return page, [*tables, long_table(outcome), jobs_table(outcome)]


def _is_shown(piece: Piece | StudyTable) -> bool:
    return not isinstance(piece, StudyTable) or piece.shown


def _overview(outcome: StudyOutcome, views: list[Matched]) -> Iterator[Piece | StudyTable]:
    """Figure 8 and Table I."""
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
    """Size of the loop as the FNN leaves it."""
    for view in views:
        if view.direction == "forward" and BASELINE in view.results:
            up, down = branch_bias(view)
            yield Paragraph(
                f"The FNN on {MOTION_NAMES[view.motion]} (simulated, preset {view.preset}): mean error {up:+.2f} deg "
                f"while the command rises, {down:+.2f} deg while it falls; in the paper it overestimates a rising "
                f"angle by {S2_FNN_BIAS_DEG[view.motion]} deg and underestimates a falling one by as much."
            )


def branch_bias(view: Matched) -> tuple[float, float]:
    """Mean error of the FNN over all samples at which the command rises, and falls [deg].

    Raises:
        ModelError: if its model is gone or damaged.
    """
    rising, falling = [], []
    for trial in view.outcome.splits[split_tested_on(view.motion)]:
        error = (view.outcome.free_run(view.results[BASELINE].job, trial).theta - trial.angle)[1:]
        change = np.diff(trial.command)
        rising.append(error[change > 0])
        falling.append(error[change < 0])
    return float(np.mean(np.concatenate(rising))), float(np.mean(np.concatenate(falling)))


def _device(outcome: StudyOutcome) -> Iterator[Piece | StudyTable]:
    """Figures 5 and 6."""
    loops = hysteresis_figure(outcome.splits)
    if loops is not None:
        yield Heading("Hysteresis of the device (Figure 5)")
        yield Plot(
            loops,
            "Simulated: (a) tip angle over tendon displacement for decaying sinusoids of five frequencies, (b) over "
            "tension, (c) of equal trials. In the paper amplitudes fall slightly with frequency, and loops are "
            "smoother over displacement than over tension.",
        )
    try:
        found = tip_mapping(outcome.splits)
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


def _training(outcome: StudyOutcome) -> Iterator[Piece | StudyTable]:
    """Figure 7, the cross table and the window study."""
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
    """Figure 9, then every table."""
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
