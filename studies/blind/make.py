"""Suites of the blind check, and making one: cases under shuffled names, answers sealed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hystmpc.sim.jobs.runner import backend_for, run_jobs
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.read import read_trials
from hystmpc.trials.run_folder import require_vacant
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Progress

from .cases import CONTROLS, Wish, affected_case, control_case, set_up
from .cores import RATE_HZ
from .generators import FOREIGN_EFFECTS, LABELS, UNKNOWN
from .injection import injection_case
from .sealed import Answer, Case, Manifest, Suite, case_name, seal, write_case

SUITES: tuple[Suite, ...] = (
    "single",
    "none",
    "misset",
    "pairs",
    "contaminated",
    "unknown",
    "without",
    "controls",
    "injection",
)
RATIOS = (1.5, 3.0, 6.0, 12.0)
_CODES = {name: k for k, name in enumerate(SUITES)}
# Places of a suite in a round of `all`; injection joins where logs are given.
_ONCE: tuple[Suite, ...] = ("none", "misset", "pairs", "contaminated", "unknown", "without", "controls")
_AGAIN: tuple[Suite, ...] = ("pairs", "contaminated", "unknown", "without", "controls")
_SINGLES: tuple[Suite, ...] = ("single", "single", "single", "single")
_ROUND: tuple[Suite, ...] = (*_SINGLES, *_ONCE, *_SINGLES, *_AGAIN)
_INJECTIONS: tuple[Suite, ...] = ("injection", "injection")
_CONTAMINANT = 0.35


def places(suite: str, cases: int, with_logs: bool = False) -> list[tuple[Suite, int]]:
    """Suite of every case and its number within that suite.

    Raises:
        ConfigError: on an unknown suite.
    """
    if suite not in (*SUITES, "all"):
        raise ConfigError(f"no suite {suite!r}, {did_you_mean(suite, (*SUITES, 'all'))}")
    whole = (*_ROUND, *(_INJECTIONS if with_logs else ()))
    wheel = whole if suite == "all" else tuple(name for name in SUITES if name == suite)
    counts: dict[str, int] = {}
    found = []
    for k in range(cases):
        name = wheel[k % len(wheel)]
        found.append((name, counts.get(name, 0)))
        counts[name] = counts.get(name, 0) + 1
    return found


def make_case(seed: int, suite: Suite, number: int, logs: Sequence[Trial] = ()) -> Case:
    """Case `number` of a suite; equal arguments give equal cases.

    Raises:
        ConfigError: if an injection is asked for without logs.
        FitError: if no simulator can be identified.
    """
    key = (seed, _CODES[suite], number)
    if suite == "injection":
        return injection_case(logs, number, np.random.default_rng(key))
    if suite == "controls":
        return control_case(set_up(key), CONTROLS[number % len(CONTROLS)])
    if suite in ("none", "misset"):
        return affected_case(set_up(key, 0.0 if suite == "none" else 1.5), suite, ())
    if suite == "without":
        return _without(key, number)
    if suite in ("pairs", "contaminated"):
        return _together(key, suite)
    label = UNKNOWN if suite == "unknown" else LABELS[number % len(LABELS)]
    # Shifted by one every round through the labels, so that every label meets every size.
    rounds = number // (len(FOREIGN_EFFECTS) if suite == "unknown" else len(LABELS))
    ratio = RATIOS[(number + rounds) % len(RATIOS)]
    pick = number if suite == "unknown" else number // len(LABELS)
    return affected_case(set_up(key), suite, [Wish(label, ratio, pick=pick)])


def _without(key: tuple[int, int, int], number: int) -> Case:
    """A library without the true class, and every second time, as a decoy, without another one."""
    bench = set_up(key, plan="rich")
    true, other = bench.random.choice(LABELS, 2, replace=False)
    decoy = number % 2 == 1
    ratio = float(bench.random.choice(RATIOS[1:]))
    gone, variant = (str(other), "decoy") if decoy else (str(true), "")
    return affected_case(bench, "without", [Wish(str(true), ratio)], (gone,), variant)


def _together(key: tuple[int, int, int], suite: Suite) -> Case:
    """Two causes of like size, or one with two contaminants of a third of its size."""
    bench = set_up(key, plan="rich")
    labels = [str(x) for x in bench.random.choice(LABELS, 3, replace=False)]
    ratio = float(bench.random.choice(RATIOS[1:]))
    if suite == "pairs":
        second = ratio * float(bench.random.uniform(0.6, 1.0))
        return affected_case(bench, suite, [Wish(labels[0], ratio), Wish(labels[1], second)])
    wishes = [Wish(labels[0], ratio), *(Wish(name, _CONTAMINANT * ratio, main=False) for name in labels[1:])]
    return affected_case(bench, suite, wishes)


@dataclass(frozen=True, eq=False)
class _CaseJob:
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
        suite: one of `SUITES`, or `all`.
        logs: real logs of one device, or folders of them, for `injection`.

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
        _CaseJob(
            folder / "cases" / case_name(int(place), cases), seed, name, number, real if name == "injection" else ()
        )
        for place, (name, number) in zip(order, wanted, strict=True)
    ]
    backend = backend_for(jobs, where=str(folder))
    answers = dict(run_jobs(todo, _make, backend, total=cases, progress=progress))
    return seal(folder, [answers[name] for name in sorted(answers)])


def _make(job: _CaseJob) -> tuple[str, Answer]:
    case = make_case(job.seed, job.suite, job.number, job.logs)
    write_case(job.folder, case)
    return job.folder.name, case.answer
