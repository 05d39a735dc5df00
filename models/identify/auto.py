"""Identification of a whole device, `fit auto`: drive, creep and hysteresis, chosen by errors on held-out trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.trials.errors import LogError
from hystmpc.trials.trial import Trial, Units, resample
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..contract.metadata import NoiseModel, Range
from ..decades import Decades
from ..effects.catalogue import EFFECTS
from ..effects.effect import Candidate, Freedom
from .auto_search import SEARCH_HZ, STANDARD_ERRORS, AutoSearch, Choice, PartRow, SearchProgress, stays
from .chain_fit import no_result
from .cross_validation import Hypothesis, gain
from .estimation_noise import estimation_noise
from .least_squares import one_blas_thread
from .parts import NO_RANGES, Ends, varies, whole_delay
from .runs import Run, check_trial_set, command_range, ordered, runs_to_fit
from .uncertainty import ParameterRow, parameter_rows

_REFIT_SHARE = 0.1  # ratio of the durations of the fit at the full rate and the search, for equal rates

MOTIONS_THAT_SEPARATE = {
    "fast": "fast steps and small sines of 2 to 4 Hz",
    "speeds": "ramps at three speeds",
    "holds": "holds of 10 s",
    "long_holds": "holds of 45 s",
    "repeat": "the opening motion a second time",
    "amplitudes": "strokes of several amplitudes",
}
"""Motions by the words of `Effect.separated_by`."""


@dataclass(frozen=True, eq=False)
class AutoFit:
    """Identified device.

    Attributes:
        choice: chosen device with its errors on held-out trials.
        parameters: values of drive and creep, with intervals of 90 %.
        noise: noise of the model on held-out trials; of a single trial, on its thirds.
        advice: parameters that the trials do not determine, and what to record for them.
        decades: working units of `choice`; rows, parameters and noise are in those of the log.
    """

    choice: Choice
    rows: tuple[PartRow, ...]
    parameters: tuple[ParameterRow, ...]
    offsets: bool
    noise: NoiseModel
    advice: tuple[str, ...]
    decades: Decades
    interrupted: bool = False


@one_blas_thread
def identify_auto(
    trials: Sequence[Trial],
    skip_first_flexure: bool = False,
    progress: SearchProgress = lambda share, rmse: None,
    ranges: Mapping[str, Ends] = NO_RANGES,
) -> AutoFit:
    """Identify drive, creep and hysteresis of a device jointly, each in the simplest form that explains the trials.

        theta = core(creep(drive(u))),  drive: delay, lag of first or second order, top speed, or none

    All alternatives are fitted by bounded least squares on free runs with exact sensitivities, and compared on held-out
    trials, or on thirds of a single trial. Each trial has a separate offset where that lowers the held-out error: angle
    sensors are often zeroed anew. The result does not depend on the order of the trials.

    Args:
        trials: uniformly sampled at one rate, in one pair of units; ramps, sines, or steps of a few values alone. All
            have the same measured inputs, on which friction, gain, offset and time constants may depend.
        skip_first_flexure: leave out each trial up to the first reversal of its command.
        progress: called with the completed share and the best error; KeyboardInterrupt keeps the best so far.
        ranges: of measured inputs over which their dependences are to hold; those of the trials where left out.

    Raises:
        FitError: on unusable trials, or an angle that falls with the command.
    """
    check_trial_set(trials)
    decades = Decades.of(trials := ordered(trials))
    return _identified(
        decades.trials(trials),
        skip_first_flexure,
        lambda share, rmse: progress(share, rmse * decades.angle),
        decades,
        ranges,
    )


def _identified(
    trials: Sequence[Trial],
    skip_first_flexure: bool,
    progress: SearchProgress,
    decades: Decades,
    ranges: Mapping[str, Ends],
) -> AutoFit:
    coarse = _thinned(trials, check_trial_set(trials))
    runs = runs_to_fit(coarse, skip_first_flexure)
    refit_share = 0.0 if coarse is trials else _REFIT_SHARE * sum(map(len, trials)) / sum(map(len, coarse))
    share, command = 1 / (1 + refit_share), command_range(trials)  # share of the whole duration
    last = search = AutoSearch(coarse, runs, lambda done, rmse: progress(share * done, rmse), ranges=ranges)
    device, parameters = _searched(search, command)
    rows: tuple[PartRow, ...] = ()
    if coarse is not trials:
        full = runs_to_fit(trials, skip_first_flexure)
        tell: SearchProgress = lambda done, rmse: progress(share + (1 - share) * done, rmse)  # noqa: E731
        last = AutoSearch(trials, full, tell, search.terms, ranges)
        try:
            device, parameters = _at_full_rate(last, device, parameters, command)
        except KeyboardInterrupt:  # the model of the search must not be used: its delay's store fits another rate
            raise no_result("the fit at the full rate", interrupted=True) from None
    try:
        if not search.interrupted:
            kept, rows = last.part_contributions(device)
            if kept is not device:
                device, parameters = kept, _numbers_at(last, kept, parameters)
    except KeyboardInterrupt:  # the device is identified; only the table of its parts is missing
        search.interrupted = True
    noise = estimation_noise(trials, _without_zeros(last.left_out(device), search.offsets))
    unsure = _perhaps_none(device, parameters, command)
    parameters = tuple(row.times(decades.in_log(row.unit)) for row in parameters)
    return AutoFit(
        device,
        tuple(
            replace(row, without_deg=row.without_deg * decades.angle, with_deg=row.with_deg * decades.angle)
            for row in rows
        ),
        parameters,
        search.offsets,
        decades.log_noise(noise),
        (*_advice(parameters, trials[0].units, unsure), *_on_inputs(trials, device)),
        decades,
        search.interrupted,
    )


def _without_zeros(residuals: Sequence[Vec], zeroed: bool) -> Sequence[Vec]:
    """Residuals without the offset of a sensor that was zeroed anew for each trial: it is no error of the model."""
    return [residual - residual.mean() for residual in residuals] if zeroed else residuals


def _searched(search: AutoSearch, command: Range) -> tuple[Choice, tuple[ParameterRow, ...]]:
    """Device of the search and its parameter values, without effects that may be the identity."""

    def numbers_of(device: Choice) -> tuple[ParameterRow, ...]:
        return tuple(widened_rows(device, search.runs, search.tried))

    def reduced_by(device: Choice, part: str, effect: str, lost: set[str]) -> Choice:
        return search.reselect_other_parts(search.without_effect(device, part, effect), lost)

    device = search.run()
    parameters = numbers_of(device)
    try:
        if not search.interrupted:
            device, parameters = _with_meaning(device, parameters, command, reduced_by, numbers_of)
            simpler = search.least_of_simpler(device)
            if simpler is not device:
                device, parameters = simpler, numbers_of(simpler)
    except KeyboardInterrupt:
        search.interrupted = True
    return device, parameters


def auto_chain(fit: AutoFit) -> Chain:
    """Identified device as a chain, in the units of the log."""
    hypothesis = fit.choice.hypothesis
    return fit.decades.log_chain(hypothesis.chain)


def _with_meaning(
    device: Choice,
    rows: tuple[ParameterRow, ...],
    command: Range,
    reduced_by: Callable[[Choice, str, str, set[str]], Choice],
    numbers_of: Callable[[Choice], tuple[ParameterRow, ...]],
) -> tuple[Choice, tuple[ParameterRow, ...]]:
    """Device without effects that may be the identity, unless held-out errors rise by more than their standard error.

    An effect that stays is of use for predictions. Its interval says that it may be another one, or none.
    """
    lost, required, searched = set[str](), device.hidden, device
    while nothing := without_meaning(device, rows, command, required):
        part, effect = nothing
        reduced = reduced_by(device, part, effect, {*lost, part})
        if stays(reduced.judged, searched.judged):
            required.add(nothing)
            continue
        lost.add(part)
        device, rows = reduced, numbers_of(reduced)
    return device, rows


def _at_full_rate(
    full: AutoSearch, device: Choice, parameters: Sequence[ParameterRow], command: Range
) -> tuple[Choice, tuple[ParameterRow, ...]]:
    """Device of the search fitted to all samples, without effects that may be the identity at this rate."""
    device = full.refit_at_full_rate(device)
    rows = _numbers_at(full, device, parameters)
    return _with_meaning(
        device,
        rows,
        command,
        lambda present, part, effect, lost: full.without_effect(present, part, effect),
        lambda present: _numbers_at(full, present, parameters),
    )


def _numbers_at(search: AutoSearch, device: Choice, before: Sequence[ParameterRow]) -> tuple[ParameterRow, ...]:
    """Parameter values at the full rate; their intervals include those of the search at a lower rate."""
    wide = {(row.owner, row.name): row for row in before}

    def joint(row: ParameterRow, before: ParameterRow | None) -> ParameterRow:
        if before is None:
            return row
        ends = [*row.ci90, *moved_row(before, row.value, device).ci90]
        return replace(row, ci90=(min(ends), max(ends)), at_bound=row.at_bound or before.at_bound)

    rows = widened_rows(device, search.runs, search.tried)
    return tuple(joint(row, wide.get((row.owner, row.name))) for row in rows)


def _thinned(trials: Sequence[Trial], dt: float) -> Sequence[Trial]:
    """Trials resampled to at most 50 Hz for the search."""
    keep = math.floor(1 / (dt * SEARCH_HZ) + 1e-9)
    if keep < 2:
        return trials
    try:
        return [resample(trial, 1 / (keep * dt)) for trial in trials]
    except LogError:
        return trials


def _advice(parameters: Sequence[ParameterRow], units: Units, unsure: Collection[str] = ()) -> Iterator[str]:
    doubtful = (row.owner for row in parameters if row.flat or row.at_bound or row.owner in unsure)
    for owner in dict.fromkeys(doubtful):
        rows_of_effect, what = [r for r in parameters if r.owner == owner], owner.replace("_", " ")
        for row in (r for r in rows_of_effect if r.at_bound):
            value = f"{row.value:.4g} {units.named(row.unit)}".rstrip()
            way = "more" if math.isinf(row.ci90[1]) else "less"
            yield f"{what}: {row.name} {value} is at the end of what was searched; it may be {way}"
        known = EFFECTS.get(owner)  # none of a dependence on an input
        motions = [MOTIONS_THAT_SEPARATE[kind] for kind in (known.separated_by if known else ())]
        record = f"; record {' and '.join(motions)}" if motions else ""
        if owner in unsure:
            yield f"{what}: it lowers the error on trials left out, but may be another effect or none{record}"
        elif names := ", ".join(r.name for r in rows_of_effect if r.flat and not r.at_bound):
            yield f"{what}: {names} not identifiable from these logs{record}"


def _on_inputs(trials: Sequence[Trial], device: Choice) -> Iterator[str]:
    """Lines on inputs on which nothing depends in the end."""
    used = {c.depends.input.name for form in device.forms.values() for c in form if c.depends is not None}
    for name in trials[0].inputs:
        values = np.concatenate([trial.inputs[name] for trial in trials])
        if not varies(values):
            seen = f"{values.min():.4g} to {values.max():.4g}"
            yield f"{name}: not determined: the input hardly varies ({seen}); record trials over its range"
        elif name not in used:
            yield f"{name}: no dependence on it lowers the error on trials left out"


_WIDENING = 1.5  # factor k on the intervals
_QUANTILE = 1.645  # of the normal distribution, 95 %


def widened_rows(choice: Choice, runs: Sequence[Run], tried: Sequence[Choice]) -> Iterator[ParameterRow]:
    """Parameter values of a device, with intervals that allow for other forms of its parts.

        half = k 1.645 sqrt(s^2 + j^2 + a^2)

    s: standard error of the fit (sandwich); j: that of a jackknife over the held-out folds; a: root mean square
    difference to alternatives with the same effect that do as well on held-out trials, such as a lag with a delay; k:
    1.5, for what no alternative of the list can express. An interval is open at an end of the search range.

    Source: Buckland, Burnham, Augustin, Model selection: an integral part of inference, Biometrics 53 (1997), eq. (3).
    """
    rows = [r for r in parameter_rows(choice.hypothesis, runs, {}) if r.owner != "baseline"]
    folds = [_numbers(choice.hypothesis, q) for q in choice.judged.fold_q]
    equals = [other for other in tried if _as_good(other, choice)]
    for row, (candidate, freedom) in zip(rows, _free(choice), strict=True):
        key, logarithmic = (candidate.label, freedom.name), freedom.scale == 0
        change = _log if logarithmic else float
        value = change(row.value)
        ends = [abs(change(end) - value) for end in row.ci90 if math.isfinite(end)]
        sigma = max(ends, default=0.0) / _QUANTILE
        left = np.array([change(fold[key]) for fold in folds])
        jackknife = math.sqrt((left.size - 1) / max(left.size, 1) * float(np.sum((left - left.mean()) ** 2)))
        alike = [_numbers(o.hypothesis, o.hypothesis.q) for o in equals if candidate.label in _labels(o)]
        away = [change(other[key]) - value for other in alike]
        spread = math.sqrt(float(np.mean(np.square(away)))) if away else 0.0
        half = _WIDENING * _QUANTILE * math.hypot(sigma, jackknife, spread)
        low, high = value - half, value + half
        if logarithmic:
            low, high = math.exp(max(low, -50.0)), math.exp(min(high, 50.0))
        if _at_lower(row, freedom):  # values beyond the search range are unknown
            low = 0.0 if freedom.lower >= 0 else -math.inf
        elif row.at_bound:
            high = math.inf
        more = sum(map(whole_delay, choice.forms.values())) if candidate.effect == "delay" else 0.0
        yield replace(row, value=row.value + more, ci90=(low + more, high + more))


def _free(choice: Choice) -> list[tuple[Candidate, Freedom]]:
    return [(c, freedom) for c in choice.hypothesis.problem.effects for freedom in c.free]


def _labels(choice: Choice) -> set[str]:
    return {c.label for c in choice.hypothesis.problem.effects}


def moved_row(row: ParameterRow, value: float, choice: Choice) -> ParameterRow:
    """Parameter row with the value from a fit at another rate and the width of the former interval."""
    low, high = row.ci90
    effects = choice.hypothesis.problem.effects
    if any((c.effect, f.name) == (row.owner, row.name) and f.scale == 0 for c in effects for f in c.free):
        return replace(row, value=value, ci90=(value * low / row.value, value * high / row.value))
    return replace(row, value=value, ci90=(value + low - row.value, value + high - row.value))


_NEARLY = 2.0  # times its lower bound: a shorter lag counts as none
_EDGE = 0.01  # share of the command's range: a slack this near its lowest value is an offset


def without_meaning(
    choice: Choice,
    parameters: Sequence[ParameterRow],
    command: Range,
    required: Collection[tuple[str, str]] = (),
) -> tuple[str, str] | None:
    """First effect, with its part, whose intervals include its neutral value; None where there is none.

    A lag is neutral within twice its lower bound, a top speed where it may equal the fastest command, a slack where it
    may end below the lowest command.

    Args:
        required: parts and effects that are kept without this test, see `stays`.
    """
    rows = iter(parameters)
    owners = [(name, c) for name, form in choice.forms.items() for c in form]
    for name, candidate in [*owners, *(("core", c) for c in choice.core.curve)]:
        numbers = [(next(rows), freedom) for freedom in candidate.free]
        if (name, candidate.effect) not in required and _may_do_nothing(numbers, command):
            return name, candidate.effect
    return None


def _perhaps_none(choice: Choice, parameters: Sequence[ParameterRow], command: Range) -> frozenset[str]:
    """Effects whose intervals include their neutral value."""
    seen = choice.hidden
    while nothing := without_meaning(choice, parameters, command, seen):
        seen.add(nothing)
    return frozenset(effect for _, effect in seen - choice.hidden)


def _may_do_nothing(numbers: Sequence[tuple[ParameterRow, Freedom]], command: Range) -> bool:
    neutral: list[bool] = []
    for row, freedom in numbers:
        low, high = row.ci90
        if row.owner == "lag":
            none = low < _NEARLY * freedom.lower if row.name.startswith("tau") else False
            none |= row.name == "top_speed" and high >= freedom.upper
        elif row.owner == "slack":
            none = row.name == "slack" and low <= command.lower + _EDGE * (command.upper - command.lower)
        elif row.owner == "delay":
            none = low <= 0.0
        elif row.owner == "creep":
            none = low <= 0.0 <= high if row.name.startswith("share") else _at_lower(row, freedom)
        else:
            if row.neutral is not None:
                neutral.append(low <= row.neutral <= high)
            continue
        if none:
            return True
    return bool(neutral) and all(neutral)


def _at_lower(row: ParameterRow, freedom: Freedom) -> bool:
    return row.at_bound and row.value - freedom.lower < freedom.upper - row.value


def _log(value: float) -> float:
    return math.log(max(value, 1e-9))


def _numbers(hypothesis: Hypothesis, q: Vec) -> dict[tuple[str, str], float]:
    values = hypothesis.problem.effect_values(q)
    pairs = zip(hypothesis.problem.effects, values, strict=True)
    return {(c.label, name): value for c, values in pairs for name, value in values.items()}


def _as_good(other: Choice, choice: Choice) -> bool:
    fall, error = gain(other.judged, choice.judged)
    return fall <= max(STANDARD_ERRORS * error, 0.02 * choice.judged.mse)
