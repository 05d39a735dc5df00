"""Data of a figure: its curves, bars and images, for interactive figures and for files (SVG, PDF, CSV)."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle, StepPatch
from numpy.typing import NDArray

from .files import figures_folder
from .types import Vec

MOST_POINTS = 3000
"""Greatest number of points of a curve on a page."""

MOST_ZOOMED = 20_000  # points of a curve in a figure that zooms; more make a page heavy

COLUMNS = ("panel", "x axis", "y axis", "kind", "series", "x", "y", "value")
"""Columns of the table of a figure, with a row for each point, bar, step and cell of an image."""

_WHOLE: WeakKeyDictionary[Line2D, tuple[Vec, Vec]] = WeakKeyDictionary()
_MATHS = re.compile(r"\$\\mathdefault\{([^}]*)\}\$")


def draw_long(axes: Axes, x: Vec, y: Vec, **look: Any) -> None:
    """Draw a curve with no more points than a page can show; tables and zooming use all points."""
    draw_part(axes, x, y, slice(None), **look)


def draw_part(axes: Axes, x: Vec, y: Vec, part: NDArray[np.bool_] | slice, **look: Any) -> None:
    """Draw a part of a curve with fewer points; tables and zooming use the whole curve."""
    step = max(1, -(-x[part].size // MOST_POINTS))
    (line,) = axes.plot(x[part][::step], y[part][::step], **look)
    _WHOLE[line] = (x, y)


@dataclass(frozen=True, eq=False)
class Curve:
    """A line of a panel, with all of its points x, y (N,)."""

    series: str
    x: Vec
    y: Vec
    look: dict[str, Any]  # colour, width [pt], dashes [pt], opacity, and whether it goes in steps to each point


def curves_of(axes: Axes) -> Iterator[Curve]:
    """Curves of a panel, without lines across the whole panel."""
    for line in axes.get_lines():
        if line.get_transform() != axes.transData or not line.get_visible():
            continue
        x, y = _WHOLE.get(line) or (line.get_xdata(), line.get_ydata())
        opacity = line.get_alpha()
        look = {
            "colour": to_hex(line.get_color()),
            "width": float(line.get_linewidth()) if str(line.get_linestyle()) != "None" else 0.0,
            "dash": [float(n) for n in line._dash_pattern[1] or ()],  # type: ignore[attr-defined]  # has no getter
            "opacity": 1.0 if opacity is None else float(opacity),
            "steps": line.get_drawstyle() == "steps-pre",
        }
        yield Curve(_label(line), np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64), look)


def rows_of(figure: Figure) -> Iterator[tuple[object, ...]]:
    """Rows of the data table of a figure, in the columns of `COLUMNS`."""
    for number, axes in enumerate(figure.axes, start=1):
        name = _title(axes)
        panel = f"{number}: {name}" if name else str(number)
        place = panel, _plain(axes.get_xlabel()), _plain(axes.get_ylabel())
        for kind, series, points in _marks(axes):
            for point in points:
                yield (*place, kind, series, *point)


def _marks(axes: Axes) -> Iterator[tuple[str, str, Iterator[tuple[object, ...]]]]:
    for curve in curves_of(axes):
        points = ((x, y, "") for x, y in zip(curve.x.tolist(), curve.y.tolist(), strict=True))
        yield "curve" if curve.look["width"] else "point", curve.series, points
    for bars in (each for each in axes.containers if isinstance(each, BarContainer)):
        yield "bar", _label(bars), _bars(axes, bars)
    for steps in (patch for patch in axes.patches if isinstance(patch, StepPatch)):
        values, edges, _ = steps.get_data()
        yield "step from x", _label(steps), ((x, y, "") for x, y in zip(edges, values, strict=False))
    for dots in (each for each in axes.collections if isinstance(each, PathCollection)):
        yield "point", _label(dots), ((float(x), float(y), "") for x, y in np.asarray(dots.get_offsets()))
    for area in (each for each in axes.collections if isinstance(each, PolyCollection)):
        corners = (corner for path in area.get_paths() for corner in np.asarray(path.vertices).tolist())
        yield "outline", _label(area), ((float(x), float(y), "") for x, y in corners)
    for image in axes.images:
        yield "cell", "", _cells(np.asarray(image.get_array()), image.get_extent())


def _bars(axes: Axes, bars: BarContainer) -> Iterator[tuple[object, ...]]:
    flat = bars.orientation == "horizontal"
    axis = axes.yaxis if flat else axes.xaxis
    labels = (_plain(label.get_text()) for label in axis.get_ticklabels())
    names = dict(zip(np.asarray(axis.get_ticklocs()).tolist(), labels, strict=False))
    for bar in bars.patches:
        if flat:
            middle, length = bar.get_y() + bar.get_height() / 2, bar.get_x() + bar.get_width()
            yield length, names.get(round(middle, 9)) or middle, ""
        else:
            middle, length = bar.get_x() + bar.get_width() / 2, bar.get_y() + bar.get_height()
            yield names.get(round(middle, 9)) or middle, length, ""


def _cells(values: NDArray[Any], extent: tuple[float, float, float, float]) -> Iterator[tuple[object, ...]]:
    left, right, bottom, top = extent
    rows, columns = values.shape[:2]
    for i in range(rows):
        for k in range(columns):
            x = left + (k + 0.5) * (right - left) / columns
            yield x, top + (i + 0.5) * (bottom - top) / rows, float(np.mean(values[i, k]))


def _label(artist: Any) -> str:
    label = str(artist.get_label())
    return "" if label.startswith("_") else label


def _title(axes: Axes) -> str:
    return next(filter(None, (_plain(axes.get_title(place)) for place in ("left", "center", "right"))), "")


def _plain(text: str) -> str:
    return " ".join(_MATHS.sub(r"\1", text).split())


def zoomed(figure: Figure) -> dict[str, Any]:
    """Data of an interactive figure: panels, axes and curves with all points.

    The figure must be drawn before, since positions are those of the last drawing. Legends of single panels are
    included even if the figure has one.
    """
    width, height = figure.get_size_inches()
    panels, legend = [], dict[str, dict[str, Any]]()
    for axes in figure.axes:
        box, first = axes.get_position(), axes.get_shared_x_axes().get_siblings(axes)
        across, up = axes.get_yaxis_transform(which="grid"), axes.get_xaxis_transform(which="grid")
        lines = [line for line in axes.get_lines() if line.get_transform() == across]
        shaded = [p for p in axes.patches if isinstance(p, Rectangle) and p.get_height() == 1.0]
        bands = [p for p in shaded if p.get_data_transform() == up]
        curves = [_of_zoom(curve) for curve in curves_of(axes)]
        panel_entries = dict[str, dict[str, Any]]()
        entries = panel_entries if figure.legends and axes.get_legend() is not None else legend
        for curve in curves:
            if curve["label"]:
                entries.setdefault(curve["label"], curve["look"])
        panels.append(
            {
                "box": [round(float(v), 4) for v in (box.x0, 1.0 - box.y1, box.width, box.height)],
                "group": min(figure.axes.index(each) for each in first if each in figure.axes),
                "x": list(map(float, axes.get_xlim())),
                "y": list(map(float, axes.get_ylim())),
                "title": _title(axes),
                "xlabel": _plain(axes.get_xlabel()),
                "ylabel": axes.get_ylabel(),
                "ticks": bool(axes.xaxis.get_tick_params().get("labelbottom", True)),
                "rules": [float(np.asarray(line.get_ydata(), dtype=np.float64)[0]) for line in lines],
                "bands": [(float(p.get_x()), float(p.get_x() + p.get_width())) for p in bands],
                "curves": curves,
                "legend": list(panel_entries.items()),
            }
        )
    return {"size": [float(width), float(height)], "panels": panels, "legend": list(legend.items())}


def _of_zoom(curve: Curve) -> dict[str, Any]:
    """A curve with six digits, more than a screen shows; null for values that are not finite."""
    step = max(1, -(-curve.x.size // MOST_ZOOMED))
    x, y = (
        [float(f"{v:.6g}") if np.isfinite(v) else None for v in values[::step].tolist()]
        for values in (curve.x, curve.y)
    )
    return {"label": curve.series, "look": curve.look, "x": x, "y": y}


_WORDS = 4  # of heading and of caption
_WORD = re.compile(r"[a-z0-9]+")


def write_figures(named: Iterable[tuple[str, str, Figure]]) -> None:
    """Write figures into the folder of `figures_to`, in order: `01-WORDS.svg`, `.pdf` and `.csv` for each."""
    folder = figures_folder()
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    for number, (heading, caption, figure) in enumerate(named, start=1 + len(list(folder.glob("*.svg")))):
        words = [word for text in (heading, caption) for word in _WORD.findall(text.lower())[:_WORDS]]
        path = folder / "-".join((f"{number:02d}", *words))
        figure.savefig(path.with_suffix(".svg"), metadata={"Date": None})
        figure.savefig(path.with_suffix(".pdf"), metadata={"CreationDate": None})
        with path.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows(rows_of(figure))
