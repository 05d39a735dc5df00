"""Short texts: a result in one line (`repr`), with arrays shown by their shape, and a duration in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

LONGEST = 200
"""Greatest length of the line [characters]."""

_LONGEST_TEXT = 40  # characters of a text inside it
_MOST_NUMBERS = 3  # greatest length of a sequence that is written in full


def in_brief(kind: object, text: str) -> str:
    """Text `Kind(text)` on one line, cut to at most `LONGEST` characters."""
    name, line = type(kind).__name__, " ".join(text.split())
    room = LONGEST - len(name) - 2
    return f"{name}({line})" if len(line) <= room else f"{name}({line[: room - 3]}...)"


def brief(self: Any) -> str:
    """Short `__repr__` of a dataclass of results: arrays by their shape, sequences by their length."""
    parts = (f"{f.name}={_shortened(getattr(self, f.name))}" for f in fields(self) if f.repr)
    return in_brief(self, ", ".join(parts))


def about(seconds: float) -> str:
    """A duration in words, no finer than an estimate is worth: 4 s, 25 s, 2.5 min."""
    if seconds < 9.5:
        return f"{max(1, round(seconds))} s"
    if seconds < 87.5:
        return f"{5 * round(seconds / 5)} s"
    return f"{round(2 * seconds / 60) / 2:g} min"


def _shortened(value: Any) -> str:
    if isinstance(value, Enum):
        return str(value.value)
    if value is None or isinstance(value, bool | int):
        return str(value)
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str | Path):
        text = value.name if isinstance(value, Path) else " ".join(value.split())
        return text if len(text) <= _LONGEST_TEXT else f"{text[: _LONGEST_TEXT - 3]}..."
    if hasattr(value, "shape"):
        return str(tuple(value.shape))
    if isinstance(value, Mapping):
        return f"{len(value)} entries"
    if isinstance(value, Sequence):
        plain = len(value) <= _MOST_NUMBERS and not any(is_dataclass(item) for item in value)
        return f"({', '.join(map(_shortened, value))})" if plain else f"{len(value)} of {type(value[0]).__name__}"
    return type(value).__name__
