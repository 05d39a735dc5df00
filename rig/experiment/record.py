"""Recordings for identification: each excitation is played by the control loop and becomes one trial."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import final

import numpy as np

from hystmpc.trials.csv_files import format_table, write_csv
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.recording import write_manifest
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from ..config import RecordSettings
from ..live.desk import Desk
from ..recording.sample import Sink
from ..run import BenchResult, Note, run_bench
from ..safety.ramp import waypoint_commands
from ..transports.transport import PlantFactory, Transport
from .phases import CommandMotion, Decision, Past, Phase, PhaseInput

_ROUNDING = 1e-9
_LEAST = 2  # samples that make a trial
_BETWEEN_FRAMES = (
    "sensor.kind intermittent: samples without a frame get no angle, and check, fit and diagnose refuse such trials; "
    "record with a continuous sensor to identify from them"
)


@final
class Recorded(Phase):
    """Phase that plays commands (N,) and records the commands sent and the angles measured.

    An angle belongs to the end of its sample: it is read at the beginning of the next one, so one sample more is
    spent at the last command. A frame belongs to the sample at whose end it was taken, and `late` samples more are
    spent there until those of the last ones have come.

    Args:
        commands: to play, from the command held on (N,).
        dt_s: sample time [s].
        late: age of the oldest frame [samples]; None for a continuous sensor.
    """

    def __init__(self, name: str, commands: Vec, dt_s: float, late: int | None = None) -> None:
        self.name = name
        self._dt, self._late = dt_s, late
        self._commands = commands.tolist()
        self.sent = [math.nan] * commands.size
        self.angles_deg = [math.nan] * commands.size
        self.times = [math.nan] * commands.size
        self._k, self._skipped = 0, 0

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now, past
        self._k = self._skipped = 0

    def step(self, now: PhaseInput) -> Decision:
        """Next command; records the angle at the end of the previous one."""
        k = self._k
        self._skipped += now.skipped
        count = len(self._commands)
        if 0 < k <= count:
            self.sent[k - 1] = now.held
            self.angles_deg[k - 1] = now.angle_deg if self._late is None else math.nan
            self.times[k - 1] = k + self._skipped
        for frame in now.frames:
            taken = k + self._skipped - frame.age_s / self._dt
            if (place := bisect_right(self.times, taken + 0.5, hi=min(k, count)) - 1) >= 0:
                self.angles_deg[place] = frame.angle_deg
        u = self._commands[min(k, count - 1)]
        self._k += 1
        return Decision(u, self.name, finished=k >= count + (self._late or 0))

    def write(self, folder: Path, unit: str) -> Path | None:
        """Write the trial as CSV; None without a file where fewer than two angles were measured.

        Samples without an angle are left out; between frames they stay, with an empty cell: the commands count.
        """
        trial, file = self.trial(unit), folder / f"{self.name}.csv"
        if trial is None:
            return None
        if self._late is None:
            return write_csv(trial, file)
        t, u, y = (np.array(values) for values in (self.times, self.sent, self.angles_deg))
        done = np.isfinite(t)
        angles = [repr(angle) if math.isfinite(angle) else "" for angle in y[done].tolist()]
        columns = {CANONICAL.time: self._dt * t[done], f"command_{unit}": u[done], CANONICAL.angle: angles}
        return write_atomically(file, format_table(columns))

    def trial(self, unit: str) -> Trial | None:
        """The samples with an angle; None with fewer than two."""
        t, u, y = (np.array(values) for values in (self.times, self.sent, self.angles_deg))
        seen = np.isfinite(t) & np.isfinite(y)
        if np.count_nonzero(seen) < _LEAST:
            return None
        return Trial(self._dt * t[seen], u[seen], y[seen], units=Units(command=unit), source=self.name)

    @property
    def whole(self) -> bool:
        """Whether it was played to its end."""
        return math.isfinite(self.times[-1])


@dataclass(frozen=True)
class RecordResult:
    """Result of a recording."""

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
    transport: Transport | None = None,
    desk: Desk | None = None,
) -> RecordResult:
    """Play every excitation and write `trials/NAME.csv` in canonical columns and a manifest.

    Arguments as of `run_bench`.

    Trials by frames have empty cells between them, which no identification reads: `note` is told so first.

    Raises:
        HystmpcError: of any kind, before anything moves; `ConfigError` if an excitation is in another unit or
            beyond the limits.
    """
    phases: list[Phase] = []
    recorded: list[Recorded] = []
    sensor = settings.sensor
    late = math.ceil(sensor.oldest_frame_s / settings.dt_s) if sensor.kind == "intermittent" else None
    for name, excitation in settings.excitations.items():
        if excitation.unit not in (None, settings.command_unit):
            raise ConfigError(
                f"excitations.{name}: got commands in {excitation.unit}, expected the bench's {settings.command_unit}"
            )
        commands = excitation.commands(settings.rate_hz, settings.ramps)
        _within(settings, name, commands)
        way = partial(_approach, settings, float(commands[0]))
        recorded.append(Recorded(name, commands, settings.dt_s, late))
        phases += [CommandMotion("approach", way), recorded[-1]]
    if late is not None:
        note(_BETWEEN_FRAMES)
    bench = run_bench(settings, lambda: phases, sink, plants, folder=folder, note=note, transport=transport, desk=desk)
    written, cut = [], None
    for phase in recorded:
        file = phase.write(folder / ("trials" if phase.whole else "partial"), settings.command_unit)
        if file is None:
            continue
        if phase.whole:
            written.append(file)
        else:
            cut = file
    if written:
        write_manifest(folder / "trials", written)  # tells a diagnosis their order
    return RecordResult(bench, tuple(written), cut)


def _approach(settings: RecordSettings, start: float, held: float) -> Vec:
    """Ramp to where an excitation starts, and rest there."""
    rest_s = max(settings.settle_s, settings.dt_s)
    return waypoint_commands(held, [start], [rest_s], settings.ramps, settings.dt_s)


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
