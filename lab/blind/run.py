"""Diagnosis of every case of a blind check, resumable; further motions and sessions of a case's device."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from hystmpc.gap.decide.attribution import Findings
from hystmpc.gap.decide.gap_closed import FinalErrors, without_sawtooth
from hystmpc.gap.logs.preparation import prepare
from hystmpc.gap.logs.simulated import as_simulated
from hystmpc.gap.replay import confirmed_shares, replays_of
from hystmpc.models.simulator import Simulator
from hystmpc.sim.jobs import attempt, backend_for, run_jobs
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError, HystmpcError, LogError, did_you_mean
from hystmpc.trials.files import write_atomically
from hystmpc.trials.formats import read_lines
from hystmpc.trials.read import read_trials
from hystmpc.trials.tables import read_table
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress

from ..devices.cores import RATE_HZ, Core
from .device import lasts_s
from .rules import correlation_rule, fit_rules
from .sealed import open_answers, read_case, read_manifest

_RECORDED = 2  # times that a proposed motion is recorded, as the diagnosis asks for
_ANOTHER_SESSION = 7919  # added to the seed of what is random in a device
DIAGNOSIS = "diagnosis.json"
FAILURE = "failure.txt"
BESIDE = "beside.json"
NEXT_MOTION = "next_motion.csv"
ORDERS = "orders"


def record_motion(folder: Path, case: str, motion: Path) -> Path:
    """Run a motion on a case's simulated device and write the log, without a hint at the answer.

    Args:
        motion: CSV with columns `time_s` and `command`, or `command_bar`.

    Returns:
        The log, in `follow_up/CASE`, numbered on from all trials of the case, those recorded later among them.

    Raises:
        ConfigError: on an unknown case, one of real logs, or a command beyond the device's travel.
    """
    answers = open_answers(folder)
    if case not in answers:
        raise ConfigError(f"{folder}: no case {case!r}, {did_you_mean(case, answers)}")
    if not answers[case].device or answers[case].suite == "controls":
        raise ConfigError(f"{folder}: case {case} has no device that could move again")
    before = read_trials([folder / "cases" / case]) + _later(folder, case)
    clock_s = sum(lasts_s(len(trial)) for trial in before)
    device = answers[case].blind_device()
    command, log = _command(motion, device.core), folder / "follow_up" / case / f"trial_{len(before) + 1:02d}.csv"
    (trial,) = answers[case].with_own_output(device.record([command], len(before), clock_s))
    return write_csv(trial, log)


def record_again(folder: Path, case: str) -> list[Trial]:
    """Record another session of a case's motions on its device: other noise and draws, same effects.

    Raises:
        ConfigError: on an unknown case, or one without a device.
    """
    answers = open_answers(folder)
    if case not in answers or not answers[case].device or answers[case].suite == "controls":
        raise ConfigError(f"{folder}: case {case!r} has no device that could move again")
    device = answers[case].blind_device()
    commands = [trial.command for trial in read_trials([folder / "cases" / case])]
    return answers[case].with_own_output(replace(device, seed=device.seed + _ANOTHER_SESSION).record(commands))


def _command(path: Path, core: Core) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    columns = ("time_s", "command" if core.UNIT == "mm" else f"command_{core.UNIT}")
    table = read_table(read_lines(path), str(path))
    missing = [name for name in columns if name not in table.numbers]
    if missing:
        raise LogError(f"{path}: missing columns {', '.join(missing)}, expected {', '.join(columns)}")
    t, command = (np.asarray(table.numbers[name], dtype=np.float64) for name in columns)
    if t.size < 2 or not (np.isfinite(t).all() and np.isfinite(command).all() and np.all(np.diff(t) > 0)):
        raise LogError(f"{path}: expected two or more finite samples with increasing time")
    if command.min() < -1e-6 or command.max() > core.travel + 1e-6:
        raise ConfigError(
            f"{path}: command {command.min():.4g} to {command.max():.4g} {core.UNIT}, "
            f"expected within 0 to {core.travel:g}"
        )
    grid = np.arange(round((t[-1] - t[0]) * RATE_HZ) + 1) / RATE_HZ
    return np.clip(np.interp(grid, t - t[0], command), 0.0, core.travel)


@dataclass(frozen=True)
class DiagnosisJob:
    """Job of one diagnosis.

    Attributes:
        only: classes of the oracle's reduced library; empty for the blind diagnosis.
        kind: `diagnoses`, `follow_up_diagnoses`, `oracle` or `orders/NN`: the folder of the result.
        shuffled: number of a random order of the files; the order of recording is then withheld.
    """

    folder: Path
    case: str
    seed: int
    without: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    kind: str = "diagnoses"
    shuffled: int | None = None

    @property
    def out(self) -> Path:
        """Folder of the result."""
        return self.folder / self.kind / self.case


def run_blind(
    folder: Path,
    jobs: int = 1,
    seed: int = 0,
    follow_up: bool = False,
    with_truth: bool = True,
    progress: Progress | None = None,
) -> int:
    """Diagnose every case without a diagnosis.

    First all cases blindly; then, where asked for, the motions that the diagnoses propose are recorded and diagnosed
    with them; last, unless left out, the oracle: single effects with a library of nothing but the true class.

    Args:
        follow_up: record and diagnose again where a next motion is proposed.

    Returns:
        Diagnoses that failed, in this call.
    """
    manifest = read_manifest(folder)
    blind = [DiagnosisJob(folder, name, seed, manifest.without.get(name, ())) for name in manifest.cases]
    failed = diagnose_all(blind, jobs, progress)
    if follow_up:
        open_cases = [job for job in blind if (job.out / NEXT_MOTION).is_file()]
        again = [DiagnosisJob(folder, job.case, seed, job.without, (), "follow_up_diagnoses") for job in open_cases]
        failed += diagnose_all([job for job in again if _recorded(job)], jobs, progress)
    if with_truth:
        answers = open_answers(folder)
        told = [
            DiagnosisJob(folder, name, seed, (), a.labels, "oracle")
            for name, a in answers.items()
            if a.suite == "single"
        ]
        failed += diagnose_all(told, jobs, progress)
    return failed


def run_orders(
    folder: Path, cases: int = 20, orders: int = 10, jobs: int = 1, seed: int = 0, progress: Progress | None = None
) -> int:
    """Diagnose some cases in random orders of their files, the order of recording unknown; resumable.

    Args:
        cases: how many; the first ones, which are drawn at random.

    Returns:
        Diagnoses that failed, in this call.

    Raises:
        ConfigError: on a count below 1, or if a worker process died.
    """
    if cases < 1 or orders < 1:
        raise ConfigError(f"orders: got {orders} of {cases} cases, expected at least 1 of 1")
    manifest = read_manifest(folder)
    todo = [
        DiagnosisJob(folder, name, seed, manifest.without.get(name, ()), (), f"{ORDERS}/{k:02d}", k)
        for name in manifest.cases[:cases]
        for k in range(orders)
    ]
    return diagnose_all(todo, jobs, progress)


def diagnose_job(job: DiagnosisJob) -> tuple[DiagnosisJob, bool]:
    """Make one diagnosis and write it, or its error; return whether it was successful."""

    def diagnose() -> tuple[dict[str, Any], dict[str, Any]]:
        trials, simulator = read_case(job.folder, job.case)
        return _diagnose(trials + _followed(job), simulator, job)

    made = attempt(diagnose)
    if made.value is None:
        write_atomically(job.out / FAILURE, f"{type(made.raised).__name__}: {made.raised}\n")
        return job, False
    data, beside = made.value
    write_atomically(job.out / BESIDE, json.dumps({"seconds": made.seconds, **beside}))
    write_atomically(job.out / DIAGNOSIS, json.dumps(data, indent=1))
    (job.out / FAILURE).unlink(missing_ok=True)
    return job, True


def _diagnose(
    trials: Sequence[Trial], simulator: Simulator, job: DiagnosisJob
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Diagnosis as JSON, and further facts about it; the proposed motion is written."""
    from hystmpc.gap.diagnose import conclude, find_causes
    from hystmpc.gap.next.motion_design import write_motion

    told = job.shuffled is None
    findings = find_causes(
        trials if told else _renamed(trials, job),
        simulator,
        seed=job.seed,
        without=job.without,
        only=job.only or None,
        ordered=told,
    )
    found, evidence = conclude(findings)
    if evidence.proposal is not None and told:
        write_motion(job.out / NEXT_MOTION, evidence.proposal, simulator.command_unit)
    beside = _beside(findings, trials, simulator, job) if job.kind == "diagnoses" else {}
    return dict(found.as_json()), beside


def _renamed(trials: Sequence[Trial], job: DiagnosisJob) -> list[Trial]:
    """Trials in a random order, under names that follow it."""
    order = np.random.default_rng([job.seed, job.shuffled or 0, int(job.case)]).permutation(len(trials))
    return [replace(trials[k], source=f"log_{place + 1:02d}.csv") for place, k in enumerate(order)]


def _beside(findings: Findings, trials: Sequence[Trial], simulator: Simulator, job: DiagnosisJob) -> dict[str, Any]:
    """Answers of simple rules, and the closed share of the causes in another session, if the device can have one."""
    rules = fit_rules(findings.attribution.selection, findings.prepared.development)
    found: dict[str, Any] = {"others": {"correlation": correlation_rule(trials, simulator), **rules}}
    if findings.conclusion.closed.causes:
        with suppress(ConfigError):  # logs of a real device
            found["closed_again"] = closed_in_later_session(findings, record_again(job.folder, job.case))
    if findings.prepared.stand_in_rmse_deg is not None:
        found["confirmed"] = _confirmed(findings, job)
    return found


def _confirmed(findings: Findings, job: DiagnosisJob) -> list[tuple[float, float]]:
    """Closed share of each replayed effect as said, and as the unaffected device confirms it."""
    replays, answer = replays_of(findings), open_answers(job.folder)[job.case]
    if not (replays.each and answer.own_simulator):
        return []
    played = [as_simulated(trial) for trial in answer.with_own_output(replays.trials)]
    shares, causes = confirmed_shares(findings, replays, played)[0], findings.conclusion.closed.causes
    return [(causes[name].share, one.closed_share) for name, one in shares.items()]


def diagnose_all(todo: Sequence[DiagnosisJob], processes: int, progress: Progress | None) -> int:
    """Execute the jobs without a diagnosis; return the number of failures."""
    kind = todo[0].kind if todo else ""
    return complete_cases(todo, diagnose_job, DIAGNOSIS, processes, progress, kind)


class CaseJob(Protocol):
    """Job on one case of a blind check."""

    @property
    def folder(self) -> Path:
        """Folder of the check."""
        ...

    @property
    def case(self) -> str:
        """Name of the case."""
        ...

    @property
    def out(self) -> Path:
        """Folder of the result."""
        ...


C = TypeVar("C", bound=CaseJob)


def complete_cases(
    todo: Sequence[C],
    do: Callable[[C], tuple[C, bool]],
    marker: str,
    processes: int,
    progress: Progress | None,
    kind: str = "",
) -> int:
    """Execute the jobs whose folder lacks its last file; return the number of failures.

    Args:
        do: does one job; returns it, and whether it worked.
        marker: name of the file that a finished job leaves.
        kind: before the names of cases in the progress.
    """
    if not todo:
        return 0

    def is_done(job: C) -> bool:
        return (job.out / marker).is_file()

    if progress:
        progress(sum(map(is_done, todo)), len(todo), kind)
    done = run_jobs(
        do,
        todo,
        backend_for(processes, where=str(todo[0].folder)),
        is_done=is_done,
        total=len(todo),
        progress=progress,
        note=lambda made: f"{kind} {made[0].case}{'' if made[1] else ' failed'}".strip(),
    )
    return sum(not worked for _, worked in done)


def _recorded(job: DiagnosisJob) -> bool:
    """Record the proposed motion on the case's device; return False without a device or for an unfit motion."""
    try:
        while len(_later(job.folder, job.case)) < _RECORDED:
            record_motion(job.folder, job.case, job.folder / "diagnoses" / job.case / NEXT_MOTION)
    except HystmpcError as error:
        write_atomically(job.out / FAILURE, f"{error}\n")
        return False
    return True


def _followed(job: DiagnosisJob) -> list[Trial]:
    return _later(job.folder, job.case) if job.kind == "follow_up_diagnoses" else []


def _later(folder: Path, case: str) -> list[Trial]:
    """Trials of a case that were added after its creation."""
    logs = folder / "follow_up" / case
    return read_trials([logs]) if logs.is_dir() else []


def closed_in_later_session(findings: Findings, trials: Sequence[Trial]) -> float:
    """Closed share of the corrected simulator on trials of a later session, above the floor of the first one.

    The 90 % interval of the closed share refers to this quantity: the corrected simulator on more such trials, not a
    perfect model. As in `FinalErrors.closed`, what jumps leave by their nature counts as closed.

    Args:
        trials: a whole session of the device, ordered as the first one was.
    """
    later = prepare(trials, findings.simulator, ordered=findings.prepared.order == "known")
    later = replace(later, final=later.everything)
    attribution, conclusion = findings.attribution, findings.conclusion
    causes = conclusion.closed.causes.keys()
    jumps = attribution.jumps if "stick_slip" in causes - conclusion.chosen.effects else None
    fitted = attribution.validation, attribution.retuned, conclusion.chosen, conclusion.floor
    errors = FinalErrors(later, *fitted, "sensor" in causes, findings.seed, jumps)
    return errors.shares.closed(without_sawtooth(errors.after, jumps.mse if jumps else 0.0).mse)
