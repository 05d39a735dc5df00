"""Every page of the gallery is text and figures, shows one often enough, and claims something.

`make docs` runs the pages: a claim that does not hold, or an axis without a unit, stops it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from .site_pages import extension

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "examples" / "gallery").glob("plot_*.py"))
LONGEST = 60  # lines of code without a figure between
TEXT_CELL = re.compile(r"^# %%\n(?:#.*\n)*", re.MULTILINE)
CLAIMS = re.compile(r"^# sphinx_gallery_start_ignore\n(.*?)^# sphinx_gallery_end_ignore\n", re.MULTILINE | re.DOTALL)


def cells(page: Path) -> Iterator[str]:
    """The code of a page between its cells of text, as a reader sees it."""
    text = CLAIMS.sub("", page.read_text(encoding="utf-8"))
    node = ast.parse(text).body[0]
    yield from TEXT_CELL.split("".join(text.splitlines(keepends=True)[node.end_lineno or 0 :]))


def longest_stretch(page: Path) -> int:
    """Greatest number of lines of code, blank ones left out, from one cell with a figure to the end of the next."""
    lengths = [0]
    for cell in cells(page):
        lengths[-1] += sum(bool(line.strip()) for line in cell.splitlines())
        if "plt.subplots(" in cell:
            lengths.append(0)
    return max(lengths)


def test_there_are_pages() -> None:
    assert len(PAGES) >= 10


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_text_figures_and_claims(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    title, rule, blank = (ast.get_docstring(ast.parse(text)) or "").splitlines()[:3]
    assert (len(rule), set(rule), blank) == (len(title), {"="}, "")
    assert longest_stretch(page) <= LONGEST
    # Without it a reader at a terminal sees no figure, and the page prints the last value of the cell.
    assert all(cell.rstrip().endswith("plt.show()") for cell in cells(page) if "plt.subplots(" in cell)
    (claims,) = CLAIMS.findall(text)
    nodes = ast.parse(claims).body
    assert nodes
    assert all(isinstance(node, ast.Assert) and not isinstance(node.test, ast.Constant) for node in nodes)


def test_an_axis_without_a_unit_is_found() -> None:
    without = import_module(f"{extension().__name__}.gallery").axes_without_unit
    figure, (named, bare) = plt.subplots(1, 2)
    for axes in (named, bare):
        axes.plot([0, 1], [0, 1])
    named.set(xlabel="time [s]", ylabel="angle [deg]")
    bare.set(xlabel="time", ylabel="angle [deg]")
    figure.canvas.draw()
    assert without(figure) == [": x"]
    plt.close(figure)
