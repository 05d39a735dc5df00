"""Tables of the study on recorded logs: every log tested by models that have not seen it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hystmpc.models.evaluate import Errors
from hystmpc.trials.types import Vec

from ..statistics import compared, least_p
from ..tables import NOTHING, Cell, StudyTable
from .outcome import Outcome, title_of
from .real_plan import BASELINE
from .result import JobResult, Score

COUNTS = {"later": "without the first flexure", "errors": "with the first flexure"}


@dataclass(frozen=True, eq=False)
class Candidate:
    """One kind, preset and beta with a score for every log.

    Attributes:
        kind, preset: which.
        beta: None for the preset's.
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


def candidates(outcome: Outcome, direction: str) -> tuple[tuple[Candidate, ...], tuple[Candidate, ...]]:
    """Those with a score for every log, and those that lack some, which are not compared."""
    groups: dict[tuple[str, str, float | None], list[JobResult]] = {}
    for result in outcome.results:
        if result.job.direction == direction:
            key = result.job.kind, result.job.preset, result.job.constancy
            groups.setdefault(key, []).append(result)
    whole: list[Candidate] = []
    broken: list[Candidate] = []
    for key, results in groups.items():
        complete = all(result.status == "done" for result in results)
        (whole if complete else broken).append(Candidate(*key, tuple(results)))
    return tuple(whole), tuple(broken)


def baseline_of(found: Sequence[Candidate]) -> Candidate | None:
    """The 4-parameter backlash that the others are measured against: of its presets the one with the lowest error."""
    own = [candidate for candidate in found if candidate.kind == BASELINE]
    return min(own, key=lambda c: float(np.mean(c.figures("offset_free_rmse_deg", "later"))), default=None)


def errors_table(found: Sequence[Candidate], direction: str, unit: str, count: str) -> StudyTable:
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


def trials_table(found: Sequence[Candidate], direction: str, unit: str, count: str) -> StudyTable:
    """Offset-free RMSE of every model on every log."""
    logs = [Path(score.trial).name for score in found[0].scores] if found else []
    rows: list[list[Cell]] = [[c.name, *map(float, c.figures("offset_free_rmse_deg", count))] for c in found]
    caption = f"Real logs, {direction} map, {COUNTS[count]}: offset-free RMSE [{unit}] of every trial."
    return StudyTable(f"real_trials_{direction}_{count}", ["model", *logs], rows, caption)


def signed_rank_table(found: Sequence[Candidate], direction: str, count: str) -> StudyTable | None:
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


def presets_table(found: Sequence[Candidate], direction: str, unit: str) -> StudyTable | None:
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
