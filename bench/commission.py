"""Commissioning: safe range, recordings, check, identification, diagnosis, controller, verification, report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.rig.axes import NAMES as AXIS_NAMES
from hystmpc.rig.axes import PerAxis, each, in_words, of_axis, together
from hystmpc.rig.config import BenchSettings
from hystmpc.sim.results import Limits
from hystmpc.trials.axes import both_axes
from hystmpc.trials.brief import brief
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.read import expand_logs, read_trials
from hystmpc.trials.run_folder import RunFolder, alone_in
from hystmpc.trials.types import Progress

from .config import CommissionBlock, CommissionSettings, PlaneCommissionBlock, kind_of_commission, narrowed
from .device import MovableDevice, Open, opened_device
from .identify import (
    FIXED_FILE,
    MODEL_FILE,
    TIP_FILE,
    ControllerFiles,
    FittedModel,
    IdentifiedDevice,
    ModelDiagnosis,
    Subject,
    TrialCheck,
    check_trials,
    diagnose_model,
    fit_model,
    fresh_references,
    make_controllers,
    subject_of,
)
from .motions import CONTROLLERS, CORNER_STEPS, SCANS_HZ, Budget, budget, corners, directions, recordings
from .phases import Bounded, Climb, ClimbResult, Dash, moving_axes
from .plane import diagnose_both, fit_both, make_plane_controllers
from .stages import AxisFigures, Stages, begun, differing, fingerprint
from .verify import MPC, Tracks, Verification, judge_tracks, load_tracks, track_all

NAMES = ("1-range", "2-record", "3-check", "4-fit", "5-diagnose", "6-controller", "7-verify")
"""Folders of the stages, in their order."""

RANGE, RECORD, CHECK, FIT, DIAGNOSE, CONTROLLER, VERIFY = NAMES
REPORT_FILE = "report.html"
_LEAST_RANGE = 0.2  # of the limits: a narrower range says that something is wrong
_LEAST_CORNER = 0.5  # of the ranges of two axes: a narrower one says that one angle hardly leaves the other any room
_LEAST_MOTION = 0.02  # of the angle limits
_COMPUTING_S = {FIT: 60.0, DIAGNOSE: 150.0, CONTROLLER: 40.0, "report": 10.0}  # expected, for the bar


@dataclass(frozen=True)
class CommandRange:
    """Range and rate of the command for all further stages, with the angles at rest within it [deg].

    Of two axes each is a pair.
    """

    lower: AxisFigures
    upper: AxisFigures
    rate_per_s: AxisFigures
    low_deg: AxisFigures
    high_deg: AxisFigures
    words: str  # how they were determined
    still: float = 0.0  # longest travel of the command in which the tip did not move


@dataclass(frozen=True)
class RecordedTrials:
    """File names of the recordings, in their order."""

    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Commissioned:
    """Result of a commissioning."""

    folder: Path
    tip: Path  # file for `TipController.from_config`
    model: Path  # simulator that the controller predicts with
    report: Path
    verified: Verification | None  # the verdict; None after a commissioning from logs
    device_s: float  # device time used [s]
    joined: str = ""  # what joins the axes of a device of two, in one line; empty of one axis
    __repr__ = brief


def plan_rows(settings: CommissionSettings, planned: Budget) -> tuple[tuple[str, str, float], ...]:
    """Rows of the plan: stage, its motions, and minutes of device time."""
    steps, given = settings.commission.range_steps, settings.commission.motions
    motions = len(given) if given else 1 + len(SCANS_HZ)
    prepare = f"; preparation {planned.prepare_s:.0f} s" if planned.prepare_s else ""
    climbs, recorded = f"climb in {steps} steps, a dash", "6 recordings: steps, holds, sines, reversals"
    if len(settings.axes_limits) > 1:
        climbs = f"climbs of x and y in {steps} steps, to 4 corners, dashes"
        recorded = "6 recordings of each axis alone, 5 of both: circles, rows, reversals, one left out of the fit"
    rows = [
        (RANGE, f"{climbs} at the greatest rate{prepare}", planned.range_s + planned.prepare_s),
        (RECORD, f"{recorded}{prepare}", planned.record_s + planned.prepare_s),
        (CHECK, "none", 0.0),
        (FIT, "none", 0.0),
        (DIAGNOSE, "none" if settings.commission.diagnose else "left out", 0.0),
        (CONTROLLER, "none", 0.0),
        (
            VERIFY,
            f"{motions} references with {len(CONTROLLERS)} controllers, {planned.motion_s:.0f} s each{prepare}",
            planned.verify_s + planned.prepare_s,
        ),
    ]
    return (*((name, what, seconds / 60) for name, what, seconds in rows), ("all", "", planned.total_s / 60))


def commission_device(
    settings: CommissionSettings,
    device: Open,
    out: Path | str,
    progress: Progress | None = None,
) -> Commissioned:
    """Commission a device: safe range and rate, recordings, model, controller, verification, report.

    The same call resumes after the last complete stage, and within recordings and verification after the last motion.

    Args:
        device: opens the device, given the folder and the callback for progress within a motion.
        out: a new or empty folder, or one in which the same commissioning was begun.
        progress: called with seconds done, seconds expected in all, and a note.

    Raises:
        ConfigError: before anything moves: on a foreign folder, too few minutes, a silent device, or a latched stop.
        DeviceStoppedError: if a motion was stopped safely; complete trials are kept.
        EndedEarlyError: if a stage cannot be completed after the device has moved.
        KeyboardInterrupt: if the user ended a computation.
    """
    planned, block = budget(settings), settings.commission
    with begun(out, "commissioning", settings.model_dump(mode="json"), block.seed, device, progress) as stages:
        stages.expect(planned.total_s, _computing_s(block))
        return _on_device(settings, stages, planned)


def commission_logs(
    logs: Sequence[Path | str],
    out: Path | str,
    settings: CommissionSettings | None = None,
    progress: Progress | None = None,
) -> Commissioned:
    """Commission from recordings alone: model, controller and report, without a verification on the device.

    Args:
        settings: of the bench, for limits, rate and safe command; what the recordings show where left out.

    Raises:
        HystmpcError: if the recordings or the folder cannot be used.
        KeyboardInterrupt: if the user ended it; complete stages are kept.
    """
    files = tuple(path.resolve() for path in expand_logs([Path(log) for log in logs]))
    subject, words = _from_logs(files, settings)
    plain: dict[str, Any] = {} if settings is None else settings.model_dump(mode="json")
    with begun(out, "commissioning", plain | {"logs": _hashes(files)}, subject.block.seed, None, progress) as stages:
        stages.expect(0.0, _computing_s(subject.block))
        return _reported(_identified(subject, stages), stages, words)


@only_reads()
def rewrite_report(folder: Path | str) -> Commissioned:
    """Rewrite the report of a complete commissioning from the results of its stages, without moving the device.

    Raises:
        ConfigError: if a stage follows other results than those before it, or another process works in the folder.
        LogError: if the folder holds no complete commissioning, or a recording has changed.
    """
    run = RunFolder.open(folder)
    config = run.config()
    if not isinstance(config, Mapping) or "commissioning" not in config:
        raise LogError(f"{folder}: holds another kind of run, expected the folder of a commissioning")
    plain = {key: value for key, value in config.items() if key != "commissioning"}
    bench = {key: value for key, value in plain.items() if key != "logs"}
    kind = kind_of_commission(bench, run.path)
    settings = kind.parse(bench, str(run.path / "config.yaml")) if bench else None
    with alone_in(run.path):
        if settings is not None and "logs" not in plain:
            stages = Stages(run.path, plain, opened_device(settings, run.path), closed=True)
            return _on_device(settings, stages, budget(settings))
        files = tuple(map(Path, plain["logs"]))
        subject, words = _from_logs(files, settings)
        stages = Stages(run.path, plain, closed=True)
        if text := differing({"logs": plain["logs"]}, {"logs": _hashes(files)}):
            raise LogError(f"{run.path}: {text}; expected the recordings that it was made from")
        return _reported(_identified(subject, stages), stages, words)


def _hashes(files: Sequence[Path]) -> dict[str, str]:
    return {str(path): fingerprint(path.read_bytes().hex()) for path in files}


def _computing_s(block: CommissionBlock) -> float:
    return sum(seconds for name, seconds in _COMPUTING_S.items() if name != DIAGNOSE or block.diagnose)


def _on_device(settings: CommissionSettings, stages: Stages, planned: Budget) -> Commissioned:
    """Execute all stages; complete ones are loaded."""
    seconds = planned.range_s + planned.prepare_s
    ranged = stages.complete(RANGE, CommandRange, lambda folder: _ranged(settings, stages), device_s=seconds)
    bench = narrowed(settings, ranged.lower, ranged.upper, ranged.rate_per_s, ranged.still)

    def record(folder: Path) -> RecordedTrials:
        motions = recordings(bench, planned.share, settings.commission.seed)
        return RecordedTrials(tuple(stages.record(motions, bench, folder)))

    recorded = stages.complete(RECORD, RecordedTrials, record, device_s=planned.record_s + planned.prepare_s)
    trials = [stages.root / RECORD / "trials" / f"{name}.csv" for name in recorded.names]
    limits = bench.axes_limits
    subject = subject_of(settings, _of_all(limits), trials)
    identified = _identified(subject, stages)

    def verify(folder: Path) -> Verification:
        motions = fresh_references(subject, identified.made.reached, planned.motion_s)
        tracks = track_all(stages.device, motions, bench, folder, lambda what: stages.say(f"verify {what}"))
        fitted = identified.fitted
        return judge_tracks(tracks, subject.limits, settings.dt_s, fitted.sensor_sigma_deg, fitted.model_sigma_deg)

    verified = stages.complete(VERIFY, Verification, verify, device_s=planned.verify_s + planned.prepare_s)
    tracks = load_tracks(stages.root / VERIFY)
    in_order = {motion: tracks[motion] for motion in verified.scores[MPC].by_motion if motion in tracks}
    return _reported(identified, stages, ranged.words, in_order, verified)


def _ranged(settings: CommissionSettings, stages: Stages) -> CommandRange:
    """Determine the command range by climbs from the safe command, and its rate by a dash, within the limits.

    Of two axes each climbs alone, then both climb at once towards every corner: the range is made smaller until its
    corners are within the limits of both angles.
    """
    stages.say("range")
    limits, safe = settings.axes_limits, each(settings.safe_command)
    climbs = [_climbed(settings, stages, end, k) for k, end in enumerate(directions(settings))]
    ends = [[each(c.end)[i] for c in climbs if i in moving_axes(settings, c.end)] for i in range(len(safe))]
    lower, upper = (
        [within([at, *(end for end in one if math.isfinite(end))]) for at, one in zip(safe, ends, strict=True)]
        for within in (min, max)
    )
    words = "; ".join(_range_words(settings, c) for c in climbs)
    for i in range(len(limits)):
        _require_motion(
            settings, [c for c in climbs if i in moving_axes(settings, c.end)], i, lower[i], upper[i], words
        )
    reached = narrowed(settings, together(lower), together(upper), together(one.rate for one in limits))
    share, said = _cornered(settings, stages, reached, len(climbs))
    lower, upper = (
        [end if share == 1.0 else at + share * (end - at) for at, end in zip(safe, side, strict=True)]
        for side in (lower, upper)
    )
    still = max(c.still for c in climbs)
    within = narrowed(settings, together(lower), together(upper), together(one.rate for one in limits), still)
    first = [next(c.end for c in climbs if i in moving_axes(settings, c.end)) for i in range(len(safe))]
    rates = [_dashed(within, end, stages.device, settings, i) for i, end in enumerate(first)]
    angles = np.array([each(a) for c in climbs for a in (c.start_deg, c.angle_deg)])
    words = "; ".join([words, *said, *(text for _, text in rates)])
    return CommandRange(
        lower=together(lower),
        upper=together(upper),
        rate_per_s=together(rate for rate, _ in rates),
        low_deg=together(np.nanmin(angles, axis=0).tolist()),
        high_deg=together(np.nanmax(angles, axis=0).tolist()),
        words=words,
        still=still,
    )


def _climbed(settings: CommissionSettings, stages: Stages, end: PerAxis, number: int) -> ClimbResult:
    block = settings.commission
    climb = Climb(settings, end, settings.angle_limits, block.range_steps, block.angle_limits_deg is None)
    stages.device.explore(f"{RANGE}/climb-{number + 1}", climb, settings)
    return climb.result


def _range_words(settings: CommissionSettings, climb: ClimbResult) -> str:
    return f"to {in_words(climb.end, '.4g')} {settings.command_unit}: {climb.why}"


def _require_motion(
    settings: CommissionSettings, climbs: Sequence[ClimbResult], axis: int, lower: float, upper: float, words: str
) -> None:
    """Refuse a range that is too narrow, and an axis that does not move, or not with its command.

    Raises:
        LogError: in one line that says what to correct.
    """
    limits, unit, safe = settings.axes_limits[axis], settings.command_unit, each(settings.safe_command)[axis]
    at = f"range of {AXIS_NAMES[axis]}" if len(settings.axes_limits) > 1 else "range"
    if upper - lower < _LEAST_RANGE * (limits.upper - limits.lower):
        raise LogError(
            f"{at}: got {lower:.4g} to {upper:.4g} {unit} ({words}), expected at least "
            f"{100 * _LEAST_RANGE:.0f} % of the limits; correct limits, sensor or commission.angle_limits_deg"
        )
    seen = np.array([each(a) for c in climbs for a in (c.start_deg, c.angle_deg)])
    moved = np.nanmax(seen, axis=0) - np.nanmin(seen, axis=0)
    if moved[axis] < _LEAST_MOTION * (settings.angle_limits[1] - settings.angle_limits[0]):
        raise LogError(
            f"{at}: the angle moved by {moved[axis]:.2f} deg over {lower:.4g} to {upper:.4g} "
            f"{unit}, expected a device that moves; is the tip blocked, the sensor fixed?"
        )
    if moved[axis] < moved.max():
        raise LogError(
            f"{at}: the command moved angle {AXIS_NAMES[1 - axis]} by {moved.max():.2f} deg and angle "
            f"{AXIS_NAMES[axis]} by {moved[axis]:.2f} deg, expected more of {AXIS_NAMES[axis]}; exchange the angles or "
            "the commands"
        )
    first = climbs[0]
    start, end = each(first.start_deg)[axis], each(first.angle_deg)[axis]
    if (end - start) * (each(first.end)[axis] - safe) < 0:
        raise LogError(
            f"{at}: the angle falls as the command rises, expected it to rise; set wire.angle_sign: -1 (and "
            "wire.angle_offset_deg)"
        )


def _cornered(
    settings: CommissionSettings, stages: Stages, reached: BenchSettings, climbs: int
) -> tuple[float, list[str]]:
    """Part of the range of two axes whose corners are within the limits of both angles; 1 of one axis."""
    share, block = 1.0, settings.commission
    for k, corner in enumerate(corners(reached)):
        climb = Climb(reached, corner, settings.angle_limits, CORNER_STEPS, block.angle_limits_deg is None)
        stages.device.explore(f"{RANGE}/climb-{climbs + k + 1}", climb, reached)
        share = min(share, climb.result.share)
    if not corners(reached):
        return share, []
    if share < _LEAST_CORNER:
        raise LogError(
            f"range: both commands at once reached {100 * share:.0f} % of their ranges, expected at least "
            f"{100 * _LEAST_CORNER:.0f} %; correct limits, sensor or commission.angle_limits_deg"
        )
    return share, [f"both at once reach {100 * share:.0f} % of these"]


def _dashed(
    bench: BenchSettings, end: PerAxis, device: MovableDevice, settings: CommissionSettings, axis: int
) -> tuple[float, str]:
    """Usable rate of one axis, and how it was determined."""
    phase, several = Dash(bench, end), len(bench.axes_limits) > 1
    name, axes = f"{RANGE}/dash" + (f"-{AXIS_NAMES[axis]}" if several else ""), len(bench.axes_limits)
    device.explore(name, Bounded(phase, settings.commission.angle_limits_deg, bench.sensor, axes), bench)
    rate, limit = float(f"{phase.rate_per_s:.4g}"), bench.axes_limits[axis].rate
    rate = min(rate, limit)
    if not phase.tells:
        text = f"the device does not tell what it holds, so that {limit:g} per s is taken as it is"
    elif rate == limit:
        text = f"the device follows {limit:g} per s"
    else:
        text = f"it follows {rate:g} of {limit:g} per s"
    return rate, of_axis(text, axis, axes)


def _identified(subject: Subject, stages: Stages) -> IdentifiedDevice:
    """Execute the stages without a device: check, identification, diagnosis, controllers."""
    checked = stages.complete(CHECK, TrialCheck, lambda folder: check_trials(subject))

    of_plane = subject.axes > 1

    def fit(folder: Path) -> FittedModel:
        return (fit_both if of_plane else fit_model)(subject, folder, stages.computing("identify"))

    def diagnose(folder: Path) -> ModelDiagnosis:
        judge = diagnose_both if of_plane else diagnose_model
        return judge(subject, stages.root / FIT / MODEL_FILE, folder, stages.computing("diagnose"))

    def make(folder: Path) -> ControllerFiles:
        noise = fitted.sensor_sigma_deg if math.isfinite(fitted.sensor_sigma_deg) else 0.0
        make_all = make_plane_controllers if of_plane else make_controllers
        return make_all(subject, model, noise, folder, stages.computing("tune"))

    fitted = stages.complete(FIT, FittedModel, fit, _COMPUTING_S[FIT])
    model, diagnosed = stages.root / FIT / MODEL_FILE, None
    if subject.block.diagnose:
        diagnosed = stages.complete(DIAGNOSE, ModelDiagnosis, diagnose, _COMPUTING_S[DIAGNOSE])
        model = stages.root / DIAGNOSE / FIXED_FILE if diagnosed.corrected else model
    made = stages.complete(CONTROLLER, ControllerFiles, make, _COMPUTING_S[CONTROLLER])
    return IdentifiedDevice(subject, checked, fitted, diagnosed, made, model)


def _reported(
    identified: IdentifiedDevice,
    stages: Stages,
    range_words: str,
    tracks: Tracks | None = None,
    verified: Verification | None = None,
) -> Commissioned:
    from .report import write_commission  # matplotlib takes a second to import

    stages.say("report")
    root, used_s = stages.root, stages.used_s
    report = write_commission(root / REPORT_FILE, identified, range_words, used_s, tracks or {}, verified)
    joined = identified.fitted.report if identified.subject.axes > 1 else ""
    return Commissioned(root, root / TIP_FILE, identified.model, report, verified, used_s, joined)


def _from_logs(files: Sequence[Path], settings: CommissionSettings | None) -> tuple[Subject, str]:
    """Subject of an identification from logs, and the origin of its limits in words."""
    several = 1 if settings is None else len(settings.axes_limits)
    read = read_trials(files)
    trials = both_axes(read) or read
    axes, unit = trials[0].commands.shape[1], trials[0].units.command
    if settings is not None and axes != several:
        got, bench = ("one axis" if n == 1 else "two axes" for n in (axes, several))
        raise ConfigError(f"logs: got {got}, expected {bench} as in the bench file; take the bench of this device")
    low = np.min([trial.commands.min(axis=0) for trial in trials], axis=0)
    high = np.max([trial.commands.max(axis=0) for trial in trials], axis=0)
    rates = [np.abs(np.diff(trial.commands, axis=0)) / np.diff(trial.t)[:, None] for trial in trials]
    if settings is None:
        rate = np.max([steps.max(axis=0) for steps in rates], axis=0)
        if not np.all(moves := (low < high) & (rate > 0)):
            name = "" if axes == 1 else f" {AXIS_NAMES[int(np.argmin(moves))]}"
            raise LogError(f"logs: the command{name} does not move, expected recordings of a motion")
        limits = _of_all([CommandLimits(*one) for one in np.stack([low, high, rate], axis=1).tolist()])
        words = f"as the recordings show: {_span(limits, unit)} at {in_words(together(rate.tolist()), '.4g')} per s"
        hz, block = float(f"{1 / trials[0].dt:.4g}"), CommissionBlock() if axes == 1 else PlaneCommissionBlock()
        # Two axes bend to both sides: their rest is the command next to zero.
        safe = together(low.tolist() if axes == 1 else np.clip(0.0, low, high).tolist())
        return Subject("recorded device", unit, hz, limits, safe, None, tuple(files), block), words
    if unit != settings.command_unit:
        raise ConfigError(f"logs: got commands in {unit}, expected the bench's {settings.command_unit}")
    made = []
    for bounds, at, *ends in zip(settings.axes_limits, each(settings.safe_command), low, high, strict=True):
        lower, upper = max(min(float(ends[0]), at), bounds.lower), min(max(float(ends[1]), at), bounds.upper)
        if not lower < upper:
            raise ConfigError(f"logs: commands are beyond the bench's limits {bounds}, expected some within them")
        made.append(CommandLimits(lower, upper, bounds.rate))
    limits = _of_all(made)
    words = f"commands that the recordings show within the bench's limits: {_span(limits, unit)}"
    return subject_of(settings, limits, files), words


def _of_all(limits: Sequence[CommandLimits]) -> Limits:
    return limits[0] if len(limits) == 1 else tuple(limits)


def _span(limits: Limits, unit: str) -> str:
    """Range of the command, or of both, in words."""
    ends = (in_words(together(getattr(one, end) for one in each(limits)), ".4g") for end in ("lower", "upper"))
    return f"{' to '.join(ends)} {unit}"
