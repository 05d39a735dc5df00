"""The table of the front pages, from `docs/results/front.yaml`; run as a program, it writes that of README.md."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

DOCS = Path(__file__).resolve().parents[1]
README = DOCS.parent / "README.md"
BEGINNING, END = "<!-- table of docs/results/front.yaml -->\n", "<!-- end of the table -->\n"
COLUMNS = ("task", "measured", "hystmpc", "beside it", "data")
NUMBER = re.compile(r"(?<![\w.])\d*\.?\d+(?![\w.]*\d)")


def settings() -> dict[str, Any]:
    """The file."""
    found: dict[str, Any] = yaml.safe_load((DOCS / "results" / "front.yaml").read_text(encoding="utf-8"))
    return found


def text(place: str = "") -> str:
    """The table in Markdown.

    Args:
        place: from the page that holds it to `docs/`.
    """
    lines = [COLUMNS, ("---",) * len(COLUMNS)]
    for row in settings()["rows"]:
        page: str = row["page"]
        task = f"[{row['task']}]({place}{page})" if ".md" in page else row["task"]
        lines.append((task, row["measured"], row["ours"], row["beside"], row["data"]))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def numbers(words: str) -> list[str]:
    """Numbers of a text, as they are written."""
    return NUMBER.findall(words)


def with_table(page: str) -> str:
    """README with the table in its place."""
    before, _, rest = page.partition(BEGINNING)
    return before + BEGINNING + "\n" + text("docs/") + "\n\n" + END + rest.partition(END)[2]


if __name__ == "__main__":
    README.write_text(with_table(README.read_text(encoding="utf-8")), encoding="utf-8")
