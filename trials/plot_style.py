"""One look for every figure: type sizes, lines, and colours that stay apart for colour-blind readers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.figure import Figure

# Okabe and Ito, "Color Universal Design", 2008.
REFERENCE = "#4d4d4d"
MEASURED = "#0072b2"
COMMAND = "#009e73"
MODEL = "#d55e00"
ACCENTS = ("#cc79a7", "#56b4e9", "#e69f00")
PALETTE = (MEASURED, MODEL, COMMAND, *ACCENTS, REFERENCE)

_INK = "#222222"
_STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "text.color": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "patch.linewidth": 0.6,
    "axes.prop_cycle": cycler(color=PALETTE),
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "savefig.facecolor": "white",
    "savefig.dpi": 200,
    "svg.fonttype": "path",  # a report must look the same where the font is missing
    "svg.hashsalt": "hystmpc",  # the same figure gives the same bytes
}


@contextmanager
def new_figure(width: float = 7.0, height: float = 3.2) -> Iterator[Figure]:
    """A figure in the style of the project, to be drawn on inside the `with` block; it stays valid after it.

    Not made through pyplot: nothing global keeps it alive, and no display is needed.

    Args:
        width, height: size [inch].
    """
    with mpl.rc_context(_STYLE):
        yield Figure(figsize=(width, height))


@contextmanager
def style() -> Iterator[None]:
    """The style alone, for saving a figure that was made by `new_figure`."""
    with mpl.rc_context(_STYLE):
        yield
