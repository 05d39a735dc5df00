"""Pages that run: their Python blocks, one after another, with what they print and draw put into the page."""

from __future__ import annotations

import contextlib
import io
import re
import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from hystmpc.trials.report import style

_BLOCK = re.compile(
    r"(?P<before>^:::\{dropdown\}[^\n]*\n)?(?P<block>^```python\n(?P<code>.*?)^```\n)(?P<after>:::\n)?",
    re.MULTILINE | re.DOTALL,
)


def executed(text: str, page: Path) -> str:
    """The page with outputs and figures behind its blocks; of a folded block its figures stand before it.

    Args:
        text: of the page, in Markdown.
        page: its file without ending; figures go to the folder `drawn` beside it.

    Raises:
        Exception: whatever a block raises; the site is not built then.
    """
    names: dict[str, Any] = {"__name__": "page"}
    drawn: list[Path] = []

    def run(block: re.Match[str]) -> str:
        printed = io.StringIO()
        where = f"{page.name}.md, line {text.count(chr(10), 0, block.start('code')) + 1}"
        with contextlib.redirect_stdout(printed), style():
            exec(compile(block["code"], where, "exec", dont_inherit=True), names)
            figures = _saved(page, drawn)
        output = f"```text\n{printed.getvalue().rstrip()}\n```\n" if printed.getvalue().strip() else ""
        return f"{figures}\n{block[0]}" if block["before"] else f"{block['block']}\n{output}\n{figures}"

    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        return _BLOCK.sub(run, text)


def _saved(page: Path, drawn: list[Path]) -> str:
    """Write the open figures and close them; the Markdown that shows them."""
    folder = page.parent / "drawn"
    shown = []
    for number in plt.get_fignums():
        figure = plt.figure(number)
        figure.set_layout_engine("constrained")
        drawn.append(folder / f"{page.name}_{len(drawn) + 1}.svg")
        folder.mkdir(exist_ok=True)
        figure.savefig(drawn[-1], metadata={"Date": None})
        shown.append(f"![{_described(figure)}](drawn/{drawn[-1].name})\n")
        plt.close(figure)
    return "\n".join(shown)


def _described(figure: Any) -> str:
    """What a figure shows, for those who do not see it: the titles and axes of its parts."""
    parts = [f"{axes.get_title()} ({axes.get_ylabel()} over {axes.get_xlabel()})" for axes in figure.axes]
    return re.sub(r"[\[\]]", "", "; ".join(parts))
