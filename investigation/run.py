"""An investigation from beginning to end: round after round, each part kept when it is complete."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import final

from hystmpc.commissioning.device import BenchDevice, Device, DeviceStoppedError, Tick
from hystmpc.commissioning.identify import MODEL_FILE, Fitted, Subject, check_trials, fit_model
from hystmpc.commissioning.motions import LEAST_SHARE, prepare_seconds, recordings, recordings_seconds
from hystmpc.commissioning.plants import plants_in
from hystmpc.commissioning.run import EndedEarlyError
from hystmpc.commissioning.stages import StageStore, begun_folder, fingerprint
from hystmpc.gap.report.report_data import FIXED_FILE
from hystmpc.models.simulator import load_simulator
from hystmpc.rig.bench import Note
from hystmpc.rig.recording.recorder_process import Views
from hystmpc.sim.jobs.runner import alone_in
from hystmpc.trajectories.excitation import WHOLE_S
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError, HystmpcError, LogError, ModelError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.types import Progress, Vec

from .config import InvestigateSettings
from .judge import DIAGNOSIS, Judged, judge
from .plan import Plan, first_seconds, plan_first, planned_commands, run_seconds
from .story import FIRST, Investigated, RecordedRound, Round, round_folder

RESULT_FILE, REPORT_FILE = "investigation.json", "report.html"
IDENTIFY = "identify"
_FIT_S, _JUDGE_S, _ROUNDS = 60.0, 60.0, 3  # expected of a fit, of a diagnosis, and of their number, for the bar
_COMPUTED = 0.05  # seconds that a computed device takes for one of its own, for the bar
_IDENTIFY_SHARE = 0.45  # of the device time, where no simulator is given


@final
class _Budgeted:
    """Plays motions as long as the device time lasts.

    Args:
        device: that is moved.
        progress: told the time that has passed of that expected, computations included.
    """

    def __init__(self, device: Device, settings: InvestigateSettings, progress: Progress | None) -> None:
        self.device, self._settings, self._progress = device, settings, progress
        self._stage = ""
        self._computed_s, self._computing_s = 0.0, 0.0  # of computations that are complete, and of the present one
        self._expected_s = _ROUNDS * _JUDGE_S + (_FIT_S if settings.investigate.model is None else 0.0)

    @property
    def left_s(self) -> float:
        """Device time that is left [s]."""
        return self._settings.budget_s - self.device.used_s

    def say(self, note: str, more_s: float = 0.0) -> None:
        """Tell what is done."""
        if self._progress is None:
            return
        pace, computed = 1.0 if self.device.in_real_time else _COMPUTED, self._computed_s + self._computing_s
        total = pace * self._settings.budget_s + max(self._expected_s, computed)
        self._progress(min(pace * (self.device.used_s + more_s) + computed, total), total, note)

    def computing(self, seconds: float, what: str) -> Progress:
        """The progress of a computation that is expected to take so long, as part of the whole."""
        self._computed_s, self._computing_s = self._computed_s + self._computing_s, 0.0

        def told(done: float, total: float, note: str = "", /) -> None:
            self._computing_s = seconds * min(done / max(total, 1e-9), 1.0)
            self.say(f"{what} {note}".strip())

        told(0, 1)
        return told

    def fits(self, stage: str, commands: int) -> bool:
        """Whether one more run is certain to end within the device time."""
        prepare = 0.0 if stage == self._stage else prepare_seconds(self._settings)
        return run_seconds(self._settings, commands) + prepare <= self.left_s

    def play(self, stage: str, name: str, commands: Vec, file: Path) -> None:
        """Play and write one motion."""
        self.say(f"{stage}: {name}")
        trial = self.device.play(f"{stage}/{name}", commands, self._settings)
        self._stage = stage
        write_csv(trial, file)


def investigate_device(
    settings: InvestigateSettings,
    device: Callable[[Path, Tick], Device],
    out: Path | str,
    progress: Progress | None = None,
) -> Investigated:
    """Record, diagnose and record what decides most, until the verdict is stable or the device time is spent.

    The same call goes on after the last complete part, and within the recordings after the last complete motion.

    Args:
        device: opens the device, given the folder and what to tell while a motion lasts.
        out: a new or empty folder, or one in which the same investigation was begun.
        progress: called with the time passed, that expected at most [s], and what is being done.

    Raises:
        ConfigError: before anything moves: on a folder that holds something else, minutes that are too few, a device
            that does not answer, or a latched stop.
        ModelError: if the simulator cannot be used.
        DeviceStoppedError: if a motion was stopped safely; complete recordings are kept.
        EndedEarlyError: if a part cannot be completed after the device has moved.
        KeyboardInterrupt: if the user ended it while something was computed.
    """
    plain = settings.model_dump(mode="json") | {"model_hash": _model_hash(settings)}
    identification_share(settings)
    root = begun_folder(out, "investigation", plain, settings.investigate.seed)
    with alone_in(root):
        told: list[_Budgeted] = []
        moved = device(root, lambda seconds: told[0].say("moving", seconds))
        told.append(_Budgeted(moved, settings, progress))
        before = moved.used_s
        try:
            return _investigated(settings, told[0], StageStore(root, fingerprint(plain)))
        except (DeviceStoppedError, EndedEarlyError):
            raise
        except HystmpcError as error:
            if moved.used_s > before:
                raise EndedEarlyError(f"{error} (what was recorded is kept in {root})") from error
            raise


def opened_device(
    settings: InvestigateSettings, folder: Path, views: Views = Views(), note: Note = lambda text: None
) -> Callable[[Path, Tick], Device]:
    """Opens the device of the settings, as a commissioning does."""
    plants, limits = plants_in(folder, settings.command_unit), settings.commission.angle_limits_deg
    return lambda root, tick: BenchDevice(settings, plants, root, limits, views, note, tick)


def plan_rows(settings: InvestigateSettings) -> tuple[tuple[str, str, float], ...]:
    """Parts with their motions and minutes of device time, as they are said before anything moves.

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
        rows.append((IDENTIFY, "6 recordings to identify a simulator from: steps, holds, sines, reversals", spent))
        first, what = first_seconds(settings, settings.budget_s - spent), f"{count} motions chosen by the simulator"
    else:
        with TemporaryDirectory() as folder:
            plan = plan_first(
                settings, load_simulator(settings.investigate.model or ""), settings.budget_s, Path(folder)
            )
        first = plan.seconds
        what = ", ".join(name.partition("-")[2].replace("_", " ") for name in plan.motions)
    rows.append(("round 1", what, first))
    left_s = settings.budget_s - spent - first
    rows.append(("further rounds", "one designed motion each, until the verdict is stable; at most", left_s))
    return (*((name, text, seconds / 60) for name, text, seconds in rows), ("all", "at most", settings.budget_s / 60))


def identification_share(settings: InvestigateSettings) -> float:
    """Share of the full recordings of a commissioning that a simulator is identified from; 0 where one is given.

    Raises:
        ConfigError: if the minutes are too few.
    """
    if settings.investigate.model is not None:
        return 0.0
    room = _IDENTIFY_SHARE * settings.budget_s - recordings_seconds(settings, 0.0) - prepare_seconds(settings)
    share = min(room / WHOLE_S, 1.0)
    if share < LEAST_SHARE:
        raise ConfigError(
            f"investigate: got {settings.investigate.minutes:g} minutes and no model, so that {max(room, 0.0):.0f} s "
            f"are left for recordings to identify one, expected {LEAST_SHARE * WHOLE_S:.0f} s; more minutes, or --model"
        )
    return share


def _model_hash(settings: InvestigateSettings) -> str:
    """Fingerprint of the simulator's file, empty without one.

    Raises:
        ModelError: if it is missing, foreign or corrupt.
    """
    if settings.investigate.model is None:
        return ""
    path = Path(settings.investigate.model)
    unit = load_simulator(path).command_unit
    if unit != settings.command_unit:
        raise ModelError(f"{path}: takes commands in {unit}, expected the bench's {settings.command_unit}")
    return fingerprint(path.read_bytes().hex())


def _investigated(settings: InvestigateSettings, moved: _Budgeted, store: StageStore) -> Investigated:
    root = store.root
    model, store = _model(settings, moved, store)
    plan, store = store.complete(
        FIRST, Plan, lambda folder: plan_first(settings, load_simulator(model), moved.left_s, folder)
    )
    planned_in, rounds = root / FIRST, list[Round]()
    while True:
        found, store = _round(settings, moved, store, model, rounds, plan, planned_in)
        rounds.append(found)
        if found.judged.next is None:
            return _reported(settings, root, tuple(rounds), model, moved.device.used_s)
        plan, planned_in = found.judged.next, round_folder(root, found.number) / "diagnose"


def _round(
    settings: InvestigateSettings,
    moved: _Budgeted,
    store: StageStore,
    model: Path,
    before: Sequence[Round],
    plan: Plan,
    planned_in: Path,
) -> tuple[Round, StageStore]:
    """Record what is planned, and judge all recordings so far."""
    root, number = store.root, len(before) + 1
    stage = round_folder(root, number).name
    runs = {name: planned_commands(planned_in, name) for name in plan.motions}

    def record(folder: Path) -> RecordedRound:
        return _record(moved, stage, runs, folder)

    recorded, store = store.complete(f"{stage}/record", RecordedRound, record)
    played = [(found.number, name) for found in before for name in found.recorded.names]
    played += [(number, name) for name in recorded.names]
    files = [round_folder(root, k) / "record" / "trials" / f"{name}.csv" for k, name in played]

    def diagnose(folder: Path) -> Judged:
        told, verdicts = moved.computing(_JUDGE_S, f"{stage}: diagnose"), [found.judged for found in before]
        return judge(settings, model, files, verdicts, settings.budget_s - recorded.device_s, folder, told)

    judged, store = store.complete(f"{stage}/diagnose", Judged, diagnose)
    return Round(number, plan, recorded, judged), store


def _model(settings: InvestigateSettings, moved: _Budgeted, store: StageStore) -> tuple[Path, StageStore]:
    """The simulator that is judged: given, or identified from recordings of its own."""
    if settings.investigate.model is not None:
        return Path(settings.investigate.model), store
    motions = recordings(settings, identification_share(settings), settings.investigate.seed)

    def fit(folder: Path) -> Fitted:
        check_trials(subject)
        return fit_model(subject, folder, moved.computing(_FIT_S, f"{IDENTIFY}: fit"))

    recorded, store = store.complete(
        f"{IDENTIFY}/record", RecordedRound, lambda folder: _record(moved, IDENTIFY, motions, folder)
    )
    subject = Subject(
        name=settings.name,
        command_unit=settings.command_unit,
        rate_hz=settings.rate_hz,
        limits=settings.limits.build(),
        safe_command=settings.safe_command,
        angle_limits=settings.angle_limits,
        trials=tuple(store.root / IDENTIFY / "record" / "trials" / f"{name}.csv" for name in recorded.names),
        block=settings.commission.model_copy(update={"seed": settings.investigate.seed}),
    )
    _, store = store.complete(f"{IDENTIFY}/fit", Fitted, fit)
    return store.root / IDENTIFY / "fit" / MODEL_FILE, store


def _record(moved: _Budgeted, stage: str, runs: Mapping[str, Vec], folder: Path) -> RecordedRound:
    """Record what is not there yet, in order, as long as the device time is certain to suffice.

    Raises:
        LogError: if it suffices for none.
    """
    names = []
    for name, commands in runs.items():
        file = folder / "trials" / f"{name}.csv"
        if not file.exists():
            if not moved.fits(stage, commands.size):
                break
            moved.play(stage, name, commands, file)
        names.append(name)
    if not names:
        raise LogError(
            f"{stage}: {moved.left_s:.0f} s of device time are left, motions that were cut short included, which is "
            "too little for what was planned, expected more; another --out begins anew"
        )
    return RecordedRound(tuple(names), moved.device.used_s)


def _reported(
    settings: InvestigateSettings, root: Path, rounds: tuple[Round, ...], model: Path, used_s: float
) -> Investigated:
    last, fixed = rounds[-1].judged, round_folder(root, len(rounds)) / "diagnose" / DIAGNOSIS / FIXED_FILE
    made = Investigated(
        folder=root,
        rounds=rounds,
        ended=last.ended,
        why=last.why,
        model=model,
        fixed=fixed if fixed.exists() else None,
        report=root / REPORT_FILE,
        device_s=used_s,
        budget_s=settings.budget_s,
    )
    write_atomically(root / RESULT_FILE, json.dumps(made.as_json(), indent=1, allow_nan=False) + "\n")
    from .report import write_report  # matplotlib takes a second to import

    write_report(made, settings.name, settings.command_unit)
    return made
