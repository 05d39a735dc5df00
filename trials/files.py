"""Atomic writing of files, a check for write permission, and the folder for figure files (`--figures DIR`)."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from .errors import ConfigError

_NAME = 40  # characters of a file's name that its temporary file shows


def write_atomically(path: Path | str, content: bytes | str) -> Path:
    """Write `content` to `path` through a temporary file in the same folder, so that no partial file remains.

    Raises:
        OSError: if the folder cannot be made or written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    data = content.encode("utf-8") if isinstance(content, str) else content
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name[:_NAME]}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return target


def require_writable(path: Path | str) -> None:
    """Refuse a path at which no file or folder can be made or replaced, before any computation.

    Raises:
        ConfigError: if a part of the path is a file or cannot be entered, the name is too long, or the parent folder or
            the existing file is write-protected.
    """
    target = Path(path)
    try:
        mode = _mode(target)
        place = target if mode is not None and stat.S_ISDIR(mode) else target.absolute().parent
        while _mode(place) is None:
            place = place.parent
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{target}: cannot be written ({reason}), expected a path that can be made") from None
    if not place.is_dir():
        raise ConfigError(f"{target}: cannot be written ({place} is not a folder), expected a path that can be made")
    try:
        with tempfile.TemporaryFile(dir=place):  # reported permissions are unreliable: only a trial decides
            pass
    except OSError as error:
        reason = f"{error.strerror} in {place}"
        raise ConfigError(f"{target}: cannot be written ({reason}), expected a writable folder") from None


def _mode(path: Path) -> int | None:
    try:
        return os.lstat(path).st_mode
    except FileNotFoundError:
        return None


_WANTED: ContextVar[Path | None] = ContextVar("figures", default=None)


@contextmanager
def figures_to(folder: Path | str | None) -> Iterator[None]:
    """Context in which every report also writes its figures into a folder; None writes none."""
    token = _WANTED.set(None if folder is None else Path(folder))
    try:
        yield
    finally:
        _WANTED.reset(token)


def figures_folder() -> Path | None:
    """Folder of the active `figures_to`; None if there is none."""
    return _WANTED.get()
