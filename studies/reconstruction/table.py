"""A reconstruction as rows of text, beside what the paper prints."""

from __future__ import annotations

from .printed import PAPER_P, paper_error, paper_section
from .result import ErrorSummary, Reconstruction

ERROR_COLUMNS = ("pattern", "model", "mean [mm]", "std [mm]", "max [mm]", "n", "mean printed in the paper [mm]")
TEST_COLUMNS = (
    "pattern",
    "models",
    "counted",
    "n each",
    "U",
    "p (two-sided)",
    "P(first < second)",
    "mean, first / second",
    "p in the paper",
)
SECTION_DEG = 45.0  # the section of pattern I of which the paper gives errors

_SMALLEST_P = 1e-300


def error_rows(result: Reconstruction) -> list[list[str]]:
    """A row for every pattern and model, then for the section of pattern I at 45 deg where it was scanned."""
    rows = [
        [f"{pattern}", model, *_figures(result.summary(model, result.in_pattern(pattern))), paper_error(model, pattern)]
        for pattern in result.patterns
        for model in result.models
    ]
    if not _has_section(result):
        return rows
    here = result.in_scan(SECTION_DEG)
    section = [[model, *_figures(result.summary(model, here)), paper_section(model)] for model in result.models]
    return rows + [[f"I, section at {SECTION_DEG:g} deg", *row] for row in section]


def rank_test_rows(result: Reconstruction) -> list[list[str]]:
    """A row for every Mann-Whitney test; the ratio is that of the mean errors in the pattern."""
    rows = []
    for test in result.rank_tests:
        inside = result.in_pattern(test.pattern)
        first, second = (result.summary(name, inside).mean_mm for name in (test.first, test.second))
        ratio = f"{first / second:.2f}" if second > 0 else "-"
        counted = [test.unit, str(test.n), f"{test.u:g}", _p_value(test.p), f"{test.probability_smaller:.2f}"]
        rows.append([test.pattern, f"{test.first}, {test.second}", *counted, ratio, f"< {PAPER_P}"])
    return rows


def _figures(summary: ErrorSummary) -> list[str]:
    return [f"{summary.mean_mm:.3f}", f"{summary.std_mm:.3f}", f"{summary.max_mm:.2f}", str(summary.n)]


def _p_value(p: float) -> str:
    return f"{p:.2g}" if p > _SMALLEST_P else f"< {_SMALLEST_P:g}"  # below it floating point has no digits left


def _has_section(result: Reconstruction) -> bool:
    at = result.pattern[abs(result.rotation_deg - SECTION_DEG) < 1e-6]
    return at.size > 0 and at[0] == "I"
