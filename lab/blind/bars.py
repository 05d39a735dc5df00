"""Measures over scored cases, and the requirements with their bounds, 90 % intervals and violating cases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hystmpc.models.effects.catalogue import confusable

from ..page import Bar, Rate
from .generators import CONFIGURATION, NAMES, UNKNOWN
from .reading import FAILED, TRIAL, VERDICTS, DiagnosisReading, ScoredCase, large, of_suites, orders_said
from .sealed import DENSE, read_manifest

# Confounders beside each other, so that a confusion of the two lies near the diagonal.
_ORDER = (
    "lag",
    "delay",
    "rate_dependence",
    "stick_slip",
    "creep",
    "first_flexure",
    "drift",
    "trial_shift",
    CONFIGURATION,
    "slack",
    "nonlinear_gain",
    "contact",
    "asymmetry",
    "periodic_disturbance",
    "sensor",
    *(verdict for verdict in VERDICTS if verdict not in ("named", "one_of")),
    FAILED,
)
_RESAMPLES = 500


def rate(cases: Sequence[ScoredCase], hit: Callable[[ScoredCase], bool]) -> Rate:
    """Share of cases for which `hit` holds."""
    return Rate(sum(map(hit, cases)), len(cases))


def resampled(cases: Sequence[ScoredCase], measure: Callable[[Sequence[ScoredCase]], float]) -> tuple[float, float]:
    """90 % interval of a measure other than a share: percentiles over resamples of the cases; NaN without a value.

    Source: Efron, Ann. Stat. 7, 1979.
    """
    if not cases:
        return float("nan"), float("nan")
    random = np.random.default_rng(0)
    drawn = random.integers(len(cases), size=(_RESAMPLES, len(cases)))
    values = np.array([measure([cases[k] for k in row]) for row in drawn])
    values = values[np.isfinite(values)]
    low, high = np.quantile(values, (0.05, 0.95)) if values.size else (float("nan"), float("nan"))
    return float(low), float(high)


@dataclass(frozen=True)
class Confusion:
    """Confusion matrix (R, C): number of cases by true class and answer."""

    truths: tuple[str, ...]
    guesses: tuple[str, ...]
    counts: np.ndarray[tuple[int, int], np.dtype[np.int64]]


def confusion(cases: Sequence[ScoredCase]) -> Confusion:
    """Confusion matrix of largest cause and best single answer; names first, then verdicts, empty ones left out."""
    pairs = Counter((case.answer.truth, case.reading.guess) for case in cases)
    seen = {name for pair in pairs for name in pair}
    order = tuple(name for name in (*_ORDER, *sorted(seen - set(_ORDER))) if name in seen)
    truths = tuple(name for name in order if any(t == name for t, _ in pairs))
    guesses = tuple(name for name in order if any(g == name for _, g in pairs) or name in truths)
    counts = np.array([[pairs[(t, g)] for g in guesses] for t in truths], dtype=np.int64).reshape(
        len(truths), len(guesses)
    )
    return Confusion(truths, guesses, counts)


@dataclass(frozen=True)
class Overlap:
    """Overlap of named and true sets, over all cases together."""

    both: int
    said: int
    true: int

    @property
    def precision(self) -> float:
        """Share of the named effects that are true; not-a-number without names."""
        return self.both / self.said if self.said else float("nan")

    @property
    def recall(self) -> float:
        """Share of the true effects that are named."""
        return self.both / self.true if self.true else float("nan")

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall."""
        return 2 * self.both / (self.said + self.true) if self.said + self.true else float("nan")


def overlap(pairs: Iterable[tuple[Iterable[str], Iterable[str]]]) -> Overlap:
    """Sum of the overlaps over cases of (named, true)."""
    sets = [(set(said), set(true)) for said, true in pairs]
    return Overlap(sum(len(s & t) for s, t in sets), sum(len(s) for s, _ in sets), sum(len(t) for _, t in sets))


@dataclass(frozen=True)
class Bin:
    """Claims of similar probability."""

    claims: int
    confidence: float
    right: float


@dataclass(frozen=True)
class Calibration:
    """Calibration of the claimed probabilities.

    Attributes:
        error: expected calibration error, the mean over claims of |confidence - right| of their bin.
    """

    bins: tuple[Bin, ...]
    error: float


def calibration(cases: Sequence[ScoredCase], bins: int = 10) -> Calibration:
    """Calibration of all names with a probability (M. P. Naeini et al., AAAI 2015)."""
    claims = [
        (probability, name in truths_of(case))
        for case in cases
        for name, probability in zip(case.reading.claims, _probabilities(case.reading), strict=False)
    ]
    if not claims:
        return Calibration((), float("nan"))
    p, right = (np.array(column, dtype=np.float64) for column in zip(*claims, strict=True))
    place = np.minimum((p * bins).astype(int), bins - 1)
    found = [
        Bin(int(np.sum(place == k)), float(p[place == k].mean()), float(right[place == k].mean()))
        for k in range(bins)
        if np.any(place == k)
    ]
    error = sum(b.claims * abs(b.confidence - b.right) for b in found) / p.size
    return Calibration(tuple(found), float(error))


def _probabilities(reading: DiagnosisReading) -> tuple[float, ...]:
    return reading.probabilities if reading.effects else (reading.confidence,)


def truths_of(case: ScoredCase) -> set[str]:
    """Names that are true for a case, contaminants included."""
    return {effect.label for effect in case.answer.effects if effect.label in NAMES - set(case.answer.without)}


def chance(cases: Sequence[ScoredCase]) -> float:
    """Top-1 of the same answers after a random permutation of the cases, as the level of pure chance."""
    if not cases:
        return float("nan")
    truths = Counter(case.answer.truth for case in cases)
    guesses = Counter(case.reading.guess for case in cases)
    return sum(truths[name] * guesses[name] for name in truths) / len(cases) ** 2


_CONFIDENT = 0.8
_NEAR_ORACLE = 0.10
_NEAR_SAID = 0.10
HEALTHY = ("none", "misset", "controls", "retuned")
"""Suites of devices that lack nothing which other numbers of the simulator would not give."""


def bars(cases: Sequence[ScoredCase]) -> list[Bar]:
    """Requirements of the blind check; unless stated otherwise, at three floors or more on separating motions."""
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
        _share("own simulator: confirmed near the said share", [c for c in cases if c.confirmed], _confirms, 0.9),
        _localisation(single),
        _calibrated(cases),
        _resolved(cases),
        orders_bar({case.name: case.orders for case in cases if case.orders}),
    ]


def metrics(cases: Sequence[ScoredCase]) -> list[Bar]:
    """Metrics of the DX competition, bounded by the results of its winner; only the last leaves out the small gaps.

    Detection rate: share of the devices with a structural fault for which a fault is claimed, with a name or without.
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
    """Whether a named effect, or all of them together, raises the error of the final trials."""
    said = case.reading
    return min((*said.closed_shares, said.closed_share or 0.0)) < 0


def true_probability(case: ScoredCase) -> float:
    """Probability of the largest cause in the diagnosis; 0 if it is not in the ranking."""
    return dict(case.reading.ranking).get(case.answer.truth, 0.0)


def _probability(cases: Sequence[ScoredCase]) -> Bar:
    """Mean probability of the true class; a case counts as a miss below one half."""

    def mean(some: Sequence[ScoredCase]) -> float:
        return float(np.mean([true_probability(case) for case in some])) if some else float("nan")

    misses = tuple(case.name for case in cases if true_probability(case) < 0.5)
    name = "mean probability on the true class"
    return Bar(name, mean(cases), (0.85, 1.0), len(cases), misses, resampled(cases, mean))


def _sets(suite: str, cases: Sequence[ScoredCase], bound: float) -> tuple[Bar, Bar]:
    """Precision and recall of the names, over all cases together."""

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
    """Whether a false name is the answer with a probability of 0.8 or more."""
    said = case.reading
    return said.verdict == "named" and said.guess not in truths_of(case) and said.confidence >= _CONFIDENT


def true_share(case: ScoredCase) -> float:
    """True closed share: part of the gap closed by the effects on the final trials, above the diagnosis' floor.

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
    """Mean square over the final trials of an error given by trial [deg^2]; 0 if they are unknown."""
    numbers = [int(found.group(1)) for name in case.reading.final_trials if (found := TRIAL.search(name))]
    kept = [by_trial[n - 1] ** 2 for n in numbers if n <= len(by_trial)]
    return float(np.mean(kept)) if kept else 0.0


def _foreign(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    """Cases whose cause is missing in the library: foreign effects, and classes left out."""
    return [case for case in of_suites(cases, "unknown", "without") if case.answer.truth == UNKNOWN]


def _share(
    name: str, cases: Sequence[ScoredCase], hit: Callable[[ScoredCase], bool], bound: float, good: bool = True
) -> Bar:
    found: Rate = rate(cases, hit)
    misses = tuple(case.name for case in cases if hit(case) is not good)
    wanted = (bound, 1.0) if good else (0.0, bound)
    return Bar(name, found.value, wanted, found.cases, misses, found.ci90)


def _oracle(cases: Sequence[ScoredCase]) -> Bar:
    """Mean deficit of the closed share compared with a diagnosis that is given the class."""
    told = [case for case in cases if case.oracle is not None]

    def behind(case: ScoredCase) -> float:
        return max((case.oracle or 0.0) - (case.reading.closed_share or 0.0), 0.0)

    def mean(some: Sequence[ScoredCase]) -> float:
        return float(np.mean([behind(case) for case in some])) if some else float("nan")

    misses = tuple(case.name for case in told if behind(case) > _NEAR_ORACLE)
    bound = (0.0, _NEAR_ORACLE)
    return Bar("closed share behind the oracle", mean(told), bound, len(told), misses, resampled(told, mean))


def _coverage(cases: Sequence[ScoredCase]) -> Bar:
    """Share of intervals of the closed share that cover it in another session, for exactly the true effects named."""
    told = [case for case in rightly_named(cases) if case.again is not None]

    def covered(case: ScoredCase) -> bool:
        low, high = case.reading.closed_ci90 or (0.0, 0.0)
        return low <= (case.again or 0.0) <= high

    found = rate(told, covered)
    misses = tuple(case.name for case in told if not covered(case))
    return Bar("90 % intervals cover", found.value, (0.85, 0.95), found.cases, misses, found.ci90)


def _confirms(case: ScoredCase) -> bool:
    return all(abs(said - confirmed) <= _NEAR_SAID for said, confirmed in case.confirmed)


def rightly_named(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    """Cases with an interval of the closed share in which exactly the true effects were named."""
    return [c for c in cases if c.reading.closed_ci90 and set(c.reading.claims) == truths_of(c) != set()]


def covers_perfection(cases: Sequence[ScoredCase]) -> Rate:
    """Share of those intervals that cover the closed share of a perfect equation of the class (`true_share`)."""

    def covered(case: ScoredCase) -> bool:
        low, high = case.reading.closed_ci90 or (0.0, 0.0)
        return low <= true_share(case) <= high

    clear = [case for case in large(cases) if case.answer.separable and case.answer.true_closed is not None]
    return rate(rightly_named(clear), covered)


def _localisation(cases: Sequence[ScoredCase]) -> Bar:
    """F1 of the dense regions, over the regions with a statement in the diagnosis."""
    told = [case for case in cases if case.reading.densities]

    def truth(case: ScoredCase) -> set[str]:
        said = case.reading.densities
        return {name for name, density in case.answer.where.items() if density >= DENSE and name in said}

    def f1(some: Sequence[ScoredCase]) -> float:
        return overlap((case.reading.dense_regions, truth(case)) for case in some).f1

    misses = tuple(case.name for case in told if set(case.reading.dense_regions) != truth(case))
    return Bar("localisation F1", f1(told), (0.9, 1.0), len(told), misses, resampled(told, f1))


def _calibrated(cases: Sequence[ScoredCase]) -> Bar:
    """Calibration bar over all names; the count is of names, the misses are cases with a sure and false name."""
    told = of_suites(cases, "single", "pairs", "triple", "contaminated", "unknown", "configuration", *HEALTHY)
    found = calibration(told)
    misses = tuple(case.name for case in told if confidently_wrong(case))
    interval = resampled(told, lambda some: calibration(some).error)
    return Bar("calibration error", found.error, (0.0, 0.08), sum(b.claims for b in found.bins), misses, interval)


def _resolved(cases: Sequence[ScoredCase]) -> Bar:
    """Share of ambiguities that are resolved correctly after the proposed motion was recorded."""
    asked = [case for case in cases if case.reading.verdict == "one_of" and case.followed is not None]
    return _share("ambiguities that the next motion resolves", asked, resolved, 0.80)


def resolved(case: ScoredCase) -> bool:
    """Whether the diagnosis with the proposed motion leaves nothing open, and is right about the open effects.

    It names those open effects that are true, and nothing else that is false.
    """
    said, true = case.followed, truths_of(case)
    if said is None or said.verdict not in ("named", "none", "retuned"):
        return False
    claims, were_open = set(said.claims), frozenset[str]().union(*case.reading.ambiguity)
    if claims & were_open != true & were_open:
        return False
    return bool(true & were_open) or (claims <= true and bool(claims) == bool(true))


def orders_bar(said: Mapping[str, tuple[frozenset[str], ...]]) -> Bar:
    """Share of the diagnoses in other file orders that name the most frequent set of their case.

    The interval takes them as independent, which those of one case are not.
    """
    found = Rate(sum(max(map(sets.count, sets)) for sets in said.values()), sum(map(len, said.values())))
    misses = tuple(name for name, sets in said.items() if len(set(sets)) > 1)
    name = "same names in any order of the files"
    return Bar(name, found.value, (0.95, 1.0), found.cases, misses, found.ci90)


def orders_of(folder: Path) -> tuple[list[tuple[str, int, str]], Bar]:
    """Table of the names in each file order (case, orders, sets with counts), and the bar; answers stay sealed."""
    said = {name: orders_said(folder, name) for name in read_manifest(folder).cases}
    told = {name: sets for name, sets in said.items() if sets}
    words = {
        name: "; ".join(f"{' + '.join(sorted(s)) or 'no name'} {n}" for s, n in Counter(sets).most_common())
        for name, sets in told.items()
    }
    return [(name, len(sets), words[name]) for name, sets in told.items()], orders_bar(told)
