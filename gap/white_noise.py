"""White noise of a sampled signal from its differences, and whether anything but noise is left in a residual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from hystmpc.trials.types import Vec

_ORDERS = (2, 3, 4)
_LESS = 0.93  # a higher order, whose estimate scatters more, has to find that much less
_KEPT = 0.8  # jumps, kinks and spikes are in the rest
_KEPT_MOMENT = 0.43773  # E[z^2 | |z| < 1.28155] of a standard normal z: what keeping 80 % leaves of its variance
_MOST_LAGS = 20
_LEAST_P, _LEAST_SHARE = 1e-4, 0.05


@dataclass(frozen=True)
class Structure:
    """What a residual holds beyond white noise.

    Attributes:
        p_value: of the Ljung-Box test that the residual is white, over all trials.
        lag_one: correlation of neighbouring residuals, about zero.
        share: of the residual's energy above that of its white part, 0 to 1.
    """

    p_value: float
    lag_one: float
    share: float

    @property
    def left(self) -> bool:
        """Whether a twentieth of the energy or more is structure, and not by chance (p < 0.0001)."""
        return self.p_value < _LEAST_P and self.share > _LEAST_SHARE


def white_noise(signals: Sequence[Vec]) -> float:
    """Standard deviation of the white part of signals, each (T,), in their unit; 0 where none is long enough.

    From the n-th differences d of a signal, whose white part has variance C(2n, n) sigma^2 while a smooth motion
    leaves next to nothing: sigma^2 = mean(d^2 over the smaller 80 %) / (0.438 C(2n, n)) with n = 2, or 3 or 4 where
    these find less by 7 % or more.
    Noise that the sensor has filtered is underrated: a lower bound.

    Source: von Neumann et al., Ann. Math. Stat. 12 (1941) 153, for n = 1; orders and trimming are ours.
    """
    found = math.inf
    for order in _ORDERS:
        parts = [np.abs(np.diff(signal, order)) for signal in signals if signal.size > order + 1]
        if not parts:
            break
        size = np.concatenate(parts)
        kept = np.sort(size)[: max(1, round(_KEPT * size.size))]
        value = math.sqrt(float(np.mean(kept**2)) / (_KEPT_MOMENT * math.comb(2 * order, order)))
        found = value if value < _LESS * found else found
    return found if math.isfinite(found) else 0.0


def structure_left(residuals: Sequence[Vec]) -> Structure:
    """Test residuals of trials, each (T,) [deg], for anything that is not white; a constant error is structure.

    Ljung-Box: Q = n (n + 2) sum_k r_k^2 / (n - k) over k = 1 ... min(20, n / 5) with correlations r_k about zero; the Q
    of trials add up, chi-squared with as many degrees of freedom as lags.

    Source: Ljung and Box, Biometrika 65 (1978) 297, eq. (1.3).
    """
    statistic, freedom, first, energy, samples = 0.0, 0, 0.0, 0.0, 0
    for e in residuals:
        own = float(e @ e)
        lags = min(_MOST_LAGS, e.size // 5)
        energy, samples = energy + own, samples + e.size
        if own <= 0 or lags < 1:
            continue
        products = np.array([e[k:] @ e[:-k] for k in range(1, lags + 1)])
        first += float(products[0])
        weights = e.size * (e.size + 2) / (e.size - np.arange(1, lags + 1))
        statistic += float(weights @ (products / own) ** 2)
        freedom += lags
    if energy <= 0:
        return Structure(1.0, 0.0, 0.0)
    white = white_noise(residuals) ** 2 * samples
    p_value = float(chi2.sf(statistic, freedom)) if freedom else 1.0
    return Structure(p_value, first / energy, float(np.clip(1 - white / energy, 0.0, 1.0)))
