"""Stability of a verdict: the same rules on other splits of the same trials, with the fitted hypotheses."""

from __future__ import annotations

import functools
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hystmpc.models.identify.cross_validation import HeldOutErrors, Hypothesis
from hystmpc.models.identify.runs import Blocks, Run, blocks_of
from hystmpc.models.identify.selection import Selection, SelectionSettings, reselect
from hystmpc.trials.types import Index

from ..diagnosis import Stability, Verdict
from ..logs.preparation import PreparedTrials
from .ambiguity import ambiguity_of
from .attribution import Attribution, Conclusion, drift_test
from .gap_closed import ClosedShares, negligible_cause
from .remaining_structure import structure_left
from .retuning import width_grown
from .verdict import AT_FLOOR, FinalFacts, VerdictDecision, VerdictFacts, decide_verdict, residual_ratio

RESAMPLES = 40
_LEAST_SPLITS = 8  # with fewer, blocks of the errors are drawn as well

Names = frozenset[str]


_TrialSplit = tuple[tuple[int, ...], tuple[int, ...], int | None]
"""Development and final runs of one resample, and the seed of the block resampling; None without it."""


def stability_of(
    prepared: PreparedTrials, attribution: Attribution, conclusion: Conclusion, seed: int
) -> Stability | None:
    """Share of resampled splits with the same verdict and effects; None if the trials allow no choice.

    Every hypothesis has held-out errors on all trials. Choice, ambiguity, confirmation and verdict are repeated with
    these; nothing is refitted. With fewer than eight splits, blocks of 3 s are drawn with replacement as well.
    """
    if prepared.too_little or prepared.checked.unrelated:
        return None
    resampled = _ResampledVerdict(prepared, attribution, conclusion, seed)
    count = len(prepared.development), len(prepared.final)
    verdicts = Counter(resampled.verdict(split) for split in _splits(*count, prepared.order == "known", seed))
    reference = conclusion.decision.verdict, conclusion.chosen.effects
    rivals = [set(names) for names in conclusion.decision.ambiguity]
    same = sum(times for verdict, times in verdicts.items() if _same_result(verdict, reference, rivals))
    others = Counter({_label(*verdict): 0 for verdict in verdicts})
    for verdict, times in verdicts.items():
        others[_label(*verdict)] += 0 if _same_result(verdict, reference, rivals) else times
    total = sum(verdicts.values())
    return Stability(same / total, total, tuple((text, n / total) for text, n in others.most_common(3) if n))


def _same_result(verdict: tuple[Verdict, Names], reference: tuple[Verdict, Names], rivals: Sequence[set[str]]) -> bool:
    """Whether verdict and effects are the same; members of one ambiguous set count as the same effect."""
    if verdict[0] != reference[0] or len(verdict[1]) != len(reference[1]):
        return False
    left, right = verdict[1] - reference[1], reference[1] - verdict[1]
    return all(any(a in names and b in names for names in rivals for b in right) for a in left)


def _label(verdict: Verdict, names: Names) -> str:
    return f"{verdict}: {', '.join(sorted(names))}" if names else verdict


def _splits(development: int, final: int, ordered: bool, seed: int) -> Iterator[_TrialSplit]:
    """Different splits of the runs; with a known order the first trial always stays a development run."""
    runs = range(development + final)
    free = runs[1:] if ordered and development > final else runs
    random = np.random.default_rng([seed, len(runs)])
    count = math.comb(len(free), final)
    if count <= RESAMPLES:
        chosen = [frozenset(part) for part in itertools.combinations(free, final)]
    else:
        drawn: dict[frozenset[int], None] = {}
        while len(drawn) < RESAMPLES:
            drawn[frozenset(random.choice(free, final, replace=False).tolist())] = None
        chosen = list(drawn)
    repeats = 1 if count >= _LEAST_SPLITS else math.ceil(RESAMPLES / 2 / count)
    for k, part in enumerate(itertools.product(chosen, range(repeats))):
        rest = tuple(run for run in runs if run not in part[0])
        yield rest, tuple(sorted(part[0])), None if repeats == 1 else seed + k


class _ResampledVerdict:
    """Verdicts on resampled splits, from errors of hypotheses that were fitted once."""

    def __init__(self, prepared: PreparedTrials, attribution: Attribution, conclusion: Conclusion, seed: int) -> None:
        self._facts, self._seed = conclusion.facts, seed
        self._floor, self._form_mse = conclusion.floor, prepared.form_mse
        self._spread, self._moved = conclusion.closed.spread, conclusion.closed.moved
        self._faults_mse, self._final_part = prepared.excess_mse, prepared.final_part
        validation, selection = attribution.validation, attribution.selection
        self._tried = {names: _errors_on_all_runs(judged, prepared.final) for names, judged in selection.tried.items()}
        self._drift_shows = drift_test(validation)
        baseline, floor_mse = selection.baseline, attribution.facts.floor_mse
        self._structure_left = functools.cache(
            lambda chosen: structure_left(
                Selection(baseline, chosen, {}), validation.runs, prepared.everything, floor_mse
            )
        )

    def verdict(self, split: _TrialSplit) -> tuple[Verdict, Names]:
        """Verdict and names of the effects on one split."""
        development, end, seed = split
        blocks = self._tried[frozenset()].run  # the same of all
        places = _blocks_on_runs(blocks, development, seed), _blocks_on_runs(blocks, end, seed)
        tried = {names: _errors_on_runs(judged, development, places[0]) for names, judged in self._tried.items()}
        final: dict[Names, Blocks] = {n: _errors_on_runs(judged, end, places[1]) for n, judged in self._tried.items()}
        selection = reselect(tried, SelectionSettings(), self._facts.floor_mse, self._faults_mse)
        names = selection.chosen.hypothesis.effects
        facts = replace(
            self._facts,
            effects=names,
            retuned_mse=selection.baseline.mse,
            chosen_mse=selection.chosen.mse,
            structure_left=self._structure_left(self._tried[names]),
            width_grown=width_grown(selection.chosen.hypothesis),
            ambiguity=ambiguity_of(selection, self._drift_shows),
        )
        explained = decide_verdict(facts).explained
        kept = self._confirmed_causes(facts, final) if explained else frozenset()
        decision = self._decision(facts, kept, selection.chosen.hypothesis, tried, final)
        return decision.verdict, kept if decision.explained else frozenset()

    def _confirmed_causes(self, facts: VerdictFacts, final: Mapping[Names, Blocks]) -> Names:
        """Causes that significantly lower the error of the final runs."""
        names, replaceable = facts.effects - facts.form_like, {names[0] for names in facts.ambiguity}
        names = names if names in final else facts.effects
        while names:
            shares = self._shares(names, final)
            together = shares.interval(final[frozenset()], final[names])
            least, small = dict.fromkeys(names, together[0]), ""
            if all(names - {name} in final for name in names):
                closed = shares.of_causes(names, final.__getitem__)
                least = {name: min(ci90[0], together[0]) for name, (_, ci90) in closed.items()}
                small = negligible_cause({name: share for name, (share, _) in closed.items()}, replaceable)
            weakest = min(sorted(least), key=lambda name: least[name])
            weakest = weakest if least[weakest] <= 0 else small
            if not weakest:
                break
            names = names - {weakest}
            if names not in final:
                return frozenset()
        return names

    def _shares(self, names: Names, final: Mapping[Names, Blocks]) -> ClosedShares:
        before, after = final[frozenset()], final[names]
        return ClosedShares(before, min(self._floor.rmse_deg**2, before.mse, after.mse), self._spread, self._seed)

    def _decision(
        self,
        facts: VerdictFacts,
        kept: Names,
        chosen: Hypothesis,
        tried: Mapping[Names, HeldOutErrors],
        final: Mapping[Names, Blocks],
    ) -> VerdictDecision:
        shares = self._shares(kept, final)
        closed = FinalFacts(
            shares.closed(final[kept].mse),
            residual_ratio(final[kept].mse, self._form_mse, self._floor.noise_deg**2),
            unproven=bool(chosen.effects) and not kept,
            at_floor=shares.before.mse < AT_FLOOR * self._floor.noise_deg**2,
            moved=self._moved,
        )
        if kept and kept != facts.effects:
            facts = facts.with_only(kept, tried[kept].mse, width_grown(tried[kept].hypothesis))
        everywhere = facts.closed_everywhere((final[frozenset()].mse, final[kept].mse), self._final_part)
        return decide_verdict(replace(facts, final=replace(closed, everywhere=everywhere)))


def _errors_on_all_runs(judged: HeldOutErrors, final: Sequence[Run]) -> HeldOutErrors:
    """Held-out errors of all runs: by the fits of the folds, on final runs by the fit to development runs."""
    hypothesis = judged.hypothesis
    errors = hypothesis.held_out_errors(final)
    blocks = blocks_of(errors, final)
    return replace(
        judged,
        energy=np.concatenate([judged.energy, blocks.energy]),
        samples=np.concatenate([judged.samples, blocks.samples]),
        run=np.concatenate([judged.run, blocks.run + len(judged.errors)]),
        errors=(*judged.errors, *errors),
        parts=judged.parts and judged.parts.with_trials(blocks.energy),
    )


def _blocks_on_runs(run: Index, runs: Sequence[int], seed: int | None) -> Index:
    """Blocks of some runs; with a seed, an equal number of blocks of each, drawn with replacement."""
    places = [np.flatnonzero(run == k) for k in runs]
    if seed is not None:
        random = np.random.default_rng(seed)
        places = [blocks[random.integers(0, blocks.size, blocks.size)] for blocks in places]
    return np.concatenate(places)


def _errors_on_runs(judged: HeldOutErrors, runs: Sequence[int], at: Index) -> HeldOutErrors:
    """Errors on some runs, in some of their blocks."""
    return replace(judged.at(at), errors=tuple(judged.errors[k] for k in runs))
