"""Arrays of NumPy, `.npz` and `.npy`; pickled objects are not read, since they can run code."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.lib import format as npy

from .arrays import ArrayLog
from .errors import LogError, shown
from .formats import MOST_BYTES, read_bytes, reading, seconds_since_first

_MOST_ARRAYS = 2000
_LONGEST_HEADER = 10_000
_PICKLED = "an array of pickled objects, which can run code; save plain numbers instead"


def open_npz(path: Path | str) -> ArrayLog:
    """Read the arrays of a file of NumPy: of an `.npz` by name, the one of an `.npy` as `[0]`, `[1]`, ... or `data`.

    Fields of a structured array have names of their own.

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
    """The signals of a file with one array."""
    if value.dtype.names:
        return dict(cast(Mapping[str, Any], _fields(value)))
    plain = np.squeeze(value)
    if plain.ndim != 2:
        return {"data": plain}
    signals = plain.T if plain.shape[0] >= plain.shape[1] else plain
    return {f"[{k}]": row for k, row in enumerate(signals)}


def _fields(value: np.ndarray[Any, Any]) -> Any:
    return {name: value[name] for name in value.dtype.names} if value.dtype.names else value
