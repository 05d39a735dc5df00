"""The report of the study of S1."""

from __future__ import annotations

from collections.abc import Iterator

from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.report import Heading, Paragraph, Piece, Plot, Report

from ..reconstruction.report import reconstruction_pieces
from ..reconstruction.result import Reconstruction
from ..reconstruction.table import ERROR_COLUMNS, TEST_COLUMNS, error_rows, rank_test_rows
from .common import jobs_pieces, jobs_table, set_up
from .outcome import Outcome
from .s1_figures import loops_figure, tracking_figure
from .s1_plan import TESTS
from .s1_scan import scan_study
from .s1_tables import errors_table, improvement_table, inverse_table, training_table
from .tables import StudyTable


def s1_report(outcome: Outcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    found = (errors_table(outcome), improvement_table(outcome), inverse_table(outcome), training_table(outcome))
    tables = [table for table in found if table is not None]
    scans, scan_tables = _reconstruction(outcome)
    page = Report(
        "Study of S1: hysteresis of a pressure-driven catheter",
        (
            *set_up(outcome),
            Heading("Errors and convergence (Tables III and IV)"),
            *(table.piece for table in tables),
            *_figures(outcome),
            *scans,
            *jobs_pieces(outcome),
        ),
        "simulated device, beside what the paper prints",
    )
    return page, [*tables, *scan_tables, long_table(outcome), jobs_table(outcome)]


def long_table(outcome: Outcome) -> StudyTable:
    """Every figure of every job on every test; CSV only."""
    rows = [
        [r.job.kind, r.job.preset, r.job.direction, s.split, s.trial, *vars(s.errors).values()]
        for r in outcome.done
        for s in r.scores
    ]
    figures = ("rmse", "bias", "offset_free_rmse", "max_abs_error", "nrmse", "hold_drift")
    return StudyTable("per_trial", ("kind", "preset", "direction", "split", "trial", *figures), rows, "", shown=False)


def _figures(outcome: Outcome) -> Iterator[Piece]:
    yield Heading("Models on the four tests (Figure 5)")
    for preset in outcome.presets:
        results = outcome.matching(preset=preset, direction="forward")
        if results:
            yield Plot(tracking_figure(outcome, results), f"Simulated, preset {preset}: {', '.join(TESTS.values())}.")
    yield Heading("Hysteresis of the device (Figure 4)")
    yield Plot(loops_figure(outcome.splits), "Simulated: the training groups, zero baseline first.")


def _reconstruction(outcome: Outcome) -> tuple[list[Piece], list[StudyTable]]:
    """The scanning experiment; what it raises is said in its place."""
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
