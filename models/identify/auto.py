"""`fit auto`: drive, creep and core of a device, each chosen by held-out free-run errors, fitted jointly."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.trials.errors import LogError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Vec

from ..effects.catalogue import EFFECTS
from ..effects.effect import Candidate, Scale
from ..operators.dynamics import Delay
from .baseline import FreeCoreBaseline
from .chain_fit import nothing_found
from .cross_validation import CrossValidation, HeldOutErrors, Hypothesis, gain
from .parts import CoreForm, Form, core_forms, device_parts
from .problem import TrialTerms
from .runs import Run, check_trial_set, command_range, runs_of
from .uncertainty import ParameterRow, parameter_rows

SearchProgress = Callable[[float, float], None]
"""Told the share that is done, and the least error on held-out trials so far [deg]."""

MOTIONS_THAT_SEPARATE = {
    "fast": "fast steps and small sines of 2 to 4 Hz",
    "speeds": "ramps at three speeds",
    "holds": "holds of 10 s",
    "long_holds": "holds of 45 s",
    "repeat": "the opening motion a second time",
    "amplitudes": "strokes of several amplitudes",
}
"""Motions by the words of `Effect.separated_by`."""

_FROM_AFAR = 3  # times as many evaluations where a fit starts from a line instead of from a neighbour
_SEARCH_HZ = 50.0  # the structure is searched on trials of at most this rate
_QUANTILE = 1.645  # of the normal distribution, 95 %


@dataclass(frozen=True)
class AutoSettings:
    """How `fit auto` searches; thresholds were chosen on simulated development devices.

    Attributes:
        standard_errors: by which the held-out error has to fall for a part to be added.
        least_share: of the held-out mean square error, by which it has to fall.
        near: alternatives within this factor of the best training error are judged on held-out trials.
        rounds: greatest number of passes over all parts.
        evaluations: free runs of one fit.
        widening: factor on intervals for what no alternative of the list can express.
    """

    standard_errors: float = 2.0
    least_share: float = 0.05
    near: float = 1.15
    rounds: int = 3
    evaluations: int = 12
    widening: float = 1.5


@dataclass(frozen=True, eq=False)
class Choice:
    """A device as far as it is chosen.

    Attributes:
        core: form of the core.
        forms: alternative of each part, by its name.
        judged: the fit, with its errors on held-out trials.
    """

    core: CoreForm
    forms: dict[str, Form]
    judged: HeldOutErrors

    @property
    def size(self) -> int:
        """Free parameters."""
        return self.core.size + sum(len(c.free) for form in self.forms.values() for c in form)

    @property
    def hypothesis(self) -> Hypothesis:
        """The fit to all trials."""
        return self.judged.hypothesis

    @property
    def rmse_deg(self) -> float:
        """Root mean square error on held-out trials [deg]."""
        return math.sqrt(self.judged.mse)


@dataclass(frozen=True)
class PartRow:
    """What one part bought.

    Attributes:
        part: `drive`, `creep`, `core` or `sensor zero`.
        form: the alternative that was chosen, `none` for a device without the part.
        without_deg: held-out error of the device without the part, everything else fitted anew [deg]; of the core:
            with a backlash in its place. Not-a-number where there is nothing to leave out.
        with_deg: held-out error of the chosen device [deg].
    """

    part: str
    form: str
    without_deg: float
    with_deg: float


@dataclass(frozen=True, eq=False)
class AutoFit:
    """An identified device.

    Attributes:
        choice: what was chosen, with its held-out errors.
        rows: what each part bought.
        parameters: numbers of drive and creep, with intervals of 90 %.
        offsets: whether each trial had an offset of its own.
        advice: what these trials do not determine, and what to record for it.
        interrupted: stopped by the user; this is the best so far.
    """

    choice: Choice
    rows: tuple[PartRow, ...]
    parameters: tuple[ParameterRow, ...]
    offsets: bool
    advice: tuple[str, ...]
    interrupted: bool = False


def identify_auto(
    trials: Sequence[Trial],
    settings: AutoSettings | None = None,
    skip_first_flexure: bool = False,
    progress: SearchProgress = lambda share, rmse: None,
) -> AutoFit:
    """Identify drive, creep and hysteresis of a device jointly, each in the simplest form that explains the trials.

        theta = core(creep(drive(u))),  drive: delay, lag of first or second order, top speed, or none

    All alternatives are fitted by bounded least squares on free runs with exact sensitivities, and compared on trials
    that their fit did not see. Each trial has an offset of its own where that lowers the held-out error: angle sensors
    are often zeroed anew.

    Args:
        trials: uniformly sampled at one rate, in one pair of units; ramps, sines, or steps of a few values alone.
        settings: thresholds.
        skip_first_flexure: leave out each trial up to the first reversal of its command.
        progress: told the share that is done and the best error so far; KeyboardInterrupt keeps the best so far.

    Raises:
        FitError: on unusable trials, or an angle that falls with the command.
    """
    settings = settings or AutoSettings()
    dt = check_trial_set(trials)
    coarse = _thinned(trials, dt)
    runs = _runs(coarse, skip_first_flexure)
    search = AutoSearch(coarse, runs, settings, progress)
    found = search.run()
    parameters = tuple(_widened(found, runs, search.tried, settings))
    rows: tuple[PartRow, ...] = ()
    try:
        while not search.interrupted and (nothing := _without_meaning(found, parameters)):
            found = search.less(found, *nothing)
            parameters = tuple(_widened(found, runs, search.tried, settings))
        rows = () if search.interrupted else tuple(search.bought(found))
    except KeyboardInterrupt:  # the device is found; only the table of its parts is missing
        search.interrupted = True
    if coarse is not trials:
        full = AutoSearch(trials, _runs(trials, skip_first_flexure), settings, progress, search.offsets)
        try:
            found = full.again(found)
            parameters = tuple(_moved(parameters, found))
        except KeyboardInterrupt:  # a delay's store is sized for the rate of the search: that model must not be used
            raise nothing_found("the fit at the full rate", interrupted=True) from None
    return AutoFit(found, rows, parameters, search.offsets, tuple(_advice(parameters)), search.interrupted)


def _runs(trials: Sequence[Trial], skip_first_flexure: bool) -> tuple[Run, ...]:
    runs = runs_of(trials)
    if not skip_first_flexure:
        return runs
    first = [np.arange(len(trial)) >= first_flexure_end(trial) for trial in trials]
    return tuple(replace(run, counts=counts) for run, counts in zip(runs, first, strict=True))


def _thinned(trials: Sequence[Trial], dt: float) -> Sequence[Trial]:
    """Trials of at most 50 Hz for the search."""
    keep = math.floor(1 / (dt * _SEARCH_HZ) + 1e-9)
    if keep < 2:
        return trials
    try:
        return [resample(trial, 1 / (keep * dt)) for trial in trials]
    except LogError:
        return trials


@final
class AutoSearch:
    """Part after part, the simplest alternative whose held-out error is not significantly above the best one.

    All parameters are fitted jointly for each alternative. It begins with the richest core, so that no other part has
    to stand in for it, and chooses each part anew while the others change.

    Source: one-standard-error rule of Breiman, Friedman, Olshen, Stone, Classification and Regression Trees (1984),
    section 3.4.3; the number of standard errors is `AutoSettings.standard_errors`.
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        runs: Sequence[Run],
        settings: AutoSettings,
        progress: SearchProgress,
        offsets: bool = False,
    ) -> None:
        self._runs, self._settings, self._progress = tuple(runs), settings, progress
        scale = Scale.of(runs)
        self._cores, self._parts = core_forms(trials, scale), device_parts(scale)
        self._command = command_range(trials)
        self._steps, self._done = (len(self._parts) + 1) * settings.rounds + 1, 0
        self.offsets, self.interrupted = offsets, False
        self.tried: list[Choice] = []

    def run(self) -> Choice:
        """The chosen device."""
        core, none = self._cores[-1], self._none()
        try:
            self.offsets = self._zeroed_anew()
            present = self._judged(core, none, self._fitted(core, none, None))
        except KeyboardInterrupt:
            raise nothing_found("the first core", interrupted=True) from None
        try:
            for _ in range(self._settings.rounds):
                before = _labels(present.core, present.forms)
                for part in self._parts:
                    present = self._simplest(
                        [(present.core, present.forms | {part.name: f}) for f in part.forms], present
                    )
                    self._tell()
                present = self._simplest([(core, present.forms) for core in self._cores], present)
                self._tell()
                if _labels(present.core, present.forms) == before:
                    break
            return self._polished(self._with_one_zero(present))
        except KeyboardInterrupt:
            self.interrupted = True
            return present

    def _with_one_zero(self, choice: Choice) -> Choice:
        """The device with one offset for all trials, where offsets of their own are worth nothing any more."""
        if not self.offsets:
            return choice
        self.offsets = False
        plain = self._judged(choice.core, choice.forms, self._fitted(choice.core, choice.forms, choice))
        self.offsets = self._worth(plain.judged, choice.judged)
        return choice if self.offsets else plain

    def again(self, choice: Choice) -> Choice:
        """The same structure fitted to these trials, from the values of another rate."""
        known = {c.label: c for part in self._parts for form in part.forms for c in form}
        values = _values(choice.hypothesis)
        forms = {
            name: tuple(_near(known[c.label], tuple(values[c.label]), self._runs[0].dt_s) for c in form)
            for name, form in choice.forms.items()
        }
        core = next(core for core in self._cores if core.label == choice.core.label)
        z = choice.hypothesis.problem.retuned(choice.hypothesis.q)
        core = replace(core, starts=(core.starts[0].with_values(z.tolist()),))
        return self._polished(self._judged(core, forms, self._fitted(core, forms, None)))

    def less(self, choice: Choice, part: str, effect: str) -> Choice:
        """The device with a part's next simpler alternative: with the effect if there is one, else without it."""
        forms = next(p.forms for p in self._parts if p.name == part)
        present = choice.forms[part]
        whole, rest = {c.effect for c in present}, {c.label for c in present if c.effect != effect}
        simpler = [f for f in forms if {c.effect for c in f} == whole and _count(f) < _count(present)]
        without = [f for f in forms if {c.label for c in f} == rest]
        left = choice.forms | {part: max([*without, *(simpler if len(present) == 1 else [])], key=_count)}
        return self._polished(self._judged(choice.core, left, self._fitted(choice.core, left, choice)))

    def bought(self, choice: Choice) -> Iterator[PartRow]:
        """What each part bought, the chosen device less that part fitted anew."""
        for name, form in choice.forms.items():
            if not form:
                yield PartRow(name, "none", math.nan, choice.rmse_deg)
                continue
            forms = {**choice.forms, name: ()}
            without = self._judged(choice.core, forms, self._fitted(choice.core, forms, choice))
            yield PartRow(name, " + ".join(_title(c) for c in form), without.rmse_deg, choice.rmse_deg)
        plain, rmse = self._cores[0], math.nan
        if choice.core.label != plain.label:
            rmse = self._judged(plain, choice.forms, self._fitted(plain, choice.forms, choice)).rmse_deg
        yield PartRow("core", choice.core.label, rmse, choice.rmse_deg)
        yield PartRow("sensor zero", "of each trial" if self.offsets else "one", math.nan, choice.rmse_deg)

    def _none(self) -> dict[str, Form]:
        return {part.name: () for part in self._parts}

    def _tell(self) -> None:
        best = min((choice.judged.mse for choice in self.tried), default=math.nan)
        self._progress(self._done / self._steps, math.sqrt(best))
        self._done += 1

    def _zeroed_anew(self) -> bool:
        """Whether trials have offsets of their own, seen with the richest core behind the commonest drive."""
        if len(self._runs) < 2:
            return False
        found = []
        for self.offsets in (False, True):
            delay_and_lag = next(form for form in self._parts[0].forms if len(form) > 1)
            forms = {**self._none(), self._parts[0].name: delay_and_lag}
            fit = self._fitted(self._cores[-1], forms, None)
            found.append(self._validation(self._cores[-1]).judge(fit))
        return self._worth(found[0], found[1])

    def _simplest(self, made: Sequence[tuple[CoreForm, dict[str, Form]]], present: Choice) -> Choice:
        fits = [(core, forms, self._fitted(core, forms, present)) for core, forms in made]
        least = min(fit.mse for *_, fit in fits)
        choices = [self._judged(core, forms, fit) for core, forms, fit in fits if fit.mse < self._settings.near * least]
        best = min(choices, key=lambda choice: choice.judged.mse)
        for choice in sorted(choices, key=lambda choice: choice.size):
            if choice is best or not self._worth(choice.judged, best.judged):
                return choice
        return best

    def _worth(self, before: HeldOutErrors, after: HeldOutErrors) -> bool:
        fall, error = gain(before, after)
        return fall > max(self._settings.standard_errors * error, self._settings.least_share * before.mse)

    def _fitted(self, core: CoreForm, forms: Mapping[str, Form], present: Choice | None) -> Hypothesis:
        """Joint fit from the present values where a part stays, from its own starts where it is new."""
        validation, terms = self._validation(core), TrialTerms(own_offset=self.offsets)
        effects = [*(c for form in forms.values() for c in form), *core.curve]
        held = _values(present.hypothesis) if present else {}
        starts = [[held[c.label]] if c.label in held else [list(start) for start in c.starts] for c in effects]
        values = [list(chosen) for chosen in itertools.product(*starts)]
        if present is not None and present.core.label == core.label:
            z = present.hypothesis.problem.retuned(present.hypothesis.q)
            return validation.with_causes(effects, terms, z, values)
        longer = replace(validation, evaluations=_FROM_AFAR * self._settings.evaluations)
        cores = [np.array(start.core.values) for start in core.starts]
        found = [longer.with_causes(effects, terms, z, values[:1]) for z in cores]
        return min(found, key=lambda fit: fit.mse)

    def _polished(self, choice: Choice) -> Choice:
        validation = self._validation(choice.core)
        return replace(choice, judged=validation.judge(validation.polished(choice.hypothesis)))

    def _judged(self, core: CoreForm, forms: dict[str, Form], fit: Hypothesis) -> Choice:
        choice = Choice(core, forms, self._validation(core).judge(fit))
        self.tried.append(choice)
        return choice

    def _validation(self, core: CoreForm) -> CrossValidation:
        baseline = FreeCoreBaseline(core.starts[0], self._command)
        return CrossValidation(baseline, self._runs, self._settings.evaluations)


def _near(candidate: Candidate, values: tuple[float, ...], dt_s: float) -> Candidate:
    """The candidate from known values on; a delay may move by a sample of the search, and has no longer a store."""
    candidate = replace(candidate, starts=(values,))
    if candidate.effect != "delay":
        return candidate
    operator = Delay.at_rate(values[0] + 1 / _SEARCH_HZ, dt_s)
    free = (replace(candidate.free[0], upper=operator.samples * dt_s),)
    return replace(candidate, operators=(operator,), free=free)


def _values(hypothesis: Hypothesis) -> dict[str, list[float]]:
    """Free values of each effect of a fit, by label."""
    found = hypothesis.problem.effect_values(hypothesis.q)
    return {c.label: list(v.values()) for c, v in zip(hypothesis.problem.effects, found, strict=True)}


def _labels(core: CoreForm, forms: Mapping[str, Form]) -> tuple[str, ...]:
    return (core.label, *(c.label for form in forms.values() for c in form))


def _title(candidate: Candidate) -> str:
    plain = candidate.variant in ("command", "output")
    return candidate.effect.replace("_", " ") + ("" if plain else f" ({candidate.variant})")


def _widened(
    choice: Choice, runs: Sequence[Run], tried: Sequence[Choice], settings: AutoSettings
) -> Iterator[ParameterRow]:
    """Numbers of the parts with intervals that hold the choice of the form, too.

        half = k 1.645 sqrt(s^2 + j^2 + a^2)

    s: standard error of the fit (sandwich); j: that of a jackknife over the held-out folds; a: root mean square
    difference to alternatives that do as well on held-out trials; k: `AutoSettings.widening`.

    Source: Buckland, Burnham, Augustin, Model selection: an integral part of inference, Biometrics 53 (1997), eq. (3).
    """
    rows = [r for r in parameter_rows(choice.hypothesis, runs, {}) if r.owner != "baseline"]
    folds = [_numbers(choice.hypothesis, q) for q in choice.judged.fold_q]
    equals = [other for other in tried if _as_good(gain(other.judged, choice.judged), choice, settings)]
    for row in rows:
        key, logarithmic = (row.owner, row.name), _is_logarithmic(choice, row)
        change = _log if logarithmic else _same
        value = change(row.value)
        ends = [abs(change(end) - value) for end in row.ci90 if math.isfinite(end)]
        own = max(ends, default=0.0) / _QUANTILE
        left = np.array([change(fold[key]) for fold in folds])
        jackknife = math.sqrt((left.size - 1) / max(left.size, 1) * float(np.sum((left - left.mean()) ** 2)))
        alike = [_numbers(o.hypothesis, o.hypothesis.q) for o in equals if _form_of(o, row) == _form_of(choice, row)]
        away = [change(other[key]) - value for other in alike]
        spread = math.sqrt(float(np.mean(np.square(away)))) if away else 0.0
        half = settings.widening * _QUANTILE * math.hypot(own, jackknife, spread)
        low, high = value - half, value + half
        if logarithmic:
            low, high = math.exp(max(low, -50.0)), math.exp(min(high, 50.0))
        yield replace(row, ci90=(low, high))


def _form_of(choice: Choice, row: ParameterRow) -> set[str]:
    """Labels of the part that a number belongs to."""
    every = [*choice.forms.values(), choice.core.curve]
    return {c.label for form in every if any(c.effect == row.owner for c in form) for c in form}


def _count(form: Form) -> int:
    """Free numbers of an alternative."""
    return sum(len(c.free) for c in form)


def _moved(rows: Sequence[ParameterRow], choice: Choice) -> Iterator[ParameterRow]:
    """The numbers of a fit at another rate, their intervals as wide as they were, in logarithms where they are wide so.

    A lag between samples that are held is half a sample early: at another rate the delay is another one.
    """
    found = _numbers(choice.hypothesis, choice.hypothesis.q)
    for row in rows:
        value, (low, high) = found[(row.owner, row.name)], row.ci90
        if _is_logarithmic(choice, row):
            ends = (value * low / row.value, value * high / row.value)
        else:
            ends = (value + low - row.value, value + high - row.value)
        yield replace(row, value=value, ci90=ends)


def _is_logarithmic(choice: Choice, row: ParameterRow) -> bool:
    effects = choice.hypothesis.problem.effects
    return any((c.effect, f.name) == (row.owner, row.name) and f.scale == 0 for c in effects for f in c.free)


def _without_meaning(choice: Choice, parameters: Sequence[ParameterRow]) -> tuple[str, str] | None:
    """A part and its effect of which a number may have the value at which it does nothing; None where there is none.

    That is a share of creep or a delay whose interval holds zero, or a lag at its lower bound.
    """
    for name, form in choice.forms.items():
        for row in (row for row in parameters if row.owner in {c.effect for c in form}):
            low, high = row.ci90
            may_be_none = row.name.startswith(("share", "delay")) and low <= 0.0 <= high
            if may_be_none or (row.owner == "lag" and _at_lower_bound(choice, row)):
                return name, row.owner
    return None


def _at_lower_bound(choice: Choice, row: ParameterRow) -> bool:
    free = [f for c in choice.hypothesis.problem.effects for f in c.free if (c.effect, f.name) == (row.owner, row.name)]
    return row.at_bound and row.name.startswith("tau") and any(row.value < 1.01 * f.lower for f in free)


def _log(value: float) -> float:
    return math.log(max(value, 1e-9))


def _same(value: float) -> float:
    return value


def _numbers(hypothesis: Hypothesis, q: Vec) -> dict[tuple[str, str], float]:
    found = hypothesis.problem.effect_values(q)
    pairs = zip(hypothesis.problem.effects, found, strict=True)
    return {(c.effect, name): value for c, values in pairs for name, value in values.items()}


def _as_good(gained: tuple[float, float], choice: Choice, settings: AutoSettings) -> bool:
    """Whether the chosen device is not significantly better."""
    fall, error = gained
    return fall <= max(settings.standard_errors * error, 0.02 * choice.judged.mse)


def _advice(parameters: Sequence[ParameterRow]) -> Iterator[str]:
    """What these trials do not determine, and what would."""
    for owner in dict.fromkeys(row.owner for row in parameters if row.flat or row.at_bound):
        names = ", ".join(r.name for r in parameters if r.owner == owner and (r.flat or r.at_bound))
        motions = [MOTIONS_THAT_SEPARATE[kind] for kind in EFFECTS[owner].separated_by]
        record = f"; record {' and '.join(motions)}" if motions else ""
        yield f"{owner.replace('_', ' ')}: {names} not identifiable from these logs{record}"
