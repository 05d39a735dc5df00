"""What the text of an error owes to its reader."""

from __future__ import annotations

from pathlib import Path


def names(text: str, path: Path, more: str = ": ") -> bool:
    """Whether an error begins with its file, of whose path the beginning may be left out (`trials.errors.in_short`)."""
    if text.startswith(f"{path}{more}"):
        return True
    place, _, _ = text.partition(more)
    return place.startswith("...") and str(path).endswith(place[3:]) and path.name in place and more in text
