"""Figures of the gallery's pages, each with the units of its axes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt


def figures(block: Any, block_vars: Mapping[str, Any], gallery_conf: Mapping[str, Any]) -> str:
    """The figures of a cell as Sphinx-Gallery's own scraper saves them; arguments and result are its.

    Raises:
        ValueError: if an axis with numbers says no unit in square brackets; the site is not built then.
    """
    from sphinx_gallery.scrapers import matplotlib_scraper

    for number in plt.get_fignums():
        figure = plt.figure(number)
        figure.canvas.draw()
        if missing := axes_without_unit(figure):
            raise ValueError(f"{block_vars['src_file']}: got axes without a unit [...]: {', '.join(missing)}")
    return str(matplotlib_scraper(block, block_vars, gallery_conf))


def axes_without_unit(figure: Any) -> list[str]:
    """Title and letter of each axis that shows numbers without a unit in square brackets."""
    missing = []
    for axes in figure.axes:
        for which in "xy":
            shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
            label = "".join(getattr(each, f"get_{which}label")() for each in shared)
            ticks = "".join(tick.get_text() for tick in getattr(axes, f"get_{which}ticklabels")())
            if not re.search(r"\[.+\]", label) and re.search(r"\d", ticks) and not re.search("[a-z]", ticks):
                missing.append(f"{axes.get_title(loc='left')}: {which}")
    return missing
