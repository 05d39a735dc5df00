"""Table I of S2: signed-rank tests between models, beside the paper's signs."""

from __future__ import annotations

from ..statistics import least_p
from ..tables import NOTHING, Cell, StudyTable
from .outcome import Outcome, title_of
from .printed import s2_symbol
from .s2_views import MOTION_NAMES, UNITS, Matched, matched


def wilcoxon_table(view: Matched) -> StudyTable | None:
    """Table I: signed-rank tests of every pair beside the paper's symbols; None for a single model."""
    tests = view.tests
    if not tests:
        return None
    rows: list[list[Cell]] = []
    for test in tests:
        printed = s2_symbol(view.motion, view.direction, test.row, test.column)
        same = NOTHING if printed is None else ("yes" if printed.value == test.symbol else "no")
        shown = [f"{p:.2g}" for p in (test.p_less, test.p_greater, test.p, test.p_holm)]
        rows.append(
            [
                title_of(test.row),
                title_of(test.column),
                test.n,
                test.symbol,
                str(printed or NOTHING),
                same,
                *shown,
                test.symbol_holm,
            ]
        )
    agree, known = [sum(row[5] == "yes" for row in rows), sum(row[5] != NOTHING for row in rows)]
    n = max(test.n for test in tests)
    caption = (
        f"Table I, {view.where}: Wilcoxon signed-rank tests of the RMSE over {n} simulated test trials; row < column: "
        f"the row's error is smaller. {agree} of {known} known signs of the paper agree. One-sided exact p is at least "
        f"{least_p(n):.2g}; the paper corrects nothing, Holm's correction is over the {len(rows)} two-sided tests here."
    )
    columns = ("row", "column", "n", "simulated", "paper", "agree", "p row less", "p row greater", "p two-sided")
    return StudyTable(f"wilcoxon_{view.suffix}", (*columns, "p Holm", "sign by Holm"), rows, caption)


def symbols_table(outcome: Outcome, preset: str, motion: str) -> StudyTable | None:
    """Table I as the paper lays it out: forward / inverse, ours and the paper's in brackets."""
    views = {v.direction: v for v in matched(outcome) if v.preset == preset and v.motion == motion}
    signs = {(t.row, t.column, d): t.symbol for d, view in views.items() for t in view.tests}
    kinds = [kind for kind in outcome.kinds if any(kind in view.results for view in views.values())]
    if len(kinds) < len(("row", "column")):
        return None

    def cell(row: str, column: str) -> str:
        ours = " / ".join(signs.get((row, column, d), NOTHING) for d in UNITS)
        known = [s2_symbol(motion, d, row, column) for d in UNITS]
        paper = " / ".join(str(p.value) if p else NOTHING for p in known)
        return f"{ours}  ({paper})" if any(known) else ours

    rows = [
        [title_of(row), *(cell(row, column) if j < i else "" for j, column in enumerate(kinds[:-1]))]
        for i, row in enumerate(kinds)
        if i
    ]
    mark = "[P]" if motion == "p2p" else "[I], from the text: the printed rows are lost"
    caption = (
        f"Table I, {MOTION_NAMES[motion]}, preset {preset}: forward / inverse, row against column; simulated, in "
        f"brackets the paper's {mark}."
    )
    return StudyTable(f"table_1_{motion}_{preset}", ["", *map(title_of, kinds[:-1])], rows, caption)
