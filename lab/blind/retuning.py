"""Gap of an effect: its remaining error after a refit of the baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.models.contract.metadata import Range
from hystmpc.models.identify.baseline import Baseline, baseline_of
from hystmpc.models.identify.free_run import FreeRuns
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..devices.cores import RATE_HZ

_STEPS = 25
_DONE = 1e-4  # relative change of the loss that ends a refit


@dataclass(frozen=True, eq=False)
class Retuned:
    """Baseline refitted to some angles.

    Attributes:
        rmse_deg: remaining error [deg].
        angles: its free runs, (T,) by trial [deg].
    """

    simulator: Simulator
    rmse_deg: float
    angles: tuple[Vec, ...]


def retune(simulator: Simulator, commands: Sequence[Vec], angles: Sequence[Vec]) -> Retuned:
    """Refit the baseline, from its present parameters, to angles (T,) [deg] without noise under commands (T,).

    Levenberg-Marquardt on the normal equations: far cheaper than the library's own fit with ten thousand
    samples and nine parameters, and sufficient from a near start. Commands in mm or bar.
    """
    trials = [
        Trial(np.arange(u.size) / RATE_HZ, u, y, source=f"trial {k}")
        for k, (u, y) in enumerate(zip(commands, angles, strict=True))
    ]
    fitted = replace(simulator, chain=simulator.chain.with_values(_fitted(simulator, trials).tolist()))
    runs = free_runs(fitted, commands, [float(y[0]) for y in angles])
    return Retuned(fitted, rms([a - b for a, b in zip(runs, angles, strict=True)]), runs)


def _fitted(simulator: Simulator, trials: Sequence[Trial]) -> Vec:
    """Parameters of the chain after the refit; one that equals an effect stays fixed, since its refit would hide it."""
    command = np.concatenate([trial.command for trial in trials])
    baseline = baseline_of(simulator.chain, Range(lower=float(command.min()), upper=float(command.max())))
    runs = FreeRuns(simulator.chain, trials)
    held = {*baseline.held, *(k for own in baseline.effects.values() for k in own.values())}
    active = np.array([k not in held for k in range(baseline.nominal.size)])
    z, damping = baseline.nominal.copy(), 1e-3
    r, jacobian = _errors(runs, baseline, z)
    for _ in range(_STEPS):
        slope = jacobian.T @ r
        # A bound that the error pushes against holds its parameter for this step.
        free = active & ~(((z <= baseline.lower) & (slope > 0)) | ((z >= baseline.upper) & (slope < 0)))
        move = np.zeros(z.size)
        move[free] = _step(jacobian[:, free], slope[free], damping)
        tried = np.clip(z + move, baseline.lower, baseline.upper)
        following, by_z = _errors(runs, baseline, tried)
        gain = float(r @ r - following @ following)
        if not np.isfinite(gain) or gain <= 0:
            damping *= 10
            continue
        done = gain < _DONE * float(r @ r)
        z, r, jacobian, damping = tried, following, by_z, max(damping / 10, 1e-9)
        if done:
            break
    return baseline.chain_values(z)[0]


def _errors(runs: FreeRuns, baseline: Baseline, z: Vec) -> tuple[Vec, Vec]:
    """Free-run errors, regularisation terms included, and their derivative by the free parameters."""
    p, by_z = baseline.chain_values(z)
    r, by_p = runs.residuals(p)
    if not baseline.roughness.size:
        return r, by_p @ by_z
    tied = baseline.roughness / np.sqrt(r.size)  # errors are of the mean
    return np.concatenate([r, tied @ z]), np.vstack([by_p @ by_z, tied])


def _step(jacobian: Vec, slope: Vec, damping: float) -> Vec:
    """Levenberg's step (Q,), each parameter damped by its curvature."""
    normal = jacobian.T @ jacobian
    curvature = np.diag(normal)
    scale = np.maximum(curvature, 1e-9 * max(float(curvature.max(initial=0.0)), 1e-12))
    return np.asarray(-np.linalg.solve(normal + damping * np.diag(scale), slope), dtype=np.float64)


def free_runs(simulator: Simulator, commands: Sequence[Vec], first_deg: Sequence[float]) -> tuple[Vec, ...]:
    """Free runs (T,) of a simulator [deg], each from its first angle."""
    model = ChainModel(simulator)
    return tuple(model.run(np.array(u), y) for u, y in zip(commands, first_deg, strict=True))


def rms(parts: Sequence[Vec]) -> float:
    """Root of the mean square over all samples of all trials."""
    return float(np.sqrt(np.mean(np.concatenate(list(parts)) ** 2)))


@dataclass(frozen=True, eq=False)
class GapRuler:
    """Measure of effects on one device and its motions.

    Attributes:
        commands: (T,) by trial [mm or bar].
        plain: angles without the effects and without noise, (T,) by trial [deg].
        base: the baseline refitted to them; its rmse is the model-form error.
    """

    commands: tuple[Vec, ...]
    plain: tuple[Vec, ...]
    base: Retuned

    @classmethod
    def of(cls, simulator: Simulator, commands: Sequence[Vec], plain: Sequence[Vec]) -> GapRuler:
        """Refit the baseline to the unaffected device."""
        return cls(tuple(commands), tuple(plain), retune(simulator, commands, plain))

    def gap(self, affected: Sequence[Vec]) -> float:
        """RMSE of the effect after a refit of the baseline [deg].

        The change by the effect is added to angles that the baseline reproduces exactly, so that the model-form
        error does not count.
        """
        target = [run + (a - p) for run, a, p in zip(self.base.angles, affected, self.plain, strict=True)]
        return retune(self.base.simulator, self.commands, target).rmse_deg
