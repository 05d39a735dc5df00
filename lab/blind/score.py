"""Score of a blind check: bars, misses, and the tables behind them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.effects.catalogue import confusable
from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import plain

from ..page import Bar, Rate
from .bars import (
    HEALTHY,
    Calibration,
    Confusion,
    alarm,
    bars,
    calibration,
    chance,
    confidently_wrong,
    confusion,
    covers_perfection,
    metrics,
    rate,
    truths_of,
)
from .generators import LABELS, NAMES
from .make import RATIOS, SUITES
from .reading import FAILED, ScoredCase, load_scored, of_suites

FORMAT = "hystmpc-blind-score/1"


@dataclass(frozen=True)
class Score:
    """Content of the report.

    Attributes:
        confusion: of all cases whose cause has a name to ask for: not of the aliased ones.
        groups: share of right verdicts, by table and row.
        beside: top-1 on single effects of the diagnosis and of simpler rules.
    """

    cases: tuple[ScoredCase, ...]
    bars: tuple[Bar, ...]
    metrics: tuple[Bar, ...]
    confusion: Confusion
    calibration: Calibration
    groups: dict[str, dict[str, Rate]]
    beside: dict[str, float]

    def misses(self) -> list[ScoredCase]:
        """Cases whose verdict is wrong, in the order of their folders."""
        return [case for case in self.cases if not case.right]


def score_blind(folder: Path, partial: bool = False) -> Score:
    """Open the answers, score the diagnoses, and write `score.json`."""
    result = score_of(load_scored(folder, partial))
    result = replace(result, bars=(*result.bars, *_investigation_bars(folder)))
    write_atomically(folder / "score.json", json.dumps(score_json(result), indent=1))
    return result


def _investigation_bars(folder: Path) -> tuple[Bar, Bar]:
    """Bars of `hystmpc investigate` on single effects: correct causes, and share of the battery's time."""
    from .investigated import NEEDED, named_right, scored_investigations, time_share  # with the bench behind it

    found = scored_investigations(folder)
    named, wrong = named_right(found), tuple(one.case for one in found if not one.right)
    long = tuple(one.case for one in found if one.device_s > NEEDED * one.battery_s)
    return (
        Bar("investigate names the class", named.value, (0.95, 1.0), named.cases, wrong, named.ci90),
        Bar("investigate: device time over the battery's", time_share(found), (0.0, NEEDED), len(found), long),
    )


def score_of(cases: Sequence[ScoredCase]) -> Score:
    """Score of the given cases."""
    single = of_suites(cases, "single")
    return Score(
        tuple(cases),
        tuple(bars(cases)),
        tuple(metrics(cases)),
        confusion([case for case in cases if case.answer.suite != "aliased"]),
        calibration(cases),
        {
            "suite": _by(cases, lambda c: (c.answer.suite,), SUITES),
            "gap in floors": _by(single, lambda c: (_size(c),), [f"{r:g}" for r in RATIOS]),
            "effect": _by(single, lambda c: (c.answer.truth,), LABELS),
            "recording plan": _by(single, lambda c: (c.answer.plan,)),
            "motion in the plan": _by(single, lambda c: tuple(sorted(set(c.answer.motions)))),
            "baseline": _by(single, lambda c: (c.answer.baseline,)),
            "simulator": _by(cases, lambda c: ("the user's own" if c.answer.own_simulator else "a model",)),
            "model error over noise": _by(cases, lambda c: (_model_error(c),), _MODEL_ERRORS),
            "device": _by(single, lambda c: (str(c.answer.device.get("core", "recorded")),)),
            "separable": _by(single, lambda c: ("separable" if c.answer.separable else "not separable",)),
            "moved, regrouped or aliased": _by(
                of_suites(cases, "retuned", "configuration", "aliased"),
                lambda c: (f"{c.answer.suite}: {c.answer.variant}",),
            ),
            "left out class": _by(of_suites(cases, "without"), lambda c: (c.answer.variant or "the true one",)),
            "90 % intervals hold": {"what a perfect equation would close": covers_perfection(cases)},
            "nothing wrong, left alone by": _left_alone(of_suites(cases, *HEALTHY)),
        },
        _beside(single),
    )


def _by(
    cases: Sequence[ScoredCase], keys: Callable[[ScoredCase], tuple[str, ...]], order: Sequence[str] = ()
) -> dict[str, Rate]:
    """Share of right verdicts by key; a case may count under several."""
    groups: dict[str, list[ScoredCase]] = {}
    for case in cases:
        for key in keys(case):
            groups.setdefault(key, []).append(case)
    names = [*(name for name in order if name in groups), *sorted(set(groups) - set(order))]
    return {name: rate(groups[name], lambda c: c.right) for name in names}


def _size(case: ScoredCase) -> str:
    """Nominal ratio nearest to the measured one."""
    return f"{min(RATIOS, key=lambda r: abs(math.log(max(case.answer.ratio, 1e-3) / r))):g}"


_MODEL_ERRORS = ("below 1", "1 to 2", "2 to 5", "above 5")


def _model_error(case: ScoredCase) -> str:
    """Range of the model-form error over the noise."""
    ratio = case.answer.form_deg / max(case.answer.noise_deg, 1e-9)
    return _MODEL_ERRORS[int(np.searchsorted((1.0, 2.0, 5.0), ratio, side="right"))]


def _beside(single: Sequence[ScoredCase]) -> dict[str, float]:
    """Top-1 on single effects: the diagnosis, with confounders counted as right, simple rules, and chance."""
    if not single:
        return {}
    found = {
        "diagnosis": rate(single, lambda c: c.reading.guess == c.answer.truth).value,
        "diagnosis, twins allowed": rate(single, lambda c: confusable(c.reading.guess, c.answer.truth)).value,
    }
    for rule in sorted({name for case in single for name in case.reading.others}):
        told = [case for case in single if rule in case.reading.others]
        found[f"rule: {rule}"] = sum(c.reading.others[rule] == c.answer.truth for c in told) / len(told)
    found["the same guesses dealt at random"] = chance(single)
    found["a name drawn at random"] = 1 / len(LABELS)
    return found


def _left_alone(healthy: Sequence[ScoredCase]) -> dict[str, Rate]:
    """Share of devices without a gap for which nothing is named: by the diagnosis, and by the simple rules."""
    if not healthy:
        return {}
    found = {"diagnosis": rate(healthy, lambda c: not alarm(c))}
    for rule in sorted({name for case in healthy for name in case.reading.others}):
        told = [case for case in healthy if rule in case.reading.others]
        found[f"rule: {rule}"] = Rate(sum(c.reading.others[rule] == "none" for c in told), len(told))
    return found


def score_json(score: Score) -> dict[str, Any]:
    """Plain data of a score; not-a-number becomes null."""
    seconds = [case.seconds for case in score.cases if case.seconds is not None]
    data = {
        "format": FORMAT,
        "cases": len(score.cases),
        "bars": [_bar_json(bar) for bar in score.bars],
        "metrics": [_bar_json(bar) for bar in score.metrics],
        "confusion": {
            "truths": score.confusion.truths,
            "guesses": score.confusion.guesses,
            "counts": score.confusion.counts.tolist(),
        },
        "calibration": asdict(score.calibration),
        "groups": {
            table: {name: {"right": r.hits, "cases": r.cases, "ci90": r.ci90} for name, r in rows.items()}
            for table, rows in score.groups.items()
        },
        "top1_beside": score.beside,
        "misses": [miss_json(case) for case in score.misses()],
        "seconds": {"median": float(np.median(seconds)), "greatest": max(seconds)} if seconds else None,
    }
    return dict(plain(data))


def _bar_json(bar: Bar) -> dict[str, Any]:
    return {**asdict(bar), "goal": bar.goal, "state": bar.state}


def kind_of_miss(case: ScoredCase) -> str:
    """Kind of a wrong verdict, in words."""
    said, truth = case.reading, truths_of(case)
    if said.verdict == FAILED:
        return "the diagnosis ended with an error"
    if case.answer.suite == "aliased":
        return "a periodic disturbance that these motions cannot show"
    if not case.answer.mains:
        return "a gap is claimed where there is none"
    if not said.claims:
        return f"no name: {said.verdict}"
    if case.answer.truth not in NAMES:
        return "a name for what the library does not have"
    if case.answer.suite == "configuration" and said.guess in truth:
        return "the right name with other groups of trials"
    if truth & set(said.claims):
        return "the right name, but not first"
    return "its confounder" if any(confusable(said.guess, name) for name in truth) else "a false name"


def miss_json(case: ScoredCase) -> dict[str, Any]:
    """Data of one wrong verdict: the truth, the answer, and the size of the gap."""
    answer, said = case.answer, case.reading
    return {
        "case": case.name,
        "suite": answer.suite,
        "truth": answer.truth,
        "effects": [f"{e.label} ({e.generator}, {e.ratio:.1f} floors)" for e in answer.effects],
        "verdict": said.verdict,
        "said": said.claims,
        "probability": said.confidence,
        "ambiguity": [sorted(group) for group in said.ambiguity],
        "ratio": answer.ratio,
        "plan": answer.plan,
        "separable": answer.separable,
        "baseline": answer.baseline,
        "variant": answer.variant,
        "device": answer.device.get("core", "recorded"),
        "miss": kind_of_miss(case),
        "confidently_wrong": confidently_wrong(case),
    }
