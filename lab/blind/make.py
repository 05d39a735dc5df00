"""Suites of the blind check and their creation: cases under shuffled names, answers sealed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import get_args

import numpy as np

from hystmpc.sim.jobs import backend_for, run_jobs
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.read import read_trials
from hystmpc.trials.run_folder import require_vacant
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Progress

from ..devices.cores import RATE_HZ, Core, Mounting, MuscleCore
from .cases import CONTROLS, Wish, affected_case, control_case, injection_case, set_up
from .device import DEVICES
from .generators import ALIASED_RATE, CONFIGURATION, FOREIGN_EFFECTS, LABELS, SCATTER, UNKNOWN
from .plan import ALIASED
from .sealed import Answer, Case, Manifest, Suite, case_name, seal, write_case

SUITES: tuple[Suite, ...] = get_args(Suite)
WHEEL: Mapping[Suite, int] = MappingProxyType(
    {
        "single": 70,
        "none": 15,
        "misset": 15,
        "controls": 15,
        "retuned": 16,
        "pairs": 15,
        "triple": 10,
        "contaminated": 12,
        "unknown": 15,
        "without": 10,
        "configuration": 10,
        "aliased": 20,
    }
)
"""Cases of each suite in one round of `all`."""
CASES = sum(WHEEL.values())
RATIOS = (1.5, 3.0, 6.0, 12.0)
_CODES = {name: k for k, name in enumerate(SUITES)}
_INJECTIONS = 16  # in a round with logs
_CONTAMINANT = 0.35
_OF_THREE = (6.0, 5.0, 4.0)
_MOVES: tuple[tuple[str, float], ...] = (
    ("friction", 0.5),
    ("friction", 1.5),
    ("friction", 2.0),
    ("friction", 3.0),
    ("stiffness", 0.7),
    ("stiffness", 1.4),
    ("weights", 2.0),
    ("weights", 0.45),
)
_SMALL_ON_A_MUSCLE = ("contact", "nonlinear_gain", "rate_dependence")
_MEANT = ("width", "gain", "offset", "all of them")  # what a new configuration changes
_SHARED = 0.6  # of the wanted ratio for each of the three
_ALIASES = ("friction by trial", "no disturbance", "disturbance")
_HARMONICS, _NEAR = (1, 2, 3), 0.9  # of the motion; greatest distance from one in 1/T


def places(suite: str, cases: int | None = None, with_logs: bool = False) -> list[tuple[Suite, int]]:
    """Suite of every case and its number within it; the first cases of a round hold all suites in proportion.

    Args:
        cases: one round where left out.

    Raises:
        ConfigError: on an unknown suite.
    """
    if suite not in (*SUITES, "all"):
        raise ConfigError(f"no suite {suite!r}, {did_you_mean(suite, (*SUITES, 'all'))}")
    whole = {**WHEEL, "injection": _INJECTIONS}
    names = [n for n in SUITES if n == suite or (suite == "all" and (with_logs or n != "injection"))]
    turns = sorted(((k + 0.5) / whole[name], SUITES.index(name), name) for name in names for k in range(whole[name]))
    counts: dict[str, int] = {}
    found = []
    for k in range(len(turns) if cases is None else cases):
        name = turns[k % len(turns)][2]
        found.append((name, counts.get(name, 0)))
        counts[name] = counts.get(name, 0) + 1
    return found


def make_case(seed: int, suite: Suite, number: int, logs: Sequence[Trial] = ()) -> Case:
    """Build case `number` of a suite; equal arguments give equal cases. Devices alternate within each suite."""
    key = (seed, _CODES[suite], number)
    if suite == "injection":
        return injection_case(logs, number, np.random.default_rng(key))
    kind = device_of(suite, number)
    if suite == "controls":
        return control_case(set_up(key, kind), CONTROLS[number % len(CONTROLS)])
    if suite in ("none", "misset"):
        return affected_case(set_up(key, kind, 0.0 if suite == "none" else 1.5), suite, ())
    if suite == "retuned":
        return _retuned(key, kind, number)
    if suite == "without":
        return _without(key, kind, number)
    if suite in ("pairs", "contaminated", "triple"):
        return _together(key, kind, suite)
    if suite == "configuration":
        return _configuration(key, kind, number)
    if suite == "aliased":
        return _aliased(key, kind, number)
    if suite == "unknown":
        ratio = RATIOS[number // len(FOREIGN_EFFECTS) % len(RATIOS)]
        return affected_case(set_up(key, kind), suite, [Wish(UNKNOWN, ratio, pick=number)])
    rounds, label = divmod(number, len(LABELS))
    # The rounds through the labels shift sizes and devices against each other: every label meets all of either.
    ratio = RATIOS[(label // len(DEVICES) + rounds) % len(RATIOS)]
    return affected_case(set_up(key, kind), suite, [Wish(LABELS[label], ratio, pick=rounds)])


def device_of(suite: Suite, number: int) -> type[Core]:
    """Device of a case: devices alternate, shifted by one with every round of the suite's other choices."""
    rounds = {"single": len(LABELS), "unknown": len(FOREIGN_EFFECTS), "retuned": len(_MOVES), "without": 2}
    rounds |= {"configuration": len(_MEANT)}
    turn = rounds.get(suite, len(DEVICES))
    shift = 1 if (turn + 1) % len(DEVICES) else 2  # every choice meets all devices
    place = (number + shift * (number // turn)) % len(DEVICES)
    hidden = suite == "single" and LABELS[number % len(LABELS)] not in _labels(DEVICES[place])
    return DEVICES[(place + hidden) % len(DEVICES)]


def _labels(kind: type[Core]) -> tuple[str, ...]:
    """Possible effects at three floors; a muscle, when retuned, absorbs a wall or weight and bounds its friction."""
    return tuple(label for label in LABELS if kind is not MuscleCore or label not in _SMALL_ON_A_MUSCLE)


def _retuned(key: tuple[int, int, int], kind: type[Core], number: int) -> Case:
    """Device with different friction, stiffness or weights, and a new mounting."""
    what, factor = _MOVES[number % len(_MOVES)]

    def moved(core: Core) -> Core:
        if what == "friction":
            return core.mounted(Mounting(friction=factor))
        return core.stiffer(factor) if what == "stiffness" else core.reweighted(factor)

    return affected_case(set_up(key, kind, plan="rich", moved=moved), "retuned", (), variant=f"{what} x {factor:g}")


def _configuration(key: tuple[int, int, int], kind: type[Core], number: int) -> Case:
    """Case of two groups of trials, consecutive or mixed, that differ in width, gain, offset or all of them."""
    bench = set_up(key, kind, plan="rich")
    trials = np.arange(len(bench.plan.commands))
    in_turn = (number + number // len(_MEANT)) % 2
    second = 2 * trials >= trials.size if in_turn else bench.random.permutation(trials % 2 == 1)
    shape = {"second": float(np.sum(2.0 ** trials[second]))}
    ratio, meant = float(bench.random.choice(RATIOS[1:])), number % len(_MEANT)
    picks = range(len(_MEANT) - 1) if meant == len(_MEANT) - 1 else (meant,)
    each = ratio * (_SHARED if len(picks) > 1 else 1.0)
    wishes = [Wish(CONFIGURATION, each, pick=pick, shape=shape) for pick in picks]
    return affected_case(bench, "configuration", wishes, variant=_MEANT[meant])


def _aliased(key: tuple[int, int, int], kind: type[Core], number: int) -> Case:
    """Case with all motions at one frequency, and an effect that is, or resembles, a disturbance at that frequency."""
    rounds, which = divmod(number, len(_ALIASES))
    plan = ALIASED[0 if which == 0 else rounds % 2]
    bench = set_up(key, kind, plan=plan)
    ratio = float(bench.random.choice(RATIOS[1:]))
    harmonic, away = int(bench.random.choice(_HARMONICS)), float(bench.random.uniform(-_NEAR, _NEAR))
    hz = harmonic * bench.plan.aliased_hz + away / bench.plan.seconds
    wishes = (
        [Wish(SCATTER, ratio)],
        [],
        [Wish(ALIASED_RATE, ratio, shape={"hz": hz, "phase": float(bench.random.uniform())})],
    )[which]
    return affected_case(bench, "aliased", wishes, variant=_ALIASES[which])


def _without(key: tuple[int, int, int], kind: type[Core], number: int) -> Case:
    """Case with a library without the true class or, every second time, as a decoy, without another class."""
    bench = set_up(key, kind, plan="rich")
    true, other = bench.random.choice(_labels(kind), 2, replace=False)
    decoy = number % 2 == 1
    ratio = float(bench.random.choice(RATIOS[1:]))
    gone, variant = (str(other), "decoy") if decoy else (str(true), "")
    return affected_case(bench, "without", [Wish(str(true), ratio)], (gone,), variant)


def _together(key: tuple[int, int, int], kind: type[Core], suite: Suite) -> Case:
    """Case of two or three causes of similar size, or of one with two contaminants of a third of its size."""
    bench = set_up(key, kind, plan="rich")
    labels = [str(x) for x in bench.random.choice(_labels(kind), 3, replace=False)]
    ratio = float(bench.random.choice(RATIOS[1:]))
    if suite == "triple":
        return affected_case(bench, suite, [Wish(name, r) for name, r in zip(labels, _OF_THREE, strict=True)])
    if suite == "pairs":
        second = ratio * float(bench.random.uniform(0.6, 1.0))
        return affected_case(bench, suite, [Wish(labels[0], ratio), Wish(labels[1], second)])
    wishes = [Wish(labels[0], ratio), *(Wish(name, _CONTAMINANT * ratio, main=False) for name in labels[1:])]
    return affected_case(bench, suite, wishes)


@dataclass(frozen=True, eq=False)
class _CaseJob:
    """Job of one case."""

    folder: Path
    seed: int
    suite: Suite
    number: int
    logs: tuple[Trial, ...]
    own_simulator: bool


def make_blind(
    folder: Path,
    seed: int,
    cases: int | None = None,
    suite: str = "all",
    logs: Sequence[Path] = (),
    jobs: int = 1,
    progress: Progress | None = None,
    layout: str = "auto",
    own_simulator: int = 3,
) -> Manifest:
    """Make and seal a blind check; equal arguments give equal files.

    Args:
        folder: new or empty; gets `cases/NNN`, `answers.json` and `manifest.json`.
        cases: how many; one round of the suite, or of all suites, where left out.
        suite: one of `SUITES`, or `all`.
        logs: real logs of one device, or folders of them, for `injection`.
        own_simulator: of so many cases one holds what the unaffected device gives, as a simulator of the user's own;
            0 for none.

    Raises:
        ConfigError: on an unknown suite, an occupied folder, a count below 1, or an injection without logs.
    """
    if cases is not None and cases < 1:
        raise ConfigError(f"cases: got {cases}, expected at least 1")
    wanted = places(suite, cases, bool(logs))
    if not logs and any(name == "injection" for name, _ in wanted):
        raise ConfigError("suite injection: got no logs, expected --logs with those of one real device")
    require_vacant(folder)
    count = len(wanted)
    real = tuple(resample(trial, RATE_HZ) for trial in (read_trials(logs, layout) if logs else ()))
    order = np.random.default_rng([seed, 0]).permutation(count)
    todo = [
        _CaseJob(
            folder / "cases" / case_name(int(place), count),
            seed,
            name,
            number,
            real if name == "injection" else (),
            bool(own_simulator) and k % own_simulator == 0,
        )
        for k, (place, (name, number)) in enumerate(zip(order, wanted, strict=True))
    ]
    backend = backend_for(jobs, where=str(folder))
    answers = dict(run_jobs(_make, todo, backend, total=count, progress=progress))
    return seal(folder, [answers[name] for name in sorted(answers)])


def _make(job: _CaseJob) -> tuple[str, Answer]:
    case = make_case(job.seed, job.suite, job.number, job.logs)
    own = job.own_simulator and job.suite not in (
        "controls",
        "injection",
    )  # these are made of the simulator, or of logs
    case = replace(case, answer=case.answer.model_copy(update={"own_simulator": own}))
    write_case(job.folder, case)
    return job.folder.name, case.answer
