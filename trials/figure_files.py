"""Every figure of a report as files: SVG and PDF for papers, and its data as CSV (`--figures DIR`)."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable

from matplotlib.figure import Figure

from .figure_data import COLUMNS, rows_of
from .figure_folder import figures_folder

_WORDS = 4  # of heading and of caption
_WORD = re.compile(r"[a-z0-9]+")


def write_figures(named: Iterable[tuple[str, str, Figure]]) -> None:
    """Write figures where `figures_to` asks for them: `01-WORDS.svg`, `.pdf` and `.csv` for each, in their order.

    Args:
        named: heading above it, caption, figure.
    """
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
