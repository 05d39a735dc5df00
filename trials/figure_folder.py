"""Where the figures of reports go as files: `--figures DIR`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_WANTED: ContextVar[Path | None] = ContextVar("figures", default=None)


@contextmanager
def figures_to(folder: Path | str | None) -> Iterator[None]:
    """Within the block every report that is saved also writes its figures into a folder; None writes none."""
    token = _WANTED.set(None if folder is None else Path(folder))
    try:
        yield
    finally:
        _WANTED.reset(token)


def figures_folder() -> Path | None:
    """The folder that `figures_to` asks for."""
    return _WANTED.get()
