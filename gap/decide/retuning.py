"""Retuning of the simulator: free parameters, growth of the model-form error, and significantly changed parameters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.baseline import FreeCoreBaseline
from hystmpc.models.identify.cross_validation import CrossValidation, HeldOutErrors, Hypothesis, gain
from hystmpc.models.identify.parts import core_forms
from hystmpc.models.identify.uncertainty import ParameterRow, core_rows
from hystmpc.models.operators.hysteresis import CurvedPlays
from hystmpc.trials.errors import FitError

from ..diagnosis import RetunedParameter
from ..logs.preparation import PreparedTrials
from ..logs.sensor import white_noise
from ..residual import friction_share

_ASKED = 1.5  # held-out error over model-form error, from which the widths of curved plays are freed
_GAINED = 0.5  # of the error above the model-form error, by which it has to fall with them
_MOST_NOISE = 0.9  # of the model-form error
_LEAST_MOVE = 0.01  # of a number: less is irrelevant for a device
_WIDER = 1.7  # widest play of a second start, three quarters of the range: no fit brings one across half of it
_LEAST_LEFT = 0.5  # of the height of a loop
_MOST_GROWN = 4.0  # height of a loop over the given one: more is no friction of the same device


@dataclass(frozen=True)
class Retuning:
    """Effect of retuning on the error of the simulator.

    Attributes:
        moved: mean square error of the simulator as given over that of the retuned one, on held-out development trials.
        grown_form_mse: expected model-form error of the retuned simulator [deg^2]; zero if the simulator's own is
            unknown.
        friction_share: share of the retuned error above the noise explained by plays of other weights and widths.
        reidentified_share: share of the retuned error above the floor explained by a newly identified core.
        unrepeatable: share of the retuned error that differs between repeats of one motion; zero without repeats.
    """

    moved: float = 1.0
    grown_form_mse: float = 0.0
    friction_share: float = 0.0
    reidentified_share: float = 0.0
    unrepeatable: float = 0.0


def retuned_with(
    prepared: PreparedTrials, validation: CrossValidation
) -> tuple[PreparedTrials, CrossValidation, Hypothesis]:
    """Retune the simulator, and free the widths of curved plays if that lowers the held-out error.

    The half-widths of curved plays are freed if the error is 1.5 times the model-form error and they explain half of
    the excess, by more than two standard errors on held-out trials.
    """
    retuned, freed = validation.retuned(), prepared.baseline.freed()
    if freed is prepared.baseline or retuned.mse < _ASKED * prepared.form_mse or not prepared.form_mse:
        return prepared, validation, retuned
    wider = replace(validation, baseline=freed)
    other = wider.retuned()
    fall, error = gain(before := validation.judge(retuned), wider.judge(other))
    if fall < 2 * error or fall < _GAINED * (before.mse - prepared.form_mse):
        return prepared, validation, retuned
    return replace(prepared, baseline=freed), wider, other


def retuning_of(prepared: PreparedTrials, retuned: Hypothesis, left_out_mse: float) -> Retuning:
    """Measure the effect of retuning on the error, given the retuned error on held-out trials [deg^2].

        e' = n^2 + min(max(1, h' / h), 4)^2 (e - n^2)

    is the form error of a simulator of friction, which grows with the height h of its loop; n is the noise. If a loop
    has lost more than half of its height, no share is counted.
    """
    residuals = prepared.residuals(retuned)
    noise, form, baseline = white_noise(residuals), prepared.form_mse, prepared.baseline
    before, after = (baseline.loop_height(z) for z in (baseline.nominal, retuned.z))
    grown = min(max(1.0, after / before), _MOST_GROWN) if before > 0 else 1.0
    still = min(noise**2, _MOST_NOISE * form)
    problem = retuned.problem
    nominal = np.concatenate([problem.error(problem.as_given, run)[0] for run in prepared.development])
    floor = prepared.floor(residuals)
    differ = floor.rmse_deg**2 if floor.kind == "repeats" else 0.0
    kept = after > _LEAST_LEFT * before
    return Retuning(
        float(np.mean(nominal**2)) / max(left_out_mse, 1e-12),
        still + grown**2 * (form - still) if form else 0.0,
        friction_share(prepared.checked.trials, prepared.scored(residuals), noise) if kept else 0.0,
        unrepeatable=differ / max(float(np.mean(np.concatenate(prepared.scored(residuals)) ** 2)), 1e-12),
    )


def width_grown(hypothesis: Hypothesis) -> float:
    """Ratio of the loop width of a hypothesis, without its effects, to that of the simulator as given."""
    baseline, z = hypothesis.problem.baseline, hypothesis.z
    of_effects = [k for names in baseline.effects.values() for k in names.values()]
    z[of_effects] = baseline.nominal[of_effects]
    before, after = baseline.loop_width(baseline.nominal), baseline.loop_width(z)
    return after / before if before > 0 else 1.0


def reidentified_share(
    prepared: PreparedTrials, validation: CrossValidation, retuned: HeldOutErrors, floor_mse: float
) -> float:
    """Share of the retuned error above the floor that a newly identified sum of plays explains held out, 0 to 1."""
    try:
        forms = core_forms(prepared.decades.trials(prepared.checked.trials), Scale.of(validation.runs))
    except FitError:
        return 0.0
    cores = [chain.core for form in forms for chain in form.starts]
    curved = next((core for core in cores if isinstance(core, CurvedPlays) and core.pieces > 1), None)
    if curved is None:  # plays of one piece are no more than a given core can be
        return 0.0
    wide = replace(curved, radii=tuple(_WIDER * radius for radius in curved.radii))
    starts = [FreeCoreBaseline(Chain(c), prepared.baseline.command, free_widths=True) for c in (curved, wide)]
    anew = [replace(validation, baseline=start) for start in starts]
    best = min(((one, one.retuned()) for one in anew), key=lambda pair: pair[1].mse)
    fall = retuned.mse - best[0].judge(best[1]).mse
    return float(np.clip(fall / max(retuned.mse - floor_mse, 1e-12), 0.0, 1.0))


def moved_numbers(
    prepared: PreparedTrials, retuned: Hypothesis, quantities: Iterable[ParameterRow]
) -> tuple[RetunedParameter, ...]:
    """Parameters, in the units of the log, whose 90 % interval after retuning excludes the given value."""
    baseline, decades, units = prepared.baseline, prepared.decades, prepared.checked.trials[0].units
    given = dict(baseline.quantities(baseline.nominal))
    rows = [(row, given[row.name]) for row in quantities if row.owner == "baseline"]
    rows += [(row, float(row.neutral or 0.0)) for row in core_rows(retuned, prepared.development)]
    moved = []
    for row, before in rows:
        sure = not row.flat and np.isfinite(row.ci90).all() and not row.ci90[0] <= before <= row.ci90[1]
        if sure and abs(row.value - before) > _LEAST_MOVE * max(abs(before), abs(row.value)):
            shown = row.times(decades.in_log(row.unit))
            was, unit = decades.log_value(before, row.unit), units.named(row.unit) or "1"
            moved.append(RetunedParameter(row.name, unit, was, shown.value, shown.ci90))
    return tuple(moved)
