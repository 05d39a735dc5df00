"""Search for the structure of a device: the simplest form of each part that the held-out errors allow."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..effects.effect import Candidate, Scale
from ..operators.hysteresis import Backlash, CurvedPlays
from ..operators.static_curves import Line
from ..start import search_box
from .baseline import FreeCoreBaseline
from .chain_fit import no_result
from .cross_validation import CrossValidation, HeldOutErrors, Hypothesis, fit_problem, gain, sureness
from .least_squares import side_by_side
from .parts import (
    NO_RANGES,
    CoreForm,
    Ends,
    Form,
    core_forms,
    dead_time,
    device_parts,
    input_parts,
    plain_of,
    split_delay,
    straight,
    whole_delay,
)
from .problem import Problem, TrialTerms
from .runs import Blocks, Run, angle_range, command_range

SearchProgress = Callable[[float, float], None]
"""Told the share that is done, and the least error on held-out trials so far [deg]."""

Enough = Callable[[Blocks, Blocks], bool]
"""Whether held-out errors fall enough for a richer form."""

SEARCH_HZ = 25.0
"""The structure is searched on trials of at most this rate [Hz]: what is found hangs on no rate of the logs."""

_FROM_AFAR = 3  # factor on the evaluations of a fit that starts from a line instead of a neighbour
_CORE = "core"
_PLAIN = 13  # parameters of the largest core that is a plain kind
_NEXT_ROUND = 0.5  # ratio of the durations of successive rounds
_AT_LAST = 5  # duration of the last fit and the table of parts, in fits
_A_SAMPLE = 0.75  # samples: a delay of half a sample comes from the hold


# Thresholds, chosen on development data; `_CLEAR_SHARE` on short real logs, too.
STANDARD_ERRORS = 2.0  # least fall of the held-out error for an added part
_LEAST_SHARE = 0.05  # least fall in any case, as share of the held-out mean square error
# A fall by this share for each block of three seconds is enough: in logs of a few blocks the standard error is as large
# as the error itself, and a part that halves the error would be left out.
_CLEAR_SHARE = 0.0125
# Alternatives within this factor of the best training error may be the best on held-out trials. Simpler ones are judged
# there, too, unless even the error of their fit is significantly above that of the best.
_NEAR = 1.15
_ROUNDS = 3  # greatest number of passes over all parts
_EVALUATIONS = 12  # free runs of one fit
_FOLDS = 6


def worth(before: Blocks, after: Blocks) -> bool:
    """Whether held-out errors fall enough for a part to be added."""
    return _exceeds(before, after, STANDARD_ERRORS, gain(before, after)[1])


def recurs(before: Blocks, after: Blocks) -> bool:
    """Whether held-out errors fall enough for a richer core: by the standard error of blocks and by that of trials.

    A drive that is seen in one trial is there in all. The form of a core has no such meaning: what serves one trial
    alone serves no other motion.
    """
    each = np.bincount(before.run, before.energy - after.energy)
    scatter = math.sqrt(each.size * float(np.var(each, ddof=1))) if each.size > 1 else 0.0
    return _exceeds(before, after, 1.0, max(gain(before, after)[1], scatter / float(before.samples.sum())))


def _exceeds(before: Blocks, after: Blocks, errors: float, error: float) -> bool:
    """Whether the fall is a share of the error, and clear: by its standard error, by roots of blocks, or by its size.

    Squares of few blocks scatter as much as they fall; see `sureness` for roots.
    """
    fall, sure = gain(before, after)[0], errors * error
    clear = fall > min(sure, _CLEAR_SHARE * before.energy.size * before.mse) or sureness(before, after) > 2.0 * errors
    return clear and fall > _LEAST_SHARE * before.mse


def stays(before: Blocks, after: Blocks) -> bool:
    """Whether a chosen part lowers the held-out error by more than its standard error."""
    fall, error = gain(before, after)
    return fall > max(error, _LEAST_SHARE * before.mse)


@dataclass(frozen=True, eq=False)
class Choice:
    """Structure of the device model that the search has chosen so far."""

    core: CoreForm
    forms: dict[str, Form]
    judged: HeldOutErrors

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return size_of(self.core, self.forms)

    @property
    def blocks(self) -> int:
        """Number of operators: of two devices with as many parameters the one with fewer poles is the simpler."""
        return sum(len(c.operators) for form in self.forms.values() for c in form)

    @property
    def hypothesis(self) -> Hypothesis:
        """Fit to all trials."""
        return self.judged.hypothesis

    @property
    def hidden(self) -> set[tuple[str, str]]:
        """Parts and effects of which held-out errors say nothing: offsets by an input beside those of trials."""
        offsets = {(name, c.effect) for name, form in self.forms.items() for c in _offsets(form)}
        return offsets if offsets and self.hypothesis.problem.terms.trial_offset else set()

    @property
    def rmse_deg(self) -> float:
        """Root mean square error on held-out trials [deg]."""
        return math.sqrt(self.judged.mse)


@dataclass(frozen=True)
class PartRow:
    """Effect of one part on the held-out error.

    Attributes:
        part: `drive`, `creep`, `core` or `sensor zero`.
        form: the form that was chosen, `none` for a device without the part.
        without_deg: held-out error of the device refitted without the part [deg]; with a line in place of the core.
            Not-a-number where there is nothing to leave out.
        with_deg: held-out error of the chosen device [deg].
    """

    part: str
    form: str
    without_deg: float
    with_deg: float


@final
class AutoSearch:
    """Search that selects for each part the simplest form whose held-out error is not significantly above the least.

    All parameters are fitted jointly for each alternative. The search begins with the richest core, so that no other
    part replaces it, and chooses each part again while the others change. A second search begins with a line, since the
    richest core can replace a valve or a lag. The simplest of all tried devices is selected.

    Source: one-standard-error rule of Breiman, Friedman, Olshen, Stone, Classification and Regression Trees (1984),
    section 3.4.3; see `worth` for the number of standard errors and the accepted loss of a simpler form, and
    `least_of_simpler` for what the rule leaves open.
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        runs: Sequence[Run],
        progress: SearchProgress,
        terms: TrialTerms | None = None,
        ranges: Mapping[str, Ends] = NO_RANGES,
    ) -> None:
        self.runs, self._progress = tuple(runs), progress
        scale = Scale.of(runs)
        self._cores, inputs = core_forms(trials, scale), input_parts(trials, scale, ranges)
        self._parts = (*device_parts(scale, dead_time(runs)), *inputs)
        self._inputs = tuple(part.name for part in inputs)  # first of all: what they explain looks like anything else
        self._names = (*self._inputs, *(p.name for p in self._parts if p not in inputs), _CORE)
        self._command = command_range(trials)
        self._box = search_box(self._command, angle_range(trials))
        self._done, self._planned, self._weight = 0.0, 1.0, 1.0  # in starting points of fits
        self.terms, self.interrupted = terms or TrialTerms(), False
        self.tried: list[Choice] = []
        self._core_starts: dict[str, list[Vec]] = {}  # values of cores to start from

    @property
    def offsets(self) -> bool:
        """Whether each trial has its separate offset."""
        return self.terms.trial_offset

    def run(self) -> Choice:
        """Search and return the chosen device."""
        core, none = self._cores[-1], self._none()
        try:
            self.terms = self._terms_of_trials()
            present = rich = self._judged(core, none, self._fitted(core, none, None))
        except KeyboardInterrupt:
            raise no_result("the first core", interrupted=True) from None
        try:
            parts = tuple(name for name in self._names[:-1] if name not in self._inputs)
            names = (*parts, _CORE, *parts, *(2 * self._names if self._inputs else ()))
            open_forms = [a for name in names for a in self._alternatives(name, present)]
            self._plan(open_forms, present, _ROUNDS)
            present = self._rounds(present, (*parts, _CORE))
            line = self._judged(self._cores[0], none, self._fitted(self._cores[0], none, None))
            self._rounds(line, parts)
            chosen = self._simplest_tried(present)
            if chosen.core is self._cores[0] is not present.core:
                chosen = self._simplest_tried(self._reselected(_CORE, chosen))
            if self._inputs:  # also from the richest core: without an input it may have been chosen by what that hides
                ends = [self._rounds(start, self._names) for start in (rich, chosen)]
                chosen = self._simplest_tried(min(ends, key=lambda end: end.judged.mse))
            chosen = self._with_one_zero(chosen)
            self._judge_plain_kinds(chosen.size)
            return self._finished(self.least_of_simpler(chosen))
        except KeyboardInterrupt:
            self.interrupted, self.terms = True, present.hypothesis.problem.terms
            return self._simplest_tried(present)

    def _judge_plain_kinds(self, largest: int) -> None:
        """Judge each core alone, without drive or curve, up to a number of parameters."""
        known = {_labels(c.core, c.forms) for c in self.tried if c.hypothesis.problem.terms == self.terms}
        for core in self._cores:
            if not core.curve and core.size <= min(largest, _PLAIN) and (core.label,) not in known:
                fit = self._fitted(core, self._none(), None)
                if not self._crosses(fit):
                    self._judged(core, self._none(), fit)

    def _rounds(self, present: Choice, names: Sequence[str]) -> Choice:
        # for each part: the device at its last choice, and the tried forms
        seen: dict[str, tuple[tuple[str, ...], list[Choice]]] = {}
        for k in range(_ROUNDS):
            self._weight = _NEXT_ROUND**k
            before = _labels(present.core, present.forms)
            for name in names:
                device, tried = seen.get(name, ((), []))
                if device == _labels(present.core, present.forms):
                    self.tried += tried  # repeated devices weigh in the intervals as often
                    continue
                first = len(self.tried)
                present = self._reselected(name, present)
                seen[name] = _labels(present.core, present.forms), self.tried[first:]
            if _labels(present.core, present.forms) == before:
                break
        return present

    def _simplest_tried(self, present: Choice) -> Choice:
        """Simplest of all devices tried, by the rule of one round: rounds may miss a simpler or better device."""
        alike = [present, *(c for c in self.tried if c.hypothesis.problem.terms == self.terms)]
        best = min(alike, key=lambda choice: choice.judged.mse)
        ordered = sorted(alike, key=lambda choice: (choice.size, choice.blocks, choice.judged.mse))
        simple = next(c for c in ordered if c is best or not worth(c.judged, best.judged))
        parts = [c for c in ordered if _part_labels(c.forms) == _part_labels(simple.forms)]
        best = min(parts, key=lambda choice: choice.judged.mse)
        return next(c for c in parts if c is best or not recurs(c.judged, best.judged))

    def least_of_simpler(self, choice: Choice) -> Choice:
        """Device, or one that was tried, is no larger, has no part or curve that it lacks, and errs less when held out.

        So no plain kind that is in the search is better than what the search answers. The standard errors of `worth` do
        not ensure it: they are of differences to the best device, and a simpler device may be surely worse than the
        best one and still better than one that is perhaps as good.
        """
        parts = set(_part_labels(choice.forms))
        simpler = [
            other
            for other in self.tried
            if other.hypothesis.problem.terms == self.terms
            and other.size <= choice.size
            and parts.issuperset(_part_labels(other.forms))
            and choice.hidden <= other.hidden
            and (not other.core.curve or other.core.label == choice.core.label)
        ]
        best = min([choice, *simpler], key=lambda other: other.judged.mse)
        return choice if best is choice else min(best, self._polished(best), key=lambda other: other.judged.mse)

    def _alternatives(self, name: str, present: Choice) -> list[tuple[CoreForm, dict[str, Form]]]:
        if name == _CORE:
            return [(core, present.forms) for core in self._cores]
        forms = next(part.forms for part in self._parts if part.name == name)
        if kept := _offsets(present.forms[name]) if self.offsets else ():
            forms = tuple((*(c for c in form if c not in _offsets(form)), *kept) for form in forms)
        return [(present.core, present.forms | {name: form}) for form in dict.fromkeys(forms)]

    def _with_one_zero(self, choice: Choice) -> Choice:
        """Device with one offset for all trials, where separate offsets do not lower the held-out error."""
        if not self.offsets:
            return choice
        self.terms = replace(self.terms, trial_offset=False)
        plain = self._judged(choice.core, choice.forms, self._fitted(choice.core, choice.forms, choice))
        for name in self._inputs:  # separate offsets have hidden one that depends on an input
            plain = self._reselected(name, plain)
        if not worth(plain.judged, choice.judged):
            return plain
        self.terms = replace(self.terms, trial_offset=True)
        return self._with_offsets_of(plain, choice)

    def _with_offsets_of(self, plain: Choice, choice: Choice) -> Choice:
        """Device of separate offsets whose mean depends on an input, where one offset for all trials does."""
        values, forms = _values(plain.hypothesis), dict(choice.forms)
        for name in self._inputs:
            known = {c.effect for c in forms[name]}
            more = (c for c in _offsets(plain.forms[name]) if c.effect not in known)
            forms[name] += tuple(replace(c, starts=(tuple(values[c.label]),)) for c in more)
        if forms == choice.forms:
            return choice
        return self._judged(choice.core, forms, self._fitted(choice.core, forms, choice))

    def refit_at_full_rate(self, choice: Choice) -> Choice:
        """Device of another rate refitted to these trials; its drive is selected from more samples."""
        dt_s, values, drive = self.runs[0].dt_s, _values(choice.hypothesis), self._parts[0]
        about = whole_delay(choice.forms[drive.name])

        def near(form: Form) -> Form:
            return tuple(
                new for c in form if c.free for new in _near(c, tuple(values.get(c.label, c.starts[0])), dt_s, about)
            )

        self._parts = (replace(drive, forms=tuple(near(form) for form in drive.forms)), *self._parts[1:])
        known = {_names(form): form for part in self._parts for form in part.forms}
        forms = {name: near(known[_names(form)]) for name, form in choice.forms.items()}
        core = next(core for core in self._cores if core.label == choice.core.label)
        z = choice.hypothesis.z
        core = replace(core, starts=(core.starts[0].with_values(z.tolist()),))
        present = self._judged(core, forms, self._fitted(core, forms, None))
        drives = self._alternatives(drive.name, present)
        self._plan(drives, present)
        return self._finished(self._simplest(drives, present))

    def without_effect(self, choice: Choice, part: str, effect: str) -> Choice:
        """Device whose part has the same effect with fewer parameters or, without such a form, lacks the effect."""
        if part == _CORE:
            core = plain_of(choice.core, self._cores)
            return self._polished(self._judged(core, choice.forms, self._fitted(core, choice.forms, choice)))
        forms = next(p.forms for p in self._parts if p.name == part)
        present = choice.forms[part]
        whole, rest = {c.effect for c in present}, {c.label for c in present if c.free and c.effect != effect}
        simpler = [f for f in forms if {c.effect for c in f} == whole and free_numbers(f) < free_numbers(present)]
        without = [f for f in forms if set(_names(f)) == rest]
        open_forms: list[Form] = [*without, *(simpler if len(_names(present)) == 1 else [])]
        others = tuple(c for c in present if c.effect != effect)
        left = choice.forms | {part: max(open_forms, key=free_numbers, default=others)}
        return self._polished(self._judged(choice.core, left, self._fitted(choice.core, left, choice)))

    def reselect_other_parts(self, choice: Choice, lost: Collection[str]) -> Choice:
        """Device with a new selection of all parts except those that lost an effect."""
        for name in self._names:
            if name not in lost:
                choice = self._reselected(name, choice)
        return self._finished(choice)

    def part_contributions(self, choice: Choice) -> tuple[Choice, tuple[PartRow, ...]]:
        """Device without parts of insignificant effect, and held-out errors without and with each part."""
        reduced = self._without_each(choice)
        while needless := [c for c in reduced.values() if c and not stays(c.judged, choice.judged)]:
            choice = self._polished(min(needless, key=lambda c: c.judged.mse))
            reduced = self._without_each(choice)
        rows = [
            PartRow(name, _form_title(form), _rmse(reduced[name]), choice.rmse_deg)
            for name, form in choice.forms.items()
        ]
        rows.append(PartRow(_CORE, choice.core.label, _rmse(reduced[_CORE]), choice.rmse_deg))
        zero = PartRow("sensor zero", "of each trial" if self.offsets else "one", math.nan, choice.rmse_deg)
        return choice, (*rows, zero)

    def _without_each(self, choice: Choice) -> dict[str, Choice | None]:
        """Device refitted without each part, None where there is no such part; a line replaces the core."""
        reduced: dict[str, Choice | None] = {}
        for name, form in choice.forms.items():
            forms = {**choice.forms, name: _offsets(form) if self.offsets else ()}
            fit = self._fitted(choice.core, forms, choice) if form != forms[name] else None
            reduced[name] = None if fit is None else self._judged(choice.core, forms, fit)
        plain, reduced[_CORE] = self._cores[0], None
        if choice.core.label != plain.label:
            reduced[_CORE] = self._judged(plain, choice.forms, self._fitted(plain, choice.forms, choice))
        if choice.core.curve:
            core = plain_of(choice.core, self._cores)
            reduced["curve"] = self._judged(core, choice.forms, self._fitted(core, choice.forms, choice))
        return reduced

    def left_out(self, choice: Choice) -> tuple[Vec, ...]:
        """Held-out residuals of each trial, see `CrossValidation.left_out`."""
        return self._validation(choice.core).left_out(choice.judged)

    def _none(self) -> dict[str, Form]:
        return {part.name: () for part in self._parts}

    def _plan(self, made: Sequence[tuple[CoreForm, dict[str, Form]]], present: Choice, rounds: int = 1) -> None:
        """Reset the progress count: at most so many rounds of these fits, then the last fit and the table of parts."""
        points = sum(_points(*alternative, present) for alternative in made)
        self._done, self._weight = 0.0, 1.0
        self._planned = _AT_LAST + points * sum(_NEXT_ROUND**k for k in range(rounds))

    def _tell(self, points: int) -> None:
        self._done += self._weight * points
        best = min((choice.judged.mse for choice in self.tried), default=math.nan)
        self._progress(min(self._done / self._planned, 1.0), math.sqrt(best))

    def _terms_of_trials(self) -> TrialTerms:
        """Terms of single trials: separate offsets if the better of a rich core and a valve with a line needs them."""
        if len(self.runs) == 1:
            return self.terms
        *delay, lag = next(form for form in self._parts[0].forms if len(_names(form)) > 1)
        valve = next({part.name: part.forms[-1]} for part in self._parts if part.name == "valve")
        plain, zeroed = TrialTerms(), TrialTerms(trial_offset=True)
        errors = {}
        for self.terms in (plain, zeroed):
            judged = []
            for core, more in ((self._cores[0], valve), (self._cores[-1], {})):
                drives = [{self._parts[0].name: (*delay, replace(lag, starts=(start,)))} for start in lag.starts]
                fits = [self._fitted(core, self._none() | drive | more, None) for drive in drives]
                judged.append(self._validation(core).judge(min(fits, key=lambda fit: fit.mse)))
            errors[self.terms] = min(judged, key=lambda held_out: held_out.mse)
        return zeroed if worth(errors[plain], errors[zeroed]) else plain

    def _reselected(self, name: str, present: Choice) -> Choice:
        """Device with a new selection of one part."""
        enough = recurs if name == _CORE else worth
        return self._simplest(self._alternatives(name, present), present, enough)

    def _simplest(
        self, made: Sequence[tuple[CoreForm, dict[str, Form]]], present: Choice, enough: Enough = worth
    ) -> Choice:
        def fitted(alternative: tuple[CoreForm, dict[str, Form]]) -> tuple[CoreForm, dict[str, Form], Hypothesis]:
            return (*alternative, self._fitted(*alternative, present))

        fits = []
        for fit in side_by_side(fitted, made):
            fits.append(fit)
            self._tell(_points(fit[0], fit[1], present))
        fits = [fit for fit in fits if not self._crosses(fit[2])] or fits
        least = min(fit.mse for *_, fit in fits)
        same = _labels(present.core, present.forms)
        near = [fit for fit in fits if fit[2].mse < _NEAR * least or _labels(*fit[:2]) == same]
        choices = list(side_by_side(lambda fit: self._choice(*fit), near))
        best = min(choices, key=lambda choice: choice.judged.mse)
        judged = {id(choice.hypothesis): choice for choice in choices}
        selected = best
        for core, forms, hypothesis in sorted(fits, key=lambda fit: size_of(fit[0], fit[1])):
            if hypothesis is best.hypothesis:
                break
            if id(hypothesis) not in judged:
                # Training errors are too small: a part that they do not justify, held-out trials do not either.
                if enough(self._validation(core).fitted_errors(hypothesis), best.judged):
                    continue
                judged[id(hypothesis)] = self._choice(core, forms, hypothesis)
            if not enough(judged[id(hypothesis)].judged, best.judged):
                selected = judged[id(hypothesis)]
                break
        self.tried += judged.values()
        return selected

    def _fitted(self, core: CoreForm, forms: Mapping[str, Form], present: Choice | None) -> Hypothesis:
        """Joint fit; present parts start from their present values, a new one from its listed starts."""
        validation, terms = self._validation(core), self.terms
        effects = [*(c for form in forms.values() for c in form), *core.curve]
        held = _values(present.hypothesis) if present else {}
        starts = [[held[c.label]] if c.label in held else [list(start) for start in c.starts] for c in effects]
        values = [list(chosen) for chosen in itertools.product(*starts)]
        if present is not None and present.core.label == core.label:
            validation = replace(validation, baseline=present.hypothesis.problem.baseline)
            return validation.with_causes(effects, terms, present.hypothesis.z, values)
        chains = core.starts
        if isinstance(core.starts[0].core, Line):
            chains = (self._line_behind([c for c in effects if c not in core.curve], values[0]),)
            validation = replace(validation, baseline=FreeCoreBaseline(chains[0], self._command, anew=True))
        cores = self._core_starts.get(core.label, [np.array(chain.core.values) for chain in chains])
        best = min((validation.with_causes(effects, terms, z, values[:1]) for z in cores), key=lambda fit: fit.mse)
        made = fit_problem(best.problem, self.runs, best.q, (_FROM_AFAR - 1) * _EVALUATIONS, 1e-3)
        if isinstance(core.starts[0].core, CurvedPlays):  # linear in its slopes: no start leads elsewhere
            self._core_starts[core.label] = [made.problem.retuned(made.q)]
        return made

    def _crosses(self, fit: Hypothesis) -> bool:
        """Whether the core is a backlash whose lines cross: no model of a device, and refused as a simulator."""
        core = fit.chain.core
        return isinstance(core, Backlash) and core.crosses(self._command.lower, self._command.upper)

    def _line_behind(self, effects: Sequence[Candidate], values: Sequence[Sequence[float]]) -> Chain:
        """Regression line over the output of the drive: behind a slow drive it is far steeper than over the command."""
        problem = Problem(FreeCoreBaseline(Chain(Line(1.0, 0.0)), self._command), effects)
        q = problem.start(np.array([1.0, 0.0]), values[: len(effects)])
        travel = np.concatenate([problem.angles(q, run)[run.counts] for run in self.runs])
        angle = np.concatenate([run.angle[run.counts] for run in self.runs])
        return Chain(Line(*np.polyfit(travel, angle, 1).tolist()))

    def _finished(self, choice: Choice) -> Choice:
        """Device fitted to convergence, without a delay that only represents the hold of a sample."""
        choice, drive = self._polished(choice), self._parts[0].name
        held = straight(choice.forms[drive])
        delays = [v for label, v in _values(choice.hypothesis).items() if label == "delay/command"]
        if not held or sum(map(sum, delays)) + whole_delay(choice.forms[drive]) > _A_SAMPLE * self.runs[0].dt_s:
            return choice
        forms = {**choice.forms, drive: held}
        other = self._polished(self._judged(choice.core, forms, self._fitted(choice.core, forms, choice)))
        return choice if worth(other.judged, choice.judged) else other

    def _polished(self, choice: Choice) -> Choice:
        if any(run.lead for run in self.runs):
            problem, q = choice.hypothesis.problem, choice.hypothesis.q
            self.runs = tuple(problem.begun(q, run, self._box) for run in self.runs)
        validation = self._validation(choice.core)
        return replace(choice, judged=validation.judge(validation.polished(choice.hypothesis)))

    def _judged(self, core: CoreForm, forms: dict[str, Form], fit: Hypothesis) -> Choice:
        self.tried.append(self._choice(core, forms, fit))
        return self.tried[-1]

    def _choice(self, core: CoreForm, forms: dict[str, Form], fit: Hypothesis) -> Choice:
        return Choice(core, forms, self._validation(core).judge(fit))

    def _validation(self, core: CoreForm) -> CrossValidation:
        baseline = FreeCoreBaseline(core.starts[0], self._command, anew=True)
        return CrossValidation(baseline, self.runs, _EVALUATIONS, in_time=True, most_folds=_FOLDS)


def _near(candidate: Candidate, values: tuple[float, ...], dt_s: float, whole_s: float) -> Form:
    """Candidate that starts from known values; a delay may move by half a sample of the search."""
    if candidate.effect != "delay":
        return (replace(candidate, starts=(values,)),)
    return split_delay(candidate, whole_s + values[0], 0.5 / SEARCH_HZ, dt_s)


def _values(hypothesis: Hypothesis) -> dict[str, list[float]]:
    return {c.label: v for c, v in zip(hypothesis.problem.effects, hypothesis.values, strict=True)}


def _points(core: CoreForm, forms: Mapping[str, Form], present: Choice) -> int:
    """Number of starting points of a fit, weighted by their evaluations; see `AutoSearch._fitted`."""
    if core.label != present.core.label:
        return _FROM_AFAR * len(core.starts)
    held = _labels(present.core, present.forms)
    return math.prod(len(c.starts) for form in forms.values() for c in form if c.label not in held)


def _offsets(form: Form) -> Form:
    """Offsets that depend on an input; those of single trials hide what they are for."""
    return tuple(c for c in form if c.depends is not None and c.depends.group == "offset")


def _names(form: Form) -> tuple[str, ...]:
    return tuple(c.label for c in form if c.free)


def _part_labels(forms: Mapping[str, Form]) -> tuple[str, ...]:
    return tuple(label for form in forms.values() for label in _names(form))


def _labels(core: CoreForm, forms: Mapping[str, Form]) -> tuple[str, ...]:
    return (core.label, *_part_labels(forms))


def _rmse(choice: Choice | None) -> float:
    return math.nan if choice is None else choice.rmse_deg


def _form_title(form: Form) -> str:
    return " + ".join(_title(c) for c in form if c.free) or "none"


def _title(candidate: Candidate) -> str:
    plain = candidate.variant in ("command", "output")
    return candidate.effect.replace("_", " ") + ("" if plain else f" ({candidate.variant})")


def size_of(core: CoreForm, forms: Mapping[str, Form]) -> int:
    """Number of free parameters of a device."""
    return core.size + sum(map(free_numbers, forms.values()))


def free_numbers(form: Form) -> int:
    """Number of free parameters of a form."""
    return sum(len(c.free) for c in form)
