"""Logs of named arrays: variables, struct fields, rows or columns of matrices; NumPy files and TDMS of LabVIEW.

Pickled objects are not read, since they can run code.
"""

from __future__ import annotations

import logging
import math
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, cast, final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .errors import LogError, require, shown
from .formats import MOST_BYTES, damaged, read_bytes, reading, seconds_since_first
from .layouts import HEADER_TIME, LOG_TIME
from .signals import Series, SignalLog, missing, split_path, walk
from .types import Vec

_MOST_SIGNALS = 64  # greatest number of listed signals of a matrix or a list


@final
@dataclass(frozen=True, eq=False)
class ArrayLog(SignalLog):
    """A `SignalLog` over named arrays, such as the variables of a MATLAB file."""

    path: str
    variables: Mapping[str, Any]  # a struct is a mapping, a struct array or a cell a list, numbers are arrays
    note: str = ""
    clocks: Mapping[str, Vec] = field(default_factory=dict)  # time stamps [s] of signals that have their own
    unread: Mapping[str, str] = field(default_factory=dict)  # advice on each variable that cannot be read
    times: frozenset[str] = frozenset()

    @property
    def clock(self) -> str:  # type: ignore[override]  # read only, as all of it
        """Name of the time signal: a signal of dates, otherwise the times of waveforms."""
        return min(self.times, default=LOG_TIME if self.clocks else "")

    def names(self) -> tuple[str, ...]:
        """Names of vectors and of the signals of matrices along the longer side: `t`, `run.tip`, `data[1]`, from 0."""
        return tuple(self._named)

    @cached_property
    def _named(self) -> dict[str, NDArray[Any]]:
        return dict(_vectors(self.variables, ""))

    def series(self, signals: Sequence[str], time: str) -> list[Series]:
        """Return the requested signals with their time stamps; see `SignalLog`.

        Raises:
            LogError: on an unknown signal, one that is no vector, or one of another length than time.
        """
        if time in (LOG_TIME, HEADER_TIME):
            values = [self._vector(signal) for signal in signals]
            return [Series(self._clock(s, y.size), y) for s, y in zip(signals, values, strict=True)]
        t = self._vector(time)
        values = [self._vector(signal) for signal in signals]
        for signal, y in zip(signals, values, strict=True):
            if y.size != t.size:
                raise LogError(f"{self.path}: {signal!r} has {y.size} samples, expected {t.size} as in {time!r}")
        return [Series(t, y) for y in values]

    def _clock(self, signal: str, count: int) -> Vec:
        stamps = self.clocks.get(signal)
        return stamps if stamps is not None and stamps.size == count else np.full(count, np.nan)

    def _vector(self, signal: str) -> Vec:
        if signal in self._named:  # a name that contains dots or brackets
            return self._named[signal].astype(np.float64)
        *way, last = split_path(signal) or [signal]
        try:
            holder = walk(self.variables, way, single=True)
            of_matrix = isinstance(last, int) and isinstance(holder, np.ndarray) and np.squeeze(holder).ndim <= 2
            value = _along(holder, int(last)) if of_matrix else walk(holder, [last], single=True)
        except (KeyError, IndexError, TypeError):
            raise self._missing(signal) from None
        array = np.asarray(value)
        if array.dtype.kind not in "fiub" or sum(size > 1 for size in array.shape) > 1:
            shape = "x".join(map(str, array.shape)) or "single"
            raise LogError(
                f"{self.path}: {signal!r} is a {shape} {array.dtype} value, expected a vector of real numbers"
                f"{'; name one of its signals, counted from 0: ' + signal + '[0]' if array.ndim == 2 else ''}"
            )
        return array.astype(np.float64).reshape(-1)

    def _missing(self, signal: str) -> LogError:
        first = str((split_path(signal) or [signal])[0])
        unread = None if first in self.variables else self.not_read(first)
        return unread or missing(self.path, signal, self.names())

    def not_read(self, name: str = "") -> LogError | None:
        """Error for the named variable if it cannot be read; without a name, for the first such variable."""
        if not self.unread:
            return None
        known = name if name in self.unread else next(iter(self.unread))
        return LogError(f"{self.path}: {shown(known, 40)} is {self.unread[known]}")


def _along(value: Any, signal: int) -> Any:
    """One signal of a matrix, whose samples lie along the longer side, or down the columns of a square."""
    plain = np.squeeze(value)
    if plain.ndim < 2:
        return plain.reshape(1, -1)[signal]
    return plain[:, signal] if plain.shape[0] >= plain.shape[1] else plain[signal]


def _vectors(value: Any, prefix: str) -> list[tuple[str, NDArray[Any]]]:
    if isinstance(value, Mapping):
        inner = [(f"{prefix}.{name}" if prefix else str(name), item) for name, item in value.items()]
        return [vector for path, item in inner for vector in _vectors(item, path)]
    if isinstance(value, list):
        return [vector for k, item in enumerate(value[:_MOST_SIGNALS]) for vector in _vectors(item, f"{prefix}[{k}]")]
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or value.size < 2:
        return []
    plain = np.squeeze(value)
    if plain.ndim == 1:
        return [(prefix, plain)]
    if plain.ndim > 2:
        return []
    return [(f"{prefix}[{k}]", _along(plain, k)) for k in range(min(*plain.shape, _MOST_SIGNALS))]


_MOST_ARRAYS = 2000
_LONGEST_HEADER = 10_000
_PICKLED = "an array of pickled objects, which can run code; save plain numbers instead"


def open_npz(path: Path | str) -> ArrayLog:
    """Read the arrays of a NumPy file: an `.npz` by name, an `.npy` as `[0]`, `[1]`, ... or `data`, or by field name.

    Raises:
        LogError: if the file is missing, cut off, no file of NumPy, or unpacks to more than `MOST_BYTES`.
    """
    data = read_bytes(path)
    unread: dict[str, str] = {}
    with reading(path, "file of NumPy"):
        if data.startswith(b"PK"):
            variables = _members(str(path), data, unread)
        else:
            array = _array(str(path), BytesIO(data), len(data), MOST_BYTES)
            if array is None:
                raise LogError(f"{path}: {_PICKLED}")
            variables = _single(array)
    if not variables and not unread:
        raise LogError(f"{path}: holds no array")
    return ArrayLog(str(path), variables, unread=unread)


def _members(path: str, data: bytes, unread: dict[str, str]) -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    left = MOST_BYTES
    with zipfile.ZipFile(BytesIO(data)) as archive:
        parts = archive.infolist()
        if len(parts) > _MOST_ARRAYS:
            raise LogError(f"{path}: {len(parts)} arrays, expected at most {_MOST_ARRAYS}")
        for part in parts:
            name = part.filename.removesuffix(".npy")
            with archive.open(part) as file:
                value = _array(path, cast(BinaryIO, file), part.file_size, left)
            if value is None:
                unread[name] = _PICKLED
                continue
            left -= value.nbytes
            arrays[name] = _fields(value)
    return arrays


def _array(path: str, file: BinaryIO, size: int, left: int) -> np.ndarray[Any, Any] | None:
    """Read one array, after a check of its size; None if it holds pickled objects."""
    version = npy.read_magic(file)
    if version == (1, 0):
        shape, by_columns, dtype = npy.read_array_header_1_0(file, max_header_size=_LONGEST_HEADER)
    elif version in ((2, 0), (3, 0)):
        shape, by_columns, dtype = npy.read_array_header_2_0(file, max_header_size=_LONGEST_HEADER)
    else:
        raise ValueError(f"version {version} of the format")
    if dtype.hasobject:
        return None
    needed = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or needed > left:
        raise LogError(f"{path}: an array of shape {shown(shape, 60)} unpacks to more than {MOST_BYTES} bytes")
    if needed > size:
        raise ValueError(f"an array of {needed} bytes in {size}")
    content = file.read(needed)
    if len(content) < needed:
        raise ValueError("it ends within an array")
    if dtype.kind == "M":  # dates
        return seconds_since_first(np.frombuffer(content, dtype=dtype))
    flat = np.frombuffer(content, dtype=dtype, count=math.prod(shape)) if dtype.itemsize else np.empty(0)
    return flat.reshape(shape, order="F" if by_columns else "C") if flat.size else np.empty(0)


def _single(value: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Signals of a file that holds one array."""
    if value.dtype.names:
        return dict(cast(Mapping[str, Any], _fields(value)))
    plain = np.squeeze(value)
    if plain.ndim != 2:
        return {"data": plain}
    signals = plain.T if plain.shape[0] >= plain.shape[1] else plain
    return {f"[{k}]": row for k, row in enumerate(signals)}


def _fields(value: np.ndarray[Any, Any]) -> Any:
    return {name: value[name] for name in value.dtype.names} if value.dtype.names else value


_MOST_CHANNELS = 2000


def open_tdms(path: Path | str) -> ArrayLog:
    """Read the channels of numbers and time stamps of a TDMS file; time stamps become seconds since the first.

    A channel written as a waveform has its time (`time: log` in a mapping file) from its start and its increment,
    counted from the earliest start of all channels.

    Raises:
        LogError: if `npTDMS` is not installed, the file is missing, cut off or no TDMS file, or declares more samples
            than its size allows.
    """
    require("nptdms", "logs", f"{path}: reading TDMS files")
    data = read_bytes(path)
    with reading(path, "TDMS file"), _warnings() as warnings:
        variables, clocks, times = _read(str(path), data)
    if not variables:
        raise LogError(f"{path}: holds no channel of numbers")
    note = damaged(warnings[0][:100]) if warnings else ""
    return ArrayLog(str(path), variables, note, clocks, times=times)


@contextmanager
def _warnings() -> Iterator[list[str]]:
    logger, warnings = logging.getLogger("nptdms"), list[str]()
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: warnings.append(" ".join(record.getMessage().split()))  # type: ignore[method-assign]
    before = logger.propagate
    logger.propagate = False
    logger.addHandler(handler)
    try:
        yield warnings
    finally:
        logger.removeHandler(handler)
        logger.propagate = before


def _read(path: str, data: bytes) -> tuple[dict[str, Any], dict[str, Vec], frozenset[str]]:
    from nptdms import TdmsFile

    variables: dict[str, dict[str, Any]] = {}
    waves: dict[str, tuple[Any, float, float, int]] = {}
    times: set[str] = set()
    with TdmsFile.open(BytesIO(data)) as file:  # bytes, since a path would also read its index file
        channels = [channel for group in file.groups() for channel in group.channels()]
        if len(channels) > _MOST_CHANNELS:
            raise LogError(f"{path}: {len(channels)} channels, expected at most {_MOST_CHANNELS}")
        if sum(len(channel) for channel in channels) > min(len(data), MOST_BYTES // 8):  # a sample takes a byte or more
            raise LogError(f"{path}: says to hold more samples than {len(data)} bytes have room for, expected a log")
        for channel in channels:
            values = _numbers(channel)
            if values is None:
                continue
            variables.setdefault(channel.group_name, {})[channel.name] = values
            name = f"{channel.group_name}.{channel.name}"
            if np.dtype(channel.dtype).kind == "M":
                times.add(name)
            step = channel.properties.get("wf_increment")
            if step:
                began = channel.properties.get("wf_start_time")
                offset = float(channel.properties.get("wf_start_offset", 0.0))
                waves[name] = (began, offset, float(step), values.size)
    return dict(variables), _clocks(waves), frozenset(times)


def _numbers(channel: Any) -> np.ndarray[Any, Any] | None:
    kind = np.dtype(channel.dtype).kind
    if not len(channel) or kind not in "fiubM":
        return None
    values = np.asarray(channel[:])
    if values.dtype.kind == "M":
        return seconds_since_first(values)
    return values if values.dtype.kind in "fiub" else None


def _clocks(waves: dict[str, tuple[Any, float, float, int]]) -> dict[str, Vec]:
    starts = [began for began, *_ in waves.values() if began is not None]
    origin = min(starts) if starts and len(starts) == len(waves) else None
    clocks: dict[str, Vec] = {}
    for name, (began, offset, step, count) in waves.items():
        since = 0.0 if origin is None else float((began - origin) / np.timedelta64(1, "s"))
        clocks[name] = np.asarray(since + offset + step * np.arange(count), dtype=np.float64)
    return clocks
