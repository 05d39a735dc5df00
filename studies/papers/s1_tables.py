"""Tables III and IV of S1, beside what the paper prints."""

from __future__ import annotations

import math

import numpy as np

from ..tables import NOTHING, Cell, StudyTable
from .common import label
from .outcome import Outcome, title_of
from .printed import S1_ERRORS, S1_HALF_RANGE_DEG, S1_TRAINING
from .result import JobResult
from .s1_plan import TESTS

_TAIL = 0.1
_FIGURES = (
    ("rmse_deg", "RMSE", "deg", 1.0),
    ("max_abs_error_deg", "max abs", "deg", 1.0),
    ("nrmse", "NRMSE", "%", 100.0),
)


def errors_table(outcome: Outcome) -> StudyTable:
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


def inverse_table(outcome: Outcome) -> StudyTable | None:
    """Errors of inverse maps, of which the paper has none; None where none was trained."""
    rows: list[list[Cell]] = []
    for result in outcome.matching(direction="inverse"):
        for test, name in TESTS.items():
            figures = [factor * float(result.figures(figure, [test])[0]) for figure, _, _, factor in _FIGURES]
            rows.append([title_of(result.job.kind), result.job.preset, name, *figures])
    columns = ("model", "preset", "test", "RMSE [bar]", "max abs [bar]", "NRMSE [%]")
    caption = "Inverse maps, angle to pressure (simulated); the paper has none."
    return StudyTable("inverse_maps", columns, rows, caption) if rows else None


def improvement_table(outcome: Outcome) -> StudyTable | None:
    """How much lower the LSTM's NRMSE is than the others', ours and the paper's; None without an LSTM."""
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


def training_table(outcome: Outcome) -> StudyTable:
    """Table IV: iterations, loss and how much it still changed."""
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
    """Mean of |L_k - L_(k-1)| / L_(k-1) over the looks of the last tenth of the steps; not-a-number below two looks.

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
