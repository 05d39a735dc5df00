"""A reconstruction as pieces of a report."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.report import Heading, Paragraph, Piece, Plot, Table

from .figures import error_map_figure, section_figure, setup_figure
from .result import Reconstruction
from .segment import Segment
from .table import ERROR_COLUMNS, TEST_COLUMNS, error_rows, rank_test_rows

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


def reconstruction_pieces(result: Reconstruction, label: str = "simulated") -> tuple[Piece, ...]:
    """Heading, tables and figures of a reconstruction; `label` says where its numbers come from."""
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
    """Of every pattern the scan that is nearest to the middle of its sector, as in S1 Fig. 7d to 7f."""
    cap, found = result.settings.cap, []
    for k, pattern in enumerate(cap.patterns):
        rotations = np.unique(result.rotation_deg[result.pattern == pattern.name])
        if rotations.size:
            middle = (k + _SECTOR_MIDDLE) * cap.sector_deg
            found.append(float(rotations[np.argmin(np.abs(rotations - middle))]))
    return found
