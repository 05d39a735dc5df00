"""Figures of a report as files, with all of their data; and figures that zoom."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from hystmpc.tasks.outputs import check_figures, check_page
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.figure_data import COLUMNS, MOST_POINTS, draw_long, draw_part, rows_of, zoomed
from hystmpc.trials.files import figures_to
from hystmpc.trials.report import Folded, Heading, Plot, Report, figure_svg, new_figure

T = np.arange(0.0, 400.0, 0.04)
NAMES = ["measured", "</script><b>"]


def long_figure() -> Figure:
    with new_figure(5, 3) as figure:
        above, below = figure.subplots(2, 1, sharex=True)
        draw_part(above, T, np.sin(T), T < 40.0, label=NAMES[0])
        draw_part(below, T, np.where(T > 5.0, T, np.nan), T < 40.0, label=NAMES[1])
        below.axhline(3.0)
        below.axvspan(0.0, 2.0)
        above.set(title="a loop", ylabel="angle [deg]")
        below.set(xlabel="time [s]")
    return figure


def bar_figure() -> Figure:
    with new_figure(5, 3) as figure:
        bars, cells, shares = figure.subplots(1, 3)
        bars.barh(["lag", "creep"], [0.75, 0.25], label="probability")
        cells.imshow(np.array([[1.0, 2.0], [3.0, 4.0]]), extent=(0.0, 2.0, 1.5, -0.5), aspect="auto")
        shares.stairs([5.0, 6.0], [0.0, 1.0, 2.0], label="share")
    return figure


def table(figure: Figure) -> list[dict[str, object]]:
    return [dict(zip(COLUMNS, row, strict=True)) for row in rows_of(figure)]


def report() -> Report:
    inside = Folded("Which effect?", (Plot(bar_figure()),))
    return Report("page", (Heading("Over time"), Plot(long_figure(), "All of it: angle", zoom=True), inside))


def test_a_table_has_every_point_of_a_curve_that_is_drawn_thinned() -> None:
    with new_figure() as figure:
        draw_long(figure.subplots(), T, T)
    assert np.size(figure.axes[0].get_lines()[0].get_xdata()) <= MOST_POINTS < T.size == len(table(figure))
    figure = long_figure()
    rows = table(figure)
    for name, panel in zip(NAMES, ("1: a loop", "2"), strict=True):
        found = [row for row in rows if row["series"] == name]
        assert [row["x"] for row in found] == T.tolist()
        assert {row["panel"] for row in found} == {panel}


def test_bars_steps_and_cells_are_in_the_table() -> None:
    figure = bar_figure()
    figure_svg(figure)
    rows = table(figure)
    assert [(r["x"], r["y"]) for r in rows if r["kind"] == "bar"] == [(0.75, "lag"), (0.25, "creep")]
    assert [(r["x"], r["y"]) for r in rows if r["kind"] == "step from x"] == [(0.0, 5.0), (1.0, 6.0)]
    assert [(r["x"], r["y"], r["value"]) for r in rows if r["kind"] == "cell"] == [
        (0.5, 0.0, 1.0),
        (1.5, 0.0, 2.0),
        (0.5, 1.0, 3.0),
        (1.5, 1.0, 4.0),
    ]


@pytest.mark.slow
def test_a_report_writes_its_figures_where_they_are_asked_for_and_nowhere_else(tmp_path: Path) -> None:
    with figures_to(tmp_path / "figures"):
        report().save(tmp_path / "a.html")
    report().save(tmp_path / "b.html")
    names = [
        f"{name}{ending}"
        for name in ("01-over-time-all-of-it-angle", "02-which-effect")
        for ending in (".csv", ".pdf", ".svg")
    ]
    assert sorted(file.name for file in (tmp_path / "figures").iterdir()) == names
    assert (tmp_path / "a.html").read_text() == (tmp_path / "b.html").read_text()
    with (tmp_path / "figures" / names[0]).open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 2 * T.size


def test_a_folder_that_holds_something_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="new or empty folder"):
        check_figures(tmp_path)
    with pytest.raises(ConfigError, match="is of the page of --report"):
        check_page(None, tmp_path / "figures", (), force=False)


def test_a_figure_that_zooms_has_its_drawing_and_all_its_points_and_nothing_ends_its_script() -> None:
    html = report().html()
    (text,) = re.findall(r'<script type="application/json">(.*?)</script>', html, re.DOTALL)
    above, below = json.loads(text)["panels"]
    assert (above["curves"][0]["label"], below["curves"][0]["label"]) == tuple(NAMES)
    assert len(above["curves"][0]["x"]) == T.size
    assert above["x"][1] < 50 < T[-1] - 1, "the part that is drawn is seen at first"
    assert below["curves"][0]["y"][0] is None
    assert (below["rules"], below["bands"]) == ([3.0], [[0.0, 2.0]])
    assert above["group"] == below["group"]
    assert html.count("<script") == 2
    assert html.count("<svg") == 2


def test_a_panel_keeps_its_own_legend_beside_that_of_the_figure() -> None:
    figure = Figure()
    upper, lower = figure.subplots(2)
    upper.plot([0, 1], [0, 1], label="measured")
    lower.plot([0, 1], [1, 0], label="0.3 deg RMS")
    lower.legend()
    assert [name for name, _ in zoomed(figure)["legend"]] == ["measured", "0.3 deg RMS"]
    figure.legend(*upper.get_legend_handles_labels())
    data = zoomed(figure)
    assert [name for name, _ in data["legend"]] == ["measured"]
    assert [[name for name, _ in panel["legend"]] for panel in data["panels"]] == [[], ["0.3 deg RMS"]]


def test_a_page_without_one_has_no_script() -> None:
    assert "<script" not in Report("page", (Plot(long_figure()),)).html()
    assert "<script" not in report().fragment()


def test_places_are_those_of_the_drawing() -> None:
    figure = long_figure()
    figure_svg(figure)
    for panel, axes in zip(zoomed(figure)["panels"], figure.axes, strict=True):
        left, top, width, height = panel["box"]
        box = axes.get_position()
        assert (left, 1.0 - top - height, width, height) == pytest.approx(
            (box.x0, box.y0, box.width, box.height), abs=2e-4
        )
