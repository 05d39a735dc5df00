"""Recordings for identification: excitations, their settings, and one trial of each by the control loop.

S1 is Wu et al., RA-L 2021 (DOI 10.1109/LRA.2021.3061069), S2 RA-L 2024, PMC11633443.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from hystmpc.trajectories.excitation import (
    Offset,
    Split,
    s1_raised_baseline,
    s1_zero_baseline,
    s2_point_to_point,
    s2_sinusoid,
)
from hystmpc.trajectories.trajectory import Trajectory, sample
from hystmpc.trials.config import FolderName, NotNegative, Positive, Settings, load_settings
from hystmpc.trials.csv_files import format_table, write_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.formats import read_lines
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.recording import write_manifest
from hystmpc.trials.tables import LogTable, read_table
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Mask, Vec

from ..axes import NAMES, PerAxis, each, from_array, from_the_first, like, rows_of, together, trial_columns
from ..config import BenchSettings, located
from ..live.desk import Desk, LiveSettings
from ..plane_config import Both, PlaneBenchSettings, file_of_two_axes
from ..recording.sample import Sink
from ..run import BenchResult, Note, run_bench
from ..safety.ramp import RampSettings, waypoint_commands
from ..transports.transport import NO_INPUTS, PlantFactory, Transport
from .phases import CommandMotion, Decision, Past, Phase, PhaseInput

_ROUNDING = 1e-9
_LEAST = 2  # samples that make a trial
_BETWEEN_FRAMES = (
    "sensor.kind intermittent: samples without a frame get no angle, and check, fit and diagnose refuse such trials; "
    "record with a continuous sensor to identify from them"
)


class Recorded(Phase):
    """Phase that plays commands (N,), of two axes (N, 2), and records the commands sent and reported, and the angles.

    An angle belongs to the end of its sample: it is read at the beginning of the next one, so the last command is held
    for one sample more. A frame belongs to the sample at whose end it was taken; the last command is held for `late`
    further samples until the last frames have come.

    Args:
        commands: to play, from the held command on (N,), of two axes (N, 2).
        dt_s: sample time [s].
        late: age of the oldest frame [samples]; None for a continuous sensor.
    """

    def __init__(self, name: str, commands: Vec, dt_s: float, late: int | None = None) -> None:
        self.name = name
        self._dt, self._late = dt_s, late
        self._commands = rows_of(commands)
        nothing = together([math.nan] * len(each(self._commands[0])))
        self.sent, self.reported = [nothing] * len(commands), [nothing] * len(commands)
        self.angles_deg = [nothing] * len(commands)
        self.times = [math.nan] * len(commands)
        self.inputs: list[Mapping[str, float]] = [NO_INPUTS] * len(commands)
        self._k, self._skipped = 0, 0

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now, past
        self._k = self._skipped = 0

    def step(self, now: PhaseInput) -> Decision:
        """Next command; also records the angle at the end of the previous sample."""
        k = self._k
        self._skipped += now.skipped
        count = len(self._commands)
        if 0 < k <= count:
            self.sent[k - 1], self.reported[k - 1] = now.held, now.reported
            angle = now.angle_deg if self._late is None else math.nan
            self.angles_deg[k - 1] = like(now.held, angle)
            self.times[k - 1], self.inputs[k - 1] = k + self._skipped, now.inputs
        for frame in now.frames:
            taken = k + self._skipped - frame.age_s / self._dt
            if (place := bisect_right(self.times, taken + 0.5, hi=min(k, count)) - 1) >= 0:
                self.angles_deg[place] = frame.angle_deg
        u = self._commands[min(k, count - 1)]
        self._k += 1
        return Decision(u, self.name, finished=k >= count + (self._late or 0))

    def write(self, folder: Path, unit: str) -> Path | None:
        """Write the trial as CSV; return None without a file if fewer than two angles were measured.

        Samples without an angle are left out; between frames they stay, with an empty cell, for their commands.
        """
        trial, file = self.trial(unit), folder / f"{self.name}.csv"
        if trial is None:
            return None
        if trial.commands.shape[1] > 1:
            columns = trial_columns(trial.t, trial.commands, trial.angles, unit) | dict(trial.channels)
            return write_atomically(file, format_table(columns))
        if self._late is None:
            return write_csv(trial, file)
        t, u, y = (np.array(values) for values in (self.times, self.sent, self.angles_deg))
        done = np.isfinite(t)
        angles = [repr(angle) if math.isfinite(angle) else "" for angle in y[done].tolist()]
        signals = {CANONICAL.time: self._dt * t[done], f"command_{unit}": u[done], CANONICAL.angle: angles}
        return write_atomically(file, format_table({**signals, **self._seen_inputs(done)}))

    def trial(self, unit: str) -> Trial | None:
        """Trial of the samples with an angle; None with fewer than two."""
        t, u, y = (np.array(values) for values in (self.times, self.sent, self.angles_deg))
        seen = np.isfinite(t) & (np.isfinite(y) if y.ndim == 1 else np.isfinite(y).all(axis=1))
        if np.count_nonzero(seen) < _LEAST:
            return None
        inputs = self._seen_inputs(seen)
        return Trial(self._dt * t[seen], u[seen], y[seen], inputs, Units(command=unit), self.name)

    def _seen_inputs(self, seen: Mask) -> dict[str, Vec]:
        """Measured inputs of these samples, as channels of a trial, see `from_the_first`; without those of no value."""
        rows = [self.inputs[k] for k in np.flatnonzero(seen)]
        made = {name: from_the_first(np.array([row[name] for row in rows])) for name in (rows[0] if rows else ())}
        return {name: values for name, values in made.items() if values.size}

    @property
    def whole(self) -> bool:
        """Whether all commands have been played."""
        return math.isfinite(self.times[-1])


@dataclass(frozen=True)
class RecordResult:
    """Result of a recording: outcome of the run and files written."""

    bench: BenchResult  # how it went
    trials: tuple[Path, ...]  # files written, complete ones
    partial: Path | None  # file of a trial that was cut short, not to be taken for a whole one; None where none was


def record(
    settings: AnyRecordSettings,
    sink: Callable[[], Sink],
    plants: PlantFactory,
    folder: Path,
    *,
    note: Note = lambda text: None,
    transport: Transport | None = None,
    desk: Desk | None = None,
) -> RecordResult:
    """Play every excitation; write `trials/NAME.csv` in canonical columns and a manifest. Arguments as `run_bench`.

    Trials by frames have empty cells, which no identification accepts: `note` is then called
    with a warning first.

    Raises:
        HystmpcError: of any kind, before anything moves; `ConfigError` if an excitation is in another unit or beyond
            the limits.
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
        way = partial(_approach, settings, from_array(commands[0]))
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


def _approach(settings: AnyRecordSettings, start: PerAxis, held: PerAxis) -> Vec:
    """Ramp to the first command of an excitation, then rest."""
    rest_s = max(settings.settle_s, settings.dt_s)
    return waypoint_commands(held, [start], [rest_s], settings.ramps, settings.dt_s)


def _within(settings: AnyRecordSettings, name: str, commands: Vec) -> None:
    for limits, values in zip(settings.axes_limits, np.atleast_2d(commands.T), strict=True):
        slack = _ROUNDING * (limits.upper - limits.lower)
        low, high = float(values.min()), float(values.max())
        rate = float(np.abs(np.diff(values)).max(initial=0.0)) * settings.rate_hz
        if low < limits.lower - slack or high > limits.upper + slack or rate > limits.rate * (1 + _ROUNDING):
            raise ConfigError(
                f"excitations.{name}: got commands from {low:.6g} to {high:.6g} {settings.command_unit} at up to "
                f"{rate:.4g} per s, expected them within limits {limits.lower} to {limits.upper} at {limits.rate}"
            )


class TrajectoryExcitation(Settings):
    """Excitation defined by a trajectory of commands in one unit."""

    unit: ClassVar[str]

    @abstractmethod
    def trajectory(self) -> Trajectory:
        """Trajectory of the commands over time."""

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Sampled commands of the recording, shape (N,)."""
        del ramps
        return sample(self.trajectory(), rate_hz)[1]


class S1SinusoidSettings(TrajectoryExcitation):
    """Excitation `kind: s1_sinusoid`: a decaying pressure sinusoid [bar], S1 eq. (5) (`zero`) or (6) (`raised`).

    Attributes:
        baseline: `zero`: the decaying sinusoid has its lowest points at 0 bar; `raised`: it decays towards 1.5 bar.
        frequency_hz: of the sinusoid [Hz].
    """

    unit: ClassVar[str] = "bar"

    kind: Literal["s1_sinusoid"]
    baseline: Literal["zero", "raised"] = "zero"
    frequency_hz: Positive

    def trajectory(self) -> Trajectory:
        wave = s1_zero_baseline if self.baseline == "zero" else s1_raised_baseline
        return wave(self.frequency_hz)


class S2SinusoidSettings(TrajectoryExcitation):
    """Excitation `kind: s2_sinusoid`: seven decaying periods of tendon travel, S2 eq. (9), (10) [mm].

    Attributes:
        frequency_hz: of the sinusoid [Hz].
        offset: `0BL`: lowest points at the pretension; `MidBL`: about 3 mm; `EndBL`: highest points at 6 mm.
    """

    unit: ClassVar[str] = "mm"

    kind: Literal["s2_sinusoid"]
    frequency_hz: Positive
    offset: Offset

    def trajectory(self) -> Trajectory:
        return s2_sinusoid(self.frequency_hz, self.offset)


class S2PointToPointSettings(TrajectoryExcitation):
    """Excitation `kind: s2_point_to_point`: ten moves and holds drawn from a seed, S2 eq. (11) [mm].

    Attributes:
        seed: of the random numbers.
        split: part of the paper's data from whose distribution moves and holds are drawn.
    """

    unit: ClassVar[str] = "mm"

    kind: Literal["s2_point_to_point"]
    seed: int = Field(ge=0)
    split: Split = "train"

    def trajectory(self) -> Trajectory:
        return s2_point_to_point(self.seed, self.split)


class StopsSettings(Settings):
    """Excitation `kind: ramps`: jerk-limited ramps to commands, each with its hold; the first starts at `start`.

    Attributes:
        start: command at the start [mm or bar].
        stops: commands to reach, in order [mm or bar].
        holds_s: rest at each stop [s]; as many as stops.
    """

    unit: ClassVar[str | None] = None  # the numbers are in that of the bench

    kind: Literal["ramps"]
    start: float
    stops: tuple[float, ...] = Field(min_length=1)
    holds_s: tuple[NotNegative, ...]

    @model_validator(mode="after")
    def _as_many(self) -> StopsSettings:
        if len(self.stops) != len(self.holds_s):
            raise ValueError(f"got {len(self.stops)} stops and {len(self.holds_s)} holds_s, expected as many")
        return self

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Sampled commands of the recording, shape (N,)."""
        return np.concatenate(
            [[self.start], waypoint_commands(self.start, self.stops, self.holds_s, ramps, 1 / rate_hz)]
        )


class MotionFileSettings(Settings):
    """Excitation `kind: file`: columns `time_s` and `command` (or `command_mm`, ...) of a CSV file.

    `diagnose` writes such a file, next_motion.csv.

    Attributes:
        file: its name; a relative name starts at the folder of the configuration.
    """

    kind: Literal["file"]
    file: Path

    @property
    def unit(self) -> str | None:
        """Unit of the command column; a column `command` without a unit is in mm, as in every log."""
        return CANONICAL.command[_motion_table(self.file)[1]]

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Commands (N,), interpolated linearly.

        Raises:
            LogError: if the file cannot be read, lacks a column, or has numbers that are not finite or in order.
        """
        del ramps
        table, column = _motion_table(self.file)
        return _sampled(self.file, table.numbers["time_s"], table.numbers[column], rate_hz)


Excitation = Annotated[
    S1SinusoidSettings | S2SinusoidSettings | S2PointToPointSettings | StopsSettings | MotionFileSettings,
    Field(discriminator="kind"),
]


def _sampled(path: Path, t: Vec, u: Vec, rate_hz: float) -> Vec:
    """Commands (N,) at a rate, interpolated linearly between those of a file."""
    if t.size < 2 or not np.isfinite([t, u]).all() or not (np.diff(t) > 0).all():
        raise LogError(f"{path}: got {t.size} rows, expected at least 2 with finite numbers and increasing time_s")
    steps = int(np.ceil((t[-1] - t[0]) * rate_hz - 1e-9))
    return np.interp(t[0] + np.arange(steps + 1) / rate_hz, t, u)


def _motion_table(path: Path | str) -> tuple[LogTable, str]:
    """Table of a motion file, and the name of its command column."""
    table = read_table(read_lines(path), str(path))
    names = [name for name in table.header if name in CANONICAL.command]
    if "time_s" not in table.numbers or len(names) != 1 or names[0] not in table.numbers:
        raise LogError(
            f"{path}: got columns {', '.join(table.header)}, expected time_s and one of {', '.join(CANONICAL.command)}"
        )
    return table, names[0]


class PlaneStopsSettings(Settings):
    """Excitation `kind: ramps` of two axes: ramps to commands, both arriving at the same time, each with its hold.

    Attributes:
        start: commands x, y at the start [mm or bar].
        stops: commands to reach, in order, a pair each [mm or bar].
        holds_s: rest at each stop [s]; as many as stops.
    """

    unit: ClassVar[str | None] = None  # the numbers are in that of the bench

    kind: Literal["ramps"]
    start: Both
    stops: tuple[Both, ...] = Field(min_length=1)
    holds_s: tuple[NotNegative, ...]

    @model_validator(mode="after")
    def _as_many(self) -> PlaneStopsSettings:
        if len(self.stops) != len(self.holds_s):
            raise ValueError(f"got {len(self.stops)} stops and {len(self.holds_s)} holds_s, expected as many")
        return self

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Sampled commands of the recording, shape (N, 2)."""
        start, stops = together(self.start), list(map(together, self.stops))
        return np.vstack([self.start, waypoint_commands(start, stops, self.holds_s, ramps, 1 / rate_hz)])


class PlaneFileSettings(Settings):
    """Excitation `kind: file` of two axes: columns `time_s`, `command_x` and `command_y` of a CSV file.

    Attributes:
        file: its name; a relative name starts at the folder of the configuration.
    """

    unit: ClassVar[str | None] = None  # the numbers are in that of the bench

    kind: Literal["file"]
    file: Path

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Commands (N, 2), interpolated linearly.

        Raises:
            LogError: if the file cannot be read, lacks a column, or has numbers that are not finite or in order.
        """
        del ramps
        table, wanted = read_table(read_lines(self.file), str(self.file)), [f"command_{name}" for name in NAMES]
        if missing := [name for name in ("time_s", *wanted) if name not in table.numbers]:
            raise LogError(f"{self.file}: got no numbers in {', '.join(missing)}, expected time_s, {', '.join(wanted)}")
        return np.stack(
            [_sampled(self.file, table.numbers["time_s"], table.numbers[n], rate_hz) for n in wanted], axis=1
        )


PlaneExcitation = Annotated[PlaneStopsSettings | PlaneFileSettings, Field(discriminator="kind")]


class RecordSettings(BenchSettings):
    """Settings of recordings for identification (`hystmpc record`); every excitation becomes one trial.

    Attributes:
        excitations: motions by name, each with its `kind`; each becomes one trial.
        settle_s: rest before each of them [s].
        live: the local page; a recording takes no target.
    """

    excitations: Mapping[FolderName, Excitation] = Field(min_length=1)
    settle_s: NotNegative = 1.0
    live: LiveSettings = LiveSettings()

    @model_validator(mode="after")
    def _measures(self) -> RecordSettings:
        if self.sensor.kind == "none":
            raise ValueError("got sensor.kind none, expected continuous or intermittent: a trial holds angles")
        if self.realtime.backend != "python":
            raise ValueError(f"got realtime.backend {self.realtime.backend}, expected python: there is no controller")
        return self


class PlaneRecordSettings(PlaneBenchSettings):
    """Settings of recordings of two axes (`hystmpc record`); every excitation becomes one trial.

    Attributes:
        excitations: motions by name, each with its `kind`, `ramps` or `file`.
        settle_s: rest before each of them [s].
        live: the local page; a recording takes no target.
    """

    excitations: Mapping[FolderName, PlaneExcitation] = Field(min_length=1)
    settle_s: NotNegative = 1.0
    live: LiveSettings = LiveSettings()


AnyRecordSettings = RecordSettings | PlaneRecordSettings


def load_record(path: Path | str, overrides: Iterable[str] = ()) -> AnyRecordSettings:
    """Read the settings of a recording of one axis or of two, as `load_run`.

    Raises:
        ConfigError: on an unreadable file, an unknown key or a value out of bounds.
    """
    kind: type[AnyRecordSettings] = PlaneRecordSettings if file_of_two_axes(path) else RecordSettings
    settings, folder = load_settings(kind, path, overrides), Path(path).resolve().parent
    excitations = {
        name: e.model_copy(update={"file": folder / e.file})
        if isinstance(e, MotionFileSettings | PlaneFileSettings)
        else e
        for name, e in settings.excitations.items()
    }
    return settings.model_copy(update={"excitations": excitations, **located(settings, folder)})
