"""White noise of a sampled signal, estimated from its differences."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hystmpc.trials.types import Vec

_ORDERS = (2, 3, 4)
_LESS = 0.93  # of the lower order's estimate: a higher order, which scatters more, is taken below that only
_KEPT = 0.8  # smallest share of the differences; the rest holds jumps, kinks and spikes
_KEPT_MOMENT = 0.43773  # E[z^2 | |z| < 1.28155] of a standard normal z: what keeping 80 % leaves of its variance


def white_noise(signals: Sequence[Vec]) -> float:
    """Standard deviation of the white part of signals, each (T,), in their unit; 0 where none is long enough.

    The n-th differences d of white noise have variance C(2n, n) sigma^2, those of a smooth motion almost none:
    sigma^2 = mean(d^2 over the smaller 80 %) / (0.438 C(2n, n)) with n = 2, or 3 or 4 where these give at least 7 %
    less. A lower bound: noise that the sensor has filtered is underestimated.

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
