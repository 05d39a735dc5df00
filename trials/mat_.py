"""Variables of MATLAB files, version 4 to 7.3; the unpacked size is limited before any data are unpacked."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import ArrayLog
from .errors import LogError, require
from .formats import MOST_BYTES, read_bytes, reading

_HDF5 = b"\x89HDF\r\n\x1a\n"
_DEEPEST = 8  # structs within structs; deeper is no log
_MOST_OBJECTS = 20_000  # of an HDF5 file, counted once for every link
_FILTERS = {1, 2, 3, 4, 5, 6, 32000}  # of the library itself; any other would be code loaded from this machine
_MOST_SOFT_LINKS = 16  # greatest number of chained soft links
_LONGEST_TEXT = 10_000  # letters of a text that are read; a text is no signal


def open_mat(path: Path | str) -> ArrayLog:
    """Read the variables of a MATLAB file, version 4 to 7.3.

    Tables, timetables and other objects, which only MATLAB can read, are left out; a request for one gives advice.

    Raises:
        LogError: if the file is missing, cut off or no MATLAB file, its links form a loop, or `h5py` (version 7.3) is
            not installed.
    """
    head = read_bytes(path, 520)
    is_hdf5 = _HDF5 in (head[:8], head[512:520])
    if is_hdf5:
        require("h5py", "logs", f"{path}: reading MATLAB 7.3 files")
    with reading(path, "MATLAB file"):
        variables, unread = _read_hdf5(str(path)) if is_hdf5 else _read_scipy(str(path))
    if not variables and not unread:
        raise LogError(f"{path}: holds no variable")
    return ArrayLog(str(path), variables, unread=unread)


def _object(kind: str, name: str) -> str:
    short = name if name.isidentifier() and len(name) <= 40 else "T"
    remedy = {
        "table": f"writetable({short}, 'log.csv')",
        "timetable": f"writetimetable({short}, 'log.csv')",
        "datetime": f"t = seconds({short} - {short}(1))",
        "duration": f"t = seconds({short})",
        "timeseries": f"t = {short}.Time; y = {short}.Data; save('log.mat', 't', 'y')",
    }.get(kind, "plain vectors or a struct of vectors")
    return f"a MATLAB {kind[:40]}, which only MATLAB can read; save it there with {remedy}"


def _read_scipy(path: str) -> tuple[dict[str, Any], dict[str, str]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

    data = read_bytes(path)
    _require_bounded(path, data)
    contents = loadmat(BytesIO(data), struct_as_record=True, squeeze_me=False, chars_as_strings=True)
    variables, unread = {}, {}
    for name, value in contents.items():
        if isinstance(value, MatlabOpaque | MatlabObject | MatlabFunction):
            title, kind = _opaque(value, name)
            unread[title] = _object(kind, title)
        elif not name.startswith("__"):
            variables[name] = _plain(value)
    return variables, unread


def _opaque(value: Any, name: str) -> tuple[str, str]:
    """Name and class of a MATLAB object; for a table they are part of its content."""
    if value.dtype.names and {"s0", "s2"} <= set(value.dtype.names) and value.size:
        title, kind = (value.reshape(-1)[0][part] for part in ("s0", "s2"))
        return _text(title) or name, _text(kind) or "object"
    return name, str(getattr(value, "classname", "object"))


def _text(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)


def _plain(value: Any, depth: int = 0) -> Any:
    """Convert structs to mappings, struct arrays and cells to lists, and unwrap MATLAB's 1x1 arrays."""
    if not isinstance(value, np.ndarray) or depth > _DEEPEST:
        return value
    if value.dtype.names and value.dtype.kind == "V":
        records = [
            {name: _plain(record[name], depth + 1) for name in value.dtype.names} for record in value.reshape(-1)
        ]
        return records[0] if len(records) == 1 else records
    if value.dtype.kind == "O":
        cells = [_plain(cell, depth + 1) for cell in value.reshape(-1)]
        return cells[0] if len(cells) == 1 else cells
    return value


def _read_hdf5(path: str) -> tuple[dict[str, Any], dict[str, str]]:
    import h5py

    variables, unread = {}, {}
    with h5py.File(path, "r") as file:
        tree = _Hdf5Tree(path, file)
        for name in map(str, file):
            if name.startswith("#"):
                continue
            item = tree.item(file, name)
            if "MATLAB_object_decode" in item.attrs:
                unread[name] = _object(_text(item.attrs.get("MATLAB_class", b"object")), name)
            else:
                variables[name] = tree.read(item)
    return variables, unread


class _Hdf5Tree:
    """Bounded reader of the objects of an HDF5 file, which opens nothing outside the file; links may form loops."""

    def __init__(self, path: str, file: Any) -> None:
        self._path, self._file = path, file
        self._around = [_place(file["/"])]  # the groups and cells that are being read, from the outside in
        self._left = _MOST_OBJECTS
        self._bytes = MOST_BYTES

    def item(self, group: Any, name: str, left: int = _MOST_SOFT_LINKS) -> Any:
        """Return the object behind a link within the file; h5py alone would follow links into other files."""
        from h5py import h5l  # pyright: ignore[reportAttributeAccessIssue]  # compiled, without a stub

        links, key = group.id.links, name.encode("utf-8", "surrogateescape")
        kind = links.get_info(key).type
        if kind == h5l.TYPE_HARD:
            return group[name]
        if kind != h5l.TYPE_SOFT:
            raise LogError(f"{self._path}: {name!r} is a link out of the file, expected all data inside")
        if not left:
            raise LogError(f"{self._path}: {name!r}: too many links that lead to one another")
        target = links.get_val(key).decode("utf-8", "surrogateescape")
        place = self._file["/"] if target.startswith("/") else group
        for part in target.split("/"):
            place = self.item(place, part, left - 1) if part not in ("", ".") else place
        return place

    def read(self, item: Any) -> Any:
        """Read groups as mappings, and matrices transposed, as MATLAB shows them."""
        import h5py

        self._left -= 1
        if self._left < 0:
            raise self._too_many()
        if not isinstance(item, h5py.Group):
            self._require_inside(item)
            if h5py.check_ref_dtype(item.dtype) is None:
                return _matrix(item)
        place = _place(item)
        if place in self._around:
            raise LogError(f"{self._path}: {item.name!r} is linked to from within itself, expected no loop")
        if len(self._around) > _DEEPEST + 1:
            return None
        self._around.append(place)
        try:
            if isinstance(item, h5py.Group):
                return {name: self.read(self.item(item, name)) for name in map(str, item)}
            if (item.size or 0) > self._left:
                raise self._too_many()
            references = np.asarray(item[()]).reshape(-1)  # a cell, or one field of a struct array
            cells = [self.read(self._file[reference]) for reference in references if reference]
            return cells[0] if len(cells) == 1 else cells
        finally:
            self._around.pop()

    def _too_many(self) -> LogError:
        return LogError(f"{self._path}: more than {_MOST_OBJECTS} objects, each link counted, expected a log")

    def _require_inside(self, item: Any) -> None:
        """Refuse data in other files, data that need other code, or data that exceed the memory."""
        made = item.id.get_create_plist()
        if item.external or item.is_virtual:
            raise LogError(f"{self._path}: the data of {item.name!r} lie in another file, expected all data inside")
        if others := {made.get_filter(k)[0] for k in range(made.get_nfilters())} - _FILTERS:
            raise LogError(f"{self._path}: {item.name!r} is packed by filter {min(others)}, expected none or gzip")
        size, chunk = item.dtype.itemsize, math.prod(item.chunks or ())
        self._bytes -= size * (item.size or 0)
        if min(self._bytes, MOST_BYTES - size * chunk) < 0:
            raise LogError(f"{self._path}: unpacks to more than {MOST_BYTES} bytes at {item.name!r}, expected a log")


def _place(item: Any) -> tuple[int, int]:
    """File and address of an object, independent of the link that leads to it."""
    from h5py import h5o  # pyright: ignore[reportAttributeAccessIssue]  # compiled, without a stub

    about = h5o.get_info(item.id)
    return about.fileno, about.addr


def _matrix(item: Any) -> Any:
    if "MATLAB_empty" in item.attrs:
        return np.empty(0)
    if item.attrs.get("MATLAB_class") == b"char":  # stored as the numbers of its letters
        return "".join(map(chr, np.asarray(item[()]).reshape(-1)[:_LONGEST_TEXT].tolist()))
    return np.asarray(item[()]).T


_DEEPEST_CELL = 32  # matrices within cells and structs
_HEADER, _TAG = 128, 8
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15
_HOLDING = (1, 2, 3)  # cell, struct, object
_LEAST = 8  # bytes that any element of these takes


def _require_bounded(path: str, data: bytes) -> None:
    """Refuse a MATLAB file that would unpack to more than the memory limit or claims more cells than bytes."""
    ends = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if ends is None or not any(data[:4]):
        return
    _MatElements(path, ends, MOST_BYTES).walk(memoryview(data)[_HEADER:])


@dataclass
class _MatElements:
    """Bounded walk over the elements of a MATLAB file."""

    path: str
    ends: str
    left: int

    def walk(self, data: memoryview, depth: int = 0) -> None:
        """Check the elements of a file, or of a matrix."""
        if depth > _DEEPEST_CELL:
            raise LogError(
                f"{self.path}: more than {_DEEPEST_CELL} cells or structs within one another, expected a log"
            )
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
            unpacked = unpacking.decompress(content, self.left + 1)
        except zlib.error:
            return memoryview(b"")  # reported by the reader
        self.left -= len(unpacked)
        if self.left < 0:
            raise LogError(f"{self.path}: unpacks to more than {MOST_BYTES} bytes, expected a log")
        return memoryview(unpacked)

    def _require_room(self, content: memoryview) -> None:
        """Refuse a matrix of cells or structs larger than the file allows, since all are allocated before reading."""
        (_, flags), (kind, sizes), *_ = [*self._elements(content[:4096]), (0, content[:0]), (0, content[:0])]
        if len(flags) < 4 or kind != _INT32:
            return
        holds = struct.unpack_from(f"{self.ends}I", flags)[0] & 0xFF
        dims = struct.unpack(f"{self.ends}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])
        if holds in _HOLDING and math.prod(dims) * _LEAST > len(content):
            raise LogError(f"{self.path}: {math.prod(dims)} cells in {len(content)} bytes, expected a log")
