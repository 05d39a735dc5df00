"""Requirements of the blind check, and the measures behind them: rates, confusion, overlap, calibration."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from scipy.stats import binomtest

from hystmpc.models.effects.catalogue import confusable

from .generators import UNKNOWN
from .reading import FAILED, VERDICTS, DiagnosisReading, ScoredCase, large, of_suites
from .sealed import DENSE

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
    "slack",
    "nonlinear_gain",
    "contact",
    "asymmetry",
    "periodic_disturbance",
    "sensor",
    *(verdict for verdict in VERDICTS if verdict not in ("named", "one_of")),
    FAILED,
)
_CONFIDENT = 0.8
_NEAR_ORACLE = 0.10
_TRIAL = re.compile(r"trial_(\d+)")


@dataclass(frozen=True)
class Rate:
    """A share of cases."""

    hits: int
    cases: int

    @property
    def value(self) -> float:
        """The share; not-a-number without cases."""
        return self.hits / self.cases if self.cases else float("nan")

    @property
    def ci90(self) -> tuple[float, float]:
        """Wilson's 90 % interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
        if not self.cases:
            return 0.0, 1.0
        found = binomtest(self.hits, self.cases).proportion_ci(0.9, method="wilson")
        # Rounding may put an end past the rate itself where that is 0 or 1.
        return min(float(found.low), self.value), max(float(found.high), self.value)


def rate(cases: Sequence[ScoredCase], hit: Callable[[ScoredCase], bool]) -> Rate:
    """Share of cases for which `hit` holds."""
    return Rate(sum(map(hit, cases)), len(cases))


@dataclass(frozen=True)
class Confusion:
    """Truth by guess.

    Attributes:
        counts: cases (R, C).
    """

    truths: tuple[str, ...]
    guesses: tuple[str, ...]
    counts: np.ndarray[tuple[int, int], np.dtype[np.int64]]


def confusion(cases: Sequence[ScoredCase]) -> Confusion:
    """Largest cause against best single answer; names first, then verdicts, empty ones left out."""
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
    """Sets said against sets true, over all cases together."""

    both: int
    said: int
    true: int

    @property
    def precision(self) -> float:
        """Share of what was said that is true; not-a-number if nothing was said."""
        return self.both / self.said if self.said else float("nan")

    @property
    def recall(self) -> float:
        """Share of what is true that was said."""
        return self.both / self.true if self.true else float("nan")

    @property
    def f1(self) -> float:
        """Harmonic mean of both."""
        return 2 * self.both / (self.said + self.true) if self.said + self.true else float("nan")


def overlap(pairs: Iterable[tuple[Iterable[str], Iterable[str]]]) -> Overlap:
    """Sum over cases of (said, true)."""
    sets = [(set(said), set(true)) for said, true in pairs]
    return Overlap(sum(len(s & t) for s, t in sets), sum(len(s) for s, _ in sets), sum(len(t) for _, t in sets))


@dataclass(frozen=True)
class Bin:
    """Claims of like probability."""

    claims: int
    confidence: float
    right: float


@dataclass(frozen=True)
class Calibration:
    """Probabilities against truth.

    Attributes:
        error: expected calibration error, the mean over claims of |confidence - right| of their bin.
    """

    bins: tuple[Bin, ...]
    error: float


def calibration(cases: Sequence[ScoredCase], bins: int = 10) -> Calibration:
    """Calibration of every name put forward with a probability (M. P. Naeini et al., AAAI 2015)."""
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
    """Every name that would be true to say, contaminants included."""
    gone = (UNKNOWN, *case.answer.without)
    return {effect.label for effect in case.answer.effects if effect.label not in gone}


def chance(cases: Sequence[ScoredCase]) -> float:
    """Top-1 that the same guesses would have, dealt to the cases at random: what the mere frequencies give."""
    if not cases:
        return float("nan")
    truths = Counter(case.answer.truth for case in cases)
    guesses = Counter(case.reading.guess for case in cases)
    return sum(truths[name] * guesses[name] for name in truths) / len(cases) ** 2


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
            return f"<= {high:g}"
        return f">= {low:g}" if high >= 1 else f"{low:g} to {high:g}"

    @property
    def plain(self) -> dict[str, Any]:
        """As JSON; a number that is not finite is null."""
        numbers = (self.value, *(self.ci90 or ()))
        value, *ci90 = (number if np.isfinite(number) else None for number in numbers)
        return asdict(self) | {"state": self.state, "value": value, "ci90": ci90 or None}


def bars(cases: Sequence[ScoredCase]) -> list[Bar]:
    """All bars of the blind check, at three floors or more on motions that can tell the effects apart."""
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
    numbers = [int(found.group(1)) for name in case.reading.final_trials if (found := _TRIAL.search(name))]
    kept = [by_trial[n - 1] ** 2 for n in numbers if n <= len(by_trial)]
    return float(np.mean(kept)) if kept else 0.0


def _foreign(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    """Cases whose cause the library does not have: foreign effects, and classes left out."""
    return [case for case in of_suites(cases, "unknown", "without") if case.answer.truth == "unknown"]


def _share(
    name: str, cases: Sequence[ScoredCase], hit: Callable[[ScoredCase], bool], bound: float, good: bool = True
) -> Bar:
    found: Rate = rate(cases, hit)
    misses = tuple(case.name for case in cases if hit(case) is not good)
    wanted = (bound, 1.0) if good else (0.0, bound)
    return Bar(name, found.value, wanted, found.cases, misses, found.ci90)


def _oracle(cases: Sequence[ScoredCase]) -> Bar:
    """Mean of how far the closed share stays behind that of a diagnosis that was told the class."""
    behind = {
        case.name: max(case.oracle - (case.reading.closed_share or 0.0), 0.0)
        for case in cases
        if case.oracle is not None
    }
    misses = tuple(name for name, gap in behind.items() if gap > _NEAR_ORACLE)
    value = float(np.mean(list(behind.values()))) if behind else float("nan")
    return Bar("closed share behind the oracle", value, (0.0, _NEAR_ORACLE), len(behind), misses)


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
    truth = {
        case.name: {
            name for name, density in case.answer.where.items() if density >= DENSE and name in case.reading.densities
        }
        for case in told
    }
    found = overlap((case.reading.dense_regions, truth[case.name]) for case in told)
    misses = tuple(case.name for case in told if set(case.reading.dense_regions) != truth[case.name])
    return Bar("localisation F1", found.f1, (0.8, 1.0), len(told), misses)


def _calibrated(cases: Sequence[ScoredCase]) -> Bar:
    found = calibration(cases)
    return Bar("calibration error", found.error, (0.0, 0.10), sum(b.claims for b in found.bins))


def _resolved(cases: Sequence[ScoredCase]) -> Bar:
    """Share of ambiguities of which, after the proposed motion was recorded, the truth is left and nothing else."""
    asked = [case for case in cases if case.reading.verdict == "one_of" and case.followed is not None]

    def resolved(case: ScoredCase) -> bool:
        said = case.followed
        if said is None or said.verdict != "named":
            return False
        open_names = frozenset[str]().union(*case.reading.ambiguity)
        return set(said.claims) & open_names == truths_of(case) & open_names != set()

    return _share("ambiguities that the next motion resolves", asked, resolved, 0.70)
