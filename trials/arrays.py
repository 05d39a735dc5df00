"""Signals of logs that hold named arrays: variables, struct fields, rows or columns of matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from .errors import LogError, shown
from .layouts import HEADER_TIME, LOG_TIME
from .signals import Series, missing, split_path, walk
from .types import Vec

_MOST_SIGNALS = 64  # of a matrix or a list that are listed


@final
@dataclass(frozen=True, eq=False)
class ArrayLog:
    """A `Source` over named arrays, such as the variables of a MATLAB file.

    Attributes:
        path: the file.
        variables: by name; a struct is a mapping, a struct array or a cell a list, numbers are arrays.
        note: what a user should know about the file.
        clocks: time stamps [s] of signals that have their own, by name of the signal.
        unread: variables that cannot be read, by name, and what to do.
        times: names of signals that were dates; they are in seconds since the first.
    """

    path: str
    variables: Mapping[str, Any]
    note: str = ""
    clocks: Mapping[str, Vec] = field(default_factory=dict)
    unread: Mapping[str, str] = field(default_factory=dict)
    times: frozenset[str] = frozenset()

    @property
    def clock(self) -> str:
        """Signal that is used as time where none has a known name; empty for none."""
        return min(self.times, default=LOG_TIME if self.clocks else "")

    def names(self) -> tuple[str, ...]:
        """Vectors, and the signals of matrices: `t`, `run.tip`, `data[1]`, counted from 0.

        The samples of a matrix lie along its longer side, whichever this is.
        """
        return tuple(self._named)

    @cached_property
    def _named(self) -> dict[str, NDArray[Any]]:
        return dict(_vectors(self.variables, ""))

    def series(self, signals: Sequence[str], time: str) -> list[Series]:
        """The signals asked for; see `Source`.

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
        if signal in self._named:  # a name that holds dots or brackets of its own
            return self._named[signal].astype(np.float64)
        *way, last = split_path(signal) or [signal]
        try:
            holder = walk(self.variables, way, single=True)
            of_matrix = _is_matrix(holder) and isinstance(last, int)
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
        """Error for a signal that is missing, or that cannot be read."""
        first = str((split_path(signal) or [signal])[0])
        if self.unread and first not in self.variables:
            return self.not_read(first)
        return missing(self.path, signal, self.names())

    def not_read(self, name: str = "") -> LogError:
        """Error for a variable that cannot be read: the named one, otherwise the first such variable."""
        known = name if name in self.unread else next(iter(self.unread))
        return LogError(f"{self.path}: {shown(known, 40)} is {self.unread[known]}")


def _is_matrix(value: Any) -> bool:
    return isinstance(value, np.ndarray) and np.squeeze(value).ndim <= 2 and value.ndim >= 1


def _along(value: Any, signal: int) -> Any:
    """One signal of a matrix; its samples lie along the longer side, down the columns of a square."""
    plain = np.squeeze(value)
    if plain.ndim < 2:
        return plain.reshape(1, -1)[signal]
    return plain[:, signal] if plain.shape[0] >= plain.shape[1] else plain[signal]


def _vectors(value: Any, prefix: str) -> list[tuple[str, NDArray[Any]]]:
    """Everything that is a vector of numbers, by name."""
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
