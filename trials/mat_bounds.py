"""How much a MATLAB file of version 5 unpacks to, found out before anything of it is unpacked into memory."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .errors import LogError
from .formats import MOST_BYTES

_DEEPEST = 32  # matrices within cells and structs
_HEADER, _TAG = 128, 8
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15
_HOLDING = (1, 2, 3)  # cell, struct, object
_LEAST = 8  # bytes that any element of these takes


def require_bounded(path: str) -> None:
    """Refuse a file that would fill the memory, or whose cells say to be more than the file has room for.

    A file of version 4 is not packed: it is as large as it is. What is damaged is left to the reader.

    Raises:
        LogError: if it does.
    """
    data = Path(path).read_bytes()
    ends = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if ends is None or not any(data[:4]):
        return
    _File(path, ends, MOST_BYTES).walk(memoryview(data)[_HEADER:])


@dataclass
class _File:
    """The elements of a file.

    Attributes:
        ends: byte order, as `struct` names it.
        left: bytes that may still be unpacked.
    """

    path: str
    ends: str
    left: int

    def walk(self, data: memoryview, depth: int = 0) -> None:
        """Look at the elements of a file, or of a matrix."""
        if depth > _DEEPEST:
            raise LogError(f"{self.path}: more than {_DEEPEST} cells or structs within one another, expected a log")
        for kind, content in self._elements(data):
            if kind == _COMPRESSED:
                self.walk(self._unpacked(content), depth)
            elif kind == _MATRIX:
                self._require_room(content)
                self.walk(content, depth + 1)

    def _elements(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        at = 0
        while at + _TAG <= len(data):
            kind, size = struct.unpack_from(f"{self.ends}II", data, at)
            if kind >> 16:  # a small one, whose content stands in the tag
                yield kind & 0xFFFF, data[at + 4 : at + 4 + min(kind >> 16, 4)]
                at += _TAG
                continue
            yield kind, data[at + _TAG : at + _TAG + size]
            at += _TAG + (size if kind == _COMPRESSED else -(-size // _TAG) * _TAG)

    def _unpacked(self, content: memoryview) -> memoryview:
        unpacking = zlib.decompressobj()
        try:
            found = unpacking.decompress(content, self.left + 1)
        except zlib.error:
            return memoryview(b"")  # the reader says so
        self.left -= len(found)
        if self.left < 0:
            raise LogError(f"{self.path}: unpacks to more than {MOST_BYTES} bytes, expected a log")
        return memoryview(found)

    def _require_room(self, content: memoryview) -> None:
        """Refuse a matrix of cells or structs that there is no room for: each would be made before any is read."""
        (_, flags), (kind, sizes), *_ = [*self._elements(content[:4096]), (0, content[:0]), (0, content[:0])]
        if len(flags) < 4 or kind != _INT32:
            return
        holds = struct.unpack_from(f"{self.ends}I", flags)[0] & 0xFF
        dims = struct.unpack(f"{self.ends}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])
        if holds in _HOLDING and math.prod(dims) * _LEAST > len(content):
            raise LogError(f"{self.path}: {math.prod(dims)} cells in {len(content)} bytes, expected a log")
