"""Certainty of an attribution: effects that could replace a chosen one, inclusion in resamples, probabilities."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import beta

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.identify.cross_validation import (
    CrossValidation,
    HeldOutErrors,
    Hypothesis,
    gain,
    mean_square_difference,
    sureness,
)
from hystmpc.models.identify.selection import Selection, SelectionSettings, line_share, reselect
from hystmpc.models.identify.timing import timing_errors
from hystmpc.models.identify.uncertainty import uncertainty

# Ridge logistic regression on 407 names of three blind checks, seeds 3171823, 4172611 and 5290417; frozen.
_BIAS, _AMBIGUOUS, _SURE, _GENERIC = 1.4, -1.85, 1.45, -1.1
_UNTRIED = -2.0  # set by judgement, not fitted: keeps the probability below 0.8
_DRAWS = 60

_NEARER = 0.2  # least preference of the measurement for the chosen explanation over another, -1 to 1 ...
_NEARER_ERRORS = 1.5  # ... and by how many standard errors, for the two to be told apart
_TIMING_ERRORS, _QUICK_ERRORS = 2.0, 3.0  # the same for lag, delay and rate dependence, held out in parts, or quick
_SIGNIFICANT_DRIFT = 3.0  # standard errors by which a drift shows within trials
_SCATTER = 0.01  # chance by which shifts that scatter follow the clock so well, below which they are a drift


def ambiguity_of(selection: Selection, drift_shows: Callable[[Hypothesis], bool]) -> tuple[tuple[str, ...], ...]:
    """Sets of effects that explain the development trials equally well, the chosen effect first.

    A drift and shifts between trials are distinguished by the drift within the trials, or by shifts that follow the
    clock more closely than by chance. A clear line at a frequency that is not the motion's is no other effect.
    """
    chosen, sets = selection.chosen, []
    names = chosen.hypothesis.effects
    for effect in sorted(names):
        rest = names - {effect}
        others = []
        if effect == "periodic_disturbance" and _clear(selection.tried.get(rest), chosen):
            continue
        for tried, judged in selection.tried.items():
            exchanged = len(tried) == len(names) and rest < tried and tried != names
            if not exchanged or _distinguishable(chosen, judged):
                continue
            (other,) = tried - rest
            if (effect, other) == ("drift", "trial_shift"):
                neither = selection.tried.get(rest)
                share = line_share(neither, judged, chosen) if neither else 0.0
                if _follows_line(share, len(chosen.errors)) or drift_shows(chosen.hypothesis):
                    continue
            others.append(other)
        if others:
            sets.append((effect, *others))
    return tuple(sets)


def _clear(before: HeldOutErrors | None, after: HeldOutErrors) -> bool:
    """Whether the error falls by so many standard errors that a line leaves no doubt."""
    return before is not None and sureness(before, after) > SelectionSettings().clear_errors


def _distinguishable(chosen: HeldOutErrors, other: HeldOutErrors) -> bool:
    """Whether held-out trials are significantly closer to the chosen prediction a than to the other one b.

    (|y - b|^2 - |y - a|^2) / |a - b|^2 = 1 - 2 (y - a) . (b - a) / |a - b|^2 is 1 if a is true, -1 if b is true.
    """
    if chosen.parts is not None and other.parts is not None:
        held_out, quick = timing_errors(other, chosen)
        return held_out > _TIMING_ERRORS or quick > _QUICK_ERRORS
    fall, error = gain(other, chosen)
    return fall > _NEARER * mean_square_difference(chosen, other) and fall > _NEARER_ERRORS * error


def _follows_line(share: float, trials: int) -> bool:
    """Whether trial shifts follow a line over time: r^2 of N independent normal ones is Beta(1/2, (N - 2)/2)."""
    return trials > 2 and bool(beta.sf(min(share, 1.0), 0.5, 0.5 * (trials - 2)) < _SCATTER)


def drift_is_significant(validation: CrossValidation, hypothesis: Hypothesis) -> bool:
    """Whether the development runs show a drift even if each run may have an individual shift.

    The rate must differ from zero in the direction of the fit without shifts.
    """
    problem = hypothesis.problem
    terms = replace(problem.terms, shift=True)
    shifted = validation.with_causes(problem.effects, terms, hypothesis.z, [hypothesis.values])
    known = uncertainty(shifted.problem, shifted.q, validation.runs)
    k = problem.size - sum(len(c.free) for c in problem.effects)
    for c in problem.effects:
        for _ in c.free:
            error = float(np.sqrt(known.covariance[k, k]))
            if (
                c.effect == "drift"
                and error > 0
                and shifted.q[k] * np.sign(hypothesis.q[k]) > _SIGNIFICANT_DRIFT * error
            ):
                return True
            k += 1
    return False


def inclusion_shares(selection: Selection, floor_mse: float, faults_mse: float, seed: int) -> dict[str, float]:
    """Inclusion frequency of each effect: share of block resamples whose selection, by the same rules, contains it.

    Nothing is refitted: the rules choose among the hypotheses that were judged, from their errors in blocks drawn with
    replacement. The whole selection is repeated, since some of its preferences are not those of the error alone, as
    for a drift in place of shifts that follow the clock.
    """
    rng, tried = np.random.default_rng(seed), selection.tried
    blocks, counts = selection.baseline.energy.size, Counter[str]()
    for _ in range(_DRAWS):
        at = rng.integers(0, blocks, blocks)
        drawn = {names: judged.at(at) for names, judged in tried.items()}
        counts.update(reselect(drawn, SelectionSettings(), floor_mse, faults_mse).chosen.hypothesis.effects)
    effects = {name for names in tried for name in names}
    return {name: counts[name] / _DRAWS for name in sorted(effects)}


def probability(name: str, share: float, ambiguous: bool, stability: float, untried: bool = False) -> float:
    """Calibrated probability that a chosen effect is present.

        logit P = b_0 + b_1 ambiguous + b_2 sure + b_3 generic (1 - sure) + b_4 untried,    sure = share stability^2

    Args:
        share: of the structural gap closed by the effect, 0 to 1.
        ambiguous: whether another effect could replace it.
        stability: share of other splits of the trials with the same verdict, 0 to 1.
        untried: whether the library lacks an effect that is confusable with it.
    """
    sure = min(max(share, 0.0), 1.0) * stability**2
    generic = name in EFFECTS and EFFECTS[name].generic  # it can imitate almost any other: its name is less certain
    logit = _BIAS + _AMBIGUOUS * ambiguous + _SURE * sure + _GENERIC * generic * (1 - sure)
    return 1 / (1 + math.exp(-logit - _UNTRIED * untried))


def limited_by_inclusion(chance: float, inclusion: float) -> float:
    """Probability of an effect, limited by its inclusion in the resamples: P <= (1 + inclusion) / 2.

    An effect that no resample needs is at most as likely as not, whatever share it closes.
    """
    return min(chance, 0.5 * (1 + min(max(inclusion, 0.0), 1.0)))


def ranking(
    chosen: Mapping[str, float],
    inclusion: Mapping[str, float],
    ambiguity: Sequence[Sequence[str]],
    library: Sequence[str],
    left_open: float = 1.0,
) -> tuple[tuple[str, float], ...]:
    """Effects of the library by probability, highest first; among equal ones the chosen effect comes first.

    Effects that could replace a chosen one share its remaining probability; the others have half of that times their
    inclusion. None exceeds the effect that it could replace, or the most probable chosen one.

    Args:
        ambiguity: sets of effects that could replace each other, the chosen one first.
        left_open: probability of an effect that the verdict does not name.
    """
    most = max(chosen.values(), default=1.0)
    left = left_open * (1 - max(chosen.values(), default=0.0))
    rivals = {name: chosen.get(names[0], most) for names in ambiguity if names for name in names[1:]}
    even = left / max(len(rivals), 1)
    rows = []
    for name in library:
        minor = 0.5 * left * min(inclusion.get(name, 0.0), 1.0)
        other = min(even, rivals[name]) if name in rivals else min(minor, most)
        rows.append((name, chosen.get(name, other)))
    return tuple(sorted(rows, key=lambda row: (-row[1], row[0] not in chosen)))
