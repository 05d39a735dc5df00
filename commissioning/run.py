"""A commissioning from beginning to end: stage after stage, each kept when it is complete."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.rig.bench import Note
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.recording.recorder_process import Views
from hystmpc.sim.jobs.runner import alone_in
from hystmpc.trials.brief import brief
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError, HystmpcError, LogError
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.read import expand_logs, read_trials
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Progress

from .bounded import Bounded
from .climb import Climb, Climbed, dash
from .config import CommissionBlock, CommissionSettings, narrowed
from .controller import TIP_FILE, ControllerMade, fresh_references, make_controllers
from .device import BenchDevice, Device, DeviceStoppedError, Tick
from .identify import (
    FIXED_FILE,
    MODEL_FILE,
    Checked,
    Diagnosed,
    Fitted,
    Subject,
    check_trials,
    diagnose_model,
    fit_model,
)
from .motions import CONTROLLERS, SCANS_HZ, Budget, budget, directions, recordings
from .plants import plants_in
from .stages import NAMES, Figure, StageStore, begun_folder, differing, fingerprint
from .verify import Tracks, Verified, judge, load_tracks, track_all

RANGE, RECORD, CHECK, FIT, DIAGNOSE, CONTROLLER, VERIFY = NAMES
REPORT_FILE = "report.html"
_LEAST_RANGE = 0.2  # of the limits: a narrower range says that something is wrong
_LEAST_MOTION = 0.02  # of the angle limits
_REPORT = "report"
_COMPUTING_S = {FIT: 60.0, DIAGNOSE: 150.0, CONTROLLER: 40.0, _REPORT: 10.0}  # expected, for the bar
_COMPUTED = 0.05  # seconds that a computed device takes for one of its own


class EndedEarlyError(HystmpcError):
    """The device has moved, and a stage could not be completed; what was recorded is kept."""


@dataclass(frozen=True)
class Ranged:
    """The range and the rate that are used from here on.

    Attributes:
        lower, upper: of the command.
        rate_per_s: greatest change of the command.
        low_deg, high_deg: angles at rest within the range [deg].
        words: how they were found.
        still: longest travel of the command in which the tip did not move.
    """

    lower: float
    upper: float
    rate_per_s: float
    low_deg: Figure
    high_deg: Figure
    words: str
    still: float = 0.0


@dataclass(frozen=True)
class RecordedTrials:
    """Names of the recordings, in their order."""

    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Commissioned:
    """What a commissioning left behind.

    Attributes:
        folder: of the run.
        tip: file for `TipController.from_config`.
        model: that it predicts with.
        report: the page.
        verified: the verdict; None after a commissioning from logs.
        device_s: device time used [s].
    """

    folder: Path
    tip: Path
    model: Path
    report: Path
    verified: Verified | None
    device_s: float
    __repr__ = brief


@dataclass
class _Bar:
    """Seconds done of those expected, over all stages."""

    progress: Progress | None
    total_s: float
    before_s: float = 0.0
    _now_s: float = 0.0
    _note: str = ""

    def tick(self, seconds: float) -> None:
        """Seconds since the last call, of a motion that lasts."""
        if self.progress is not None:
            self.progress(min(self.before_s + self._now_s + seconds, self.total_s), self.total_s, self._note)

    def __call__(self, seconds: float, note: str) -> None:
        self._now_s, self._note = seconds, note
        if self.progress is not None:
            self.progress(min(self.before_s + seconds, self.total_s), self.total_s, note)

    def of(self, expected_s: float, what: str) -> Progress:
        """A stage's own progress as seconds of the whole."""
        return lambda done, total, note="": self(expected_s * done / max(total, 1e-9), f"{what} {note}".strip())


def plan_rows(settings: CommissionSettings, found: Budget) -> tuple[tuple[str, str, float], ...]:
    """Stages with their motions and minutes of device time, as they are said before anything moves."""
    steps, own = settings.commission.range_steps, settings.commission.motions
    motions = len(own) if own else 1 + len(SCANS_HZ)
    prepare = f"; preparation {found.prepare_s:.0f} s" if found.prepare_s else ""
    rows = [
        (RANGE, f"climb in {steps} steps, a dash at the greatest rate{prepare}", found.range_s + found.prepare_s),
        (RECORD, f"6 recordings: steps, holds, sines, reversals{prepare}", found.record_s + found.prepare_s),
        (CHECK, "none", 0.0),
        (FIT, "none", 0.0),
        (DIAGNOSE, "none" if settings.commission.diagnose else "left out", 0.0),
        (CONTROLLER, "none", 0.0),
        (
            VERIFY,
            f"{motions} references with {len(CONTROLLERS)} controllers, {found.motion_s:.0f} s each{prepare}",
            found.verify_s + found.prepare_s,
        ),
    ]
    return (*((name, what, seconds / 60) for name, what, seconds in rows), ("all", "", found.total_s / 60))


def commission_device(
    settings: CommissionSettings,
    device: Callable[[Path, Tick], Device],
    out: Path | str,
    progress: Progress | None = None,
) -> Commissioned:
    """Find the safe range and rate, record, check, identify, diagnose, make the controller, verify it, report.

    The same call goes on after the last complete stage, and within recordings and verification after the last complete
    motion.

    Args:
        device: opens the device, given the folder and what to tell while a motion lasts.
        out: a new or empty folder, or one in which the same commissioning was begun.
        progress: called with seconds done, seconds expected in all, and what is being done.

    Raises:
        ConfigError: before anything moves: on a folder that holds something else, minutes that are too few, a device
            that does not answer, or a latched stop.
        DeviceStoppedError: if a motion was stopped safely; complete trials are kept.
        EndedEarlyError: if a stage cannot be completed after the device has moved.
        KeyboardInterrupt: if the user ended it while something was computed.
    """
    planned = budget(settings)
    root = begun_folder(out, "commissioning", settings.model_dump(mode="json"), settings.commission.seed)
    with alone_in(root):
        bar = _Bar(progress, 0.0)
        moved = device(root, bar.tick)
        bar.total_s, before = _expected_s(settings, moved, planned), moved.used_s
        try:
            store = StageStore(root, fingerprint(settings.model_dump(mode="json")))
            return _on_device(settings, moved, store, planned, bar)
        except (DeviceStoppedError, EndedEarlyError):
            raise
        except HystmpcError as error:
            if moved.used_s > before:
                raise EndedEarlyError(f"{error} (what was recorded is kept in {root})") from error
            raise


def commission_logs(
    logs: Sequence[Path | str],
    out: Path | str,
    settings: CommissionSettings | None = None,
    progress: Progress | None = None,
) -> Commissioned:
    """The same from recordings alone: check, identify, diagnose, make the controller, report; nothing is verified.

    Args:
        logs: files or folders.
        settings: of the bench, for limits, rate and safe command; what the recordings show where left out.

    Raises:
        HystmpcError: if the recordings or the folder cannot be used.
        KeyboardInterrupt: if the user ended it; complete stages are kept.
    """
    files = tuple(path.resolve() for path in expand_logs([Path(log) for log in logs]))
    subject, words = _from_logs(files, settings)
    plain: dict[str, Any] = {} if settings is None else settings.model_dump(mode="json")
    hashes = _hashes(files)
    root = begun_folder(out, "commissioning", plain | {"logs": hashes}, subject.block.seed)
    stages = [FIT, CONTROLLER, _REPORT] + ([DIAGNOSE] if subject.block.diagnose else [])
    with alone_in(root):
        store = StageStore(root, fingerprint(plain | {"logs": hashes}))
        bar = _Bar(progress, sum(_COMPUTING_S[name] for name in stages))
        known = _identified(subject, store, bar)
        bar(0.0, _REPORT)
        return _reported(known, root, words, 0.0, None, None)


@only_reads()
def report_again(folder: Path | str) -> Commissioned:
    """Write the report of a complete commissioning again from what its stages have left; no device is opened.

    Raises:
        ConfigError: if a stage was begun after other results than those before it, or another process works in it.
        LogError: if the folder holds no complete commissioning, or a recording that it was made from has changed.
    """
    run = RunFolder.open(folder)
    config = run.config()
    if not isinstance(config, Mapping) or "commissioning" not in config:
        raise LogError(f"{folder}: holds another kind of run, expected the folder of a commissioning")
    plain = {key: value for key, value in config.items() if key != "commissioning"}
    bench = {key: value for key, value in plain.items() if key != "logs"}
    settings = CommissionSettings.parse(bench, str(run.path / "config.yaml")) if bench else None
    bar = _Bar(None, 0.0)
    with alone_in(run.path):
        store = StageStore(run.path, fingerprint(plain), closed=True)
        if settings is not None and "logs" not in plain:
            device = opened_device(settings, run.path)(run.path, bar.tick)
            return _on_device(settings, device, store, budget(settings), bar)
        files = tuple(map(Path, plain["logs"]))
        subject, words = _from_logs(files, settings)
        if text := differing({"logs": plain["logs"]}, {"logs": _hashes(files)}):
            raise LogError(f"{run.path}: {text}; expected the recordings that it was made from")
        return _reported(_identified(subject, store, bar), run.path, words, 0.0, None, None)


def opened_device(
    settings: CommissionSettings, folder: Path, views: Views = Views(), note: Note = lambda text: None
) -> Callable[[Path, Tick], Device]:
    """Opens the device of the settings.

    Args:
        folder: where file names of a simulated plant start.
        views: what is shown while a motion lasts.
        note: told what the loop's process says.
    """
    plants = plants_in(folder, settings.command_unit)
    limits = settings.commission.angle_limits_deg
    return lambda root, tick: BenchDevice(settings, plants, root, limits, views, note, tick)


def _hashes(files: Sequence[Path]) -> dict[str, str]:
    return {str(path): fingerprint(path.read_bytes().hex()) for path in files}


def _on_device(
    settings: CommissionSettings, device: Device, store: StageStore, planned: Budget, bar: _Bar
) -> Commissioned:
    root = store.root
    in_time = 1.0 if device.in_real_time else _COMPUTED
    bar(0.0, "range")
    ranged, store = store.complete(RANGE, Ranged, lambda folder: _ranged(settings, device))
    bench = narrowed(settings, ranged.lower, ranged.upper, ranged.rate_per_s, ranged.still)
    bar.before_s += in_time * (planned.range_s + planned.prepare_s)
    seconds = in_time * (planned.record_s + planned.prepare_s)

    def record(folder: Path) -> RecordedTrials:
        return _record(settings, bench, device, folder, planned, bar.of(seconds, "record"))

    recorded, store = store.complete(RECORD, RecordedTrials, record)
    bar.before_s += seconds
    subject = Subject(
        name=settings.name,
        command_unit=settings.command_unit,
        rate_hz=settings.rate_hz,
        limits=bench.limits.build(),
        safe_command=settings.safe_command,
        angle_limits=settings.angle_limits,
        trials=tuple(_trial_file(root / RECORD, name) for name in recorded.names),
        block=settings.commission,
    )
    known = _identified(subject, store, bar)
    tracks = dict[str, Any]()
    seconds = in_time * (planned.verify_s + planned.prepare_s)

    def verify(folder: Path) -> Verified:
        motions = fresh_references(subject, known.made.reached, planned.motion_s)
        told = bar.of(seconds, "verify")
        count = len(motions) * len(CONTROLLERS)
        tracks.update(track_all(device, motions, bench, folder, lambda done, what: told(done, count, what)))
        noise = known.fitted.sensor_sigma_deg
        return judge(tracks, subject.limits, settings.dt_s, noise, known.fitted.model_sigma_deg)

    verified, _ = known.store.complete(VERIFY, Verified, verify)
    if not tracks:
        tracks.update(load_tracks(root / VERIFY))
    bar.before_s += seconds
    bar(0.0, _REPORT)
    return _reported(known, root, ranged.words, device.used_s, tracks, verified)


def _expected_s(settings: CommissionSettings, device: Device, planned: Budget) -> float:
    computing = sum(s for name, s in _COMPUTING_S.items() if name != DIAGNOSE or settings.commission.diagnose)
    return computing + planned.total_s * (1.0 if device.in_real_time else _COMPUTED)


def _ranged(settings: CommissionSettings, device: Device) -> Ranged:
    """Climb in every direction, then dash; what was found is narrower than the limits or as wide."""
    block, found = settings.commission, dict[float, Climbed]()
    for k, end in enumerate(directions(settings)):
        climb = Climb(settings, end, settings.angle_limits, block.range_steps, block.angle_limits_deg is None)
        device.explore(f"{RANGE}/climb-{k + 1}", climb, settings)
        found[end] = climb.found
    safe, limits = settings.safe_command, settings.limits
    ends = [safe, *(c.end for c in found.values() if math.isfinite(c.end))]
    lower, upper = min(ends), max(ends)
    angles = [a for c in found.values() for a in (c.start_deg, c.angle_deg) if math.isfinite(a)]
    words = "; ".join(f"to {c.end:.4g} {settings.command_unit}: {c.why}" for c in found.values())
    if upper - lower < _LEAST_RANGE * (limits.upper - limits.lower):
        raise LogError(
            f"range: got {lower:.4g} to {upper:.4g} {settings.command_unit} ({words}), expected at least "
            f"{100 * _LEAST_RANGE:.0f} % of the limits; correct limits, sensor or commission.angle_limits_deg"
        )
    low_deg, high_deg = min(angles), max(angles)
    if high_deg - low_deg < _LEAST_MOTION * (settings.angle_limits[1] - settings.angle_limits[0]):
        raise LogError(
            f"range: the angle moved by {high_deg - low_deg:.2f} deg over {lower:.4g} to {upper:.4g} "
            f"{settings.command_unit}, expected a device that moves; is the tip blocked, the sensor fixed?"
        )
    first = next(iter(found.values()))
    if (first.angle_deg - first.start_deg) * (first.end - safe) < 0:
        raise LogError(
            "range: the angle falls as the command rises, expected it to rise; set wire.angle_sign: -1 (and "
            "wire.angle_offset_deg)"
        )
    still = max(c.still for c in found.values())
    within = narrowed(settings, lower, upper, limits.rate_per_s, still)
    rate, said = _dashed(within, first.end, device, block.angle_limits_deg)
    return Ranged(lower, upper, rate, low_deg, high_deg, f"{words}; {said}", still)


def _dashed(
    bench: BenchSettings, end: float, device: Device, angle_limits: tuple[float, float] | None
) -> tuple[float, str]:
    phase = dash(bench, end)
    device.explore(f"{RANGE}/dash", Bounded(phase, angle_limits, bench.sensor), bench)
    rate, limit = float(f"{phase.rate_per_s:.4g}"), bench.limits.rate_per_s
    rate = min(rate, limit)
    if not phase.tells:
        return rate, f"the device does not tell what it holds, so that {limit:g} per s is taken as it is"
    return rate, f"the device follows {limit:g} per s" if rate == limit else f"it follows {rate:g} of {limit:g} per s"


def _record(
    settings: CommissionSettings,
    bench: BenchSettings,
    device: Device,
    folder: Path,
    planned: Budget,
    told: Progress,
) -> RecordedTrials:
    """Record what is not there yet."""
    motions = recordings(bench, planned.share, settings.commission.seed)
    total, done = sum(commands.size for commands in motions.values()), 0
    for name, commands in motions.items():
        told(done, total, name)
        file = _trial_file(folder, name)
        if not file.exists():
            write_csv(device.play(f"{RECORD}/{name}", commands, bench), file)
        done += commands.size
    return RecordedTrials(tuple(motions))


def _trial_file(folder: Path, name: str) -> Path:
    return folder / "trials" / f"{name}.csv"


@dataclass(frozen=True, eq=False)
class _Known:
    """What stages 3 to 6 have found."""

    subject: Subject
    checked: Checked
    fitted: Fitted
    diagnosed: Diagnosed | None
    made: ControllerMade
    model: Path
    store: StageStore


def _identified(subject: Subject, store: StageStore, bar: _Bar) -> _Known:
    """Stages 3 to 6."""
    root, diagnosed = store.root, None
    checked, store = store.complete(CHECK, Checked, lambda folder: check_trials(subject))

    def told(name: str, what: str) -> Progress:
        return bar.of(_COMPUTING_S[name], what)

    fitted, store = store.complete(FIT, Fitted, lambda folder: fit_model(subject, folder, told(FIT, "identify")))
    model = root / FIT / MODEL_FILE
    bar.before_s += _COMPUTING_S[FIT]
    if subject.block.diagnose:
        given = model
        diagnosed, store = store.complete(
            DIAGNOSE, Diagnosed, lambda folder: diagnose_model(subject, given, folder, told(DIAGNOSE, "diagnose"))
        )
        model = root / DIAGNOSE / FIXED_FILE if diagnosed.corrected else model
        bar.before_s += _COMPUTING_S[DIAGNOSE]

    def make(folder: Path) -> ControllerMade:
        noise = fitted.sensor_sigma_deg if math.isfinite(fitted.sensor_sigma_deg) else 0.0
        return make_controllers(subject, model, noise, folder, told(CONTROLLER, "tune"))

    made, store = store.complete(CONTROLLER, ControllerMade, make)
    bar.before_s += _COMPUTING_S[CONTROLLER]
    return _Known(subject, checked, fitted, diagnosed, made, model, store)


def _reported(
    known: _Known, root: Path, words: str, used_s: float, tracks: Tracks | None, verified: Verified | None
) -> Commissioned:
    from .report import Story, write_report  # matplotlib takes a second to import

    story = Story(
        known.subject,
        words,
        known.checked,
        known.fitted,
        known.diagnosed,
        known.made,
        known.model,
        used_s,
        tracks,
        verified,
    )
    report = write_report(story, root / REPORT_FILE)
    return Commissioned(root, root / TIP_FILE, known.model, report, verified, used_s)


def _from_logs(files: Sequence[Path], settings: CommissionSettings | None) -> tuple[Subject, str]:
    """What is identified from logs, and where its limits come from.

    Raises:
        ConfigError: if the logs are beyond the limits of the bench, or in another unit.
        LogError: if a log cannot be read.
    """
    trials = read_trials(files)
    low = min(float(trial.command.min()) for trial in trials)
    high = max(float(trial.command.max()) for trial in trials)
    rates = [np.abs(np.diff(trial.command)) / np.diff(trial.t) for trial in trials]
    unit = trials[0].units.command
    if settings is None:
        rate = max(float(steps.max()) for steps in rates)
        if not (low < high and rate > 0):
            raise LogError("logs: the command does not move, expected recordings of a motion")
        words = f"as the recordings show: {low:.4g} to {high:.4g} {unit} at {rate:.4g} per s"
        hz = float(f"{1 / trials[0].dt:.4g}")
        limits = CommandLimits(low, high, rate)
        return Subject("recorded device", unit, hz, limits, low, None, tuple(files), CommissionBlock()), words
    bounds, safe = settings.limits, settings.safe_command
    if unit != settings.command_unit:
        raise ConfigError(f"logs: got commands in {unit}, expected the bench's {settings.command_unit}")
    low, high = max(min(low, safe), bounds.lower), min(max(high, safe), bounds.upper)
    if not low < high:
        raise ConfigError(f"logs: commands are beyond the bench's limits {bounds.build()}, expected some within them")
    words = f"commands that the recordings show within the bench's limits: {low:.4g} to {high:.4g} {unit}"
    limits = CommandLimits(low, high, bounds.rate_per_s)
    found = (settings.name, unit, settings.rate_hz, limits, safe, settings.angle_limits)
    return Subject(*found, tuple(files), settings.commission), words
