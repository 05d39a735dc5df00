"""Requirements of the blind check, each with its bound, its 90 % interval, and the cases that miss it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from hystmpc.models.effects.catalogue import confusable

from .generators import UNKNOWN
from .measures import Rate, calibration, overlap, rate, resampled, truths_of
from .reading import TRIAL, ScoredCase, large, of_suites
from .sealed import DENSE

_CONFIDENT = 0.8
_NEAR_ORACLE = 0.10
HEALTHY = ("none", "misset", "controls", "retuned")
"""Suites of devices that lack nothing which other numbers of the simulator would not give."""


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        value: the number; not-a-number where no case tells.
        wanted: `lower` and `upper` bound.
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
        if not self.cases or np.isnan(self.value):
            return "not measured"
        return "met" if self.wanted[0] <= self.value <= self.wanted[1] else "missed"

    @property
    def goal(self) -> str:
        """The bounds in words."""
        low, high = self.wanted
        if low <= 0:
            return f"<= {high:g}" if high > 0 else "0"
        return f">= {low:g}" if high >= 1 > low else "1" if low >= 1 else f"{low:g} to {high:g}"

    @property
    def plain(self) -> dict[str, Any]:
        """As JSON; a number that is not finite is null."""
        numbers = (self.value, *(self.ci90 or ()))
        value, *ci90 = (number if np.isfinite(number) else None for number in numbers)
        return asdict(self) | {"state": self.state, "value": value, "ci90": ci90 or None}


def bars(cases: Sequence[ScoredCase]) -> list[Bar]:
    """All bars of the blind check; where nothing else is said at three floors or more on motions that can tell."""
    clear = [case for case in large(cases) if case.answer.separable]
    single, foreign = of_suites(clear, "single"), _foreign(clear)
    return [
        _share("false alarms", of_suites(cases, *HEALTHY), alarm, 0.02, good=False),
        _share("class top-1", single, lambda c: c.reading.guess == c.answer.truth, 0.95),
        _share("family top-1", single, lambda c: confusable(c.reading.guess, c.answer.truth), 0.97),
        _probability(single),
        _share("top-1 with two contaminants", of_suites(clear, "contaminated"), lambda c: c.right, 0.85),
        *_sets("pairs", of_suites(clear, "pairs"), 0.85),
        *_sets("triples", of_suites(clear, "triple"), 0.75),
        _share("out of library: abstains", foreign, lambda c: c.right, 0.85),
        _share("out of library: confidently wrong", foreign, confidently_wrong, 0.05, good=False),
        _share("configuration change, with its groups", of_suites(clear, "configuration"), lambda c: c.right, 0.90),
        _share("aliased: no disturbance named above 0.3", of_suites(cases, "aliased"), lambda c: c.right, 1.0),
        _share("named effects that close less than nothing", _named(cases), closes_less_than_nothing, 0.0, good=False),
        _oracle(single),
        _coverage(clear),
        _localisation(single),
        _calibrated(cases),
        _resolved(cases),
        orders_bar({case.name: case.orders for case in cases if case.orders})[0],
    ]


def metrics(cases: Sequence[ScoredCase]) -> list[Bar]:
    """The DX competition's metrics, bounded by what its winner reached; only the last leaves out the small gaps.

    Detection rate: of the devices with a structural fault, those of which one is claimed, with a name or without.
    Source: DX 2025 competition on an engine, winner 0.87, 0 and 0.738.
    """
    faulty = [case for case in cases if case.answer.mains and case.answer.suite != "aliased"]
    clear = [case for case in of_suites(large(cases), "single") if case.answer.separable]
    return [
        _share("detection rate, all sizes", faulty, alarm, 0.87),
        _share("detection rate, three floors or more", large(faulty), alarm, 0.87),
        _share("false-alarm rate", of_suites(cases, *HEALTHY), alarm, 0.0, good=False),
        replace(_probability(clear), wanted=(0.738, 1.0)),
    ]


def _named(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    return [case for case in cases if case.reading.claims]


def closes_less_than_nothing(case: ScoredCase) -> bool:
    """Whether an effect that is named, or all of them together, raises the error of the final trials."""
    said = case.reading
    return min((*said.closed_shares, said.closed_share or 0.0)) < 0


def true_probability(case: ScoredCase) -> float:
    """Probability that the diagnosis gives the largest cause; 0 where it is not in the ranking."""
    return dict(case.reading.ranking).get(case.answer.truth, 0.0)


def _probability(cases: Sequence[ScoredCase]) -> Bar:
    """Mean probability on the true class; a case counts as a miss below one half."""

    def mean(some: Sequence[ScoredCase]) -> float:
        return float(np.mean([true_probability(case) for case in some])) if some else float("nan")

    misses = tuple(case.name for case in cases if true_probability(case) < 0.5)
    name = "mean probability on the true class"
    return Bar(name, mean(cases), (0.85, 1.0), len(cases), misses, resampled(cases, mean))


def _sets(suite: str, cases: Sequence[ScoredCase], bound: float) -> tuple[Bar, Bar]:
    """Precision and recall of the names said, over all cases together."""

    def precision(some: Sequence[ScoredCase]) -> float:
        return overlap((case.reading.claims, case.answer.labels) for case in some).precision

    def recall(some: Sequence[ScoredCase]) -> float:
        return overlap((case.reading.claims, case.answer.labels) for case in some).recall

    beside = tuple(c.name for c in cases if set(c.reading.claims) - set(c.answer.labels))
    lacking = tuple(c.name for c in cases if set(c.answer.labels) - set(c.reading.claims))
    wanted, count = (bound, 1.0), len(cases)
    return (
        Bar(f"set precision ({suite})", precision(cases), wanted, count, beside, resampled(cases, precision)),
        Bar(f"set recall ({suite})", recall(cases), wanted, count, lacking, resampled(cases, recall)),
    )


def alarm(case: ScoredCase) -> bool:
    """Whether a structural gap is claimed, with a name or without."""
    return case.reading.verdict not in ("none", "retuned", "too_little")


def confidently_wrong(case: ScoredCase) -> bool:
    """Whether a name that is not true is given as the answer, with a probability of 0.8 or more."""
    said = case.reading
    return said.verdict == "named" and said.guess not in truths_of(case) and said.confidence >= _CONFIDENT


def true_share(case: ScoredCase) -> float:
    """Share of the gap that the effects make up on the final trials, from the floor that the diagnosis counts from.

    closed = (MSE_retuned - MSE_with) / (MSE_retuned - MSE_floor) with MSE_with = noise^2 + form^2 and
    MSE_retuned = noise^2 + retuned^2, cut to 0..1: a floor above what is left counts model-form error as floor.
    """
    answer, floor = case.answer, case.reading.floor_deg
    retuned, form = _on_final(case, answer.retuned_by_trial), _on_final(case, answer.form_by_trial)
    if not retuned:
        retuned, form = answer.retuned_deg**2, answer.form_deg**2
    if floor is None or retuned <= 0:
        return answer.true_closed or 0.0
    gap = answer.noise_deg**2 + retuned - floor**2
    return float(np.clip((retuned - form) / max(gap, 1e-12), 0.0, 1.0))


def _on_final(case: ScoredCase, by_trial: Sequence[float]) -> float:
    """Mean square over the final trials of an error given by trial [deg^2]; 0 where they are not known."""
    numbers = [int(found.group(1)) for name in case.reading.final_trials if (found := TRIAL.search(name))]
    kept = [by_trial[n - 1] ** 2 for n in numbers if n <= len(by_trial)]
    return float(np.mean(kept)) if kept else 0.0


def _foreign(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    """Cases whose cause the library does not have: foreign effects, and classes left out."""
    return [case for case in of_suites(cases, "unknown", "without") if case.answer.truth == UNKNOWN]


def _share(
    name: str, cases: Sequence[ScoredCase], hit: Callable[[ScoredCase], bool], bound: float, good: bool = True
) -> Bar:
    found: Rate = rate(cases, hit)
    misses = tuple(case.name for case in cases if hit(case) is not good)
    wanted = (bound, 1.0) if good else (0.0, bound)
    return Bar(name, found.value, wanted, found.cases, misses, found.ci90)


def _oracle(cases: Sequence[ScoredCase]) -> Bar:
    """Mean of how far the closed share stays behind that of a diagnosis that was told the class."""
    told = [case for case in cases if case.oracle is not None]

    def behind(case: ScoredCase) -> float:
        return max((case.oracle or 0.0) - (case.reading.closed_share or 0.0), 0.0)

    def mean(some: Sequence[ScoredCase]) -> float:
        return float(np.mean([behind(case) for case in some])) if some else float("nan")

    misses = tuple(case.name for case in told if behind(case) > _NEAR_ORACLE)
    bound = (0.0, _NEAR_ORACLE)
    return Bar("closed share behind the oracle", mean(told), bound, len(told), misses, resampled(told, mean))


def _coverage(cases: Sequence[ScoredCase]) -> Bar:
    """Share of intervals of the closed share that hold what is closed in another session of the device.

    Only where exactly the true effects were named: what a wrong name closes is nobody's truth.
    """
    told = [case for case in rightly_named(cases) if case.again is not None]

    def covered(case: ScoredCase) -> bool:
        low, high = case.reading.closed_ci90 or (0.0, 0.0)
        return low <= (case.again or 0.0) <= high

    found = rate(told, covered)
    misses = tuple(case.name for case in told if not covered(case))
    return Bar("90 % intervals cover", found.value, (0.85, 0.95), found.cases, misses, found.ci90)


def rightly_named(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    """Cases with an interval of the closed share in which exactly the true effects were named."""
    return [c for c in cases if c.reading.closed_ci90 and set(c.reading.claims) == truths_of(c) != set()]


def covers_perfection(cases: Sequence[ScoredCase]) -> Rate:
    """Share of those intervals that hold what a perfect equation of the named class would close (`true_share`)."""

    def covered(case: ScoredCase) -> bool:
        low, high = case.reading.closed_ci90 or (0.0, 0.0)
        return low <= true_share(case) <= high

    clear = [case for case in large(cases) if case.answer.separable and case.answer.true_closed is not None]
    return rate(rightly_named(clear), covered)


def _localisation(cases: Sequence[ScoredCase]) -> Bar:
    """F1 of the dense regions, over those regions of which the diagnosis says anything."""
    told = [case for case in cases if case.reading.densities]

    def truth(case: ScoredCase) -> set[str]:
        said = case.reading.densities
        return {name for name, density in case.answer.where.items() if density >= DENSE and name in said}

    def f1(some: Sequence[ScoredCase]) -> float:
        return overlap((case.reading.dense_regions, truth(case)) for case in some).f1

    misses = tuple(case.name for case in told if set(case.reading.dense_regions) != truth(case))
    return Bar("localisation F1", f1(told), (0.9, 1.0), len(told), misses, resampled(told, f1))


def _calibrated(cases: Sequence[ScoredCase]) -> Bar:
    """Over all names put forward; the count is of names, the misses are the cases of a sure and false one."""
    told = of_suites(cases, "single", "pairs", "triple", "contaminated", "unknown", "configuration", *HEALTHY)
    found = calibration(told)
    misses = tuple(case.name for case in told if confidently_wrong(case))
    interval = resampled(told, lambda some: calibration(some).error)
    return Bar("calibration error", found.error, (0.0, 0.08), sum(b.claims for b in found.bins), misses, interval)


def _resolved(cases: Sequence[ScoredCase]) -> Bar:
    """Share of ambiguities of which, after the proposed motion was recorded, what is true is left and nothing else."""
    asked = [case for case in cases if case.reading.verdict == "one_of" and case.followed is not None]
    return _share("ambiguities that the next motion resolves", asked, resolved, 0.80)


def resolved(case: ScoredCase) -> bool:
    """Whether the diagnosis with the proposed motion leaves nothing open, and is right about what was open.

    Of the effects that were open it names those that are true. Where none of them is, it names none of them, and
    nothing else that is false.
    """
    said, true = case.followed, truths_of(case)
    if said is None or said.verdict not in ("named", "none", "retuned"):
        return False
    claims, were_open = set(said.claims), frozenset[str]().union(*case.reading.ambiguity)
    if claims & were_open != true & were_open:
        return False
    return bool(true & were_open) or (claims <= true and bool(claims) == bool(true))


def orders_bar(said: Mapping[str, tuple[frozenset[str], ...]]) -> tuple[Bar, Rate]:
    """Share of the diagnoses in other orders of the files that name the most frequent set of their case.

    The interval takes them as independent, which those of one case are not.
    """
    found = Rate(sum(max(map(sets.count, sets)) for sets in said.values()), sum(map(len, said.values())))
    misses = tuple(name for name, sets in said.items() if len(set(sets)) > 1)
    name = "same names in any order of the files"
    return Bar(name, found.value, (0.95, 1.0), found.cases, misses, found.ci90), found
