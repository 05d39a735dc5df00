"""Pieces of a report on a reconstruction: tables with the paper's numbers, and figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from hystmpc.trials.report import PALETTE, REFERENCE, Heading, Paragraph, Piece, Plot, Table, new_figure
from hystmpc.trials.types import Vec

from .geometry import ReconstructionSettings, Segment, profile, surface_distance
from .reconstruct import ErrorSummary, Reconstruction

PRINTED: Final = "printed in the paper"
INFERRED: Final = "inferred [I]"
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
_BACKBONE_POINTS = 50
_RING_MM = 0.5
_COLOURS = "cividis"  # even in lightness, for readers of any colour vision
_MARGIN_MM = 0.8
_SECTOR_MIDDLE = 0.5
_MAP_CAPTION = (
    "Error maps seen along the axis, one colour scale for all models; white where a groove's wall hides its bottom."
)
_SECTION_CAPTION = "Section of one scan, both strokes; the line is the cap's profile. The axes have different scales."
_DEPENDENCE = (
    "Points of one scan follow each other in time and are not independent, so the test over points, which is the "
    "paper's, gives too small a p. The test over scans takes the mean error of a scan as one observation; scans of "
    "one device that repeats itself are not independent either."
)


@dataclass(frozen=True)
class PrintedValue:
    """Number of the paper.

    Attributes:
        mark: `PRINTED`, or `INFERRED` where it was worked out from printed ones.
    """

    value: float
    mark: str = PRINTED

    def __str__(self) -> str:
        return f"{self.value:g}" + (" [I]" if self.mark == INFERRED else "")


# Mean reconstruction error by model and pattern [mm]. DRDPI: the LSTM's over one less its printed reduction; of these
# "the smallest ... is 0.54 mm" is printed in the conclusion.
PAPER_ERROR_MM: Final = {
    ("LSTM", "I"): PrintedValue(0.16),
    ("LSTM", "II"): PrintedValue(0.16),
    ("LSTM", "III"): PrintedValue(0.25),
    ("DRDPI", "I"): PrintedValue(0.54, INFERRED),
    ("DRDPI", "II"): PrintedValue(0.54, INFERRED),
    ("DRDPI", "III"): PrintedValue(0.69, INFERRED),
}
# How much lower the LSTM's error is than the DRDPI's, by pattern [%].
PAPER_REDUCTION_PERCENT: Final = {"I": PrintedValue(70.4), "II": PrintedValue(70.4), "III": PrintedValue(63.8)}
# Mean error of the planar section of pattern I at 45 deg, by model [mm].
PAPER_SECTION_I_MM: Final = {"LSTM": PrintedValue(0.22), "DRDPI": PrintedValue(0.58)}
# The Mann-Whitney test rejected equal errors in all three patterns below this p.
PAPER_P: Final = PrintedValue(0.01)


def paper_error(model: str, pattern: str) -> str:
    """The paper's mean error as text, `-` where it has none; a model's name is compared without regard to case."""
    return str(PAPER_ERROR_MM.get((model.upper(), pattern), "-"))


def paper_section(model: str) -> str:
    """The paper's error of the 45 deg section of pattern I as text, `-` where it has none."""
    return str(PAPER_SECTION_I_MM.get(model.upper(), "-"))


def error_rows(result: Reconstruction) -> list[list[str]]:
    """Rows of errors for every pattern and model, then for the section of pattern I at 45 deg if it was scanned."""
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
    """Rows of every Mann-Whitney test; the ratio is that of the mean errors in the pattern."""
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


def colours(models: Sequence[str]) -> dict[str, str]:
    """Colour of each model, equal in every figure of a reconstruction."""
    return {name: PALETTE[k % (len(PALETTE) - 1)] for k, name in enumerate(models)}


def setup_figure(settings: ReconstructionSettings, angles_deg: Sequence[float] = (0.0, 10.0, 20.0, 30.0)) -> Figure:
    """Plot of the cross-section of every pattern with the segment at some angles and its rays."""
    segment, patterns = Segment(settings.segment_length_mm), settings.cap.patterns
    with new_figure(7.0, 5.2) as figure:
        row = figure.subplots(1, len(patterns), sharex=True, sharey=True, squeeze=False)[0]
        for axes, pattern in zip(row, patterns, strict=True):
            axes.plot(*profile(settings, pattern).T, color=REFERENCE)
            theta = np.array(angles_deg)
            tips, ends = segment.tip(theta), segment.point(theta, surface_distance(settings, pattern, theta))
            for k, (angle, tip, end) in enumerate(zip(angles_deg, tips, ends, strict=True)):
                axes.plot(*_backbone(settings.segment_length_mm, angle), color=PALETTE[0], linewidth=1.6)
                axes.plot(*np.stack([tip, end]).T, color=PALETTE[1], linewidth=0.9, label=None if k else "ray")
            axes.set(title=f"pattern {pattern.name}", xlabel="across [mm]", aspect="equal")
        row[0].set_ylabel("along the straight segment [mm]")
    return figure


def section_figure(result: Reconstruction, rotation_deg: float = 45.0, models: Sequence[str] | None = None) -> Figure:
    """Plot of one scan: the cap, its ground truth and each model's points, and below the errors of all models.

    Args:
        rotation_deg: of the scan; S1 Fig. 7d is that of pattern I at 45 [deg].
    """
    here, names, colour = result.in_scan(rotation_deg), models or result.models, colours(result.models)
    pattern = result.settings.cap.pattern_at(rotation_deg)
    truth = _in_plane(result.truth_mm[here], rotation_deg)
    with new_figure(7.0, 1.5 + 2.0 * len(names)) as figure:
        ratios = [4.0] * len(names) + [3.0]
        rows = figure.subplots(len(names) + 1, 1, sharex=True, height_ratios=ratios)
        for axes, name in zip(rows, names, strict=False):
            mean = result.summary(name, here).mean_mm
            points = _in_plane(result.estimates_mm[name][here], rotation_deg)
            axes.plot(*profile(result.settings, pattern).T, color=REFERENCE, linewidth=0.7, label="cap")
            axes.plot(*truth.T, ".", color=REFERENCE, markersize=4.5, label="ground truth")
            axes.plot(*points.T, ".", color=colour[name], markersize=2.5, label=name)
            axes.set(title=f"{name}: mean error {mean:.2f} mm", ylabel="along [mm]")
            axes.set_ylim(truth[:, 1].min() - _MARGIN_MM, truth[:, 1].max() + _MARGIN_MM)
            axes.legend(loc="lower left", ncols=3)
            rows[-1].plot(truth[:, 0], result.errors(name)[here], ".", color=colour[name], markersize=2.5)
        _section_limits(rows[-1], truth)
        figure.suptitle(f"Pattern {pattern.name}, scan at {rotation_deg:g} deg", fontsize=9.5)
    return figure


def error_map_figure(result: Reconstruction, models: Sequence[str] | None = None) -> Figure:
    """Map of the mean error over rings of 0.5 mm and sectors of a scan, along the axis, with one colour scale.

    A scan's cell starts at its rotation and ends at the next one's, so that cells fill the patterns.
    """
    names = models or result.models
    columns = 2 if len(names) == 4 else min(len(names), 3)
    lines = -(-len(names) // columns)
    maps = {name: _ring_means(result, result.errors(name)) for name in names}
    top = max(float(np.nanmax(cells)) for cells in maps.values()) or 1.0
    rotations, rings = _edges(result)
    norm = Normalize(0.0, top)
    with new_figure(7.0, 0.4 + lines * 6.6 / columns) as figure:
        grid = figure.subplots(lines, columns, squeeze=False, subplot_kw={"projection": "polar"}).ravel()
        for axes, name in zip(grid, names, strict=False):
            axes.grid(visible=False)
            axes.pcolormesh(np.radians(rotations), rings, maps[name].T, cmap=_COLOURS, norm=norm)
            _polar_labels(axes, result, float(rings[-1]))
            axes.set_title(f"{name}: mean {result.summary(name).mean_mm:.2f} mm", pad=14.0)
        for axes in grid[len(names) :]:
            axes.remove()
        scale = ScalarMappable(norm, _COLOURS)
        bar = figure.colorbar(scale, ax=list(grid[: len(names)]), location="bottom", shrink=0.6, aspect=40)
        bar.set_label("mean error of a cell [mm]; radius: distance from the axis [mm]")
    return figure


def _backbone(length_mm: float, angle_deg: float) -> tuple[Vec, Vec]:
    """Points of the bent segment: a part s of its length bends by s times the angle."""
    part = np.linspace(0.0, 1.0, _BACKBONE_POINTS)
    line = length_mm * part[:, None] * Segment(1.0).tip(part * angle_deg)
    return line[:, 0], line[:, 1]


def _section_limits(axes: Axes, truth: Vec) -> None:
    axes.set(xlabel="distance of the ground truth from the axis [mm]", ylabel="error [mm]")
    axes.set_xlim(truth[:, 0].min() - _MARGIN_MM, truth[:, 0].max() + _MARGIN_MM)
    axes.set_ylim(bottom=0.0)


def _in_plane(points: Vec, rotation_deg: float) -> Vec:
    """Points (..., 3) rotated back into the bending plane (..., 2)."""
    phi = math.radians(rotation_deg)
    return np.stack([points[:, 0] * math.cos(phi) + points[:, 1] * math.sin(phi), points[:, 2]], axis=-1)


def _edges(result: Reconstruction) -> tuple[Vec, Vec]:
    """Edges of the cells: rotations [deg] and distances from the axis [mm]."""
    rotations = np.unique(result.rotation_deg)
    step = float(np.min(np.diff(rotations))) if rotations.size > 1 else result.settings.cap.sector_deg
    outermost = float(np.max(np.hypot(result.truth_mm[:, 0], result.truth_mm[:, 1])))
    rings = _RING_MM * np.arange(math.floor(outermost / _RING_MM) + 2)
    return np.append(rotations, rotations[-1] + step), np.asarray(rings, float)


def _ring_means(result: Reconstruction, error: Vec) -> Vec:
    """Mean error of every cell, (scans, rings); NaN where it has no point."""
    rotations, rings = _edges(result)
    scan = np.searchsorted(rotations, result.rotation_deg)
    ring = np.floor(np.hypot(result.truth_mm[:, 0], result.truth_mm[:, 1]) / _RING_MM).astype(np.intp)
    cell, shape = scan * (rings.size - 1) + ring, (rotations.size - 1, rings.size - 1)
    count = np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)
    total = np.bincount(cell, weights=error, minlength=shape[0] * shape[1]).reshape(shape)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _polar_labels(axes: PolarAxes, result: Reconstruction, outermost: float) -> None:
    """Names of the patterns at the middle of their sectors, and lines between them."""
    cap = result.settings.cap
    middles = [(k + 0.5) * cap.sector_deg for k in range(len(cap.patterns))]
    axes.set_thetagrids(middles, [p.name for p in cap.patterns])
    for k in range(len(cap.patterns) + 1):
        axes.plot([math.radians(k * cap.sector_deg)] * 2, [0.0, outermost], color=REFERENCE, linewidth=0.6)
    axes.set_rlim(0.0, outermost)
    axes.set_rgrids([r for r in (5.0, 10.0, 15.0, 20.0) if r < outermost], angle=-45.0)


def reconstruction_pieces(result: Reconstruction, label: str = "simulated") -> tuple[Piece, ...]:
    """Heading, tables and figures of a reconstruction; `label` gives the origin of its numbers."""
    sections = [Plot(section_figure(result, rotation), _SECTION_CAPTION) for rotation in _middle_scans(result)]
    tests: list[Piece] = []
    if result.rank_tests:
        caption = "Mann-Whitney U test of the errors of two models."
        tests = [Table(TEST_COLUMNS, rank_test_rows(result), caption), Paragraph(_DEPENDENCE)]
    return (
        Heading(f"3-D reconstruction ({label})"),
        Paragraph(_set_up(result)),
        Table(
            ERROR_COLUMNS,
            error_rows(result),
            f"Reconstruction errors ({label}); the last column is the paper's, on its own cap. [I]: inferred from "
            "printed numbers.",
        ),
        *tests,
        Plot(setup_figure(result.settings), "Segment (blue), ray (orange) and cap (grey)."),
        Plot(error_map_figure(result), _MAP_CAPTION),
        *sections,
    )


def _set_up(result: Reconstruction) -> str:
    cap = result.settings.cap
    lever = float(Segment(result.settings.segment_length_mm).lever(0.0, cap.standoff_mm))
    floor = float(np.mean(result.sensor_error_mm()))
    return (
        f"{np.unique(result.rotation_deg).size} scans of a hollow spherical cap (inner radius "
        f"{cap.inner_radius_mm:g} mm, standoff {cap.standoff_mm:g} mm; dimensions are ours, the paper's figure of them "
        f"is lost). On the axis an angle error of 1 deg displaces a point by {lever:.2f} mm. The ground truth itself, "
        f"made of the sensed angle, lies {floor:.3f} mm from the true surface points on average."
    )


def _middle_scans(result: Reconstruction) -> list[float]:
    """Scan nearest to the middle of the sector for every pattern, as in S1 Fig. 7d to 7f."""
    cap, found = result.settings.cap, []
    for k, pattern in enumerate(cap.patterns):
        rotations = np.unique(result.rotation_deg[result.pattern == pattern.name])
        if rotations.size:
            middle = (k + _SECTOR_MIDDLE) * cap.sector_deg
            found.append(float(rotations[np.argmin(np.abs(rotations - middle))]))
    return found
