"""Recordings for identification: every excitation a trial, with the safety of an experiment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import final

import numpy as np

from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from ..bench import BenchResult, Note, run_bench
from ..config import RecordSettings
from ..recording.sample import Sink
from ..safety.ramp import way_commands
from ..transports.transport import PlantFactory
from .phases import CommandMotion, Decision, Past, Phase, PhaseInput

_ROUNDING = 1e-9
_LEAST = 2  # samples that make a trial


@final
class Recorded(Phase):
    """A phase that plays commands (N,) and keeps what was sent and measured.

    An angle belongs to the end of its sample: it is read at the beginning of the next one, so one sample more is
    spent at the last command.

    Args:
        commands: to play, from the command held on (N,).
    """

    def __init__(self, name: str, commands: Vec) -> None:
        self.name = name
        self._commands = commands.tolist()
        self.sent = [math.nan] * commands.size
        self.angles_deg = [math.nan] * commands.size
        self.times = [math.nan] * commands.size
        self._k, self._skipped = 0, 0

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now, past
        self._k = self._skipped = 0

    def step(self, now: PhaseInput) -> Decision:
        """The next command; keeps the angle that the last one has led to."""
        k = self._k
        self._skipped += now.skipped
        if k:
            self.sent[k - 1], self.angles_deg[k - 1] = now.held, now.angle_deg
            self.times[k - 1] = k + self._skipped
        u = self._commands[min(k, len(self._commands) - 1)]
        self._k += 1
        return Decision(u, self.name, finished=k >= len(self._commands))

    def trial(self, dt_s: float, unit: str) -> Trial | None:
        """What was recorded, samples without an angle left out; None with fewer than two."""
        t, u, y = (np.array(values) for values in (self.times, self.sent, self.angles_deg))
        usable = np.isfinite(t) & np.isfinite(y)
        if np.count_nonzero(usable) < _LEAST:
            return None
        return Trial(dt_s * t[usable], u[usable], y[usable], units=Units(command=unit), source=self.name)


@dataclass(frozen=True)
class RecordResult:
    """What a recording left behind."""

    bench: BenchResult  # how it went
    trials: tuple[Path, ...]  # files written, complete ones
    partial: Path | None  # file of a trial that was cut short, not to be taken for a whole one; None where none was


def record(
    settings: RecordSettings,
    sink: Callable[[], Sink],
    plants: PlantFactory,
    folder: Path,
    *,
    note: Note = lambda text: None,
) -> RecordResult:
    """Play every excitation and write `trials/NAME.csv` in canonical columns. Arguments as of `run_bench`.

    Raises:
        HystmpcError: of any kind, before anything moves; `ConfigError` if an excitation is in another unit or
            beyond the limits.
    """
    phases: list[Phase] = []
    recorded: list[Recorded] = []
    for name, excitation in settings.excitations.items():
        if excitation.unit not in (None, settings.command_unit):
            raise ConfigError(
                f"excitations.{name}: got commands in {excitation.unit}, expected the bench's {settings.command_unit}"
            )
        commands = excitation.commands(settings.rate_hz, settings.ramps)
        _within(settings, name, commands)
        way = partial(_approach, settings, float(commands[0]))
        recorded.append(Recorded(name, commands))
        phases += [CommandMotion("approach", way), recorded[-1]]
    bench = run_bench(settings, lambda: phases, sink, plants, folder=folder, note=note)
    written, cut = [], None
    for phase in recorded:
        trial = phase.trial(settings.dt_s, settings.command_unit)
        if trial is None:
            continue
        whole = math.isfinite(phase.times[-1])
        file = write_csv(trial, folder / ("trials" if whole else "partial") / f"{phase.name}.csv")
        if whole:
            written.append(file)
        else:
            cut = file
    return RecordResult(bench, tuple(written), cut)


def _approach(settings: RecordSettings, start: float, held: float) -> Vec:
    """Ramp to where an excitation starts, and rest there."""
    rest_s = max(settings.settle_s, settings.dt_s)
    return way_commands(held, [start], [rest_s], settings.ramps, settings.dt_s)


def _within(settings: RecordSettings, name: str, commands: Vec) -> None:
    limits = settings.limits
    slack = _ROUNDING * (limits.upper - limits.lower)
    low, high = float(commands.min()), float(commands.max())
    rate = float(np.abs(np.diff(commands)).max(initial=0.0)) * settings.rate_hz
    if low < limits.lower - slack or high > limits.upper + slack or rate > limits.rate_per_s * (1 + _ROUNDING):
        raise ConfigError(
            f"excitations.{name}: got commands from {low:.6g} to {high:.6g} {settings.command_unit} at up to "
            f"{rate:.4g} per s, expected them within limits {limits.lower} to {limits.upper} at {limits.rate_per_s}"
        )
