"""How far: the gap on the final trials, nominal, retuned and with the causes; what each cause closes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .diagnosis import Gap, Interval
from .floor import Floor
from .hypothesis import Court, Hypothesis
from .preparation import Prepared
from .select import without_effects
from .shares import Blocks, blocks_of, closed_interval, closed_share, final_blocks, shapley


@dataclass(frozen=True, eq=False)
class HowFar:
    """Sizes on the final trials.

    Attributes:
        retuned: the retuned simulator.
        gap: nominal, retuned, with causes, floor.
        shares, intervals: what each cause closes, and its 90 % interval.
        before_deg: RMSE without each cause, the others present [deg].
        parameters: identified values of each cause.
    """

    retuned: Hypothesis
    gap: Gap
    shares: Mapping[str, float]
    intervals: Mapping[str, Interval]
    before_deg: Mapping[str, float]
    parameters: Mapping[str, Mapping[str, float]]


def measure(
    prepared: Prepared,
    court: Court,
    retuned: Hypothesis,
    chosen: Hypothesis,
    floor: Floor,
    sensor: bool,
    seed: int,
) -> HowFar:
    """Open the final trials.

    Args:
        prepared: trials.
        court: what hypotheses are fitted on.
        retuned, chosen: the simulator without and with its causes.
        floor: from repeats or noise.
        sensor: whether the sensor may be a cause.
        seed: of the resampling.
    """
    runs = prepared.final
    nominal = Hypothesis(retuned.problem, retuned.problem.start(prepared.baseline.nominal, []), np.nan)
    before, after = _raw_blocks(prepared, retuned), final_blocks(chosen, runs)
    sensor = sensor and prepared.signs.any
    if not sensor:
        after = _raw_blocks(prepared, chosen)
    floor_mse = min(floor.rmse_deg**2, after.mse, before.mse)
    names = sorted(chosen.effects)
    subsets: dict[frozenset[str], Blocks] = {frozenset(names): final_blocks(chosen, runs)}

    def blocks(kept: frozenset[str]) -> Blocks:
        if kept not in subsets:
            subsets[kept] = final_blocks(_part(court, retuned, chosen, kept), runs)
        return subsets[kept]

    base = blocks(frozenset())
    worth = shapley(names, lambda kept: closed_share(before.mse, blocks(kept).mse, floor_mse)) if names else {}
    intervals, left = {}, {}
    for name in names:
        less = blocks(frozenset(names) - {name})
        low, high = closed_interval(before, less, subsets[frozenset(names)], floor_mse, seed)
        # The interval of what dropping the cause costs, moved to its Shapley value, which shares the overlap.
        moved = worth[name] - closed_share(before.mse, before.mse - less.mse + subsets[frozenset(names)].mse, floor_mse)
        intervals[name], left[name] = (low + moved, high + moved), float(np.sqrt(less.mse))
    parameters = _parameters(chosen, prepared)
    if sensor:
        worth["sensor"] = closed_share(before.mse, before.mse - (before.mse - base.mse), floor_mse)
        intervals["sensor"] = closed_interval(before, before, base, floor_mse, seed)
        left["sensor"] = float(np.sqrt(_raw_blocks(prepared, chosen).mse))
        parameters["sensor"] = _sensor_parameters(prepared)
    closed = closed_share(before.mse, after.mse, floor_mse)
    gap = Gap(
        nominal_rmse_deg=float(np.sqrt(_raw_blocks(prepared, nominal).mse)),
        retuned_rmse_deg=float(np.sqrt(before.mse)),
        with_effects_rmse_deg=float(np.sqrt(after.mse)),
        floor_rmse_deg=float(np.sqrt(floor_mse)),
        floor_kind=floor.kind,
        closed_share=closed,
        unexplained_share=1.0 - closed,
        closed_ci90=closed_interval(before, before, after, floor_mse, seed),
        final_trials=tuple(dict.fromkeys(run.name for run in runs)),
    )
    return HowFar(retuned, gap, worth, intervals, left, parameters)


def _raw_blocks(prepared: Prepared, hypothesis: Hypothesis) -> Blocks:
    """Errors against the angles as measured."""
    errors = []
    for run in prepared.final:
        raw = prepared.raw[[r.name for r in prepared.everything].index(run.name)]
        errors.append(hypothesis.problem.held_out_error(hypothesis.q, run) + (run.angle - raw)[run.counts])
    return blocks_of(errors, prepared.final)


def _part(court: Court, retuned: Hypothesis, chosen: Hypothesis, kept: frozenset[str]) -> Hypothesis:
    """The chosen hypothesis with some of its causes, fitted anew on the development runs."""
    if not kept:
        return retuned
    return court.polished(without_effects(court, chosen, chosen.effects - kept))


def _parameters(chosen: Hypothesis, prepared: Prepared) -> dict[str, Mapping[str, float]]:
    problem = chosen.problem
    found: dict[str, Mapping[str, float]] = dict(problem.identified(chosen.q))
    if problem.terms.frequency_hz:
        sizes = [problem.terms.amplitude(run, *problem.linearised(chosen.q, run)) for run in prepared.everything]
        found["periodic_disturbance"] = {
            "amplitude_deg": float(np.median(sizes)),
            "frequency_hz": problem.terms.frequency_hz,
        }
    if problem.terms.shift:
        offsets = [problem.terms.offset(run, *problem.linearised(chosen.q, run)) for run in prepared.everything]
        found["trial_shift"] = {"offset_spread_deg": float(np.std(offsets)), "largest_offset_deg": _largest(offsets)}
    return found


def _largest(values: Sequence[float]) -> float:
    return float(max(values, key=abs))


def _sensor_parameters(prepared: Prepared) -> Mapping[str, float]:
    signs = prepared.signs
    return {
        "resolution_deg": signs.quantisation_deg if signs.coarse else 0.0,
        "sigma_deg": signs.noise_deg,
        "outlier_rate": signs.spike_rate if signs.spikes else 0.0,
        "dropout_rate": signs.held_rate if signs.drops else 0.0,
    }
