"""The study on recorded logs: every log is tested by models that have not seen it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.models.evaluate import Errors
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

from ..statistics import compared, least_p
from ..tables import NOTHING, Cell, StudyTable
from .common import jobs_pieces, jobs_table, set_up
from .job import LOGS, Splits, TrainingJob, TrainingTask, before, betas_for, preset_for, steps_for
from .result import JobResult, Score, StudyOutcome, title_of
from .settings import StudySettings

BASELINE = "backlash"
COUNTS = {"later": "without the first flexure", "errors": "with the first flexure"}
_DEVICE: Any = {"color": REFERENCE, "linewidth": 2.2, "alpha": 0.5}
_COLOURS = (MODEL, MEASURED, COMMAND, *ACCENTS)
_SHOWN = 2  # of the best models beside the backlash


def real_tasks(settings: StudySettings, splits: Splits) -> tuple[TrainingTask, ...]:
    """Leave-one-trial-out over the logs, for every kind, preset and direction; training skips the first flexure.

    The backlash is always among the kinds: the others are measured against it.
    """
    names = [kind for kind in settings.kinds if kind not in settings.left_out]
    kinds = dict.fromkeys([BASELINE, *names])
    logs, tasks = splits[LOGS], []
    for kind in kinds:
        for preset in dict.fromkeys(preset_for(kind, asked) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                for beta in betas_for(kind, preset, settings):
                    for k, held_out in enumerate(logs):
                        fold = f"{k + 1}_{Path(held_out.source).stem}"
                        job = TrainingJob(
                            "main", kind, preset, direction, fold, beta, settings.seed, steps, skip_first_flexure=True
                        )
                        others = tuple(log for log in logs if log is not held_out)
                        tasks.append(
                            TrainingTask(job, others, (), {LOGS: (held_out,)}, before(held_out, logs, settings.parts))
                        )
    return tuple(tasks)


@dataclass(frozen=True, eq=False)
class RealCandidate:
    """One kind, preset and beta with a score for every log.

    Attributes:
        results: one for each log that is left out, in the order of the logs.
    """

    kind: str
    preset: str
    beta: float | None
    results: tuple[JobResult, ...]

    @property
    def name(self) -> str:
        """For tables."""
        beta = "" if self.beta is None else f", beta {self.beta:g}"
        return f"{title_of(self.kind)} ({self.preset}{beta})"

    @property
    def scores(self) -> tuple[Score, ...]:
        """One for each log."""
        return tuple(score for result in self.results for score in result.scores)

    def figures(self, name: str, count: str) -> Vec:
        """One figure of `Errors` a log (N,); over the whole trial where the command never turns."""
        return np.array([getattr(_counted(score, count), name) for score in self.scores])


def _counted(score: Score, count: str) -> Errors:
    return score.later or score.errors if count == "later" else score.errors


def candidates(outcome: StudyOutcome, direction: str) -> tuple[tuple[RealCandidate, ...], tuple[RealCandidate, ...]]:
    """Those with a score for every log, and those that lack some, which are not compared."""
    groups: dict[tuple[str, str, float | None], list[JobResult]] = {}
    for result in outcome.results:
        if result.job.direction == direction:
            key = result.job.kind, result.job.preset, result.job.constancy
            groups.setdefault(key, []).append(result)
    whole: list[RealCandidate] = []
    broken: list[RealCandidate] = []
    for key, results in groups.items():
        complete = all(result.status == "done" for result in results)
        (whole if complete else broken).append(RealCandidate(*key, tuple(results)))
    return tuple(whole), tuple(broken)


def baseline_of(found: Sequence[RealCandidate]) -> RealCandidate | None:
    """The 4-parameter backlash that the others are measured against: of its presets the one with the lowest error."""
    own = [candidate for candidate in found if candidate.kind == BASELINE]
    return min(own, key=lambda c: float(np.mean(c.figures("offset_free_rmse_deg", "later"))), default=None)


def errors_table(found: Sequence[RealCandidate], direction: str, unit: str, count: str) -> StudyTable:
    """Means over the logs, best model first."""
    base = baseline_of(found)
    names = ("offset_free_rmse_deg", "rmse_deg", "max_abs_error_deg", "nrmse", "hold_drift_deg")
    rows: list[list[Cell]] = []
    for c in sorted(found, key=lambda c: float(np.mean(c.figures(names[0], count)))):
        means = [float(np.mean(c.figures(name, count))) for name in names]
        ratio: Cell = means[0] / float(np.mean(base.figures(names[0], count))) if base else NOTHING
        drift = float(np.max(c.figures("hold_drift_deg", count)))
        rows.append([c.name, means[0], ratio, means[1], means[2], 100 * means[3], means[4], drift])
    columns = ["model", f"offset-free RMSE [{unit}]", "over the backlash's", f"RMSE [{unit}]", f"max abs [{unit}]"]
    columns += ["NRMSE [%]", f"hold drift [{unit}]", f"worst hold drift [{unit}]"]
    caption = (
        f"Real logs, leave-one-trial-out, {direction} map, {COUNTS[count]}: means over "
        f"{len(found[0].scores) if found else 0} trials, each by a model that was identified on the others. Ratios to "
        f"{base.name if base else 'the backlash, which is missing'}."
    )
    return StudyTable(f"real_{direction}_{count}", columns, rows, caption)


def trials_table(found: Sequence[RealCandidate], direction: str, unit: str, count: str) -> StudyTable:
    """Offset-free RMSE of every model on every log."""
    logs = [Path(score.trial).name for score in found[0].scores] if found else []
    rows: list[list[Cell]] = [[c.name, *map(float, c.figures("offset_free_rmse_deg", count))] for c in found]
    caption = f"Real logs, {direction} map, {COUNTS[count]}: offset-free RMSE [{unit}] of every trial."
    return StudyTable(f"real_trials_{direction}_{count}", ["model", *logs], rows, caption)


def signed_rank_table(found: Sequence[RealCandidate], direction: str, count: str) -> StudyTable | None:
    """Every model against the backlash by Wilcoxon's signed-rank test over the trials; None without both."""
    base = baseline_of(found)
    if base is None or len(found) < len((base, "another")):
        return None
    errors = {c.name: c.figures("offset_free_rmse_deg", count) for c in found}
    tests = compared(errors, [(name, base.name) for name in errors if name != base.name])
    rows: list[list[Cell]] = []
    for test in tests:
        shown = [f"{p:.2g}" for p in (test.p_less, test.p_greater, test.p, test.p_holm)]
        rows.append([test.row, test.column, test.n, test.symbol, *shown, test.symbol_holm])
    n = len(base.scores)
    caption = (
        f"Real logs, {direction} map, {COUNTS[count]}: Wilcoxon signed-rank tests of the offset-free RMSE over {n} "
        f"trials; row < column: the row's error is smaller. With {n} trials no one-sided p can be below "
        f"{least_p(n):.2g}. Holm's correction is over these {len(rows)} two-sided tests."
    )
    columns = ("row", "column", "n", "sign", "p row less", "p row greater", "p two-sided", "p Holm", "sign by Holm")
    return StudyTable(f"real_wilcoxon_{direction}_{count}", columns, rows, caption) if rows else None


def presets_table(found: Sequence[RealCandidate], direction: str, unit: str) -> StudyTable | None:
    """For every kind the presets side by side; None where each has but one."""
    presets = tuple(dict.fromkeys(c.preset for c in found))
    means = {(c.kind, c.preset): float(np.mean(c.figures("offset_free_rmse_deg", "later"))) for c in found}
    rows: list[list[Cell]] = []
    for kind in dict.fromkeys(c.kind for c in found):
        cells: list[Cell] = [means.get((kind, preset), NOTHING) for preset in presets]
        if sum(cell != NOTHING for cell in cells) > 1:
            rows.append([title_of(kind), *cells])
    caption = (
        f"Real logs, {direction} map, {COUNTS['later']}: mean offset-free RMSE [{unit}] by preset of the training."
    )
    return StudyTable(f"real_presets_{direction}", ["model", *presets], rows, caption) if rows else None


def real_report(outcome: StudyOutcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    pieces = [piece for direction in outcome.settings.directions for piece in _direction(outcome, direction)]
    tables = [piece for piece in pieces if isinstance(piece, StudyTable)]
    shown = [piece.piece if isinstance(piece, StudyTable) else piece for piece in pieces]
    trials = outcome.splits[LOGS]
    page = Report(
        "Study on recorded logs, leave-one-trial-out",
        (*set_up(outcome), *shown, *jobs_pieces(outcome)),
        f"real logs: {', '.join(Path(trial.source).name for trial in trials)}",
    )
    return page, [*tables, jobs_table(outcome)]


def _direction(outcome: StudyOutcome, direction: str) -> Iterator[Piece | StudyTable]:
    units = outcome.splits[LOGS][0].units
    unit = units.angle if direction == "forward" else units.command
    found, broken = candidates(outcome, direction)
    yield Heading(f"{direction.capitalize()} map")
    for candidate in broken:
        yield Paragraph(f"Not compared, some of its fits failed: {candidate.name}.")
    turned = [score.later is not None for c in found for score in c.scores]
    if not all(turned):
        yield Paragraph("Trials whose command never turns are counted whole in either way of counting.")
    if not found:
        return
    for count in COUNTS:
        yield errors_table(found, direction, unit, count)
    presets = presets_table(found, direction, unit)
    if presets is not None:
        yield presets
    yield Plot(examples_figure(outcome, found, unit), "Real: errors over time of the best models and the backlash.")
    for count in COUNTS:
        yield trials_table(found, direction, unit, count)
        tests = signed_rank_table(found, direction, count)
        if tests is not None:
            yield tests


def examples_figure(outcome: StudyOutcome, found: Sequence[RealCandidate], unit: str) -> Figure:
    """Error over time on every log, of the backlash and the best models; each has not seen the log."""
    base = baseline_of(found)
    ranked = sorted(found, key=lambda c: float(np.mean(c.figures("offset_free_rmse_deg", "later"))))
    best = {c.kind: c for c in reversed(ranked) if base is None or c.kind != base.kind}
    shown = [c for c in ranked if best.get(c.kind) is c][:_SHOWN] + ([base] if base else [])
    trials = outcome.splits[LOGS]
    with new_figure(7.0, 0.6 + 1.3 * len(trials)) as figure:
        rows = figure.subplots(len(trials), 1, sharey=True, squeeze=False)[:, 0]
        for k, (axes, trial) in enumerate(zip(rows, trials, strict=True)):
            for candidate, colour in zip(shown, _COLOURS, strict=False):
                run = outcome.free_run(candidate.results[k].job, trial)
                axes.plot(trial.t, run.theta - run.trial.angle, color=colour, linewidth=0.8, label=candidate.name)
            axes.axhline(0.0, color=REFERENCE, linewidth=0.6)
            axes.set_title(Path(trial.source).name, fontsize=8)
        figure.supylabel(f"error [{unit}]", fontsize=9.0)
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
