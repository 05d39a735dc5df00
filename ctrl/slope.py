"""How much a model answers to its command on the whole, dead bands and lags left out."""

from __future__ import annotations

import numpy as np

from hystmpc.models.model import Predictor

_SETTLING_S = 2.0  # many times the lag of any catheter drive


def mean_slope(model: Predictor) -> float:
    """Angle at rest at the highest command less that at the lowest, over the range of commands [deg per unit]."""
    low, high = model.command_range
    samples = max(round(_SETTLING_S / model.dt), 1)
    plans = np.array([np.full(samples, low), np.full(samples, high)])
    ends = model.rollout(model.initial(0.0, low), plans)[:, -1]
    return abs(float(ends[1] - ends[0])) / (high - low)
