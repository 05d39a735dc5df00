"""Selection of causes: forward addition, removal and exchange, by joint fits and free-run errors on held-out trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ..effects.catalogue import EFFECTS
from ..effects.effect import Candidate
from .cross_validation import CrossValidation, HeldOutErrors, Hypothesis, gain, sureness
from .least_squares import side_by_side
from .motion_lines import motion_frequencies, strongest_line
from .problem import Problem, TrialTerms
from .timing import TIMING, by_timing, timing_rivals

RoundProgress = Callable[[float, str], None]
"""Told the share of the present round, and the candidate that is tried."""

_PARAMETERS_OF_TERMS = 100
_SAME_FIT = 1e-3  # relative fall of the error that counts as none: the tolerance of the fits
OF_SINGLE_TRIALS = frozenset({"trial_shift", "periodic_disturbance"})  # fitted to each trial, have to recur


@dataclass(frozen=True)
class SelectionSettings:
    """Thresholds of the selection, chosen on development cases and frozen.

    Attributes:
        most: greatest number of causes.
        standard_errors: by which the held-out error has to fall for a cause to be added.
        least_share: of the structural error that remains, by which it has to fall.
        shift_share: the same for `trial_shift`, which can explain any single bad trial.
        gap_share, form_share: least fall by the whole structural error, and by the floor.
        sure_share, sure_errors, most_share: the same by the whole structural error for a cause that explains so much of
            what remains, by so many standard errors: beside a large cause a smaller one is no less sure.
        clear_errors, clear_share, clear_most: by so many standard errors a fall is clear, and these shares of what
            remains replace `least_share` and `most_share`: a third cause may leave no doubt and still be small.
        generic_share: share of all that remains, less a faulty sensor's noise, that a generic effect next to others
            has to explain: what the wrong forms of these leave looks like one. At 0.64 the RMSE falls to 0.6.
        generic_sure: the same, from which a clear fall leaves no doubt, and `sure_share` is enough: the RMSE halves.
        drift_errors: by so many standard errors a drift beside shifts of trials needs no share of the whole error.
        recurs: by this share of the mean fall the median trial has to gain from what each trial has of its own.
        everywhere: the share of every trial's error that shifts have to explain where the median trial gains less.
        gives_way: generic effects, and the share of what they explain by which another cause may be worse and is still
            preferred.
        width_share: error with a width of each trial, over that with its offset and gain alone, below which it has one.
        line_of_shifts: of what shifts of the trials explain in the fit, the part that a drift may leave that makes them
            needless: it has one number for all trials.
        variants: forms of one effect that are tried again once it was tried alone.
        judged: candidates of a round that are judged on held-out trials; the others only by their fit.
        lowest_hz, highest_hz: where a periodic disturbance is looked for.
    """

    most: int = 4
    standard_errors: float = 2.0
    least_share: float = 0.2
    shift_share: float = 0.25
    gap_share: float = 0.08
    form_share: float = 0.1
    sure_share: float = 0.03
    sure_errors: float = 4.0
    most_share: float = 0.5
    clear_errors: float = 8.0
    clear_share: float = 0.1
    clear_most: float = 0.3
    generic_share: float = 0.64
    generic_sure: float = 0.75
    drift_errors: float = 3.0
    recurs: float = 0.25
    everywhere: float = 0.5
    gives_way: tuple[tuple[str, float], ...] = (("trial_shift", 0.06), ("nonlinear_gain", 0.015), ("asymmetry", 0.015))
    width_share: float = 0.6
    line_of_shifts: float = 0.2
    variants: int = 2
    judged: int = 5
    lowest_hz: float = 0.15
    highest_hz: float = 5.0


@dataclass(frozen=True, eq=False)
class Selection:
    """Result of a selection.

    Attributes:
        chosen: baseline with the chosen causes; the baseline itself if there are none.
        tried: all judged hypotheses, by the names of their causes; the best variant of each.
    """

    baseline: HeldOutErrors
    chosen: HeldOutErrors
    tried: dict[frozenset[str], HeldOutErrors]


class _Judged:
    """Hypotheses with their errors on held-out trials, by the names of their causes."""

    def __init__(self, tried: Mapping[frozenset[str], HeldOutErrors]) -> None:
        self.tried = dict(tried)

    def baseline(self) -> HeldOutErrors:
        """Retuned simulator without causes."""
        return self.tried[frozenset()]

    def additions(self, base: Hypothesis, small: bool = False) -> Sequence[Hypothesis]:
        """Base with one more effect each, the most promising first; `small`: at least those that may explain little."""
        del small
        size = len(base.effects) + 1
        return [j.hypothesis for names, j in self.tried.items() if len(names) == size and base.effects < names]

    def without(self, hypothesis: Hypothesis, effect: str) -> Hypothesis | None:
        """Hypothesis without one of its effects; None where that was not judged."""
        known = self.tried.get(hypothesis.effects - {effect})
        return None if known is None else known.hypothesis

    def judged(self, hypothesis: Hypothesis) -> HeldOutErrors:
        return self.tried[hypothesis.effects]

    def all_judged(self, hypotheses: Sequence[Hypothesis]) -> list[HeldOutErrors]:
        """Errors of several hypotheses."""
        return [self.judged(hypothesis) for hypothesis in hypotheses]

    def known(self, names: frozenset[str]) -> HeldOutErrors | None:
        """Errors of the best hypothesis with these effects; None where none was judged yet."""
        return self.tried.get(names)


@final
class _Search:
    """Selection by the rules of `select`, on any trials."""

    def __init__(self, trials: _Judged, settings: SelectionSettings, floor_mse: float, faults_mse: float) -> None:
        self._trials, self._settings, self._floor, self._faults = trials, settings, floor_mse, faults_mse
        self._baseline_mse, self._strict = 0.0, False

    def run(self) -> tuple[HeldOutErrors, HeldOutErrors]:
        """Baseline and chosen hypothesis, without generic causes that explain no more than form errors would."""
        baseline = self._trials.baseline()
        self._baseline_mse = baseline.mse
        searched = self._searched(baseline, baseline)
        self._strict = True
        kept = self._dropped(searched)
        return baseline, searched if kept is searched else self._searched(kept, baseline)

    def _searched(self, current: HeldOutErrors, baseline: HeldOutErrors) -> HeldOutErrors:
        """Add, drop and exchange causes until nothing changes."""
        been: set[frozenset[str]] = set()  # guards against an endless cycle of addition and removal
        while current.hypothesis.effects not in been:
            been.add(current.hypothesis.effects)
            if len(current.hypothesis.effects) < self._settings.most and (added := self._best_addition(current)):
                current = self._dropped(added)
            elif current is not baseline:
                current = self._swapped(current, baseline)
        return current

    def _best_addition(self, current: HeldOutErrors) -> HeldOutErrors | None:
        remaining, explained = _without_best_trial(current) - self._floor, bool(current.hypothesis.effects)
        if explained and remaining <= self._settings.form_share * self._floor:
            return None  # not even a cause that explains all of it would be added
        small = explained and remaining <= self._settings.sure_share * (self._baseline_mse - self._floor)
        judged = self._trials.all_judged(self._trials.additions(current.hypothesis, small))
        worthy = [j for j in judged if self._worth_adding(current, j)]
        if not worthy:
            return None
        best = min(worthy, key=lambda j: j.mse)
        tied = [j for j in worthy if not _exceeds(gain(j, best))]
        return min(tied, key=lambda j: (_freedoms(j.hypothesis), j.mse))

    def _worth_adding(self, before: HeldOutErrors, after: HeldOutErrors) -> bool:
        settings, (fall, error) = self._settings, gain(before, after)
        new = after.hypothesis.effects - before.hypothesis.effects
        clear = fall > settings.clear_errors * error
        share = settings.clear_share if clear else settings.least_share
        share = settings.shift_share if "trial_shift" in new else share
        useful = before.mse - max(after.mse, self._floor)
        remaining = before.mse - self._floor
        most = settings.clear_most if clear else settings.most_share
        imitates = self._strict and bool(before.hypothesis.effects) and any(EFFECTS[name].generic for name in new)
        explainable = before.mse - self._faults
        if imitates:
            sure = clear and useful > settings.generic_sure * explainable
        else:
            sure = fall > settings.sure_errors * error and useful > most * remaining
        whole = (settings.sure_share if sure else settings.gap_share) * (self._baseline_mse - self._floor)
        within = new == {"drift"} and "trial_shift" in before.hypothesis.effects
        if within and fall > settings.drift_errors * error:
            whole = 0.0  # shifts explain the differences between trials, which make its share of the whole error small
        if clear and new == {"periodic_disturbance"}:
            share = whole = 0.0  # no wrong form of another cause leaves a line that is not the motion's
        if new == {"trial_shift"} and "drift" in before.hypothesis.effects and self._on_a_line(after, before):
            return False
        if new & OF_SINGLE_TRIALS and not _recurs(before, after, new, settings):
            return False
        least = max(share * remaining, whole, settings.form_share * self._floor)
        least = max(least, settings.generic_share * explainable) if imitates else least
        return sureness(before, after) > settings.standard_errors and useful > least

    def _dropped(self, current: HeldOutErrors) -> HeldOutErrors:
        for effect in sorted(current.hypothesis.effects):
            if len(current.hypothesis.effects) < 2:
                break
            simpler_fit = self._trials.without(current.hypothesis, effect)
            if simpler_fit is None:
                continue
            judged = self._trials.judged(simpler_fit)
            simpler = self._trials.known(simpler_fit.effects) or judged  # another start or form may be better
            if not self._worth_adding(simpler, current):
                current = simpler
        return current

    def _swapped(self, current: HeldOutErrors, baseline: HeldOutErrors) -> HeldOutErrors:
        """Hypothesis with each cause exchanged for each other one, where that is better."""
        for effect in sorted(current.hypothesis.effects):
            if effect not in current.hypothesis.effects:
                continue
            rest = baseline
            if len(current.hypothesis.effects) > 1:
                simpler_fit = self._trials.without(current.hypothesis, effect)
                if simpler_fit is None:
                    continue
                rest = self._trials.judged(simpler_fit)
            for hypothesis in self._trials.additions(rest.hypothesis):
                judged = self._trials.known(hypothesis.effects) or self._trials.judged(hypothesis)
                worthy = not self._strict or self._worth_adding(rest, judged)
                if worthy and self._better(current, judged, baseline):
                    current = judged
        return current

    def _on_a_line(self, shifts: HeldOutErrors, drift: HeldOutErrors) -> bool:
        """Whether shifts of trials follow the clock, so that a drift is enough."""
        neither = self._trials.known(shifts.hypothesis.effects & drift.hypothesis.effects - {"drift"})
        return neither is not None and line_share(neither, shifts, drift) >= 1 - self._settings.line_of_shifts

    def _better(self, present: HeldOutErrors, other: HeldOutErrors, baseline: HeldOutErrors) -> bool:
        """Whether an exchange is an improvement; a specific effect that is nearly as good replaces a generic one."""
        if len(other.hypothesis.effects) != len(present.hypothesis.effects) or other is present:
            return False
        fall, error = gain(present, other)
        left = present.hypothesis.effects - other.hypothesis.effects
        come = other.hypothesis.effects - present.hypothesis.effects
        if left == {"trial_shift"} and come == {"drift"}:
            return self._on_a_line(present, other)
        if left == {"drift"} and come == {"trial_shift"}:
            return fall > error and not self._on_a_line(other, present)
        for generic, share in self._settings.gives_way:
            if generic in left:
                return fall > -share * (baseline.mse - present.mse)
            if generic in come:
                return fall > share * (baseline.mse - other.mse)
        return fall > error


@final
class _Fits(_Judged):
    """Hypotheses that are fitted to the development runs and judged in folds on request."""

    def __init__(
        self,
        validation: CrossValidation,
        candidates: Sequence[Candidate],
        settings: SelectionSettings,
        without: Sequence[str],
        progress: RoundProgress,
    ) -> None:
        super().__init__({})
        self._validation, self._candidates, self._settings = validation, tuple(candidates), settings
        self._without, self._progress, self._blocks = without, progress, 0.0
        self._added: dict[tuple[Hypothesis, bool], list[Hypothesis]] = {}

    def baseline(self) -> HeldOutErrors:
        retuned = self.judged(self._validation.retuned())
        self._blocks = float(retuned.energy.size)
        return retuned

    def without(self, hypothesis: Hypothesis, effect: str) -> Hypothesis | None:
        """Device refitted without one effect; a known device of the same structure stays unless the fit is better."""
        refitted = self._validation.without(hypothesis, {effect})
        tried = self.tried.get(refitted.effects)
        if tried is None or not _same_structure(tried.hypothesis.problem, refitted.problem):
            return refitted
        return tried.hypothesis if refitted.mse >= (1 - _SAME_FIT) * tried.hypothesis.mse else refitted

    def judged(self, hypothesis: Hypothesis) -> HeldOutErrors:
        return self.all_judged([hypothesis])[0]

    def all_judged(self, hypotheses: Sequence[Hypothesis]) -> list[HeldOutErrors]:
        known = {h: j for h in hypotheses if (j := self.tried.get(h.effects)) is not None and j.hypothesis is h}
        new = [hypothesis for hypothesis in hypotheses if hypothesis not in known]
        for hypothesis, judged in zip(new, side_by_side(self._validation.judge, new), strict=True):
            best = self.tried.get(hypothesis.effects)
            if best is None or judged.mse < best.mse:
                self.tried[hypothesis.effects] = judged
            known[hypothesis] = judged
        return [known[hypothesis] for hypothesis in hypotheses]

    def additions(self, base: Hypothesis, small: bool = False) -> list[Hypothesis]:
        """Best variant of every effect that is not yet in the base and may be worth adding, the most promising first.

        Args:
            small: only of effects that need no share of the whole error (`_Search._worth_adding`).
        """
        if (base, small) not in self._added:
            self._added[base, small] = self._fitted_additions(base, small)
        return self._added[base, small]

    def _fitted_additions(self, base: Hypothesis, small: bool) -> list[Hypothesis]:
        best: dict[str, Hypothesis] = {}
        predicted: dict[str, float] = {}
        reached: dict[Candidate, float] = {}
        exempt = {"drift"} if "trial_shift" in base.effects else set[str]()
        tried = [c for c in self._candidates if c.effect not in base.effects and (not small or c.effect in exempt)]
        fits = side_by_side(lambda candidate: self._validation.with_one_more(base, candidate), tried)
        for k, (candidate, made) in enumerate(zip(tried, fits, strict=True)):
            self._progress(k / len(tried), candidate.label)
            reached[candidate] = made.mse * self._expected(len(candidate.free))
            if candidate.effect not in best or reached[candidate] < predicted[candidate.effect]:
                best[candidate.effect], predicted[candidate.effect] = made, reached[candidate]
        if not base.effects:
            self._candidates = _favourites(reached, self._settings.variants)
        for terms in self._terms(base, small):
            made = self._validation.with_causes(base.problem.effects, terms, base.z, [base.values])
            name = next(name for name in terms.names if name not in base.problem.terms.names)
            if name not in best or made.mse < self._settings.width_share * best[name].mse:
                best[name] = made
        order = sorted(best.values(), key=lambda h: h.mse)[: self._settings.judged]
        return [h for h in side_by_side(self._validation.finished, order) if self._may_be_worth(base, h)]

    def _may_be_worth(self, base: Hypothesis, made: Hypothesis) -> bool:
        """Whether held-out trials could speak for an addition, of which they leave no less than the fit to all trials.

            E(q_k) >= E(q),   E_-k(q_k) <= E_-k(q),   so E_k(q_k) >= E_k(q)

        with q fitted to all runs, q_k to all but fold k. An addition has to explain `clear_share` of what remains and
        `form_share` of the floor: half of the lesser one is a share of their sum.
        """
        if made.problem.terms.frequency_hz and not base.problem.terms.frequency_hz:
            return True
        least = 0.5 * min(self._settings.clear_share, self._settings.form_share)
        return not base.effects or made.mse < (1 - least) * self.tried[base.effects].mse

    def _expected(self, free: int) -> float:
        """Factor (B + Q) / (B - Q) from training to other trials (Akaike, Ann. Inst. Stat. Math. 21, 1969)."""
        blocks = self._blocks
        return (blocks + free) / max(blocks - free, 1.0)

    def _several_trials(self) -> bool:
        """Whether there are several trials: folds of one trial share its samples and have no shift between trials."""
        return len({id(run.command) for run in self._validation.runs}) > 1

    def _terms(self, base: Hypothesis, small: bool) -> list[TrialTerms]:
        terms, made = base.problem.terms, []
        if not small and not terms.shift and "trial_shift" not in self._without and self._several_trials():
            width = self._validation.baseline.width
            made.append(replace(terms, shift=True))
            made += [replace(terms, shift=True, width=width)] if width >= 0 else []
        if not terms.frequency_hz and "periodic_disturbance" not in self._without:
            runs, settings = list(self._validation.runs), self._settings
            errors = [base.error(run) for run in runs]
            line = strongest_line(runs, errors, settings.lowest_hz, settings.highest_hz)
            if line > 0:
                is_motion = bool(motion_frequencies(runs, np.array([2 * line]))[0])
                made.append(replace(terms, frequency_hz=line, harmonics=1 if is_motion else terms.harmonics))
        return made


def _same_structure(one: Problem, other: Problem) -> bool:
    return frozenset(one.effects) == frozenset(other.effects) and one.terms == other.terms


def _favourites(reached: Mapping[Candidate, float], most: int) -> tuple[Candidate, ...]:
    """Best variants of each effect alone; later rounds try no others."""
    kept = []
    for effect in dict.fromkeys(candidate.effect for candidate in reached):
        reached_by_effect = sorted((c for c in reached if c.effect == effect), key=lambda c: reached[c])
        kept += reached_by_effect[:most]
    return tuple(kept)


def _without_best_trial(judged: HeldOutErrors) -> float:
    """Mean square error of all trials but the best one [deg^2], as a resample of the trials may have it."""
    energy, samples = (np.bincount(judged.run, values) for values in (judged.energy, judged.samples))
    if np.count_nonzero(samples) < 2:
        return judged.mse
    best = int(np.argmin(np.divide(energy, samples, out=np.full(samples.size, np.inf), where=samples > 0)))
    return float((energy.sum() - energy[best]) / (samples.sum() - samples[best]))


def _exceeds(gained: tuple[float, float]) -> bool:
    return gained[0] > gained[1]


def _freedoms(hypothesis: Hypothesis) -> int:
    """Number of free parameters of the causes; terms of single trials count as more than any."""
    return sum(len(c.free) for c in hypothesis.problem.effects) + _PARAMETERS_OF_TERMS * len(
        hypothesis.problem.terms.names
    )


def _recurs(before: HeldOutErrors, after: HeldOutErrors, new: AbstractSet[str], settings: SelectionSettings) -> bool:
    """Whether terms of single trials explain most trials, and not a single unusual one alone.

    Where groups of unequal size share a shift, the larger group gains less: then a shift has to explain half of the
    error of every trial, and the trials without the best one have to gain as the mean does.
    """
    runs = [before.run == k for k in np.unique(before.run)]
    falls = np.array([(before.energy - after.energy)[blocks].sum() for blocks in runs])
    least = settings.recurs * float(np.mean(falls))
    if float(np.median(falls)) > least:
        return True
    everywhere = all(
        fall > settings.everywhere * before.energy[blocks].sum() for fall, blocks in zip(falls, runs, strict=True)
    )
    return new == {"trial_shift"} and everywhere and falls.size > 1 and float(np.mean(np.sort(falls)[:-1])) > least


def line_share(neither: HeldOutErrors, shifts: HeldOutErrors, drift: HeldOutErrors) -> float:
    """Share of the error explained by shifts of the trials that a drift also explains.

    Training errors are compared: held out, the random walk about the line would count against the drift.

    Args:
        neither: fit without shifts and drift.
        shifts: fit with shifts alone.
        drift: fit with a drift alone.
    """
    rest = neither.hypothesis.mse
    return (rest - drift.hypothesis.mse) / max(rest - shifts.hypothesis.mse, 1e-12)


def select(
    validation: CrossValidation,
    candidates: Sequence[Candidate],
    settings: SelectionSettings,
    floor_mse: float,
    without: Sequence[str] = (),
    progress: RoundProgress = lambda share, what: None,
    faults_mse: float = 0.0,
    form_share: float = 0.0,
) -> Selection:
    """Select the causes of a gap.

    Args:
        floor_mse: error of sensor noise and model form; a fall below it does not count [deg^2].
        progress: called with the share of the present round and the candidate.
        faults_mse: energy of a faulty sensor's noise, which is no form error [deg^2].
        form_share: part of `floor_mse` that is the error of the model form.
    """
    fits = _Fits(validation, candidates, settings, without, progress)
    baseline, chosen = _Search(fits, settings, floor_mse, faults_mse).run()
    rest = fits.tried.get(chosen.hypothesis.effects - TIMING)
    others = rest.hypothesis if rest else None
    rivals = timing_rivals(validation, candidates, chosen.hypothesis, others, floor_mse, form_share)
    for hypothesis, parts in rivals.values():
        fits.judged(hypothesis)
        fits.tried[hypothesis.effects] = replace(fits.tried[hypothesis.effects], parts=parts)
    chosen = fits.tried[chosen.hypothesis.effects]
    return Selection(baseline, by_timing(chosen, fits.tried, settings.standard_errors), fits.tried)


def reselect(
    tried: Mapping[frozenset[str], HeldOutErrors],
    settings: SelectionSettings,
    floor_mse: float,
    faults_mse: float = 0.0,
) -> Selection:
    """Select causes by the same rules among hypotheses judged on other trials, without fits.

    Args:
        tried: errors by the names of the causes, the baseline's among them.
        floor_mse, faults_mse: see `select`.
    """
    baseline, chosen = _Search(_Judged(tried), settings, floor_mse, faults_mse).run()
    return Selection(baseline, by_timing(chosen, tried, settings.standard_errors), dict(tried))
