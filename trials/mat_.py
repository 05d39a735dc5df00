"""Signals out of MATLAB files: variables, fields of structs, columns of matrices; up to version 7.3."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from .errors import LogError, require
from .layouts import HEADER_TIME, LOG_TIME
from .mat_bounds import MOST_BYTES, require_bounded
from .signals import Series, missing, split_path, walk

_HDF5 = b"\x89HDF\r\n\x1a\n"
_DEEPEST = 8  # structs within structs; deeper is no log
_MOST_OBJECTS = 20_000  # of an HDF5 file, counted once for every link
_FILTERS = {1, 2, 3, 4, 5, 6, 32000}  # of the library itself; any other is code that it would look for on this machine
_MOST_SOFT_LINKS = 16  # that lead to one another
_LONGEST_TEXT = 10_000  # letters of a text that are read; a text is no signal
_MOST_COLUMNS = 64  # of a matrix that are listed as signals


@final
@dataclass(frozen=True, eq=False)
class MatLog:
    """A `Source` over the variables of a MATLAB file.

    Attributes:
        path: the file.
        variables: by name; a struct is a mapping, a struct array a list, numbers are arrays.
        note: empty; a MATLAB file is read whole or refused.
    """

    path: str
    variables: Mapping[str, Any]
    note: str = ""

    def names(self) -> tuple[str, ...]:
        """Vectors, and columns of matrices: `t`, `run.tip`, `data[1]`; columns count from 0."""
        return tuple(_vectors(self.variables, ""))

    def series(self, signals: Sequence[str], time: str) -> list[Series]:
        """The signals asked for; see `Source`.

        Raises:
            LogError: on an unknown signal, one that is no vector, or one of another length than time.
        """
        values = [self._vector(signal) for signal in signals]
        if time in (LOG_TIME, HEADER_TIME):
            return [Series(np.full(y.size, np.nan), y) for y in values]
        t = self._vector(time)
        for signal, y in zip(signals, values, strict=True):
            if y.size != t.size:
                raise LogError(f"{self.path}: {signal!r} has {y.size} samples, expected {t.size} as in {time!r}")
        return [Series(t, y) for y in values]

    def _vector(self, signal: str) -> NDArray[np.float64]:
        *way, last = split_path(signal)
        try:
            found = walk(self.variables, way)
            is_matrix = isinstance(found, np.ndarray) and found.ndim == 2
            value = found[:, last] if is_matrix and isinstance(last, int) else walk(found, [last])
        except (KeyError, IndexError, TypeError):
            raise missing(self.path, signal, self.names()) from None
        array = np.asarray(value)
        if array.dtype.kind not in "fiub" or sum(size > 1 for size in array.shape) > 1:
            shape = "x".join(map(str, array.shape)) or "single"
            raise LogError(
                f"{self.path}: {signal!r} is a {shape} {array.dtype} value, expected a vector of real numbers"
                f"{'; name a column, counted from 0: ' + signal + '[0]' if array.ndim == 2 else ''}"
            )
        return array.astype(np.float64).reshape(-1)


def open_mat(path: Path | str) -> MatLog:
    """Read the variables of a MATLAB file, version 4 to 7.3.

    Tables, timetables and other objects of MATLAB are left out: only MATLAB can read them; save them as structs.

    Raises:
        LogError: if the file is missing, cut off or no MATLAB file, its links form a loop, or `h5py` (version 7.3) is
            not installed.
    """
    try:
        with Path(path).open("rb") as file:
            head = file.read(520)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from None
    is_hdf5 = _HDF5 in (head[:8], head[512:520])
    if is_hdf5:
        require("h5py", "logs", f"{path}: reading MATLAB 7.3 files")
    reader: Callable[[str], dict[str, Any]] = _read_hdf5 if is_hdf5 else _read_scipy
    try:
        variables = reader(str(path))
    except LogError:
        raise
    except Exception as error:  # noqa: BLE001 - on damaged files both libraries raise whatever they meet
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LogError(f"{path}: not a readable MATLAB file, or cut off ({reason})") from None
    if not variables:
        raise LogError(f"{path}: holds no variable")
    return MatLog(str(path), variables)


def _read_scipy(path: str) -> dict[str, Any]:
    from scipy.io import loadmat

    require_bounded(path)
    # Without a name of its own scipy would add .mat to a path that has another ending.
    found = loadmat(path, appendmat=False, struct_as_record=True, squeeze_me=False, chars_as_strings=True)
    return {name: _plain(value) for name, value in found.items() if not name.startswith("__")}


def _plain(value: Any, depth: int = 0) -> Any:
    """Structs as mappings, struct arrays and cells as lists; MATLAB's 1x1 wrappings fall away."""
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


def _read_hdf5(path: str) -> dict[str, Any]:
    import h5py

    with h5py.File(path, "r") as file:
        tree = _Hdf5Tree(path, file)
        names = [str(name) for name in file]
        return {name: tree.read(tree.item(file, name)) for name in names if not name.startswith("#")}


class _Hdf5Tree:
    """The objects of an HDF5 file, whose links may form a loop, or lead to one object so often that a walk never ends.

    Nothing outside the file is opened, whatever the file says.

    Raises:
        LogError: if a group or a cell lies within itself, there are more objects or bytes than in any log, or data lie
            outside the file.
    """

    def __init__(self, path: str, file: Any) -> None:
        self._path, self._file = path, file
        self._around = [_place(file["/"])]  # the groups and cells that are being read, from the outside in
        self._left = _MOST_OBJECTS
        self._bytes = MOST_BYTES

    def item(self, group: Any, name: str, left: int = _MOST_SOFT_LINKS) -> Any:
        """The object behind a link, which stays in the file: h5py alone would follow it into another one."""
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
        found = self._file["/"] if target.startswith("/") else group
        for part in target.split("/"):
            found = self.item(found, part, left - 1) if part not in ("", ".") else found
        return found

    def read(self, item: Any) -> Any:
        """Groups as mappings; matrices the way MATLAB shows them, which stores them transposed."""
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
        """Refuse data that lie elsewhere, need other code to be read, or would fill the memory."""
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
    """File and address of an object, the same by whatever link it was come to."""
    from h5py import h5o  # pyright: ignore[reportAttributeAccessIssue]  # compiled, without a stub

    about = h5o.get_info(item.id)
    return about.fileno, about.addr


def _matrix(item: Any) -> Any:
    if "MATLAB_empty" in item.attrs:
        return np.empty(0)
    if item.attrs.get("MATLAB_class") == b"char":  # stored as the numbers of its letters
        return "".join(map(chr, np.asarray(item[()]).reshape(-1)[:_LONGEST_TEXT].tolist()))
    return np.asarray(item[()]).T


def _vectors(value: Any, prefix: str) -> list[str]:
    """Names of everything that is a vector of numbers."""
    if isinstance(value, Mapping):
        inner = [(f"{prefix}.{name}" if prefix else str(name), item) for name, item in value.items()]
        return [name for path, item in inner for name in _vectors(item, path)]
    if isinstance(value, list):
        return [name for k, item in enumerate(value[:_MOST_COLUMNS]) for name in _vectors(item, f"{prefix}[{k}]")]
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or value.size < 2 or value.ndim > 2:
        return []
    if value.ndim == 1 or 1 in value.shape:
        return [prefix]
    return [f"{prefix}[{k}]" for k in range(min(value.shape[1], _MOST_COLUMNS))]
