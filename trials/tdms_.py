"""Channels of TDMS files, which LabVIEW writes: `group.channel`, with the times of their waveforms."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import ArrayLog
from .errors import LogError, require
from .formats import MOST_BYTES, damaged, read_bytes, reading, seconds_since_first
from .types import Vec

_MOST_CHANNELS = 2000


def open_tdms(path: Path | str) -> ArrayLog:
    """Read the channels of a TDMS file; those of numbers and of time stamps, which become seconds since the first.

    A channel that was written as a waveform has a time of its own (`time: log` in a mapping file): its start and its
    increment, counted from the earliest start of all channels.

    Raises:
        LogError: if `npTDMS` is not installed, the file is missing, cut off or no TDMS file, or says to hold more
            samples than it has room for.
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
    """Collect the warnings of the library on a damaged file."""
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
    with TdmsFile.open(BytesIO(data)) as file:  # of bytes: of a path, an index file beside it would be read too
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
