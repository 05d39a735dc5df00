"""Review of a run on a device of two axes: errors of each axis and of the tip, advice, trial.csv and report.html."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hystmpc.ctrl.monitor import ChangeMonitor
from hystmpc.models.two_axes.model import load_two_axes
from hystmpc.trials.csv_files import format_table
from hystmpc.trials.errors import LogError, TrajectoryError
from hystmpc.trials.figure_data import draw_long
from hystmpc.trials.figures import REFERENCE_LOOK, LoopPanel, loop_figure
from hystmpc.trials.files import write_atomically
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.json_text import mapping_in
from hystmpc.trials.layouts import CANONICAL, command_column
from hystmpc.trials.report import MEASURED, Heading, KeyValues, Piece, Plot, Report, new_figure
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Vec, rms

from ..axes import NAMES, columns, trial_columns
from ..plane_config import PlaneRunSettings, says_two_axes
from ..recording.report import Log, causes, numbers, timing_table
from .review import (
    TRIAL_FILE,
    Review,
    ReviewedRun,
    ending_pieces,
    line_pieces,
    logged_inputs,
    review,
    review_run,
    run_figures,
    timing_pieces,
)

_LEAST = 10  # samples that can be judged
_AXES = len(NAMES)


@dataclass(frozen=True, eq=False)
class PlaneRows:
    """Signals of a run of two axes: commands (N, 2) of the samples, all else (N, 2) [deg] at their ends.

    Attributes:
        t: ends of the samples (N,) [s].
        inputs: measured inputs (N,) by name.
    """

    t: Vec
    command: Vec
    measured_deg: Vec
    reference_deg: Vec
    predicted_deg: Vec
    free_deg: Vec
    inputs: Mapping[str, Vec] = field(default_factory=dict)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Samples with both angles (N,)."""
        return np.asarray(np.isfinite(self.measured_deg).all(axis=1))


@dataclass(frozen=True)
class PlaneReview:
    """Assessment of a model of two axes by a run.

    Attributes:
        tip_deg: RMS distance of measured and wanted angles in their plane [deg]; not-a-number without a reference.
        greatest_deg: the greatest of these distances [deg].
        axes: assessment of each axis; empty with too few samples.
        problem: why the run is not judged; empty if it is.
    """

    tip_deg: float
    greatest_deg: float
    axes: tuple[Review, ...] = ()
    problem: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """Available lines on the tracking error, and the advice for each axis."""
        if self.problem:
            return (f"not judged: {self.problem}",)
        known = math.isfinite(self.tip_deg)
        tip = f"tracking error of the tip {self.tip_deg:.2f} deg RMS, {self.greatest_deg:.2f} deg at most"
        return (
            *((tip,) if known else ()),
            *(f"{name}: {one.advice}" for name, one in zip(NAMES, self.axes, strict=True)),
        )


def review_bench_run(folder: Path, more: Sequence[Piece] = ()) -> Review | PlaneReview:
    """Review a run folder of one axis or of two; arguments, files and errors as of `review_run`."""
    if says_two_axes(RunFolder.open(folder).config(), folder):
        return review_plane_run(folder, more)
    return review_run(folder, more)


@only_reads()
def review_plane_run(folder: Path, more: Sequence[Piece] = ()) -> PlaneReview:
    """Review a run folder of two axes and write its `trial.csv` (for `fit` and `diagnose`) and `report.html`.

    A run that is too short for a review still gets a report; `more` is shown after the advice.

    Raises:
        LogError: if the folder holds no readable run.
        ConfigError: if its settings are not those of a run.
    """
    run = RunFolder.open(folder)
    settings = PlaneRunSettings.parse(run.config(), str(folder / "config.yaml"))
    rows = None
    try:
        rows = plane_rows(run, settings)
        verdict = _judged(rows, settings)
        t, u, y = (values[rows.seen] for values in (rows.t, rows.command, rows.measured_deg))
        inputs = {name: values[rows.seen] for name, values in rows.inputs.items()}
        write_atomically(folder / TRIAL_FILE, format_table(trial_columns(t, u, y, settings.command_unit) | inputs))
    except (LogError, TrajectoryError) as error:
        verdict = PlaneReview(math.nan, math.nan, problem=str(error))
    _write_page(run, settings, rows, verdict, more)
    return verdict


def plane_rows(run: RunFolder, settings: PlaneRunSettings) -> PlaneRows:
    """Compare the samples of the log with the free run of the model.

    Raises:
        LogError: if the log lacks a column, is too short or has no sample with both angles.
        ModelError: if the model is missing.
    """
    log = run.log()
    if gone := [name for name in ("time_s", "sequence", "angle_x_deg", "reference_x_deg") if name not in log]:
        raise LogError(f"{run.path}: the log lacks {', '.join(gone)}, expected the log of a run of two axes")
    sequence = numbers(log, "sequence").astype(np.int64)
    angle, command = _both(log, CANONICAL.angle), _both(log, command_column(settings.command_unit))
    seen = np.flatnonzero(np.isfinite(angle).all(axis=1))
    if sequence.size < _LEAST or not seen.size:
        raise LogError(f"{run.path}: {sequence.size} samples, expected at least {_LEAST} with angles to be judged")
    follows = np.flatnonzero(np.diff(sequence) == 1)  # rows whose end is the next row's beginning
    place = sequence - sequence[0]
    row = np.searchsorted(place, np.arange(place[-1] + 1), side="right") - 1  # commands are held over skipped samples
    model, inputs = load_two_axes(settings.controller.model), logged_inputs(log, settings.inputs)
    known = {one.name: inputs[one.name][row] for one in model.inputs if one.name in inputs}
    free = model.run(command[row], angle[seen[0]], known)[place]
    return PlaneRows(
        t=numbers(log, "time_s")[follows] + settings.dt_s,
        command=command[follows],
        measured_deg=angle[follows + 1],
        reference_deg=_both(log, "reference_deg")[follows],
        predicted_deg=_both(log, "predicted_deg")[follows],
        free_deg=free[follows],
        inputs={name: values[follows] for name, values in inputs.items()},
    )


def _both(log: Log, name: str) -> Vec:
    return np.stack([numbers(log, column) for column in columns(name, 0.0, _AXES)], axis=1)


def _judged(rows: PlaneRows, settings: PlaneRunSettings) -> PlaneReview:
    model = load_two_axes(settings.controller.model)
    each = []
    for i, axis in enumerate(model.axes):
        trained = axis.trained_angle_deg.lower, axis.trained_angle_deg.upper
        one = ReviewedRun(
            t=rows.t,
            command=rows.command[:, i],
            measured_deg=rows.measured_deg[:, i],
            reference_deg=rows.reference_deg[:, i],
            predicted_deg=rows.predicted_deg[:, i],
            free_deg=rows.free_deg[:, i],
            counted=rows.seen,
            monitor=ChangeMonitor(None, settings.dt_s, trained),
        )
        each.append(review(one, settings.review.due_above_deg))
    away = np.hypot(*(rows.measured_deg - rows.reference_deg).T)
    away = away[np.isfinite(away)]
    return PlaneReview(rms(away), float(away.max()) if away.size else math.nan, tuple(each))


def _write_page(
    run: RunFolder, settings: PlaneRunSettings, rows: PlaneRows | None, verdict: PlaneReview, more: Sequence[Piece]
) -> Path:
    timing, log = mapping_in(run.path / "timing.json"), run.log()
    judged = {"RMS tracking error of the tip [deg]": verdict.tip_deg, "greatest [deg]": verdict.greatest_deg}
    for name, one in zip(NAMES, verdict.axes, strict=False):
        judged[f"{name}: RMS tracking error [deg]"] = one.tracking_deg
        judged[f"{name}: RMS prediction error, one sample ahead [deg]"] = one.one_step_deg
        judged[f"{name}: RMS prediction error, free run [deg]"] = one.free_run_deg
    angles = _both(log, CANONICAL.angle).sum(axis=1)  # not-a-number where one of both is missing
    figures = run_figures(settings, settings.controller.model, judged, angles, timing)
    pieces = [*ending_pieces(timing), *line_pieces(verdict.lines), *more, Heading("Run"), KeyValues(figures)]
    if rows is not None:
        pieces += [
            Heading("Tip"),
            Plot(_tip_figure(rows), "Measured tip in the plane of both angles, over the reference."),
            Heading("Tracking"),
            Plot(_signals_figure(rows, settings), "References, measured angles and commands over time.", True),
        ]
    pieces += [*timing_pieces(timing, settings.dt_s), Heading("Stages of a sample"), timing_table(log), *causes(log)]
    return run.write_report(Report("Run at the bench", tuple(pieces), f"{settings.name}, {run.meta.get('start', '')}"))


def _tip_figure(rows: PlaneRows) -> Figure:
    """Measured tip and reference in the plane of both angles, where there is a reference; else all of the tip."""
    wanted = np.isfinite(rows.reference_deg).all(axis=1)
    shown = wanted if wanted.any() else rows.seen
    look = {"color": MEASURED, "linewidth": 1.0, "label": "measured"}
    curves = [(*rows.reference_deg[shown].T, REFERENCE_LOOK), (*rows.measured_deg[shown].T, look)]
    return loop_figure([LoopPanel("tip", curves)], "deg", "deg", ("angle x [deg]", "angle y [deg]"))


def _signals_figure(rows: PlaneRows, settings: PlaneRunSettings) -> Figure:
    with new_figure(7.0, 6.4) as figure:
        panels = figure.subplots(2 * _AXES, 1, sharex=True)
        for i, (name, axes) in enumerate(zip(NAMES, panels[:_AXES], strict=True)):
            if np.isfinite(rows.reference_deg[:, i]).any():
                draw_long(axes, rows.t, rows.reference_deg[:, i], **REFERENCE_LOOK)
            draw_long(axes, rows.t, rows.measured_deg[:, i], color=MEASURED, linewidth=1.0, label="measured")
            axes.set_ylabel(f"angle {name} [deg]")
        for i, (name, axes) in enumerate(zip(NAMES, panels[_AXES:], strict=True)):
            draw_long(axes, rows.t, rows.command[:, i], color=MEASURED, linewidth=0.9, drawstyle="steps-pre")
            axes.set_ylabel(f"command {name} [{settings.command_unit}]")
        panels[-1].set_xlabel("time [s]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
