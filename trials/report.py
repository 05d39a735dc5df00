"""Reports: one self-contained HTML page that opens offline."""

from __future__ import annotations

import base64
import io
import json
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import numpy as np
from markupsafe import Markup, escape
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, LogFormatter, LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from .figure_data import write_figures, zoomed
from .files import write_atomically


@cache
def _style() -> mpl.RcParams:
    """Style of the figures, from a file that scripts use by `plt.style.use("hystmpc.trials.report")`."""
    with as_file(files("hystmpc.trials").joinpath("report.mplstyle")) as path:
        return mpl.rc_params_from_file(path, use_default_template=False)


PALETTE: tuple[str, ...] = tuple(_style()["axes.prop_cycle"].by_key()["color"])
MEASURED, MODEL, COMMAND, *_accents, REFERENCE = PALETTE
ACCENTS = tuple(_accents)
_STROKES = (6, 1.5), (1.5, 1), (6, 1.5, 1.5, 1.5), (3, 1), (6, 1.5, 1.5, 1.5, 1.5, 1.5)
DASHES: tuple[Any, ...] = ("-", *((0, strokes) for strokes in _STROKES))
"""Line styles that distinguish overlapping lines without colour."""


class StyledFigure(Figure):
    """Figure that a notebook shows without pyplot."""

    def _repr_html_(self) -> str:
        return _bitmap(self)


@contextmanager
def new_figure(width: float = 7.0, height: float = 3.2) -> Iterator[StyledFigure]:
    """Context with a new figure of a size [inch] in the style of the project, without pyplot and without a display."""
    with style():
        yield StyledFigure(figsize=(width, height))


@contextmanager
def style() -> Iterator[None]:
    """Context with the style of the project, for saving a figure made by `new_figure`."""
    with mpl.rc_context(_style()):
        yield


_TICKS = 3  # with a number, on every axis
_ID = re.compile(r'(\bid="|url\(#|href="#)')
_CODE = re.compile("`([^`]+)`")
_NAMESPACE = re.compile(r'\s+xmlns(?::\w+)?="[^"]*"')  # an SVG inside HTML needs none


@dataclass(frozen=True)
class Heading:
    """Heading of level 2 or 3, listed in the table of contents."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str


@dataclass(frozen=True)
class Points:
    """List of short sentences."""

    texts: tuple[str, ...]


@dataclass(frozen=True)
class KeyValues:
    """Short two-column table of names and values."""

    rows: Mapping[str, object]


@dataclass(frozen=True)
class Table:
    """Table with a header row; numbers are right-aligned, and the cells `marked` by (row, column) are bold."""

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    marked: Collection[tuple[int, int]] = ()


@dataclass(frozen=True)
class Plot:
    """A matplotlib figure and its caption.

    Attributes:
        zoom: whether the reader can zoom into its curves; in print and without scripts the drawing is shown.
    """

    figure: Figure
    caption: str = ""
    zoom: bool = False


@dataclass(frozen=True)
class Folded:
    """Section that opens by a click on its heading; in print it appears as on the screen."""

    heading: str
    pieces: tuple[Piece, ...]


Piece = Heading | Paragraph | Points | KeyValues | Table | Plot | Folded


@dataclass(frozen=True)
class Report:
    """Page made of headings, texts, tables, figures and folded sections."""

    title: str
    pieces: tuple[Piece, ...]
    subtitle: str = ""

    def html(self) -> str:
        """Self-contained HTML page with embedded styles and figures; equal pieces give equal text."""
        folded = any(isinstance(piece, Folded) for piece in self.pieces)
        headings = [(k, piece) for k, piece in enumerate(self.pieces, start=1) if isinstance(piece, Heading)]
        script = Markup(_resource("zoom.js")) if any(plot.zoom for _, plot in _plots(self.pieces)) else ""
        looks = {"css": Markup(_resource("report.css")), "script": script}
        parts = {"title": self.title, "subtitle": self.subtitle, "contents": [] if folded else headings}
        return _template().render(**parts, **looks, pieces=self.pieces, draw=_drawn, numbered=True)

    def fragment(self) -> str:
        """HTML of title and pieces for a notebook cell; figures are bitmaps, so that cells share no ids."""
        title = f"{self.title}: {self.subtitle}" if self.subtitle else self.title
        return _template().render(title=title, pieces=self.pieces, draw=_bitmap_of, numbered=False, css="", script="")

    def save(self, path: Path | str) -> Path:
        """Write the page completely or not at all, and its figures into the folder of `figures_to`, if any."""
        written = write_atomically(path, self.html())
        for _, plot in _plots(self.pieces):
            three_ticks(plot.figure)
        with style():
            write_figures((heading, plot.caption, plot.figure) for heading, plot in _plots(self.pieces))
        return written


def _plots(pieces: Sequence[Piece], heading: str = "figure") -> Iterator[tuple[str, Plot]]:
    for piece in pieces:
        if isinstance(piece, Heading):
            heading = piece.text
        elif isinstance(piece, Folded):
            yield from _plots(piece.pieces, piece.heading)
        elif isinstance(piece, Plot):
            yield heading, piece


def figure_svg(figure: Figure, prefix: str = "") -> str:
    """Figure as an `<svg>` element; the prefix of its ids keeps the figures of one page apart."""
    _print_as_it_is(figure)
    three_ticks(figure)
    svg = _printed(figure)
    svg = _NAMESPACE.sub("", svg[svg.index("<svg") :]).replace("xlink:href=", "href=")
    return _ID.sub(lambda match: match.group(1) + prefix, svg).strip()


def _printed(figure: Figure) -> str:
    """SVG file of a figure; `savefig` writes the same, and draws all of it once more for its layout alone."""
    out, canvas, dpi = io.StringIO(), figure.canvas, figure.dpi
    try:
        with style():
            figure.dpi = mpl.rcParams["savefig.dpi"]  # of bitmaps within
            printer: Any = FigureCanvasSVG(figure)  # matplotlib leaves its writers untyped
            printer.print_svg(out, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    finally:
        figure.dpi = dpi
        figure.set_canvas(canvas)
    return out.getvalue()


def three_ticks(figure: Figure) -> None:
    """Set at least three tick labels on every axis, so that its scale can be read."""
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            locator, (low, high) = axis.get_major_locator(), sorted(axis.get_view_interval())
            if isinstance(locator, MaxNLocator):
                locator.set_params(min_n_ticks=_TICKS)
            elif isinstance(locator, LogLocator) and 0 < low < high:
                seen = np.asarray(locator.tick_values(low, high), dtype=np.float64)
                if np.count_nonzero((seen >= low) & (seen <= high)) < _TICKS:
                    _more_on_logarithmic(axis, low, high)


def _more_on_logarithmic(axis: Axis, low: float, high: float) -> None:
    """Label whole decades if there are three, otherwise 1, 2 and 5, or even steps within a decade."""
    decades = np.arange(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
    if decades.size >= _TICKS:
        axis.set_major_locator(FixedLocator((10.0 ** decades[:: (decades.size - 1) // 2]).tolist()))
        return
    few = math.log10(high / low) < 1.0
    even = MaxNLocator(4, steps=[1, 2, 5, 10], min_n_ticks=_TICKS)
    axis.set_major_locator(even if few else LogLocator(subs=(1.0, 2.0, 5.0), numticks=20))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _print_as_it_is(figure: Figure) -> None:
    """Turn off mathematics outside logarithmic tick labels, since two `$` in an external name would fail."""
    axes = [axis for each in figure.axes for axis in (each.xaxis, each.yaxis)]
    powers = [axis for axis in axes if isinstance(axis.get_major_formatter(), LogFormatter)]
    mathematical = {
        id(label) for axis in powers for which in ("major", "minor") for label in axis.get_ticklabels(which=which)
    }
    for text in figure.findobj(Text):
        if isinstance(text, Text) and id(text) not in mathematical:
            text.set_parse_math(False)


def _bitmap(figure: Figure) -> str:
    three_ticks(figure)
    out = io.BytesIO()
    with style():
        figure.savefig(out, format="png", dpi=110)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(out.getvalue()).decode()}">'


def _bitmap_of(piece: Plot, prefix: str) -> tuple[Markup, Markup]:
    del prefix
    return Markup(_bitmap(piece.figure)), Markup("")


def _drawn(piece: Plot, prefix: str) -> tuple[Markup, Markup]:
    """Drawing of a figure, and the data by which a reader zooms into it."""
    svg = Markup(figure_svg(piece.figure, prefix))
    data = json.dumps(zoomed(piece.figure), separators=(",", ":"), allow_nan=False) if piece.zoom else ""
    return svg, Markup(data.replace("<", "\\u003c"))  # in a script element, where `<` would end it


def _is_figure(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _cell(value: object) -> str:
    """Text of a value; floats are shown to four digits."""
    return (f"{value:.4g}" if math.isfinite(value) else "-") if isinstance(value, float) else str(value)


def _resource(name: str) -> str:
    return files("hystmpc.trials").joinpath(name).read_text(encoding="utf-8")


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["prose"] = lambda text: Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))
    environment.filters["cell"], environment.tests["figure"] = _cell, _is_figure
    return environment.from_string(_resource("report.html.j2"))
