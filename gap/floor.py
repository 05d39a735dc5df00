"""What no simulator can go below: the floor from repeats of a motion, and from the noise of the residual."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hystmpc.trials.errors import GapError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .diagnosis import FloorKind
from .repeats import Repeat, find_repeats
from .sensor import SensorSigns, repaired, sensor_signs
from .white_noise import Structure, structure_left, white_noise

__all__ = ["Floor", "SensorSigns", "Structure", "find_floor", "repaired", "sensor_signs", "structure_left"]


_LEAST_S = 5.0  # of repeats in all; less is not worth the name of a floor


@dataclass(frozen=True)
class Floor:
    """Root mean square error that is left to the best simulator.

    Attributes:
        rmse_deg: from repeats where there are any, else the noise [deg].
        kind: which of the two.
        noise_deg: white noise of the residual [deg]. Repeats hold whatever is not locked to the command, a heartbeat
            and drift among it, and hide it; noise does not.
        repeats_deg: from repeats; not-a-number without [deg].
        details: `pairs` and `seconds` of repeats; `offset_deg`, root mean square of the mean differences between
            repeats over the square root of two; `without_offset_deg`, the floor with each pair's mean difference taken
            out; `median_deg` and `quartile_deg` (the lower one), over pairs: one odd pair does not move them, and slow
            memory such as creep is least in the lower ones.
    """

    rmse_deg: float
    kind: FloorKind
    noise_deg: float
    repeats_deg: float = math.nan
    details: Mapping[str, float] = field(default_factory=dict)


def find_floor(
    trials: Sequence[Trial], residuals: Sequence[Vec], dt: float, repeats: Sequence[Repeat] | None = None
) -> Floor:
    """Both floors of uniform trials.

    From repeats: sigma^2 = sum_p sum_k (e2 - e1)^2 / sum_p n_p w_p over pairs p of n_p samples, with w = 2 at a shift
    of whole samples, less where interpolation evens noise out. Residuals, not angles, are compared, since commands of
    repeats may differ by 1 % of their range.

    Args:
        trials: in recording order, at one rate.
        residuals: measured less simulated angle, (T,) each [deg]; a sign or a simulator of no use change little.
        dt: sample interval [s].
        repeats: of these trials, if known already.

    Raises:
        GapError: if residuals do not fit the trials or are not finite.
        LogError: if a trial is not uniform.
    """
    require_residuals(trials, residuals)
    noise = white_noise(residuals)
    pairs = find_repeats(trials) if repeats is None else repeats
    seconds = sum(repeat.stop - repeat.start for repeat in pairs) * dt
    if seconds < _LEAST_S:
        return Floor(noise, "noise", noise, details={"pairs": float(len(pairs)), "seconds": seconds})
    differences = [repeat.differences(residuals) for repeat in pairs]
    squares = np.array([float(d @ d) for d, _ in differences])
    means = np.array([float(np.mean(d)) for d, _ in differences])
    weights = np.array([d.size * w for d, w in differences])
    sizes = np.array([d.size for d, _ in differences])
    centred = squares - sizes * means**2
    freedom = weights * (1 - 1 / sizes)
    rmse = math.sqrt(float(squares.sum() / weights.sum()))
    details = {
        "pairs": float(len(pairs)),
        "seconds": seconds,
        "offset_deg": math.sqrt(float(np.mean(means**2)) / 2),
        "without_offset_deg": math.sqrt(max(float(centred.sum() / freedom.sum()), 0.0)),
        "median_deg": math.sqrt(float(np.median(squares / weights))),
        "quartile_deg": math.sqrt(float(np.percentile(squares / weights, 25))),
    }
    return Floor(rmse, "repeats", noise, rmse, details)


def require_residuals(trials: Sequence[Trial], residuals: Sequence[Vec]) -> None:
    """Check that there is one finite residual (T,) per trial.

    Raises:
        GapError: if numbers or shapes differ, or a value is not finite.
    """
    if len(trials) != len(residuals):
        raise GapError(f"got {len(residuals)} residuals for {len(trials)} trials, expected one per trial")
    for trial, e in zip(trials, residuals, strict=True):
        if e.shape != (len(trial),):
            raise GapError(f"{trial.source}: residual has shape {e.shape}, expected ({len(trial)},) as the trial")
        if not np.all(np.isfinite(e)):
            raise GapError(f"{trial.source}: residual is not finite at sample {int(np.argmin(np.isfinite(e)))}")
