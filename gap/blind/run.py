"""Diagnosing every case of a blind check; what is done already is kept."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hystmpc.models.simulator import Simulator
from hystmpc.sim.parallel.backend import backend_for
from hystmpc.trials.errors import ConfigError, HystmpcError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial

from ..findings import Findings
from .fit_rules import fit_rules
from .record import record_again, record_motion
from .rule import correlation_rule
from .sealed import open_answers, read_case, read_manifest

Progress = Callable[[int, int, str], None]

DIAGNOSIS = "diagnosis.json"
FAILURE = "failure.txt"
BESIDE = "beside.json"
NEXT_MOTION = "next_motion.csv"


@dataclass(frozen=True)
class Job:
    """One diagnosis to make.

    Attributes:
        folder: of the blind check.
        case: name of its folder.
        seed: of the diagnosis.
        without: classes left out of the library.
        only: classes that the library is cut down to: the oracle's; empty for the blind diagnosis.
        kind: `diagnoses`, `follow_up_diagnoses` or `oracle`: the folder of the result.
    """

    folder: Path
    case: str
    seed: int
    without: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    kind: str = "diagnoses"

    @property
    def out(self) -> Path:
        """Where the result goes."""
        return self.folder / self.kind / self.case


def run_blind(
    folder: Path,
    jobs: int = 1,
    seed: int = 0,
    follow_up: bool = False,
    with_truth: bool = True,
    progress: Progress | None = None,
) -> int:
    """Diagnose every case that has no diagnosis yet.

    First all cases blindly; then, where asked for, the motions that the diagnoses propose are recorded and diagnosed
    with them; last, unless left out, the oracle: the same cases with a library of nothing but the true classes.

    Args:
        folder: made by `make_blind`.
        jobs: processes.
        seed: of the diagnoses.
        follow_up: record and diagnose again where a next motion is proposed.
        with_truth: run the oracle.
        progress: called with jobs done, jobs in all and a note.

    Returns:
        Diagnoses that failed, in this call.

    Raises:
        LogError: if the folder holds no blind check.
        ConfigError: if a worker process died.
    """
    manifest = read_manifest(folder)
    blind = [Job(folder, name, seed, manifest.without.get(name, ())) for name in manifest.cases]
    failed = _all(blind, jobs, progress)
    if follow_up:
        open_cases = [job for job in blind if (job.out / NEXT_MOTION).is_file()]
        again = [Job(folder, job.case, seed, job.without, (), "follow_up_diagnoses") for job in open_cases]
        failed += _all([job for job in again if _recorded(job)], jobs, progress)
    if with_truth:
        answers = open_answers(folder)
        told = [Job(folder, name, seed, (), a.labels, "oracle") for name, a in answers.items() if a.labels]
        failed += _all(told, jobs, progress)
    return failed


def diagnose_job(job: Job) -> tuple[Job, bool]:
    """Make one diagnosis and write it; an error of the diagnosis is written too. Returns whether it worked."""
    start = time.perf_counter()
    try:
        trials, simulator = read_case(job.folder, job.case)
        trials += _followed(job)
        data, beside = _diagnose(trials, simulator, job)
    except (HystmpcError, ArithmeticError, ValueError, IndexError, KeyError, AttributeError) as error:
        write_atomically(job.out / FAILURE, f"{type(error).__name__}: {error}\n")
        return job, False
    write_atomically(job.out / BESIDE, json.dumps({"seconds": time.perf_counter() - start, **beside}))
    write_atomically(job.out / DIAGNOSIS, json.dumps(data, indent=1))
    (job.out / FAILURE).unlink(missing_ok=True)
    return job, True


def _diagnose(trials: Sequence[Trial], simulator: Simulator, job: Job) -> tuple[dict[str, Any], dict[str, Any]]:
    """The diagnosis in its fixed form, and what goes beside it; the motion that it proposes is written."""
    from ..next_motion import write_motion
    from ..procedure import conclude, investigate

    findings = investigate(trials, simulator, seed=job.seed, without=job.without, only=job.only or None)
    found, evidence = conclude(findings)
    if evidence.proposal is not None:
        write_motion(job.out / NEXT_MOTION, evidence.proposal, simulator.command_unit)
    beside = _beside(findings, trials, simulator, job) if job.kind == "diagnoses" else {}
    return dict(found.as_json()), beside


def _beside(findings: Findings, trials: Sequence[Trial], simulator: Simulator, job: Job) -> dict[str, Any]:
    """What rules of thumb would say, and what the causes close in another session of the device, if it can have one."""
    from ..fresh_session import closed_again

    rules = fit_rules(findings.selection, findings.prepared.development)
    found: dict[str, Any] = {"others": {"correlation": correlation_rule(trials, simulator), **rules}}
    if findings.far.shares:
        with suppress(ConfigError):  # logs of a real device
            found["closed_again"] = closed_again(findings, record_again(job.folder, job.case))
    return found


def _all(todo: Sequence[Job], processes: int, progress: Progress | None) -> int:
    rest = [job for job in todo if not (job.out / DIAGNOSIS).is_file()]
    done, failed = len(todo) - len(rest), 0
    if progress and todo:
        progress(done, len(todo), todo[0].kind)
    where = str(rest[0].folder) if rest else ""
    for job, worked in backend_for(processes, where=where).results(diagnose_job, rest) if rest else ():
        done, failed = done + 1, failed + (not worked)
        if progress:
            progress(done, len(todo), f"{job.kind} {job.case}{'' if worked else ' failed'}")
    return failed


def _recorded(job: Job) -> bool:
    """Record the proposed motion on the case's device; False where there is no such device or the motion is unfit."""
    if _followed(job):
        return True
    try:
        record_motion(job.folder, job.case, job.folder / "diagnoses" / job.case / NEXT_MOTION)
    except HystmpcError as error:
        write_atomically(job.out / FAILURE, f"{error}\n")
        return False
    return True


def _followed(job: Job) -> list[Trial]:
    """Trials recorded because a diagnosis asked for them."""
    logs = job.folder / "follow_up" / job.case
    return read_trials([logs]) if job.kind == "follow_up_diagnoses" and logs.is_dir() else []
