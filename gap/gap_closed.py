"""How far: the gap on the final trials, nominal, retuned and with the causes; what each cause closes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.runs import Blocks, blocks_of
from hystmpc.models.identify.uncertainty import Interval

from .diagnosis import Gap
from .floor import Floor
from .preparation import Prepared
from .shares import closed_interval, closed_share, final_blocks, shapley

# Of a 90 % interval; less than a normal's, since sessions have the same kinds of motion: of 27 sessions of development
# seed 106 that were recorded again 25 lie within, 26 with 1.645, 19 without any of it.
_TRIALS = 0.66
_LEAST_FLOOR = 0.02  # of the floor found that is left once a sensor's noise is taken out
_GAP_FACTOR = 2.0  # of the floor, from which a single trial says anything about shares
_UNKNOWN_SPREAD, _LEAST_SHARE = 0.1, 0.1


@dataclass(frozen=True, eq=False)
class GapClosed:
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

    def joined_by(self, name: str, parameters: Mapping[str, float]) -> GapClosed:
        """The same with a cause known by its signs, which closes nothing, unless it is among the causes."""
        if name in self.shares:
            return self
        return replace(
            self,
            shares={**self.shares, name: 0.0},
            intervals={**self.intervals, name: (0.0, 0.0)},
            before_deg={**self.before_deg, name: self.gap.with_effects_rmse_deg},
            parameters={**self.parameters, name: parameters},
        )


def measure(
    prepared: Prepared,
    validation: CrossValidation,
    retuned: Hypothesis,
    chosen: Hypothesis,
    floor: Floor,
    sensor: bool,
    seed: int,
) -> GapClosed:
    """Open the final trials.

    Args:
        prepared: trials.
        court: what hypotheses are fitted on.
        retuned, chosen: the simulator without and with its causes.
        floor: from repeats or noise.
        sensor: whether the sensor is a cause.
        seed: of the resampling.
    """
    opened = FinalErrors(prepared, validation, retuned, chosen, floor, sensor)
    names, everything = sorted(chosen.effects), frozenset(chosen.effects)
    worth = shapley(names, lambda kept: opened.closed(opened.blocks(kept).mse)) if names else {}
    intervals: dict[str, Interval] = {}
    left: dict[str, float] = {}
    for name in names:
        less = opened.blocks(everything - {name})
        low, high = opened.interval(less, opened.blocks(everything), seed)
        # The interval of what dropping the cause costs, moved to its Shapley value, which shares the overlap.
        moved = worth[name] - opened.closed(opened.before.mse - less.mse + opened.blocks(everything).mse)
        intervals[name], left[name] = (low + moved, high + moved), float(np.sqrt(less.mse))
    parameters = _parameters(chosen, prepared)
    if opened.sensor:
        base = opened.blocks(frozenset())
        mended = opened.mended(base)
        worth["sensor"] = opened.closed(mended.mse)
        intervals["sensor"] = opened.interval(opened.before, mended, seed)
        left["sensor"] = float(np.sqrt(_raw_blocks(prepared, chosen).mse))
        parameters["sensor"] = _sensor_parameters(prepared)
    return GapClosed(retuned, opened.gap(seed), worth, intervals, left, parameters)


@final
class FinalErrors:
    """Errors on the final trials of the simulator with any of its causes."""

    def __init__(
        self,
        prepared: Prepared,
        validation: CrossValidation,
        retuned: Hypothesis,
        chosen: Hypothesis,
        floor: Floor,
        sensor: bool,
    ) -> None:
        self._prepared, self._court, self._retuned, self._chosen = prepared, validation, retuned, chosen
        self._floor, self.sensor = floor, sensor
        self._parts = {frozenset(chosen.effects): final_blocks(chosen, prepared.final)}
        self.before = _raw_blocks(prepared, retuned)
        excess = prepared.excess_mse if sensor else 0.0
        self.after = self.mended(self.blocks(frozenset(chosen.effects))) if sensor else _raw_blocks(prepared, chosen)
        lowest = max(floor.rmse_deg**2 - excess, _LEAST_FLOOR * floor.rmse_deg**2)
        self.floor_mse = min(lowest, self.after.mse, self.before.mse)
        self._spread = self._between_trials()

    def mended(self, blocks: Blocks) -> Blocks:
        """Errors less the energy of noise that a sensor in the simulator would have, too."""
        energy = blocks.energy - self._prepared.excess_mse * blocks.samples
        return replace(blocks, energy=energy if energy.sum() > 0 else np.zeros_like(energy))

    def _between_trials(self) -> float:
        """Half of the 90 % interval that comes from trials being different, as a share of what is closed."""
        shares = []
        for run in self._prepared.everything:
            before, after = (
                float(np.mean(h.problem.held_out_error(h.q, run) ** 2)) for h in (self._retuned, self._chosen)
            )
            if before > _GAP_FACTOR * self.floor_mse:
                shares.append(closed_share(before, after, self.floor_mse))
        if len(shares) < 2:
            return _UNKNOWN_SPREAD
        return _TRIALS * float(np.std(shares, ddof=1)) / float(np.sqrt(len(self._prepared.final)))

    def blocks(self, kept: frozenset[str]) -> Blocks:
        """Errors with some of the causes, fitted anew on the development runs."""
        if kept not in self._parts:
            part = self._retuned
            if kept:
                part = self._court.polished(self._court.without(self._chosen, self._chosen.effects - kept))
            self._parts[kept] = final_blocks(part, self._prepared.final)
        return self._parts[kept]

    def closed(self, mse: float) -> float:
        """Share of the structural gap that is closed at that error."""
        return closed_share(self.before.mse, mse, self.floor_mse)

    def interval(self, before: Blocks, after: Blocks, seed: int) -> Interval:
        """Of the share that lies between two stages."""
        low, high = closed_interval(self.before, before, after, self.floor_mse, seed)
        middle = self.closed(self.before.mse - before.mse + after.mse)
        further = self._spread * max(abs(middle), _LEAST_SHARE)
        return middle - float(np.hypot(middle - low, further)), middle + float(np.hypot(high - middle, further))

    def gap(self, seed: int) -> Gap:
        """The sizes."""
        problem = self._retuned.problem
        nominal = Hypothesis(problem, problem.start(self._prepared.baseline.nominal, []), np.nan)
        closed = self.closed(self.after.mse)
        return Gap(
            nominal_rmse_deg=float(np.sqrt(_raw_blocks(self._prepared, nominal).mse)),
            retuned_rmse_deg=float(np.sqrt(self.before.mse)),
            with_effects_rmse_deg=float(np.sqrt(self.after.mse)),
            floor_rmse_deg=float(np.sqrt(self.floor_mse)),
            floor_kind=self._floor.kind,
            closed_share=closed,
            unexplained_share=1.0 - closed,
            closed_ci90=self.interval(self.before, self.after, seed),
            final_trials=tuple(dict.fromkeys(run.name for run in self._prepared.final)),
        )


def _raw_blocks(prepared: Prepared, hypothesis: Hypothesis) -> Blocks:
    """Errors against the angles as measured."""
    errors = []
    for run in prepared.final:
        raw = prepared.raw[[r.name for r in prepared.everything].index(run.name)]
        errors.append(hypothesis.problem.held_out_error(hypothesis.q, run) + (run.angle - raw)[run.counts])
    return blocks_of(errors, prepared.final)


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
