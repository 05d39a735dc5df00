"""A file that grows by whole commits: what a kill or a full disk leaves is readable up to the last one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import final


@final
class GrowingFile:
    """Bytes are collected in memory and appended to the file by `commit`.

    After a commit the operating system holds the data: it survives the death of the process (kill -9), though not a
    power cut until the system writes it out or `close` does.

    Args:
        path: a new file.

    Raises:
        OSError: if the file exists or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("xb", buffering=0)
        self._pending = bytearray()
        self._committed = 0

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Collect bytes."""
        self._pending += data
        return len(data)

    def tell(self) -> int:
        """Length of the file once everything is committed."""
        return self._committed + len(self._pending)

    def flush(self) -> None:
        """Nothing: only `commit` writes, so that a writer of some format cannot leave half a record on the disk."""

    def commit(self) -> None:
        """Append what was collected.

        Raises:
            OSError: if the disk is full or fails; the file then ends with the commit before.
        """
        rest = memoryview(bytes(self._pending))
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError:
            os.ftruncate(self._file.fileno(), self._committed)
            self._file.seek(self._committed)
            raise
        self._committed += len(self._pending)
        self._pending.clear()

    def close(self) -> None:
        """Let the disk have everything that was committed; what was not is lost.

        Raises:
            OSError: if the disk fails.
        """
        try:
            os.fsync(self._file.fileno())
        finally:
            self._file.close()
