"""Measures over scored cases: rates with their intervals, confusion, overlap of sets, calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from .generators import CONFIGURATION, NAMES
from .reading import FAILED, VERDICTS, DiagnosisReading, ScoredCase

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


def resampled(cases: Sequence[ScoredCase], measure: Callable[[Sequence[ScoredCase]], float]) -> tuple[float, float]:
    """90 % interval of a measure that is no share: percentiles over resamples of the cases (Efron, Ann. Stat. 7, 1979).

    Not-a-number where no resample gives a value.
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
    return {effect.label for effect in case.answer.effects if effect.label in NAMES - set(case.answer.without)}


def chance(cases: Sequence[ScoredCase]) -> float:
    """Top-1 that the same guesses would have, dealt to the cases at random: what the mere frequencies give."""
    if not cases:
        return float("nan")
    truths = Counter(case.answer.truth for case in cases)
    guesses = Counter(case.reading.guess for case in cases)
    return sum(truths[name] * guesses[name] for name in truths) / len(cases) ** 2
