"""`fit auto`: drive, creep and core of a device, each chosen by held-out free-run errors, fitted jointly."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.trials.errors import LogError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial, Units, resample

from ..chain import Chain
from ..contract.metadata import NoiseModel, Range
from ..decades import Decades
from ..effects.catalogue import EFFECTS
from .auto_search import SEARCH_HZ, AutoSearch, AutoSettings, Choice, PartRow, SearchProgress
from .chain_fit import nothing_found
from .estimation_noise import estimation_noise
from .least_squares import one_blas_thread
from .part_intervals import moved_row, widened_rows, without_meaning
from .runs import Run, check_trial_set, command_range, runs_of
from .uncertainty import ParameterRow

_AGAIN = 0.1  # time of the fit at the full rate over that of the search, if both had the same rate

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
    """An identified device.

    Attributes:
        choice: what was chosen, with its held-out errors.
        rows: what each part bought.
        parameters: numbers of drive and creep, with intervals of 90 %.
        offsets: whether each trial had an offset of its own.
        noise: what the device leaves unexplained of trials that its fit did not see; of one trial alone, of its thirds.
        advice: what these trials do not determine, and what to record for it.
        decades: working units of `choice`; rows, parameters and noise are in those of the log.
        interrupted: stopped by the user; this is the best so far.
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
    settings: AutoSettings | None = None,
    skip_first_flexure: bool = False,
    progress: SearchProgress = lambda share, rmse: None,
) -> AutoFit:
    """Identify drive, creep and hysteresis of a device jointly, each in the simplest form that explains the trials.

        theta = core(creep(drive(u))),  drive: delay, lag of first or second order, top speed, or none

    All alternatives are fitted by bounded least squares on free runs with exact sensitivities, and compared on trials
    that their fit did not see, of one trial alone on thirds of its time. Each trial has an offset of its own where that
    lowers the held-out error: angle sensors are often zeroed anew.

    Args:
        trials: uniformly sampled at one rate, in one pair of units; ramps, sines, or steps of a few values alone.
        settings: thresholds.
        skip_first_flexure: leave out each trial up to the first reversal of its command.
        progress: told the share that is done and the best error so far; KeyboardInterrupt keeps the best so far.

    Raises:
        FitError: on unusable trials, or an angle that falls with the command.
    """
    decades = Decades.of(trials)
    return _identified(
        decades.trials(trials),
        settings or AutoSettings(),
        skip_first_flexure,
        lambda share, rmse: progress(share, rmse * decades.angle),
        decades,
    )


def _identified(
    trials: Sequence[Trial],
    settings: AutoSettings,
    skip_first_flexure: bool,
    progress: SearchProgress,
    decades: Decades,
) -> AutoFit:
    coarse = _thinned(trials, check_trial_set(trials))
    runs = runs_to_fit(coarse, skip_first_flexure)
    refit_share = 0.0 if coarse is trials else _AGAIN * sum(map(len, trials)) / sum(map(len, coarse))
    share, command = 1 / (1 + refit_share), command_range(trials)  # of the whole time
    search = AutoSearch(coarse, runs, settings, lambda done, rmse: progress(share * done, rmse))
    device = search.run()
    parameters = tuple(widened_rows(device, runs, search.tried, settings))
    rows: tuple[PartRow, ...] = ()
    last = search
    try:
        if not search.interrupted:
            device, parameters = _with_meaning(search, device, parameters, command)
    except KeyboardInterrupt:
        search.interrupted = True
    if coarse is not trials:
        last = AutoSearch(
            trials,
            runs_to_fit(trials, skip_first_flexure),
            settings,
            lambda done, rmse: progress(share + (1 - share) * done, rmse),
            search.terms,
        )
        try:
            device, parameters = _at_full_rate(last, device, parameters, command)
        except KeyboardInterrupt:  # a delay's store is sized for the rate of the search: that model must not be used
            raise nothing_found("the fit at the full rate", interrupted=True) from None
    try:
        if not search.interrupted:
            kept, rows = last.part_contributions(device)
            if kept is not device:
                device, parameters = kept, _numbers_at(last, kept, parameters)
    except KeyboardInterrupt:  # the device is found; only the table of its parts is missing
        search.interrupted = True
    noise = estimation_noise(trials, last.left_out(device))
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
        tuple(_advice(parameters, trials[0].units)),
        decades,
        search.interrupted,
    )


def auto_chain(fit: AutoFit) -> Chain:
    """The identified device in the units of the log."""
    hypothesis = fit.choice.hypothesis
    return fit.decades.log_chain(hypothesis.problem.fitted_chain(hypothesis.q))


def _with_meaning(
    search: AutoSearch, device: Choice, parameters: tuple[ParameterRow, ...], command: Range
) -> tuple[Choice, tuple[ParameterRow, ...]]:
    """The device less what may do nothing, its other parts chosen anew each time."""
    lost, needed = set[str](), set[tuple[str, str]]()
    while nothing := without_meaning(device, parameters, command, needed):
        reduced = search.reselect_other_parts(search.without_effect(device, *nothing), {*lost, nothing[0]})
        if _needed(reduced, device, parameters, nothing[1], search.settings):
            needed.add(nothing)
            continue
        lost.add(nothing[0])
        device = reduced
        parameters = tuple(widened_rows(device, search.runs, search.tried, search.settings))
    return device, parameters


def _needed(
    reduced: Choice, device: Choice, parameters: Sequence[ParameterRow], effect: str, settings: AutoSettings
) -> bool:
    """Whether an effect stays however its numbers trade; one at the end of what was searched stands in for another."""
    ended = any(row.at_bound for row in parameters if row.owner == effect)
    return not ended and settings.needed(reduced.judged, device.judged)


def _at_full_rate(
    full: AutoSearch, device: Choice, parameters: Sequence[ParameterRow], command: Range
) -> tuple[Choice, tuple[ParameterRow, ...]]:
    """The device of the search fitted again, less what may do nothing at this rate."""
    device = full.refit_at_full_rate(device)
    rows, needed = _numbers_at(full, device, parameters), set[tuple[str, str]]()
    while nothing := without_meaning(device, rows, command, needed):
        reduced = full.without_effect(device, *nothing)
        if _needed(reduced, device, rows, nothing[1], full.settings):
            needed.add(nothing)
            continue
        device, rows = reduced, _numbers_at(full, reduced, parameters)
    return device, rows


def _numbers_at(search: AutoSearch, device: Choice, before: Sequence[ParameterRow]) -> tuple[ParameterRow, ...]:
    """Numbers of a device at the full rate, with intervals that hold those of the search at a lower rate, too."""
    wide = {(row.owner, row.name): row for row in before}

    def joint(row: ParameterRow, before: ParameterRow | None) -> ParameterRow:
        if before is None:
            return row
        ends = [*row.ci90, *moved_row(before, row.value, device).ci90]
        return replace(row, ci90=(min(ends), max(ends)), at_bound=row.at_bound or before.at_bound)

    rows = widened_rows(device, search.runs, search.tried, search.settings)
    return tuple(joint(row, wide.get((row.owner, row.name))) for row in rows)


def runs_to_fit(trials: Sequence[Trial], skip_first_flexure: bool) -> tuple[Run, ...]:
    """Trials as runs, each counted from the first reversal of its command on where the first flexure is skipped."""
    runs = runs_of(trials)
    if not skip_first_flexure:
        return runs
    first = [np.arange(len(trial)) >= first_flexure_end(trial) for trial in trials]
    return tuple(replace(run, counts=run.counts & counts) for run, counts in zip(runs, first, strict=True))


def _thinned(trials: Sequence[Trial], dt: float) -> Sequence[Trial]:
    """Trials of at most 50 Hz for the search."""
    keep = math.floor(1 / (dt * SEARCH_HZ) + 1e-9)
    if keep < 2:
        return trials
    try:
        return [resample(trial, 1 / (keep * dt)) for trial in trials]
    except LogError:
        return trials


def _advice(parameters: Sequence[ParameterRow], units: Units) -> Iterator[str]:
    """What these trials do not determine, and what would."""
    for owner in dict.fromkeys(row.owner for row in parameters if row.flat or row.at_bound):
        rows_of_effect, what = [r for r in parameters if r.owner == owner], owner.replace("_", " ")
        for row in (r for r in rows_of_effect if r.at_bound):
            value = f"{row.value:.4g} {units.named(row.unit)}".rstrip()
            way = "more" if math.isinf(row.ci90[1]) else "less"
            yield f"{what}: {row.name} {value} is at the end of what was searched; it may be {way}"
        motions = [MOTIONS_THAT_SEPARATE[kind] for kind in EFFECTS[owner].separated_by]
        record = f"; record {' and '.join(motions)}" if motions else ""
        if names := ", ".join(r.name for r in rows_of_effect if r.flat and not r.at_bound):
            yield f"{what}: {names} not identifiable from these logs{record}"
