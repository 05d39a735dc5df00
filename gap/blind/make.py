"""Making a blind check: cases written under shuffled names, answers sealed at the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hystmpc.sim.parallel.backend import backend_for
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.read import read_trials
from hystmpc.trials.run_folder import require_vacant
from hystmpc.trials.trial import Trial, resample

from .answer import Answer, Suite
from .scene import RATE_HZ
from .sealed import Manifest, case_name, seal, write_case
from .suites import make_case, places

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class _Job:
    """One case to make."""

    folder: Path
    seed: int
    suite: Suite
    number: int
    logs: tuple[Trial, ...]


def make_blind(
    folder: Path,
    seed: int,
    cases: int = 60,
    suite: str = "all",
    logs: Sequence[Path] = (),
    jobs: int = 1,
    progress: Progress | None = None,
    preset: str = "auto",
) -> Manifest:
    """Make and seal a blind check; equal arguments give equal files.

    Args:
        folder: new or empty; gets `cases/NNN`, `answers.json` and `manifest.json`.
        seed: of everything.
        cases: how many.
        suite: one of `suites.SUITES`, or `all`.
        logs: real logs of one device, or folders of them, for `injection`.
        jobs: processes.
        progress: called with cases made and their number.
        preset: layout of the logs.

    Raises:
        ConfigError: on an unknown suite, an occupied folder, a count below 1, or an injection without logs.
        FitError: if no simulator can be identified for a case.
        LogError: if a log cannot be read.
    """
    if cases < 1:
        raise ConfigError(f"cases: got {cases}, expected at least 1")
    wanted = places(suite, cases, bool(logs))
    if not logs and any(name == "injection" for name, _ in wanted):
        raise ConfigError("suite injection: got no logs, expected --logs with those of one real device")
    require_vacant(folder)
    real = tuple(resample(trial, RATE_HZ) for trial in (read_trials(logs, preset) if logs else ()))
    order = np.random.default_rng([seed, 0]).permutation(cases)
    todo = [
        _Job(folder / "cases" / case_name(int(place), cases), seed, name, number, real if name == "injection" else ())
        for place, (name, number) in zip(order, wanted, strict=True)
    ]
    answers: dict[str, Answer] = {}
    for name, answer in backend_for(jobs, where=str(folder)).results(_make, todo):
        answers[name] = answer
        if progress:
            progress(len(answers), cases)
    return seal(folder, [answers[name] for name in sorted(answers)])


def _make(job: _Job) -> tuple[str, Answer]:
    case = make_case(job.seed, job.suite, job.number, job.logs)
    write_case(job.folder, case)
    return job.folder.name, case.answer
