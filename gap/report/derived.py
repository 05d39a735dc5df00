"""What the figures show of the residuals by interval and by frequency, computed from the trials themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from hystmpc.trials.types import Vec

from .evidence import Stage, TrialEvidence

_BINS, _SEGMENT_S = 12, 16.0
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Binned:
    """RMSE over equal intervals of one quantity.

    Attributes:
        quantity, unit: of the edges.
        edges: (B + 1,).
        rmse_deg: in each interval for each simulator [deg], (B,), not-a-number where no sample lies.
        time: share of the samples, (B,).
    """

    quantity: str
    unit: str
    edges: Vec
    rmse_deg: dict[Stage, Vec]
    time: Vec


def binned(trials: Sequence[TrialEvidence], stages: Sequence[Stage]) -> list[Binned]:
    """RMSE by command, angle and speed of the command over all samples that count; constant quantities are left out."""
    unit = trials[0].trial.units.command
    values = {
        ("command", unit): [t.trial.command[t.start :] for t in trials],
        ("angle", "deg"): [t.trial.angle[t.start :] for t in trials],
        ("command speed", f"{unit}/s"): [np.gradient(t.trial.command, t.trial.t)[t.start :] for t in trials],
    }
    squares: dict[Stage, Vec] = {s: np.concatenate([t.residual(s) ** 2 for t in trials]) for s in stages}
    joined = {names: np.concatenate(parts) for names, parts in values.items()}
    return [
        _binned(*names, signal, squares)
        for names, signal in joined.items()
        if np.ptp(signal) > _ROUNDING * (1 + np.abs(signal).max())
    ]


def _binned(quantity: str, unit: str, values: Vec, squares: dict[Stage, Vec]) -> Binned:
    low, high = np.quantile(values, (0.002, 0.998)) if quantity == "command speed" else (values.min(), values.max())
    if high <= low:
        low, high = values.min(), values.max()
    edges = np.linspace(low, high, _BINS + 1)
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _BINS - 1)
    counts = np.bincount(place, minlength=_BINS)
    rmse: dict[Stage, Vec] = {}
    for stage, parts in squares.items():
        sums = np.bincount(place, parts, minlength=_BINS)
        rmse[stage] = np.sqrt(np.divide(sums, counts, out=np.full(_BINS, np.nan), where=counts > 0))
    return Binned(quantity, unit, edges, rmse, counts / values.size)


def amplitude_density(trials: Sequence[TrialEvidence], stage: Stage) -> tuple[Vec, Vec]:
    """Frequencies [Hz] and amplitude density of the residuals [deg/sqrt(Hz)], mean power over trials (Welch, 16 s)."""
    dt = float(np.median([trial.trial.dt for trial in trials]))
    shortest = min(trial.residual(stage).size for trial in trials)
    size = max(8, min(shortest, round(_SEGMENT_S / dt)))
    residuals = [trial.residual(stage) for trial in trials]
    powers = [welch(e, 1 / dt, nperseg=size, detrend="constant")[1] for e in residuals]
    mean: Vec = np.average(powers, axis=0, weights=[e.size for e in residuals])
    return np.asarray(np.fft.rfftfreq(size, dt), dtype=np.float64), np.sqrt(mean)
