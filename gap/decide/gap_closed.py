"""Closed gap: errors on the final trials without and with the causes, the closed share of each, and its interval."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.runs import Blocks, Run, blocks_of
from hystmpc.models.identify.uncertainty import Interval

from ..diagnosis import Gap
from ..logs.noise_floor import NoiseFloor
from ..logs.preparation import PreparedTrials
from .remaining_structure import Jumps

_DRAWS = 400
_LEAST_SIZE = 0.1
_LEAST_GAP = 0.1  # of the whole gap, in a resample


@dataclass(frozen=True, eq=False)
class ClosedShares:
    """Shares of the structural gap closed by the stages of a correction, on given trials.

    Attributes:
        floor_mse: irreducible error of any simulator [deg^2].
        spread: half of a 90 % interval due to differences between trials, relative to the closed share.
    """

    before: Blocks
    floor_mse: float
    spread: float
    seed: int

    def closed(self, mse: float) -> float:
        """Share of the structural gap closed at a given mean square error."""
        return closed_share(self.before.mse, mse, self.floor_mse)

    def interval(self, before: Blocks, after: Blocks) -> Interval:
        """90 % interval of the share closed between two stages."""
        middle = self.closed(self.before.mse - before.mse + after.mse)
        return self._widened(middle, closed_interval(self.before, before, after, self.floor_mse, self.seed))

    def of_causes(
        self, names: frozenset[str], blocks: Callable[[frozenset[str]], Blocks]
    ) -> dict[str, tuple[float, Interval]]:
        """Closed share of each cause, and its 90 % interval.

            share_i = closed (E_without_i - E) / sum_j max(E_without_j - E, 0)

        E_without_i is the error without cause i after refitting the others. The shares add up to the common closed
        share. The interval is that of the fall, with common block resamples before and after.
        """
        after = blocks(names)
        without = {name: blocks(names - {name}) for name in sorted(names)}
        falls = sum(max(b.mse - after.mse, 0.0) for b in without.values())
        together = max(self.closed(after.mse), 0.0)
        shares = {}
        for name, before in without.items():
            fall = before.mse - after.mse
            share = together * fall / falls if falls > 0 else 0.0
            one = self.closed(self.before.mse - fall)
            scale = share / one if one else 0.0
            low, high = closed_interval(self.before, before, after, self.floor_mse, self.seed)
            shares[name] = share, self._widened(share, (scale * low, scale * high))
        return shares

    def _widened(self, middle: float, ends: Interval) -> Interval:
        further = self.spread * max(abs(middle), _LEAST_SIZE)
        least = min(_LEAST_PART, abs(middle))
        below, above = (np.hypot(np.hypot(part, further), least) for part in (middle - ends[0], ends[1] - middle))
        return middle - float(below), middle + float(above)


def closed_share(retuned_mse: float, with_mse: float, floor_mse: float) -> float:
    """(MSE_retuned - MSE_with) / (MSE_retuned - MSE_floor), between -1 and 1; zero if there is no gap."""
    gap = retuned_mse - floor_mse
    return float(np.clip((retuned_mse - with_mse) / gap, -1.0, 1.0)) if gap > 0 else 0.0


def closed_interval(retuned: Blocks, before: Blocks, after: Blocks, floor_mse: float, seed: int) -> Interval:
    """90 % interval of the share closed between two stages, with common block resamples; zero without a gap.

    The fall in a resample is divided by its gap, but at least by a tenth of the whole gap. This keeps the sign of the
    fall, which is the evidence of a cause.
    """
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, retuned.energy.size, (_DRAWS, retuned.energy.size))
    total = retuned.samples[draws].sum(axis=1)
    gap = retuned.energy[draws].sum(axis=1) / total - floor_mse
    fall = (before.energy - after.energy)[draws].sum(axis=1) / total
    whole = retuned.mse - floor_mse
    shares = fall / np.maximum(gap, _LEAST_GAP * whole) if whole > 0 else np.zeros(_DRAWS)
    low, high = np.clip(np.quantile(shares, (0.05, 0.95)), -1.0, 1.0)
    return float(low), float(high)


# Of a 90 % interval; below Student's 1.9 of seven trials, since sessions have the same kinds of motion. Of 253 repeated
# sessions of development seeds 8814, 9917 and 10613 about nine in ten lie within.
_TRIALS = 1.4
_LEAST_PART = 0.02  # half-width: a floor is not known better
_LEAST_FLOOR = 0.02  # least remaining share of the floor after subtraction of a sensor's noise
_LEAST_DEG = 1e-6
_GAP_FACTOR = 2.0  # of the floor, from which a single trial counts for the spread of shares
_UNKNOWN_SPREAD = 0.1
_LEAST_SHARE = 0.05  # of the structural gap, for jumps and for effects that another could replace


@dataclass(frozen=True)
class ClosedByCause:
    """Share of the gap closed by one cause.

    Attributes:
        share: of the structural gap, by the error that returns without this cause.
        ci90: 90 % interval of it.
        rmse_without_deg: RMSE without this cause, the others present [deg].
    """

    share: float
    ci90: Interval
    rmse_without_deg: float
    parameters: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class GapClosed:
    """Errors on the final trials, and the share of the gap closed by each cause."""

    gap: Gap
    causes: Mapping[str, ClosedByCause]
    spread: float

    def unproven(self, replaceable: Container[str] = ()) -> str:
        """Cause with the least certain fall of the final error; empty if all are certain.

        The 90 % interval of each closed share, and of their sum, must be above zero. Faults of the sensor need no such
        test: the log shows them, and resamples may lack rare faults. A cause that could be replaced must close 5 % of
        the gap beside others, since a smaller share may be the form error of the others.
        """
        sensor = self.causes.get("sensor")
        if sensor and sensor.share <= 0:
            return "sensor"
        least = {name: cause.ci90[0] for name, cause in self.causes.items() if name != "sensor"}
        weakest = min(least, key=lambda name: least[name], default="")
        if weakest and (least[weakest] <= 0 or self.gap.closed_ci90[0] <= 0):
            return weakest
        return negligible_cause({name: cause.share for name, cause in self.causes.items()}, replaceable)

    @property
    def moved(self) -> float:
        """Ratio of mean square errors: simulator as given over retuned simulator."""
        return (self.gap.nominal_rmse_deg / max(self.gap.retuned_rmse_deg, _LEAST_DEG)) ** 2


def negligible_cause(shares: Mapping[str, float], replaceable: Container[str]) -> str:
    """Name of the replaceable cause with the smallest closed share, if that is below 5 %; otherwise empty."""
    small = [name for name in shares if name in replaceable and shares[name] < _LEAST_SHARE]
    return min(small, key=lambda name: shares[name]) if small and len(shares) > 1 else ""


def without_sawtooth(blocks: Blocks, mse: float) -> Blocks:
    """Errors of each block after subtraction of the energy of the jumps, at least zero."""
    return replace(blocks, energy=np.maximum(blocks.energy - mse * blocks.samples, 0.0))


@final
class FinalErrors:
    """Errors of the simulator on the final trials with any subset of its causes, and the share that they close.

    Noise of a faulty sensor and stick-slip jumps are unpredictable in a free run: their energy counts as closed, for
    jumps in each block up to a sawtooth of their height.

    Attributes:
        after: of the corrected simulator, without excess noise of the sensor if the sensor is a cause.
        shares: closed shares relative to the retuned simulator, against the angles as measured.

    Args:
        retuned, chosen: the simulator without and with its causes.
        jumps: of the tip, if they are a cause.
    """

    def __init__(
        self,
        prepared: PreparedTrials,
        validation: CrossValidation,
        retuned: Hypothesis,
        chosen: Hypothesis,
        floor: NoiseFloor,
        sensor: bool,
        seed: int,
        jumps: Jumps | None = None,
    ) -> None:
        self._prepared, self._validation, self._retuned, self._chosen = prepared, validation, retuned, chosen
        self._floor, self._sensor = floor, sensor
        self._jumps = None if "stick_slip" in chosen.effects else jumps
        corrected = final_blocks(chosen, prepared.final)
        self._parts = {frozenset(chosen.effects): corrected}
        before = measured_blocks(prepared, retuned)
        self.after = self.without_sensor_noise(corrected) if sensor else measured_blocks(prepared, chosen)
        jumps_mse = self._jumps.mse if self._jumps is not None else 0.0
        excess = jumps_mse + (prepared.excess_mse if sensor else 0.0)  # repeats differ by them
        lowest = max(floor.rmse_deg**2 - excess, _LEAST_FLOOR * floor.rmse_deg**2)
        floor_mse = min(lowest, self.after.mse, before.mse)
        self.shares = ClosedShares(before, floor_mse, self._between_trials(floor_mse), seed)

    def without_sensor_noise(self, blocks: Blocks) -> Blocks:
        """Errors after subtraction of the excess noise of a faulty sensor."""
        energy = blocks.energy - self._prepared.excess_mse * blocks.samples
        return replace(blocks, energy=energy if energy.sum() > 0 else np.zeros_like(energy))

    def _between_trials(self, floor_mse: float) -> float:
        """Half of the 90 % interval due to differences between trials, relative to the closed share."""
        shares, runs = [], self._prepared.counted
        errors = (h.held_out_errors(runs) for h in (self._retuned, self._chosen))
        for each in zip(*errors, strict=True):
            before, after = (float(np.mean(error**2)) for error in each)
            if before > _GAP_FACTOR * floor_mse:
                shares.append(closed_share(before, after, floor_mse))
        if len(shares) < 2:
            return _UNKNOWN_SPREAD
        return _TRIALS * float(np.std(shares, ddof=1)) / float(np.sqrt(len(self._prepared.final)))

    def blocks(self, kept: frozenset[str]) -> Blocks:
        """Errors with some of the causes, refitted on the development runs."""
        if kept not in self._parts:
            part = self._retuned
            if kept:
                without = self._validation.without(self._chosen, self._chosen.effects - kept)
                part = self._validation.polished(without)
            self._parts[kept] = final_blocks(part, self._prepared.final)
        return self._parts[kept]

    def closed(self) -> GapClosed:
        """Sizes of the gap, and the closed share of each cause; jumps that close less than 5 % are no cause."""
        chosen, prepared, shares, causes = self._chosen, self._prepared, self.shares, dict[str, ClosedByCause]()
        identified = _parameters(chosen, prepared)
        for name, (share, ci90) in shares.of_causes(chosen.effects, self.blocks).items():
            rmse = float(np.sqrt(self.blocks(chosen.effects - {name}).mse))
            causes[name] = ClosedByCause(share, ci90, rmse, identified[name])
        if self._sensor:
            faulty, signs = measured_blocks(prepared, chosen), prepared.signs
            share = shares.closed(shares.before.mse - faulty.mse + self.after.mse)
            parameters = {
                "resolution_deg": signs.quantisation_deg if signs.coarse else 0.0,
                "sigma_deg": signs.noise_deg,
                "outlier_rate": signs.spike_rate if signs.spikes else 0.0,
                "dropout_rate": signs.held_rate if signs.drops else 0.0,
            }
            rmse = float(np.sqrt(faulty.mse))
            causes["sensor"] = ClosedByCause(share, shares.interval(faulty, self.after), rmse, parameters)
        if self._jumps is not None:
            left, rmse = without_sawtooth(self.after, self._jumps.mse), float(np.sqrt(self.after.mse))
            share = shares.closed(left.mse) - shares.closed(self.after.mse)
            if share >= _LEAST_SHARE:
                ci90 = shares.interval(self.after, left)
                causes["stick_slip"] = ClosedByCause(share, ci90, rmse, self._jumps.parameters)
                self.after = left
        return GapClosed(self.gap(), causes, shares.spread)

    def gap(self) -> Gap:
        """Sizes of the gap."""
        problem = self._retuned.problem
        nominal, shares = Hypothesis(problem, problem.as_given, np.nan), self.shares
        closed = shares.closed(self.after.mse)
        return Gap(
            nominal_rmse_deg=float(np.sqrt(measured_blocks(self._prepared, nominal).mse)),
            retuned_rmse_deg=float(np.sqrt(shares.before.mse)),
            with_effects_rmse_deg=float(np.sqrt(self.after.mse)),
            floor_rmse_deg=float(np.sqrt(shares.floor_mse)),
            floor_kind=self._floor.kind,
            closed_share=closed,
            unexplained_share=1.0 - closed,
            closed_ci90=shares.interval(shares.before, self.after),
            final_trials=tuple(dict.fromkeys(run.name for run in self._prepared.final)),
        )


def final_blocks(hypothesis: Hypothesis, runs: Sequence[Run]) -> Blocks:
    """Errors of a fitted hypothesis on runs outside its fit."""
    return blocks_of(hypothesis.held_out_errors(runs), runs)


def measured_blocks(prepared: PreparedTrials, hypothesis: Hypothesis) -> Blocks:
    """Errors on the final runs against the angles as measured, faults of the sensor included."""
    names = [run.name for run in prepared.everything]
    mended = [(run.angle - prepared.raw[names.index(run.name)])[run.counts] for run in prepared.final]
    left = hypothesis.held_out_errors(prepared.final)
    return blocks_of([error + change for error, change in zip(left, mended, strict=True)], prepared.final)


def _parameters(chosen: Hypothesis, prepared: PreparedTrials) -> dict[str, Mapping[str, float]]:
    problem = chosen.problem
    parameters: dict[str, Mapping[str, float]] = dict(problem.identified(chosen.q))
    if problem.terms.frequency_hz:
        sizes = [problem.terms.amplitude(run, *problem.linearised(chosen.q, run)) for run in prepared.everything]
        parameters["periodic_disturbance"] = {
            "amplitude_deg": float(np.median(sizes)),
            "frequency_hz": problem.terms.frequency_hz,
        }
    if problem.terms.shift:
        offsets = [problem.terms.offset(run, *problem.linearised(chosen.q, run)) for run in prepared.everything]
        parameters["trial_shift"] = {
            "offset_spread_deg": float(np.std(offsets)),
            "largest_offset_deg": float(max(offsets, key=abs)),
        }
    return parameters
