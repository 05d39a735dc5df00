"""Investigation: rounds of recording, diagnosis and planning until the verdict is stable or time is spent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hystmpc.gap.diagnosis import FIXED_FILE
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import file_text
from hystmpc.trials.types import Progress, Vec

from .config import InvestigateSettings
from .device import Open
from .identify import MODEL_FILE, FittedModel, check_trials, fit_model, subject_of
from .motions import LEAST_SHARE, prepare_seconds, recordings, recordings_seconds, whole_seconds
from .plane import fit_both
from .plane_rounds import PlanePlanner, judge_plane, planned_commands_of_both, require_plane_model
from .round_plan import PlanePlan, RoundPlan, RoundPlanner, first_seconds, planned_commands
from .rounds import FIRST, Investigated, PlaneVerdict, RecordedRound, Round, RoundVerdict, judge_round, round_folder
from .stages import DIAGNOSIS, Stages, begun, fingerprint

RESULT_FILE, REPORT_FILE = "investigation.json", "report.html"
IDENTIFY = "identify"
_FIT_S, _JUDGE_S, _ROUNDS = 60.0, 60.0, 3  # expected of a fit, of a diagnosis, and of their number, for the bar
_IDENTIFY_SHARE = 0.45  # of the device time, where no simulator is given


def investigate_device(
    settings: InvestigateSettings,
    device: Open,
    out: Path | str,
    progress: Progress | None = None,
) -> Investigated:
    """Investigate the gap between a simulator and its device, until the verdict is stable or the time is spent.

    The same call resumes after the last complete part, and within the recordings after the last complete motion.

    Args:
        device: opens the device, given the folder and the callback for progress within a motion.
        out: a new or empty folder, or one in which the same investigation was begun.
        progress: called with the time passed, the time expected at most [s], and a note.

    Raises:
        ConfigError: before anything moves: on a foreign folder, too few minutes, a silent device, or a latched stop.
        ModelError: if the simulator cannot be used.
        DeviceStoppedError: if a motion was stopped safely; complete recordings are kept.
        EndedEarlyError: if a part cannot be completed after the device has moved.
        KeyboardInterrupt: if the user ended a computation.
    """
    plain = settings.model_dump(mode="json") | {"model_hash": _model_hash(settings)}
    identification_share(settings)
    with begun(out, "investigation", plain, settings.investigate.seed, device, progress) as stages:
        stages.expect(settings.budget_s, _ROUNDS * _JUDGE_S + (_FIT_S if settings.investigate.model is None else 0.0))
        return _investigated(settings, stages)


def plan_rows(settings: InvestigateSettings) -> tuple[tuple[str, str, float], ...]:
    """Rows of the plan: part, its motions, and minutes of device time.

    Raises:
        ConfigError: if the minutes are too few.
        ModelError: if the simulator cannot be used.
        FitError: if no motion stays within the angle limits by the simulator.
    """
    _model_hash(settings)
    share, count = identification_share(settings), settings.investigate.first_motions
    rows, spent = [], 0.0
    if share:
        spent = recordings_seconds(settings, share) + prepare_seconds(settings)
        runs = "17 recordings of each axis alone and of both" if of_plane(settings) else "6 recordings"
        rows.append((IDENTIFY, f"{runs} to identify a simulator from: steps, holds, sines, reversals", spent))
        first, what = first_seconds(settings, settings.budget_s - spent), f"{count} motions chosen by the simulator"
        what += " for each axis, and one of both" if of_plane(settings) else ""
    else:
        with TemporaryDirectory() as folder:
            model = Path(settings.investigate.model or "")
            plan = _first_plan(settings, model, settings.budget_s, Path(folder))
        first = plan.seconds
        what = ", ".join(name.partition("-")[2].replace("_", " ") for name in plan.motions)
    rows.append(("round 1", what, first))
    left_s = settings.budget_s - spent - first
    further = "one designed motion of each open axis, one of both" if of_plane(settings) else "one designed motion each"
    rows.append(("further rounds", f"{further}, until the verdict is stable; at most", left_s))
    return (*((name, text, seconds / 60) for name, text, seconds in rows), ("all", "at most", settings.budget_s / 60))


def identification_share(settings: InvestigateSettings) -> float:
    """Length of the recordings for the identification, as a share of the full ones; 0 where a simulator is given.

    Raises:
        ConfigError: if the minutes are too few.
    """
    if settings.investigate.model is not None:
        return 0.0
    room = _IDENTIFY_SHARE * settings.budget_s - recordings_seconds(settings, 0.0) - prepare_seconds(settings)
    whole_s = whole_seconds(settings)
    share = min(room / whole_s, 1.0)
    if share < LEAST_SHARE:
        raise ConfigError(
            f"investigate: got {settings.investigate.minutes:g} minutes and no model, so that {max(room, 0.0):.0f} s "
            f"are left for recordings to identify one, expected {LEAST_SHARE * whole_s:.0f} s; more minutes, or --model"
        )
    return share


def _model_hash(settings: InvestigateSettings) -> str:
    """Fingerprint of the simulator's file, empty without one."""
    if settings.investigate.model is None:
        return ""
    path = Path(settings.investigate.model)
    if of_plane(settings):
        require_plane_model(path, settings.command_unit)
        return fingerprint(path.read_bytes().hex())
    unit = load_simulator(path).command_unit
    if unit != settings.command_unit:
        raise ModelError(f"{path}: takes commands in {unit}, expected the bench's {settings.command_unit}")
    return fingerprint(path.read_bytes().hex())


def of_plane(settings: InvestigateSettings) -> bool:
    """Whether the bench has two axes."""
    return len(settings.axes_limits) > 1


def _first_plan(settings: InvestigateSettings, model: Path, left_s: float, folder: Path) -> RoundPlan | PlanePlan:
    """Plan of the first round, written into a folder."""
    if of_plane(settings):
        return PlanePlanner(settings, require_plane_model(model, settings.command_unit), left_s, folder).first()
    return RoundPlanner(settings, load_simulator(model), left_s, folder).first()


def _investigated(settings: InvestigateSettings, stages: Stages) -> Investigated:
    """Execute all rounds; complete stages are loaded."""
    model, rounds = _model(settings, stages), list[Round]()
    kind: type[RoundPlan | PlanePlan] = PlanePlan if of_plane(settings) else RoundPlan
    plan = stages.complete(FIRST, kind, lambda folder: _first_plan(settings, model, stages.left_s, folder))
    planned_in = stages.root / FIRST
    while True:
        rounds.append(_round(settings, stages, model, rounds, plan, planned_in))
        if rounds[-1].judged.next is None:
            return _reported(settings, stages, tuple(rounds), model)
        plan, planned_in = rounds[-1].judged.next, round_folder(stages.root, len(rounds)) / "diagnose"


def _round(
    settings: InvestigateSettings,
    stages: Stages,
    model: Path,
    before: Sequence[Round],
    plan: RoundPlan | PlanePlan,
    planned_in: Path,
) -> Round:
    """Record the planned motions and diagnose all recordings so far."""
    number = len(before) + 1
    name = round_folder(stages.root, number).name
    read = planned_commands_of_both if of_plane(settings) else planned_commands
    runs = {motion: read(planned_in, motion) for motion in plan.motions}
    recorded = stages.complete(f"{name}/record", RecordedRound, lambda folder: _record(stages, settings, runs, folder))
    played = [(earlier.number, motion) for earlier in before for motion in earlier.recorded.names]
    played += [(number, motion) for motion in recorded.names]
    files = [round_folder(stages.root, k) / "record" / "trials" / f"{motion}.csv" for k, motion in played]

    def diagnose(folder: Path) -> Any:
        left_s = settings.budget_s - recorded.device_s
        verdicts: list[Any] = [earlier.judged for earlier in before]
        judge = judge_plane if of_plane(settings) else judge_round
        return judge(settings, model, files, verdicts, left_s, folder, stages.computing(f"{name}: diagnose"))

    kind: type[RoundVerdict | PlaneVerdict] = PlaneVerdict if of_plane(settings) else RoundVerdict
    return Round(number, plan, recorded, stages.complete(f"{name}/diagnose", kind, diagnose, _JUDGE_S))


def _model(settings: InvestigateSettings, stages: Stages) -> Path:
    """Simulator under test: the given one, or one identified first from recordings of the device."""
    if settings.investigate.model is not None:
        return Path(settings.investigate.model)
    motions = recordings(settings, identification_share(settings), settings.investigate.seed)
    record = f"{IDENTIFY}/record"
    recorded = stages.complete(record, RecordedRound, lambda folder: _record(stages, settings, motions, folder))
    trials = [stages.root / record / "trials" / f"{name}.csv" for name in recorded.names]
    limits = settings.axes_limits
    subject = subject_of(settings, limits if of_plane(settings) else limits[0], trials)
    seeded = replace(subject, block=settings.commission.model_copy(update={"seed": settings.investigate.seed}))

    def fit(folder: Path) -> FittedModel:
        check_trials(seeded)
        fit_all = fit_both if of_plane(settings) else fit_model
        return fit_all(seeded, folder, stages.computing(f"{IDENTIFY}: fit"))

    stages.complete(f"{IDENTIFY}/fit", FittedModel, fit, _FIT_S)
    return stages.root / IDENTIFY / "fit" / MODEL_FILE


def _record(stages: Stages, settings: InvestigateSettings, runs: Mapping[str, Vec], folder: Path) -> RecordedRound:
    """Record motions as long as they certainly end within the device time."""
    return RecordedRound(tuple(stages.record(runs, settings, folder, limited=True)), stages.used_s)


def _reported(settings: InvestigateSettings, stages: Stages, rounds: tuple[Round, ...], model: Path) -> Investigated:
    root, last = stages.root, rounds[-1].judged
    fixed = round_folder(root, len(rounds)) / "diagnose" / DIAGNOSIS / FIXED_FILE
    made = Investigated(
        folder=root,
        rounds=rounds,
        ended=last.ended,
        why=last.why,
        model=model,
        fixed=fixed if fixed.exists() else None,
        report=root / REPORT_FILE,
        device_s=stages.used_s,
        budget_s=settings.budget_s,
    )
    write_atomically(root / RESULT_FILE, file_text(made.as_json()))
    from .report import write_investigation  # matplotlib takes a second to import

    write_investigation(made, settings.name, settings.command_unit)
    return made
