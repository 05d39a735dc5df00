"""The device of a commissioning or investigation: one run for each motion, in real time or on a simulated clock."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any, Protocol, cast, final

import numpy as np

from hystmpc.ctrl.loop import Plant
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisTipSettings
from hystmpc.rig.axes import NAMES, PerAxis, columns, from_array, is_known, like
from hystmpc.rig.config import BenchSettings, RunSettings
from hystmpc.rig.experiment.experiment import tracking_phase
from hystmpc.rig.experiment.phases import CommandMotion, Phase
from hystmpc.rig.experiment.plane import plane_tracking
from hystmpc.rig.experiment.record import Recorded
from hystmpc.rig.plane_config import PlaneRunSettings
from hystmpc.rig.realtime import SimulatedClock
from hystmpc.rig.recording.recorder_process import Views, open_recorder_process
from hystmpc.rig.recording.recording import RecordingMeta
from hystmpc.rig.recording.sample import Sample, SampleList, Sink, Tee
from hystmpc.rig.run import BenchResult, Note, run_bench
from hystmpc.rig.safety.plausibility import AxesFrame
from hystmpc.rig.safety.ramp import waypoint_commands
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.rig.transports.transport import PlantFactory
from hystmpc.sim.results import distances
from hystmpc.trials.csv_files import format_table
from hystmpc.trials.errors import ConfigError, HystmpcError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.formats import read_lines
from hystmpc.trials.json_text import mapping_in
from hystmpc.trials.tables import read_table
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .config import CommissionSettings
from .motions import AnyMotion, shaken
from .phases import Bounded

TIME_FILE = "device_time.json"
_SEEDS = 100_003
_TICK_S = 1.0

Tick = Callable[[float], None]
"""Called with the seconds of the present motion."""


class DeviceStoppedError(HystmpcError):
    """Error of a run that was stopped safely; the stop is latched."""

    def __init__(self, result: BenchResult, settings: BenchSettings) -> None:
        super().__init__(f"stopped: {result.outcome.cause}; latched until a reset")
        self.result, self.settings = result, settings


@dataclass(frozen=True, eq=False)
class Track:
    """Record of a tracked reference, one row for each sample, without the lead-in: (N,), of two axes (N, 2)."""

    t: Vec  # end of the sample since the reference's start [s]
    reference_deg: Vec  # wanted at the end of the sample
    measured_deg: Vec  # at the end of the sample, NaN without a usable angle
    command: Vec  # sent at its beginning
    source: tuple[str, ...]  # origin of the command
    late: tuple[bool, ...] = ()  # no time for the controller, after a missed deadline or skipped samples

    @property
    def error_deg(self) -> Vec:
        """Tracking error (N,) [deg]: measured minus reference angle; of two axes the distance in their plane."""
        error = self.measured_deg - self.reference_deg
        return error if error.ndim == 1 else distances(error)

    @property
    def angles_deg(self) -> Vec:
        """Measured angles of every axis (N, A) [deg]."""
        return self.measured_deg.reshape(len(self.t), -1)

    @property
    def commands(self) -> Vec:
        """Command of every axis (N, A)."""
        return self.command.reshape(len(self.t), -1)

    def save(self, path: Path) -> Path:
        """Write the record as CSV, whole or not at all; two axes have `angle_x_deg`, `angle_y_deg` and so on."""
        signals = {"reference_deg": self.reference_deg, "angle_deg": self.measured_deg, "command": self.command}
        made: dict[str, Sequence[str] | Vec] = {"time_s": self.t}
        for name, values in signals.items():
            rows = values.reshape(len(self.t), -1).T
            made |= dict(zip(columns(name, math.nan, len(rows)), rows, strict=True))
        late = np.array(self.late or [False] * len(self.source), dtype=np.float64)
        return write_atomically(path, format_table(made | {"source": self.source, "late": late}))

    @classmethod
    def load(cls, path: Path) -> Track:
        """Read a record from the CSV of `save`.

        Raises:
            LogError: if it is no such file.
        """
        table = read_table(read_lines(path), str(path))
        if "source" not in table.texts:
            raise LogError(f"{path}: got columns {', '.join(table.header)}, expected those of a tracked reference")
        n, axes = table.numbers, 1 if "command" in table.numbers else len(NAMES)

        def signal(name: str) -> Vec:
            read = [n[column] for column in columns(name, math.nan, axes)]
            return read[0] if axes == 1 else np.stack(read, axis=1)

        late = tuple(value > 0 for value in n["late"].tolist()) if "late" in n else ()  # tracks of earlier versions
        reference, angle, command = map(signal, ("reference_deg", "angle_deg", "command"))
        return cls(n["time_s"], reference, angle, command, table.texts["source"], late)


AnyTip = TipSettings | TwoAxisTipSettings
"""Settings of a planner's controller, of one axis or of two."""


class MovableDevice(Protocol):
    """Interface of a device for motions; each call starts and ends at rest at the safe command.

    Calls raise `DeviceStoppedError` after a safe stop, and `ConfigError` where the device does not answer or a stop is
    latched; nothing has moved then.
    """

    in_real_time: bool
    """Whether its motions take time."""

    used_s: float
    """Device time that all calls took together [s]."""

    def explore(self, name: str, phase: Phase, bench: BenchSettings) -> None:
        """Run a phase that chooses its commands and observes the angle limits itself."""
        ...

    def play(self, name: str, commands: Vec, bench: BenchSettings) -> Trial:
        """Play commands (N,), of two axes (N, 2), that start at the safe command, and record them.

        Raises:
            LogError: without any angle.
        """
        ...

    def track(self, name: str, tip: AnyTip, reference: AnyMotion, bench: BenchSettings) -> Track:
        """Track a reference with a controller."""
        ...


Open = Callable[[Path, Tick], MovableDevice]
"""Opens a device, given the folder of the work and what to call while a motion lasts."""


@final
class BenchDevice(MovableDevice):
    """Device behind a transport of the bench, with all safety functions of `run_bench`.

    A transport of another process is run in real time, each motion with its run folder under `folder/runs`, and
    prepared before the first motion of every stage. A device in this process (`kind: simulated`) is run on a simulated
    clock; each motion starts after a reset, with noise from its seed and the motion's name.

    Args:
        plants: makes devices of `kind: simulated`.
        folder: of the commissioning or investigation.
        angle_limits: for a safe stop of recordings and tracks [deg]; None for those of the sensor.
        views: live views of each motion.
        note: called with messages of the loop's process.
        tick: called once a second with the seconds of the present motion, from a thread outside the loop.
    """

    def __init__(
        self,
        settings: BenchSettings,
        plants: PlantFactory,
        folder: Path,
        angle_limits: tuple[float, float] | None = None,
        views: Views = Views(),
        note: Note = lambda text: None,
        tick: Tick = lambda seconds: None,
    ) -> None:
        self._plants, self._folder, self._views, self._note = plants, folder, views, note
        self._tick, self._angle_limits = tick, angle_limits
        self.in_real_time = not settings.transport.in_process
        self._prepared, self._moved = "", False
        earlier_s = mapping_in(folder / TIME_FILE).get("seconds")
        self.used_s = float(earlier_s) if isinstance(earlier_s, int | float) else 0.0

    def explore(self, name: str, phase: Phase, bench: BenchSettings) -> None:
        self._perform(name, [phase], bench)

    def play(self, name: str, commands: Vec, bench: BenchSettings) -> Trial:
        recorded = Recorded(name.rpartition("/")[2], commands, bench.dt_s)
        phases = [self._bounded(recorded, bench)]
        if len(bench.axes_limits) > 1:
            phases.insert(0, self._bounded(CommandMotion("shake", lambda held: shaken(bench)), bench))
        self._perform(name, phases, bench)
        trial = recorded.trial(bench.command_unit)
        if trial is None:
            raise LogError(f"{name}: got no angle, expected a recording")
        return trial

    def track(self, name: str, tip: AnyTip, reference: AnyMotion, bench: BenchSettings) -> Track:
        plain = {key: getattr(bench, key) for key in BenchSettings.model_fields} | {"limits": bench.limits.model_dump()}
        plain |= {"controller": tip, "reference": reference.model_dump()}
        frame: AxesFrame | None = None
        if len(bench.axes_limits) > 1:
            run = PlaneRunSettings.parse(plain, name)
            phase, frame = plane_tracking(run, threaded=self.in_real_time)
        else:
            phase = tracking_phase(RunSettings.parse(plain, name), threaded=self.in_real_time)
        samples = self._perform(name, [self._bounded(phase, bench)], bench, frame)
        return track_of(samples, reference.build().duration_s, bench.dt_s)

    def _bounded(self, phase: Phase, bench: BenchSettings) -> Phase:
        return Bounded(phase, self._angle_limits, bench.sensor, len(bench.axes_limits))

    def _perform(
        self, name: str, wanted: Sequence[Phase], bench: BenchSettings, frame: AxesFrame | None = None
    ) -> tuple[Sample, ...]:
        """One run on the device: preparation, approach to the safe command, the phases, the way back."""

        def approach(held: PerAxis) -> Vec:
            return waypoint_commands(held, [bench.safe_command], [bench.dt_s], bench.ramps, bench.dt_s)

        def phases() -> list[Phase]:
            return [CommandMotion("approach", approach), *wanted]

        kept, stage = SampleList(), name.partition("/")[0]
        settings = self._of_motion(name, stage, bench)
        folder = _free(self._folder / stage / "runs", name.rpartition("/")[2]) if self.in_real_time else None

        def sink() -> Sink:
            if folder is None:
                return kept
            axes, stages = len(settings.axes_limits), ("total", "execution")
            meta = RecordingMeta(settings.command_unit, stages=stages, axes=axes, inputs=settings.inputs)
            rate, note = settings.rate_hz, self._note
            return Tee(kept, open_recorder_process(folder, settings, meta, rate, self._views, note, report=False))

        clock = None if self.in_real_time else SimulatedClock()
        over = Event()
        if self.in_real_time:
            Thread(target=self._tell, args=(kept, settings.dt_s, over), name="progress", daemon=True).start()
        try:
            result = run_bench(
                settings, phases, sink, self._plants, folder=folder, note=self._note, clock=clock, frame=frame
            )
        finally:
            over.set()
            self.used_s += len(kept.samples) * settings.dt_s
            if kept.samples:
                write_atomically(self._folder / TIME_FILE, json.dumps({"seconds": round(self.used_s, 3)}) + "\n")
        if result.outcome.cause:
            raise DeviceStoppedError(result, settings)
        self._prepared, self._moved = stage, True
        return tuple(kept.samples)

    def _tell(self, kept: SampleList, dt_s: float, over: Event) -> None:
        while not over.wait(_TICK_S):
            self._tick(len(kept.samples) * dt_s)

    def _of_motion(self, name: str, stage: str, bench: BenchSettings) -> BenchSettings:
        """Settings of one motion: preparation once a stage; a seed by name for a computed device."""
        transport = bench.transport
        if isinstance(transport, SimulatedSettings):
            seed = transport.seed + zlib.crc32(name.encode()) % _SEEDS
            return bench.model_copy(update={"transport": transport.model_copy(update={"seed": seed})})
        changes: dict[str, object] = {"prepare": ()} if self._prepared == stage else {}
        if self._moved and bench.start_command is not None:
            changes["start_command"] = bench.safe_command  # where the motion before has left it
        return bench.model_copy(update=changes)


def opened_device(
    settings: CommissionSettings, folder: Path, views: Views = Views(), note: Note = lambda text: None
) -> Open:
    """Function that opens the device described by the settings.

    `folder` is the start of file names of a simulated plant; `views` and `note` as of `BenchDevice`.
    """
    plants, limits = plants_in(folder, settings.command_unit), settings.commission.angle_limits_deg
    return lambda root, tick: BenchDevice(settings, plants, root, limits, views, note, tick)


def track_of(samples: Sequence[Sample], duration_s: float, dt_s: float) -> Track:
    """Record of a reference of `duration_s` [s] from the samples of its run, without the lead-in.

    The reference is the end of the run. The angle at the end of a sample is that measured by the next one; NaN where
    that was skipped.

    Raises:
        LogError: if nothing was tracked.
    """
    steps = round(duration_s / dt_s)
    tracked = [k for k, sample in enumerate(samples[:-1]) if is_known(sample.reference_deg)]
    if not tracked:
        raise LogError("track: got a run without a tracked sample, expected a reference")
    first = samples[tracked[-1]].sequence - steps + 1
    counted = [k for k in tracked if samples[k].sequence >= first]
    rows = [samples[k] for k in counted]
    after = [samples[k + 1] for k in counted]
    before = [samples[max(k - 1, 0)] for k in counted]
    measured = [b.measured_deg if b.sequence == a.sequence + 1 else np.nan for a, b in zip(rows, after, strict=True)]
    measured = [like(row.command, angle) for row, angle in zip(rows, measured, strict=True)]
    return Track(
        t=dt_s * np.array([row.sequence - first + 1 for row in rows]),
        reference_deg=np.array([row.reference_deg for row in rows]),
        measured_deg=np.array(measured),
        command=np.array([row.command for row in rows]),
        source=tuple(str(row.source) for row in rows),
        late=tuple(a.missed or b.sequence > a.sequence + 1 for a, b in zip(before, rows, strict=True)),
    )


def _free(folder: Path, name: str) -> Path:
    """New folder of that name, numbered after interrupted runs."""
    free, number = folder / name, 1
    while free.exists():
        number += 1
        free = folder / f"{name}-{number}"
    return free


_NOISE_DEG = 0.05  # default: an angle that never changes would be taken for a dead sensor


def make_plant(settings: Mapping[str, Any], dt_s: float, seed: int, folder: Path, unit: str) -> tuple[Plant, PerAxis]:
    """Build the plant of a block `plant` and return it with its held command after a reset.

    The block has `simulator` or `device`, parameters and effects. Relative file names start at `folder`; `seed` is that
    of the noise, `unit` the required one of the command. A simulator of two axes gives a plant of two commands.

    Raises:
        ConfigError: on an unknown device, key or parameter, a value out of bounds, or another unit.
        ModelError: if a simulator file is missing or unusable.
    """
    from hystmpc.models.load import model_path  # simulators take long to import, and most benches have a device
    from hystmpc.models.two_axes.model import has_two_axes
    from hystmpc.sim.config import PlantSettings
    from hystmpc.sim.plants.device import make_plant as make

    if has_two_axes(folder / str(settings.get("simulator"))):
        return _plane_plant(settings, dt_s, seed, folder, unit)
    noise = {"noise_deg": _NOISE_DEG} if "device" in settings else {}
    block = PlantSettings.parse(noise | dict(settings), "plant")
    block = block.model_copy(update={"inputs": {name: one.in_folder(folder) for name, one in block.inputs.items()}})
    if block.simulator is not None:
        block = block.model_copy(update={"simulator": str(model_path(block.simulator, folder))})
    plant = make(block, dt_s, seed=seed)
    if plant.command_unit != unit:
        raise ConfigError(f"plant: got a device with commands in {plant.command_unit}, expected command_unit {unit}")
    return plant, plant.rest_command


def _plane_plant(settings: Mapping[str, Any], dt_s: float, seed: int, folder: Path, unit: str) -> tuple[Plant, PerAxis]:
    from hystmpc.models.two_axes.model import AXES, load_two_axes
    from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
    from hystmpc.sim.two_axes.plant import TwoAxisPlant

    block = TwoAxisPlantSettings.parse({"noise_deg": _NOISE_DEG} | dict(settings), "plant")
    model = load_two_axes(folder / block.simulator).at_sample_time(dt_s)
    if (count := len(model.command_limits)) != AXES:
        raise ConfigError(f"plant: got a model of {count} commands, expected two: Clarke's coordinates of tendons")
    plant = TwoAxisPlant(model, block, seed)
    if plant.command_unit != unit:
        raise ConfigError(f"plant: got a device with commands in {plant.command_unit}, expected command_unit {unit}")
    return cast(Plant, plant), from_array(plant.rest_command)  # the loop passes on what it gets


def plants_in(folder: Path, unit: str) -> PlantFactory:
    """Factory of simulated devices for the transport `kind: simulated`."""

    def made(settings: SimulatedSettings, dt_s: float) -> tuple[Plant, PerAxis]:
        return make_plant(settings.plant, dt_s, settings.seed, folder, unit)

    return made
