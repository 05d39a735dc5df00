"""Markdown of generated pages."""

from __future__ import annotations

from collections.abc import Sequence


def cell(text: object) -> str:
    """Text of a table's cell: on one line, its bars escaped."""
    return " ".join(str(text).split()).replace("|", "\\|")


def table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(cell, line)) + " |" for line in lines)


def sentence(text: str) -> str:
    """The text with a capital and a full stop, as a table's cell has it."""
    first = text[:1].upper() if text[:2].islower() else text[:1]
    return (first + text[1:]).rstrip(".") + "." if text else ""


def anchor(name: str) -> str:
    """A line that gives the next heading a name to link to."""
    return f"({name})="
