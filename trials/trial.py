"""One recorded trial: what every reader returns and every identification takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from .errors import LogError
from .types import Vec


@dataclass(frozen=True)
class Units:
    """Units of a trial's channels."""

    command: str = "mm"  # tendon travel mm, or pressure bar
    angle: str = "deg"


@dataclass(frozen=True, eq=False)  # arrays have no single truth value: trials are compared by identity
class Trial:
    """Time, command and tip angle of one uninterrupted recording.

    Attributes:
        t: time since the start of the recording [s], shape (T,), strictly increasing.
        command: tendon travel [mm] or pressure [bar], shape (T,).
        angle: tip angle [deg], shape (T,).
        channels: further named signals, each of shape (T,), in the units of the log; may hold not-a-number.
        units: units of command and angle.
        source: where the trial came from (a file's path), for messages and reports.

    Raises:
        LogError: if shapes differ, fewer than two samples are given, a value is not finite, or time does not
            increase.
    """

    t: Vec
    command: Vec
    angle: Vec
    channels: Mapping[str, Vec] = field(default_factory=dict)
    units: Units = field(default_factory=Units)
    source: str = "<memory>"

    def __post_init__(self) -> None:
        for name in ("t", "command", "angle"):
            object.__setattr__(self, name, _signal(getattr(self, name), name, self.source))
        channels = {k: _vector(v, k, self.source) for k, v in self.channels.items()}
        object.__setattr__(self, "channels", MappingProxyType(channels))
        sizes = {"command": self.command.size, "angle": self.angle.size} | {k: v.size for k, v in channels.items()}
        wrong = [f"{k} has {n}" for k, n in sizes.items() if n != self.t.size]
        if wrong:
            raise LogError(f"{self.source}: {', '.join(wrong)} samples, expected {self.t.size} as in time")
        if self.t.size < 2:
            raise LogError(f"{self.source}: {self.t.size} samples, expected at least 2")
        late = np.flatnonzero(np.diff(self.t) <= 0)
        if late.size:
            k = int(late[0])
            raise LogError(
                f"{self.source}: time does not increase at sample {k + 1} "
                f"({self.t[k]:.6g} s, then {self.t[k + 1]:.6g} s), expected strictly increasing time"
            )

    def __len__(self) -> int:
        return int(self.t.size)

    def __reduce__(self) -> tuple[type[Trial], tuple[object, ...]]:
        # A mapping proxy cannot be pickled, and trials travel to worker processes.
        return Trial, (self.t, self.command, self.angle, dict(self.channels), self.units, self.source)

    @property
    def inverted(self) -> bool:
        """Whether command and angle have changed places: what an inverse map is identified from."""
        return self.units.command == "deg"

    def swapped(self) -> Trial:
        """The trial with command and angle exchanged, so that a model of it maps angle to command; twice is once."""
        units = Units(self.units.angle, self.units.command)
        return Trial(self.t, self.angle, self.command, self.channels, units, self.source)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @property
    def dt(self) -> float:
        """Median sample interval [s]."""
        return float(np.median(np.diff(self.t)))

    def select(self, start: int, stop: int | None = None) -> Trial:
        """Return samples start to stop (exclusive) as a trial of its own; time keeps its origin."""
        part = slice(start, stop)
        return Trial(
            self.t[part],
            self.command[part],
            self.angle[part],
            {k: v[part] for k, v in self.channels.items()},
            self.units,
            self.source,
        )


def _vector(values: ArrayLike, name: str, source: str) -> Vec:
    """Return a read-only copy of `values`, or say that it has not one dimension."""
    vector = np.array(values, dtype=np.float64)
    if vector.ndim != 1:
        raise LogError(f"{source}: {name} has shape {vector.shape}, expected one dimension (T,)")
    vector.setflags(write=False)
    return vector


def _signal(values: ArrayLike, name: str, source: str) -> Vec:
    """Return `values` as a read-only finite vector, or say which sample is not finite."""
    vector = _vector(values, name, source)
    bad = np.flatnonzero(~np.isfinite(vector))
    if bad.size:
        k = int(bad[0])
        raise LogError(f"{source}: {name} is {vector[k]} at sample {k}, expected finite values ({bad.size} such)")
    return vector
