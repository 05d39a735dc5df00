"""Smallest detectable size of each effect, from the commands and the simulator alone."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from hystmpc.models.effects.catalogue import EFFECTS, candidates, diagnosable
from hystmpc.models.effects.effect import Candidate, Scale, unit_on
from hystmpc.models.identify.baseline import Baseline
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Mat

from ..diagnosis import Detectable, DetectableSizes
from .preparation import PreparedTrials
from .trial_choice import NEEDS_ORDER

NO_GAP = 2.2
"""Greatest ratio of retuned mean square error to model-form error without a gap; frozen."""

_SIZES = np.geomspace(0.02, 20.0, 10)
"""Tested sizes, as shares of the start value of a fit."""

_TYPICAL = {"drift": 0.02, "nonlinear_gain": 0.1}  # share of the angle's range, where a fit starts at nothing
_NONE = 1e-9  # mean square [deg^2] below which nothing shows
_NO_FORM = (
    "The least size of each effect is not computed: the simulator's model-form error is unknown, because its file "
    "stores no residuals of its identification or it was identified on these very trials."
)


def smallest_detectable(prepared: PreparedTrials, without: Collection[str] = ()) -> DetectableSizes:
    """Smallest size of each effect that a diagnosis of these trials counts as a gap.

        needed_mse = (NO_GAP - 1) model-form error

    Without an effect a retuned simulator leaves its model-form error; up to `NO_GAP` times that is no gap.
    """
    needed_mse, units = (NO_GAP - 1.0) * prepared.form_mse, prepared.checked.trials[0].units
    if needed_mse <= 0:
        return DetectableSizes(math.nan, why_not=_NO_FORM)
    detectable = detectable_sizes(prepared.baseline, prepared.everything, needed_mse)
    unordered = () if prepared.order == "known" else tuple(NEEDS_ORDER)
    kept = tuple(
        replace(
            one,
            size=prepared.decades.log_value(one.size, one.unit),
            unit=units.named(one.unit) or "1",
            untestable=one.effect in unordered,
        )
        for one in detectable
        if one.effect not in without
    )
    return prepared.decades.log_sizes(DetectableSizes(math.sqrt(needed_mse), kept, unit=units.angle))


def detectable_sizes(baseline: Baseline, runs: Sequence[Run], needed_mse: float) -> tuple[Detectable, ...]:
    """Size of every effect at which its part orthogonal to retuning reaches a mean square error [unit of the runs].

        d(s) = theta(with the effect at size s) - theta(nominal),   left(s) = d - J (J^T J)^-1 J^T d
        mean left(s)^2 = needed_mse

    theta is the simulator's angle along the commands, J its derivative by all retuning parameters. Of the measured
    angles only the first of each trial is used. An effect has its first variant, with its other parameters at the start
    values of a fit.
    """
    problem = Problem(baseline)
    nominal, slopes = zip(*(problem.linearised(problem.as_given, run) for run in runs), strict=True)
    known = np.linalg.qr(np.concatenate(slopes))[0]
    shown = [
        replace(run, angle=theta, counts=np.ones(theta.size, dtype=np.bool_), lead=0)
        for run, theta in zip(runs, nominal, strict=True)
    ]
    scale = replace(Scale.of(shown), fastest=math.inf)
    kept = 1.0 - 1.0 / len(runs)  # of shifts between trials the common one is an offset
    shift = math.sqrt(needed_mse / kept) if kept else math.inf
    sizes = {
        "trial_shift": Detectable("trial_shift", "offset", "deg", shift, 1.0 - kept),
        "periodic_disturbance": Detectable(
            "periodic_disturbance", "amplitude", "deg", math.sqrt(2.0 * needed_mse), hidden=0.0
        ),
    }
    first_forms: dict[str, Candidate] = {}
    for candidate in candidates(scale, ()):
        if candidate.free:
            first_forms.setdefault(candidate.effect, candidate)
    for candidate in first_forms.values():
        sizes[candidate.effect] = _least(candidate, baseline, shown, known, needed_mse)
    return tuple(sizes[name] for name in diagnosable() if name in sizes)


def _least(candidate: Candidate, baseline: Baseline, runs: Sequence[Run], known: Mat, needed_mse: float) -> Detectable:
    """Smallest detectable size of one effect in runs of the nominal simulator, by log-log interpolation on a grid."""
    effect, names = EFFECTS[candidate.effect], [freedom.name for freedom in candidate.free]
    place = next(k for k, name in enumerate(names) if name in effect.neutral)
    freedom, neutral = candidate.free[place], effect.neutral[names[place]]
    start = list(candidate.starts[0])
    step = start[place] - neutral or _TYPICAL.get(candidate.effect, 1.0) * freedom.scale * 10.0
    problem, before = Problem(baseline, (candidate,)), (0.0, 0.0)
    parameter = next(p for p in candidate.operators[0].parameters if p.name == names[place])
    unit = unit_on(parameter.unit, candidate.side)
    for share in _SIZES:
        value = neutral + float(share) * step
        if not freedom.lower <= value <= freedom.upper:
            continue
        q = problem.start(baseline.nominal, [[*start[:place], value, *start[place + 1 :]]])
        change = np.concatenate(problem.held_out_errors(q, runs))
        left = change - known @ (known.T @ change)
        square, size = float(np.mean(left**2)), abs(value - neutral)
        if square >= needed_mse and np.isfinite(square):
            if before[1] > _NONE and square > before[1]:
                power = math.log(size / before[0]) / math.log(square / before[1])
                size = size * (needed_mse / square) ** power
            hidden = 1.0 - square / max(float(np.mean(change**2)), _NONE)
            return Detectable(candidate.effect, names[place], unit, size, hidden)
        before = size, square
    return Detectable(candidate.effect, names[place], unit, math.inf, math.nan)
