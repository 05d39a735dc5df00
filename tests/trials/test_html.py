"""Reports: one page that needs nothing from outside, escapes what it is given and never mixes up its figures."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from hystmpc.trials.report import (
    PALETTE,
    Folded,
    Heading,
    KeyValues,
    Paragraph,
    Plot,
    Points,
    Report,
    Table,
    figure_svg,
    new_figure,
    style,
)

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Tags, attributes and text of a page; checks that every element is closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def values(self, name: str) -> list[str]:
        return [value for key, value in self.attributes if key == name]


def draw(label: str = "angle [deg]") -> Figure:
    with new_figure(4, 3) as figure:
        axes = figure.subplots()
        axes.plot(np.linspace(0, 1, 50), np.linspace(0, 1, 50) ** 2, label="measured", marker="o")
        axes.fill_between([0, 1], [0, 0], [1, 1], hatch="//")
        axes.set_ylabel(label)
        axes.legend()
    return figure


def report() -> Report:
    return Report(
        "Check of <log.csv>",
        (
            Heading("First & foremost"),
            Paragraph("a < b <script>alert(1)</script>"),
            KeyValues({"rate [Hz]": 499.87654, "file": "a&b.csv"}),
            Heading("Over time", 3),
            Plot(draw(), 'Angle, "measured"'),
            Plot(draw()),
            Heading("Numbers"),
            Table(("name", "value"), [("<i>rmse</i>", 1.23456789), ("n", 3), ("good", True)], "Scores"),
        ),
        "second line",
    )


@pytest.fixture(scope="module")
def html() -> str:
    return report().html()


def test_the_page_is_well_formed_and_fetches_nothing(html: str) -> None:
    page = Page(html)
    assert page.open == []
    assert html.startswith("<!DOCTYPE html>")
    assert not re.search(r"https?://|@import|//cdn", html)
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    assert all(target.startswith("#") for target in page.values("href") + page.values("src"))
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", html))


def test_ids_are_unique_and_every_reference_has_its_target(html: str) -> None:
    page = Page(html)
    ids = page.values("id")
    assert len(ids) == len(set(ids))
    targets = [target[1:] for target in page.values("href")] + re.findall(r"url\(#([^)]*)\)", html)
    assert len(targets) > 10
    assert set(targets) <= set(ids)


def test_every_piece_is_shown_and_listed(html: str) -> None:
    page = Page(html)
    text = "".join(page.text)
    assert (page.tags.count("svg"), page.tags.count("figure"), page.tags.count("figcaption")) == (2, 2, 1)
    assert page.tags.count("li") == 3
    shown = ("First & foremost", "a < b <script>", "499.9", "a&b.csv", "<i>rmse</i>", "1.235", "True", "second line")
    assert all(part in text for part in shown)


def test_the_same_pieces_give_the_same_page(html: str) -> None:
    assert report().html() == html


def test_an_id_prefix_reaches_every_id() -> None:
    svg = figure_svg(draw(), prefix="loop-")
    assert svg.startswith("<svg")
    assert svg.endswith("</svg>")
    assert all(name.startswith("loop-") for name in Page(svg).values("id"))


def test_a_report_is_saved_whole(tmp_path: Path, html: str) -> None:
    path = report().save(tmp_path / "deep" / "report.html")
    assert path.read_text(encoding="utf-8") == html
    assert [file.name for file in path.parent.iterdir()] == ["report.html"]


def test_the_style_leaves_no_trace() -> None:
    before = dict(mpl.rcParams)
    figure = draw()
    assert dict(mpl.rcParams) == before
    assert figure.axes[0].lines[0].get_color() == PALETTE[0]
    assert not figure.axes[0].spines["top"].get_visible()


def test_a_script_takes_the_style_by_its_name() -> None:
    with style():
        ours = dict(mpl.rcParams)
    with mpl.style.context("hystmpc.trials.report"):
        assert dict(mpl.rcParams) == ours
    assert ours["axes.prop_cycle"].by_key()["color"] == list(PALETTE)


def test_a_figure_shows_itself_in_a_notebook() -> None:
    with new_figure() as figure:
        figure.subplots()
    assert figure._repr_html_().startswith('<img alt="" src="data:image/png;base64,')


@pytest.mark.parametrize("name", ["$x$.csv", "a$b$c$", r"$\frac{$", "$", "$$", r"cost \$5$"])
def test_names_from_outside_are_printed_as_they_are(name: str) -> None:
    """Two dollar signs mean mathematics to the plotting library, which cannot read most names of files as such."""
    with new_figure(4, 3) as figure:
        axes = figure.subplots()
        axes.plot([1, 2], [1, 2], label=name)
        axes.set(title=name, xlabel=name, ylabel=name)
        axes.set_yticks([1, 2], [name, name])
        axes.annotate(name, (1, 1))
        axes.legend(title=name)
        figure.suptitle(name)
    svg = figure_svg(figure)
    assert svg.count(f"<!-- {name} -->") == 9


def test_powers_of_ten_on_a_logarithmic_axis_stay_mathematics() -> None:
    with new_figure(4, 3) as figure:
        axes = figure.subplots()
        axes.plot([0.01, 100], [0.01, 100])
        axes.set(xscale="log", yscale="log", title="$a$b$c")
    svg = figure_svg(figure)
    for axis in (axes.xaxis, axes.yaxis):
        shown = [label for label in axis.get_ticklabels() if label.get_text()]
        assert shown
        assert all(label.get_parse_math() for label in shown)
    assert r"<!-- $\mathdefault{10^{0}}$ -->" in svg


def test_a_folded_section_is_closed_without_a_script_and_mixes_up_no_figure() -> None:
    inside = (Plot(draw()), Plot(draw()), Folded("c < d", (Paragraph("deep"),)))
    page = Page(Report("a", (Heading("top"), Points(("one.", "two < three.")), Folded("b", inside))).html())
    assert page.open == []
    assert page.tags.count("details") == page.tags.count("summary") == 2
    assert "open" not in [name for name, _ in page.attributes]
    assert not {"script", "nav"} & set(page.tags), "the folded headings are the list of contents"
    assert len(page.values("id")) == len(set(page.values("id")))
    assert page.tags.count("li") == 2
    assert {"c < d", "two < three.", "deep"} <= {text.strip() for text in page.text}


def test_what_stands_between_backticks_is_set_as_code_and_nothing_is_shown_as_nan() -> None:
    pieces = (Paragraph("run `fit <auto>` again"), Table(("a", "b"), [(float("nan"), 1.5)]))
    html = Report("page", pieces).html()
    assert "run <code>fit &lt;auto&gt;</code> again" in html
    cells = Page(html).text
    assert "-" in cells
    assert "nan" not in "".join(cells)
