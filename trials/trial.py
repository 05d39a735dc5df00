"""The type `Trial`: one recording of time, command and angle; cutting at gaps and resampling."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import ArrayLike

from .brief import in_brief
from .clocks import counter_wrap, interval_of
from .errors import ConfigError, LogError, did_you_mean
from .types import Vec

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MOST_COMMANDS = 9
"""Most commands, or angles, of a device; as in core/axes.h."""

MOST_INPUTS = 6
"""Most measured inputs of a device."""

_LONGEST_SOURCE = 100  # characters of a path in a line


@dataclass(frozen=True)
class Units:
    """Units of command and angle, as in tables, reports and files.

    Attributes:
        command: of the command, such as tendon travel mm or pressure bar.
        angle: of the output, such as a tip angle in deg.
        inverse: whether command and angle are exchanged; by default, whether only the command is in deg.
    """

    command: str = "mm"
    angle: str = "deg"
    inverse: bool | None = None

    def __post_init__(self) -> None:
        if self.inverse is None:
            object.__setattr__(self, "inverse", self.command == "deg" != self.angle)

    def named(self, unit: str) -> str:
        """Unit of a quantity, such as `deg/cmd`, with these units for `cmd` and `deg`; empty for a plain number."""
        names = {"cmd": self.command, "deg": self.angle}
        return "" if unit == "1" else re.sub(r"\b(cmd|deg)\b", lambda match: names[match[0]], unit)


@final
class AxisSignal:
    """Commands or angles of a trial: (T,) for one axis, (T, n) for several.

    Whoever reads `trial.command` or `trial.angle` works with one axis. A trial of several is refused here, in one line
    and in one place; `Trial.commands` and `Trial.angles` are for those who take any number.
    """

    def __set_name__(self, owner: type[Trial], name: str) -> None:
        self._name = name

    def __get__(self, trial: Trial | None, owner: type[Trial]) -> Vec:
        if trial is None:
            raise AttributeError(self._name)  # a field without a default
        values: Vec = vars(trial)[self._name]
        if values.ndim > 1:
            n, m = trial.commands.shape[1], trial.angles.shape[1]
            raise LogError(f"{trial.source}: a trial of {n} commands and {m} angles, expected one of each here")
        return values

    def __set__(self, trial: Trial, values: ArrayLike) -> None:
        vars(trial)[self._name] = values


@dataclass(frozen=True, eq=False)  # arrays have no single truth value: trials are compared by identity
class Trial:
    """Time, command and tip angle of one uninterrupted recording; of several axes too.

    Attributes:
        t: time since the start of the recording [s], shape (T,), strictly increasing.
        command: tendon travel [mm] or pressure [bar], shape (T,). Several commands (T, nu) are read as `commands`.
        angle: tip angle [deg], shape (T,). Several angles (T, ny) are read as `angles`.
        channels: further named signals, each of shape (T,), in the units of the log; may hold not-a-number.
        source: origin of the trial (a file's path), for messages and reports.
        command_noise: standard deviation of the noise that was taken off the recorded command, in its unit; 0 for none.
        inputs: measured inputs by name, such as a pressure, each of shape (T,).

    Raises:
        LogError: if shapes differ, fewer than two samples are given, a value is not finite, time does not increase, or
            there are more than nine commands or angles, or six inputs. `command` and `angle`, on a trial of several.
    """

    t: Vec
    command: AxisSignal = AxisSignal()
    angle: AxisSignal = AxisSignal()
    channels: Mapping[str, Vec] = field(default_factory=dict)
    units: Units = field(default_factory=Units)
    source: str = "<memory>"
    command_noise: float = 0.0
    inputs: Mapping[str, Vec] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given = vars(self)
        for name in ("t", "command", "angle"):
            given[name] = _finite(_vector(given[name], name, self.source, name != "t"), name, self.source)
        inputs = {k: _finite(_vector(v, k, self.source), k, self.source) for k, v in self.inputs.items()}
        if len(inputs) > MOST_INPUTS:
            raise LogError(f"{self.source}: {len(inputs)} inputs, expected at most {MOST_INPUTS}")
        channels = {k: _vector(v, k, self.source) for k, v in self.channels.items()}
        given |= {"channels": MappingProxyType(channels), "inputs": MappingProxyType(inputs)}
        signals = {name: given[name] for name in ("command", "angle")} | channels | inputs
        sizes = {name: len(values) for name, values in signals.items()}
        wrong = [f"{k} has {n}" for k, n in sizes.items() if n != self.t.size]
        if wrong:
            raise LogError(f"{self.source}: {', '.join(wrong)} samples, expected {self.t.size} as in time")
        if self.t.size < 2:
            raise LogError(f"{self.source}: {self.t.size} samples, expected at least 2")
        late = np.flatnonzero(np.diff(self.t) <= 0)
        if late.size:
            k = int(late[0])
            raise LogError(
                f"{self.source}: time does not increase at sample {k + 1} ({self.t[k]:.6g} s, then "
                f"{self.t[k + 1]:.6g} s), expected strictly increasing time{clock_advice(self.t)}"
            )

    def __len__(self) -> int:
        return int(self.t.size)

    def __repr__(self) -> str:
        units = f"{self.units.command} to {self.units.angle}"
        source = self.source if len(self.source) <= _LONGEST_SOURCE else f"...{self.source[-_LONGEST_SOURCE:]}"
        return in_brief(self, f"{source}: {len(self)} samples in {self.duration_s:.4g} s, {units}")

    def __reduce__(self) -> tuple[type[Trial], tuple[object, ...]]:
        # A mapping proxy cannot be pickled, and trials are sent to worker processes.
        signals = self.t, vars(self)["command"], vars(self)["angle"], dict(self.channels)
        return Trial, (*signals, self.units, self.source, self.command_noise, dict(self.inputs))

    @property
    def commands(self) -> Vec:
        """All commands (T, nu), of one axis or several."""
        return _by_axis(vars(self)["command"])

    @property
    def angles(self) -> Vec:
        """All angles (T, ny) [deg], of one axis or several."""
        return _by_axis(vars(self)["angle"])

    @property
    def inverted(self) -> bool:
        """Whether command and angle are exchanged, for the identification of an inverse model."""
        return bool(self.units.inverse)

    def swapped(self) -> Trial:
        """Trial with command and angle exchanged, for the identification of an inverse model."""
        units = Units(self.units.angle, self.units.command, not self.inverted)
        return replace(self, command=self.angle, angle=self.command, units=units)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @cached_property
    def dt(self) -> float:
        """Median sample interval [s]."""
        return float(np.median(np.diff(self.t)))

    def select(self, start: int, stop: int | None = None) -> Trial:
        """Return samples start to stop (exclusive) as a separate trial with the same time origin."""
        return self.with_signals(lambda values: values[start:stop])

    def with_signals(self, change: Callable[[Vec], Vec], **fields: Any) -> Trial:
        """Return the trial with `change` applied to time and every signal (T,), or (T, n), and with other fields."""
        signals = {name: change(vars(self)[name]) for name in ("t", "command", "angle")}
        mappings = {"channels": self.channels, "inputs": self.inputs}
        changed = {key: {name: change(v) for name, v in given.items()} for key, given in mappings.items()}
        return replace(self, **{**signals, **changed, **fields})

    def with_inputs(self, names: Sequence[str]) -> Trial:
        """Return the trial with exactly these measured inputs, in this order; they and channels change places.

        Raises:
            LogError: if the log has no such signal, or one of its values is not finite.
        """
        known = {**self.channels, **self.inputs}
        for name in names:
            if name not in known:
                raise LogError(
                    f"{self.source}: no input {name!r}, {did_you_mean(name, known)}; a mapping file names it"
                )
        channels = {name: values for name, values in known.items() if name not in names}
        return replace(self, channels=channels, inputs={name: known[name] for name in names})

    def plot(self) -> Figure:
        """Draw angle and command over time, and the angle over the command: the hysteresis loop."""
        from .report import COMMAND, MEASURED, new_figure  # matplotlib takes longer to import than a trial to read

        angle, command = f"angle [{self.units.angle}]", f"command [{self.units.command}]"
        with new_figure(7.0, 3.2) as figure:
            axes = figure.subplot_mosaic([["y", "loop"], ["u", "loop"]], width_ratios=(3, 2))
            axes["y"].plot(self.t, self.angle, color=MEASURED)
            axes["y"].set(ylabel=angle)
            axes["u"].plot(self.t, self.command, color=COMMAND)
            axes["u"].set(xlabel="time [s]", ylabel=command)
            axes["u"].sharex(axes["y"])
            axes["loop"].plot(self.command, self.angle, color=MEASURED, linewidth=0.8)
            axes["loop"].set(xlabel=command, ylabel=angle)
        return figure

    def _repr_html_(self) -> str:
        from .report import KeyValues, Plot, Report

        u, y = self.command, self.angle
        rows = {
            "samples": f"{len(self)}, every {self.dt:.4g} s, {self.duration_s:.4g} s in all",
            "command": f"{u.min():.4g} to {u.max():.4g} {self.units.command}",
            "angle": f"{y.min():.4g} to {y.max():.4g} {self.units.angle}",
        }
        if self.inputs:
            rows["inputs"] = ", ".join(f"{k} {v.min():.4g} to {v.max():.4g}" for k, v in self.inputs.items())
        if self.channels:
            rows["channels"] = ", ".join(self.channels)
        return Report(f"Trial {self.source}", (KeyValues(rows), Plot(self.plot()))).fragment()


def _vector(values: ArrayLike, name: str, source: str, by_axis: bool = False) -> Vec:
    """Values (T,), or (T, n) of n > 1 axes where that is allowed."""
    vector = np.array(values, dtype=np.float64)
    if by_axis and vector.ndim == 2 and 1 <= vector.shape[1] <= MOST_COMMANDS:
        vector = vector[:, 0].copy() if vector.shape[1] == 1 else vector
    elif vector.ndim != 1:
        several = f", or (T, n) of at most {MOST_COMMANDS} axes" if by_axis else ""
        raise LogError(f"{source}: {name} has shape {vector.shape}, expected one dimension (T,){several}")
    vector.setflags(write=False)
    return vector


def _finite(values: Vec, name: str, source: str) -> Vec:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        got = f"{name} is {values[tuple(bad[0])]} at sample {bad[0][0]}"
        raise LogError(f"{source}: {got}, expected finite values ({len(bad)} such)")
    return values


def _by_axis(values: Vec) -> Vec:
    return values.reshape(len(values), -1)


def positive_rate(rate_hz: float) -> float:
    """Check that a rate [Hz] is a positive number.

    Raises:
        ConfigError: if it is not a positive number.
    """
    if not (math.isfinite(rate_hz) and rate_hz > 0):
        raise ConfigError(f"rate_hz: got {rate_hz}, expected a positive number")
    return rate_hz


def even_time(samples: int, rate_hz: float) -> Vec:
    """Time [s] of evenly spaced samples, from zero on; see `positive_rate` for the error."""
    return np.arange(samples) / positive_rate(rate_hz)


def clock_advice(t: Vec) -> str:
    """Advice on time stamps (T,) [s] that repeat or run backwards, for the end of an error line."""
    wrap = counter_wrap(t)
    if wrap is not None:
        return f"; {wrap.text}: `hystmpc check` names the key of a mapping file that reads it"
    interval = interval_of(t)
    if interval is None:
        return ""
    return f"; if it was sampled evenly, `--sampled-hz {interval.rate_hz:.4g}` stands in for the broken clock"


MAX_GAP_S = 0.2
"""Longest gap that interpolation may bridge [s]: on a 0.5 Hz sine of 60 deg it errs by up to 1.5 deg."""

GAP_INTERVALS = 3.0
"""A gap is also at least this many median sample intervals, so that slow logs are not all gaps."""

PART_S, LEFT_OUT = 5.0, 0.1
"""Shortest part of a log between gaps [s], and greatest share of the log left out with shorter ones, which begin in
motion with an unknown history. The longest part always counts."""

_RATE_MARGIN = 1.5  # a grid this much finer than the log itself would only invent samples


def gap_limit_s(median_interval_s: float) -> float:
    """Sample interval above which a log has a gap [s]."""
    return max(MAX_GAP_S, GAP_INTERVALS * median_interval_s)


def parts_at_gaps(trial: Trial) -> tuple[Trial, ...]:
    """Cut a trial at its gaps and drop parts shorter than `PART_S`.

    Time keeps its origin. With several parts, the source of each names its time range.

    Raises:
        LogError: if the parts that are too short make more than `LEFT_OUT` of the trial.
    """
    limit = gap_limit_s(trial.dt)
    gaps = np.flatnonzero(np.diff(trial.t) > limit)
    if not gaps.size:
        return (trial,)
    edges = np.array([0, *(gaps + 1).tolist(), len(trial)])
    lasts = trial.t[edges[1:] - 1] - trial.t[edges[:-1]]
    kept = (lasts >= PART_S) | (lasts == lasts.max())
    if lasts[~kept].sum() > LEFT_OUT * lasts.sum():
        short = f"{lasts[~kept].sum():.3g} of {lasts.sum():.3g} s lie in parts shorter than {PART_S:g} s"
        raise LogError(f"{_widest_gap(trial, limit)}; {short}, expected at most {100 * LEFT_OUT:g} %")
    parts = [trial.select(edges[k], edges[k + 1]) for k in np.flatnonzero(kept).tolist()]
    if len(parts) == 1:
        return (parts[0],)
    return tuple(part.with_signals(np.asarray, source=f"{trial.source} from {part.t[0]:.4g} s") for part in parts)


def _widest_gap(trial: Trial, limit: float) -> str:
    intervals = np.diff(trial.t)
    k = int(np.argmax(intervals))
    return (
        f"{trial.source}: gap of {intervals[k]:.3g} s from {trial.t[k]:.6g} s (samples {k} and {k + 1}), "
        f"expected at most {limit:.3g} s"
    )


class SlowLogError(LogError):
    """Error on a log with too few samples for a rate: interpolation would add no information."""

    def __init__(self, source: str, log_hz: float, asked: str, remedy: str = "") -> None:
        super().__init__(
            f"{source}: sampled at {log_hz:.4g} Hz (median), too slow for {asked}, expected at most "
            f"{_RATE_MARGIN * log_hz:.4g} Hz ({_RATE_MARGIN:g} times its own rate){remedy}"
        )
        self.source, self.log_hz, self._rest = source, log_hz, (asked, remedy)

    def __reduce__(self) -> tuple[type[SlowLogError], tuple[object, ...]]:
        return SlowLogError, (self.source, self.log_hz, *self._rest)  # for transfer from worker processes


def resample(trial: Trial, rate_hz: float) -> Trial:
    """Interpolate all signals linearly onto t[0] + k / rate_hz, up to the last sample.

    Short parts next to a gap are left out first (`parts_at_gaps`). There is no anti-aliasing filter: a command that a
    controller sent is not band-limited, and a filter would shift its turning points.

    Raises:
        ConfigError: if the rate is not a positive number.
        SlowLogError: on a rate above 1.5 times that of the log.
        LogError: at a gap, or if the trial is shorter than one interval.
    """
    positive_rate(rate_hz)
    first, *others = parts_at_gaps(trial)
    if others:
        raise LogError(f"{_widest_gap(trial, gap_limit_s(trial.dt))}; cut the log there")
    trial = first
    log_hz = 1.0 / trial.dt
    if rate_hz > _RATE_MARGIN * log_hz:
        raise SlowLogError(trial.source, log_hz, f"{rate_hz:g} Hz")
    count = math.floor(trial.duration_s * rate_hz + 1e-6) + 1
    t = trial.t[0] + np.arange(count) / rate_hz
    return trial.with_signals(lambda values: np.apply_along_axis(lambda v: np.interp(t, trial.t, v), 0, values), t=t)


def require_uniform(trial: Trial) -> float:
    """Return the sample interval [s] of a uniformly sampled trial; refuse others.

    Raises:
        LogError: if an interval differs from the median by more than 1 %.
    """
    intervals = np.diff(trial.t)
    off = int(np.argmax(np.abs(intervals - trial.dt)))
    if abs(intervals[off] - trial.dt) > 0.01 * trial.dt:
        raise LogError(
            f"{trial.source}: sample interval {intervals[off]:.6g} s at {trial.t[off]:.6g} s, "
            f"expected {trial.dt:.6g} s throughout; resample the trial first"
        )
    return trial.dt
