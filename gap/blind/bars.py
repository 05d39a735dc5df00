"""The bars of the blind check: each with its number, how many cases it rests on, and the cases that missed."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hystmpc.models.effects.catalogue import confusable

from .measures import Rate, calibration, overlap, rate, truths_of
from .regions import DENSE
from .scored import Scored, large, of_suites

_CONFIDENT = 0.8
_NEAR_ORACLE = 0.10
_TRIAL = re.compile(r"trial_(\d+)")


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        name: what is measured.
        value: the number; not-a-number where no case tells.
        wanted: `lower` and `upper` bound.
        cases: that it rests on.
        misses: names of the cases that speak against it.
        ci90: interval of the number, for rates.
    """

    name: str
    value: float
    wanted: tuple[float, float]
    cases: int
    misses: tuple[str, ...] = ()
    ci90: tuple[float, float] | None = None

    @property
    def state(self) -> Literal["met", "missed", "not measured"]:
        """Whether the number is within its bounds."""
        if not self.cases or not np.isfinite(self.value):
            return "not measured"
        return "met" if self.wanted[0] <= self.value <= self.wanted[1] else "missed"

    @property
    def goal(self) -> str:
        """The bounds in words."""
        low, high = self.wanted
        if low <= 0:
            return f"<= {high:g}"
        return f">= {low:g}" if high >= 1 else f"{low:g} to {high:g}"


def bars(cases: Sequence[Scored]) -> list[Bar]:
    """All bars of the design's section 5, at three floors or more on motions that can tell the effects apart."""
    clear = [case for case in large(cases) if case.answer.separable]
    single, foreign = of_suites(clear, "single"), _foreign(clear)
    pairs = of_suites(clear, "pairs")
    sets = overlap((case.reading.claims, case.answer.labels) for case in pairs)
    wrong_sets = tuple(c.name for c in pairs if set(c.reading.claims) != set(c.answer.labels))
    return [
        _share("false alarms", of_suites(cases, "none", "misset", "controls"), alarm, 0.05, good=False),
        _share("class top-1", single, lambda c: c.reading.guess == c.answer.truth, 0.85),
        _share("family top-1", single, lambda c: confusable(c.reading.guess, c.answer.truth), 0.95),
        _share("top-1 with two contaminants", of_suites(clear, "contaminated"), lambda c: c.right, 0.80),
        Bar("set precision (pairs)", sets.precision, (0.85, 1.0), len(pairs), wrong_sets),
        Bar("set recall (pairs)", sets.recall, (0.85, 1.0), len(pairs), wrong_sets),
        _share("out of library: abstains", foreign, lambda c: c.right, 0.80),
        _share("out of library: confidently wrong", foreign, confidently_wrong, 0.10, good=False),
        _oracle(single),
        _coverage(clear),
        _localisation(single),
        _calibrated(of_suites(cases, "single", "pairs", "contaminated", "unknown", "none", "misset")),
        _resolved(cases),
    ]


def alarm(case: Scored) -> bool:
    """Whether a structural gap is claimed, with a name or without."""
    return case.reading.verdict not in ("none", "too_little")


def confidently_wrong(case: Scored) -> bool:
    """Whether a name that is not true is given as the answer, with a probability of 0.8 or more."""
    said = case.reading
    return said.verdict == "named" and said.guess not in truths_of(case) and said.confidence >= _CONFIDENT


def true_share(case: Scored) -> float:
    """Share of the gap that the effects make up on the final trials, from the floor that the diagnosis counts from.

    closed = (MSE_retuned - MSE_with) / (MSE_retuned - MSE_floor) with MSE_with = noise^2 + form^2 and
    MSE_retuned = noise^2 + retuned^2, cut to 0..1: a floor above what is left counts model-form error as no news.
    """
    answer, floor = case.answer, case.reading.floor_deg
    retuned, form = _on_final(case, answer.retuned_by_trial), _on_final(case, answer.form_by_trial)
    if not retuned:
        retuned, form = answer.retuned_deg**2, answer.form_deg**2
    if floor is None or retuned <= 0:
        return answer.true_closed or 0.0
    gap = answer.noise_deg**2 + retuned - floor**2
    return float(np.clip((retuned - form) / max(gap, 1e-12), 0.0, 1.0))


def _on_final(case: Scored, by_trial: Sequence[float]) -> float:
    """Mean square over the final trials of an error given by trial [deg^2]; 0 where they are not known."""
    numbers = [int(found.group(1)) for name in case.reading.final_trials if (found := _TRIAL.search(name))]
    kept = [by_trial[n - 1] ** 2 for n in numbers if n <= len(by_trial)]
    return float(np.mean(kept)) if kept else 0.0


def _foreign(cases: Sequence[Scored]) -> list[Scored]:
    """Cases whose cause the library does not have: foreign effects, and classes left out."""
    return [case for case in of_suites(cases, "unknown", "without") if case.answer.truth == "unknown"]


def _share(name: str, cases: Sequence[Scored], hit: Callable[[Scored], bool], bound: float, good: bool = True) -> Bar:
    found: Rate = rate(cases, hit)
    misses = tuple(case.name for case in cases if hit(case) is not good)
    wanted = (bound, 1.0) if good else (0.0, bound)
    return Bar(name, found.value, wanted, found.cases, misses, found.ci90)


def _oracle(cases: Sequence[Scored]) -> Bar:
    """Mean of how far the closed share stays behind that of a diagnosis that was told the class."""
    behind = {
        case.name: max(case.oracle - (case.reading.closed_share or 0.0), 0.0)
        for case in cases
        if case.oracle is not None
    }
    misses = tuple(name for name, gap in behind.items() if gap > _NEAR_ORACLE)
    value = float(np.mean(list(behind.values()))) if behind else float("nan")
    return Bar("closed share behind the oracle", value, (0.0, _NEAR_ORACLE), len(behind), misses)


def _coverage(cases: Sequence[Scored]) -> Bar:
    """Share of intervals of the closed share that hold what is closed in another session of the device.

    Only where exactly the true effects were named: what a wrong name closes is nobody's truth.
    """
    told = [case for case in rightly_named(cases) if case.again is not None]

    def covered(case: Scored) -> bool:
        low, high = case.reading.closed_ci90 or (0.0, 0.0)
        return low <= (case.again or 0.0) <= high

    found = rate(told, covered)
    misses = tuple(case.name for case in told if not covered(case))
    return Bar("90 % intervals cover", found.value, (0.85, 0.95), found.cases, misses, found.ci90)


def rightly_named(cases: Sequence[Scored]) -> list[Scored]:
    """Cases with an interval of the closed share in which exactly the true effects were named."""
    return [c for c in cases if c.reading.closed_ci90 and set(c.reading.claims) == truths_of(c) != set()]


def covers_perfection(cases: Sequence[Scored]) -> Rate:
    """Share of those intervals that hold what a perfect equation of the named class would close (`true_share`)."""

    def covered(case: Scored) -> bool:
        low, high = case.reading.closed_ci90 or (0.0, 0.0)
        return low <= true_share(case) <= high

    clear = [case for case in large(cases) if case.answer.separable and case.answer.true_closed is not None]
    return rate(rightly_named(clear), covered)


def _localisation(cases: Sequence[Scored]) -> Bar:
    """F1 of the dense regions, over those regions of which the diagnosis says anything."""
    told = [case for case in cases if case.reading.densities]
    truth = {
        case.name: {
            name for name, density in case.answer.where.items() if density >= DENSE and name in case.reading.densities
        }
        for case in told
    }
    found = overlap((case.reading.dense_regions, truth[case.name]) for case in told)
    misses = tuple(case.name for case in told if set(case.reading.dense_regions) != truth[case.name])
    return Bar("localisation F1", found.f1, (0.8, 1.0), len(told), misses)


def _calibrated(cases: Sequence[Scored]) -> Bar:
    found = calibration(cases)
    return Bar("calibration error", found.error, (0.0, 0.10), sum(b.claims for b in found.bins))


def _resolved(cases: Sequence[Scored]) -> Bar:
    """Share of ambiguities of which, after the proposed motion was recorded, the truth is left and nothing else."""
    asked = [case for case in cases if case.reading.verdict == "one_of" and case.followed is not None]

    def resolved(case: Scored) -> bool:
        said = case.followed
        if said is None or said.verdict != "named":
            return False
        open_names = frozenset[str]().union(*case.reading.ambiguity)
        return set(said.claims) & open_names == truths_of(case) & open_names != set()

    return _share("ambiguities that the next motion resolves", asked, resolved, 0.70)
