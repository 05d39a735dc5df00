"""Study of S1: jobs, Tables III and IV, Figures 4 and 5, the reconstruction, and the page."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.models.evaluate import free_run
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.report import (
    ACCENTS,
    COMMAND,
    MEASURED,
    MODEL,
    REFERENCE,
    Heading,
    Paragraph,
    Piece,
    Plot,
    Report,
    new_figure,
)
from hystmpc.trials.types import Vec

from ..page import NOTHING, Cell, StudyTable
from ..reconstruction.geometry import ReconstructionSettings
from ..reconstruction.protocol import Device, Estimator, Protocol, record_scans
from ..reconstruction.reconstruct import Reconstruction, reconstruct
from ..reconstruction.report import ERROR_COLUMNS, TEST_COLUMNS, error_rows, rank_test_rows, reconstruction_pieces
from .job import JobResult, PaperOutcome, Splits, TrainingJob, TrainingTask, preset_for, steps_for, title_of
from .printed import (
    DEVICE_LINE,
    S1_ERRORS,
    S1_HALF_RANGE_DEG,
    S1_TRAINING,
    jobs_pieces,
    jobs_table,
    label,
    paper_set_up,
)
from .settings import PaperSettings

TESTS = {
    "test_a": "(a) descending sine",
    "test_b": "(b) down-chirp, shifted baseline",
    "test_c": "(c) up-chirp, zero baseline",
    "test_d": "(d) arbitrary with plateaus",
}
S1_PRESET = "s1"
_TAIL = 0.1
_FIGURES = (
    ("rmse_deg", "RMSE", "deg", 1.0),
    ("max_abs_error_deg", "max abs", "deg", 1.0),
    ("nrmse", "NRMSE", "%", 100.0),
)
COMPARED = ("lstm", "drdpi")
_QUICK_SCANS = 2
_COLOURS = (COMMAND, MODEL, MEASURED, *ACCENTS)
_LINE: Any = {"linewidth": 0.9}


def s1_tasks(settings: PaperSettings, splits: Splits) -> tuple[TrainingTask, ...]:
    """Tasks of every model on the eight training groups, tested on (a) to (d).

    Networks are trained with their preset `s1` where `paper` is asked for. S1 knows no constant-in, constant-out term.
    """
    tasks = []
    for kind in (kind for kind in settings.kinds if kind not in settings.left_out):
        for preset in dict.fromkeys(preset_for(kind, asked, S1_PRESET) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                job = TrainingJob("main", kind, preset, direction, "train", None, settings.seed, steps)
                tasks.append(TrainingTask(job, splits["train"], (), {test: splits[test] for test in TESTS}))
    return tuple(tasks)


def errors_table(outcome: PaperOutcome) -> StudyTable:
    """Table III: a row for every model and test."""
    rows: list[list[Cell]] = []
    for result in outcome.matching(direction="forward"):
        for test, name in TESTS.items():
            printed = S1_ERRORS.get(result.job.kind, {}).get(test, (NOTHING,) * len(_FIGURES))
            cells: list[Cell] = [title_of(result.job.kind), result.job.preset, name]
            for (figure, _, _, factor), paper in zip(_FIGURES, printed, strict=True):
                cells += [factor * float(result.figures(figure, [test])[0]), str(paper)]
            rows.append(cells)
    columns = ["model", "preset", "test"]
    for _, name, unit, _ in _FIGURES:
        columns += [f"{name} [{unit}]", f"{name} in the paper [{unit}]"]
    caption = (
        f"Table III ({label('s1')}): free runs over the four tests, beside the paper's numbers. Max abs is "
        "what S1 eq. (7) calls MAE."
    )
    return StudyTable("table_3", columns, rows, caption)


def inverse_table(outcome: PaperOutcome) -> StudyTable | None:
    """Table of the errors of inverse maps, which the paper does not contain; None without such maps."""
    rows: list[list[Cell]] = []
    for result in outcome.matching(direction="inverse"):
        for test, name in TESTS.items():
            figures = [factor * float(result.figures(figure, [test])[0]) for figure, _, _, factor in _FIGURES]
            rows.append([title_of(result.job.kind), result.job.preset, name, *figures])
    columns = ("model", "preset", "test", "RMSE [bar]", "max abs [bar]", "NRMSE [%]")
    caption = "Inverse maps, angle to pressure (simulated); the paper has none."
    return StudyTable("inverse_maps", columns, rows, caption) if rows else None


def improvement_table(outcome: PaperOutcome) -> StudyTable | None:
    """Reduction of the NRMSE by the LSTM against the others, ours and the paper's; None without an LSTM."""
    rows: list[list[Cell]] = []
    for lstm in outcome.matching(kind="lstm", direction="forward"):
        for other in (r for r in outcome.matching(direction="forward") if r.job.kind in S1_ERRORS and r is not lstm):
            if other.job.kind == "lstm":
                continue
            cells: list[Cell] = [title_of(other.job.kind), lstm.job.preset, other.job.preset]
            for test in TESTS:
                ours = 1.0 - float(lstm.figures("nrmse", [test])[0] / other.figures("nrmse", [test])[0])
                pair = [S1_ERRORS[kind][test][2].value for kind in ("lstm", other.job.kind)]
                cells.append(f"{100 * ours:.1f} ({100 * (1 - float(pair[0]) / float(pair[1])):.1f})")
            rows.append(cells)
    columns = ("LSTM against", "LSTM's preset", "preset", *(f"{name} [%]" for name in TESTS.values()))
    caption = (
        "How much lower the LSTM's NRMSE is (simulated), in brackets by the paper's Table III [P]; negative: higher."
    )
    return StudyTable("lstm_against_others", columns, rows, caption) if rows else None


def training_table(outcome: PaperOutcome) -> StudyTable:
    """Table IV: iterations, loss and its final relative change."""
    half = float(S1_HALF_RANGE_DEG.value)
    rows: list[list[Cell]] = []
    for result in outcome.matching(direction="forward"):
        loss = min(error for _, error in result.history) ** 2 if result.history else math.nan
        iterations: Cell = result.history[-1][0] if result.history else NOTHING
        change = relative_change(result)
        ours: list[Cell] = [iterations, loss, loss / half**2, NOTHING if math.isnan(change) else 100 * change]
        paper = S1_TRAINING.get(result.job.kind)
        printed = (
            (paper.iterations, f"{paper.loss} {paper.unit}", paper.change_percent, paper.time) if paper else ("-",) * 4
        )
        rows.append(
            [title_of(result.job.kind), result.job.preset, *ours, f"{result.seconds:.0f} s", *map(str, printed)]
        )
    columns = ("model", "preset", "iterations", "loss [deg^2]", "loss, normalised", "change [%]", "time")
    printed_columns = tuple(f"{name} in the paper" for name in ("iterations", "loss", "change [%]", "time"))
    caption = (
        f"Table IV ({label('s1')}): square of the best error so far at the end, also over the square of half the "
        f"angle's range, {S1_HALF_RANGE_DEG} deg; mean relative change of that loss over the last tenth of the looks. "
        "Ours is the best so far, which never rises; the paper does not say which it takes. The paper's header gives "
        "deg^2 for all three, its LSTM and SVR fit Table III only if they are normalised [I]."
    )
    return StudyTable("table_4", (*columns, *printed_columns), rows, caption)


def relative_change(result: JobResult) -> float:
    """Mean of |L_k - L_(k-1)| / L_(k-1) over the records of the last tenth of the steps; NaN below two records.

    Source: S1 Table IV.
    """
    steps, errors = (
        (np.array(values, dtype=np.float64) for values in zip(*result.history, strict=True))
        if (len(result.history) > 1)
        else (np.empty(0), np.empty(0))
    )
    if steps.size < 2:
        return math.nan
    loss = np.minimum.accumulate(errors) ** 2
    change = np.abs(np.diff(loss)) / loss[:-1]
    return float(np.mean(change[steps[1:] > (1 - _TAIL) * steps[-1]]))


def scan_study(outcome: PaperOutcome, preset_of: dict[str, str]) -> Reconstruction | None:
    """Scan of the cap with the simulated catheter, reconstructed by every forward model; None without a model."""
    jobs = {
        title_of(kind): found[0].job
        for kind, preset in preset_of.items()
        if (found := outcome.matching(kind=kind, preset=preset, direction="forward"))
    }
    if not jobs:
        return None
    rate = 1.0 / outcome.drawn["train"][0].dt
    quick = {"scans": _QUICK_SCANS} if outcome.settings.quick else {}
    protocol = Protocol(rate_hz=rate, **quick)

    def estimator(job: TrainingJob) -> Estimator:
        model = outcome.model(job)

        def angles(command: Vec) -> Vec:
            return free_run(model, command, 0.0)

        return angles

    scans = record_scans(
        protocol, _device(outcome.settings.seed, 1.0 / rate), {n: estimator(j) for n, j in jobs.items()}
    )
    names = [title_of(kind) for kind in COMPARED if kind in preset_of and title_of(kind) in jobs]
    pair = (names[0], names[1]) if len(names) == len(COMPARED) else None
    return reconstruct(ReconstructionSettings(seed=outcome.settings.seed), scans, pair)


def _device(seed: int, dt_s: float) -> Device:
    """Simulated catheter of S1 with its laser: another specimen than those of the training groups."""
    from ..devices.muscle import MuscleCatheter, MuscleRecorder
    from ..devices.recorder import generator

    recorder = MuscleRecorder()
    random = generator(seed, "s1/scan", "device")
    device = MuscleCatheter(recorder.variation(recorder.device, random))

    def run(command: Vec) -> tuple[Vec, Vec]:
        done = device.advance(device.virgin(), command, dt_s, random)
        voltage = recorder.laser(done.angle, random)
        return done.angle, recorder.laser.conversion.angles_of_group(voltage)

    return run


def loops_figure(splits: Splits) -> Figure:
    """Figure 4: bending angle over pressure of the training groups."""
    groups = splits["train"]
    rows = -(-len(groups) // 4)
    with new_figure(7.0, 0.5 + 1.9 * rows) as figure:
        grid = figure.subplots(rows, 4, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, trial in zip(grid, groups, strict=False):
            axes.plot(trial.command, trial.angle, color=MEASURED, linewidth=0.6)
            axes.set_title(trial.source.rpartition("/")[2].removeprefix("train_"), fontsize=8)
        for axes in grid[len(groups) :]:
            axes.remove()
        figure.supxlabel(f"pressure [{groups[0].units.command}]", fontsize=9.0)
        figure.supylabel("bending angle [deg]", fontsize=9.0)
    return figure


def tracking_figure(outcome: PaperOutcome, results: tuple[JobResult, ...]) -> Figure:
    """Figure 5: angle and error over time, a pair of axes for each test."""
    with new_figure(7.0, 7.5) as figure:
        grid = figure.subplots(4, 2, height_ratios=(3, 2, 3, 2))
        for k, (test, name) in enumerate(TESTS.items()):
            above, below = grid[2 * (k // 2)][k % 2], grid[2 * (k // 2) + 1][k % 2]
            trial = outcome.drawn[test][0]
            above.plot(trial.t, trial.angle, label="device", **DEVICE_LINE)
            for result, colour in zip(results, _COLOURS, strict=False):
                run = outcome.free_run(result.job, trial)
                above.plot(trial.t, run.theta, color=colour, label=title_of(result.job.kind), **_LINE)
                below.plot(trial.t, run.theta - trial.angle, color=colour, **_LINE)
            below.axhline(0.0, color=REFERENCE, linewidth=0.6)
            above.set(title=name, ylabel="angle [deg]")
            below.set(xlabel="time [s]", ylabel="error [deg]")
        figure.legend(*grid[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def s1_report(outcome: PaperOutcome) -> tuple[Report, list[StudyTable]]:
    """Page of the study, and all tables that are written as CSV."""
    found = (errors_table(outcome), improvement_table(outcome), inverse_table(outcome), training_table(outcome))
    tables = [table for table in found if table is not None]
    scans, scan_tables = _reconstruction(outcome)
    page = Report(
        "Study of S1: hysteresis of a pressure-driven catheter",
        (
            *paper_set_up(outcome),
            Heading("Errors and convergence (Tables III and IV)"),
            *(table.piece for table in tables),
            *_figures(outcome),
            *scans,
            *jobs_pieces(outcome),
        ),
        "simulated device, beside what the paper prints",
    )
    return page, [*tables, *scan_tables, long_table(outcome), jobs_table(outcome)]


def long_table(outcome: PaperOutcome) -> StudyTable:
    """Table of every figure of every job on every test, for CSV only."""
    rows = [
        [r.job.kind, r.job.preset, r.job.direction, s.split, s.trial, *vars(s.errors).values()]
        for r in outcome.done
        for s in r.scores
    ]
    figures = ("rmse", "bias", "offset_free_rmse", "max_abs_error", "nrmse", "hold_drift")
    return StudyTable("per_trial", ("kind", "preset", "direction", "split", "trial", *figures), rows, "", shown=False)


def _figures(outcome: PaperOutcome) -> Iterator[Piece]:
    yield Heading("Models on the four tests (Figure 5)")
    for preset in outcome.presets:
        results = outcome.matching(preset=preset, direction="forward")
        if results:
            yield Plot(tracking_figure(outcome, results), f"Simulated, preset {preset}: {', '.join(TESTS.values())}.")
    yield Heading("Hysteresis of the device (Figure 4)")
    yield Plot(loops_figure(outcome.drawn), "Simulated: the training groups, zero baseline first.")


def _reconstruction(outcome: PaperOutcome) -> tuple[list[Piece], list[StudyTable]]:
    """Pieces of the scanning experiment, or its error message."""
    if "reconstruction" not in outcome.settings.stages:
        return [], []
    presets: dict[str, str] = {}
    for result in outcome.matching(direction="forward"):
        presets.setdefault(result.job.kind, result.job.preset)
    try:
        found = scan_study(outcome, presets)
    except HystmpcError as error:
        return [Heading("3-D reconstruction (simulated)"), Paragraph(f"FAILED: {error}")], []
    if found is None:
        return [], []
    return list(reconstruction_pieces(found)), list(_scan_tables(found))


def _scan_tables(found: Reconstruction) -> Iterator[StudyTable]:
    yield StudyTable("reconstruction_errors", ERROR_COLUMNS, error_rows(found), "")
    if found.rank_tests:
        yield StudyTable("reconstruction_tests", TEST_COLUMNS, rank_test_rows(found), "")
