"""A filter that leaves of errors what their own past does not predict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from hystmpc.trials.types import Vec

AS_IT_IS: Vec = np.ones(1)
"""The filter that changes nothing."""
_ORDER = 6
_RIDGE = 1e-9


def whitening(errors: Sequence[Vec]) -> Vec:
    """Filter (P + 1,) that leaves of errors what their own past does not predict.

    e_k - a_1 e_{k-1} - ... - a_P e_{k-P}, with a of least squares over all runs: a model-form error that follows the
    motion slowly is taken off, and noise stays. An order of P = 6.

    Source: Cochrane and Orcutt, Application of least squares regression to relationships containing auto-correlated
    error terms, J. Am. Stat. Assoc. 44 (1949).
    """
    past = np.concatenate([np.lib.stride_tricks.sliding_window_view(e[:-1], _ORDER)[:, ::-1] for e in errors])
    square = past.T @ past
    square += _RIDGE * max(float(np.trace(square)), _RIDGE) * np.eye(_ORDER)
    a = np.linalg.solve(square, past.T @ np.concatenate([e[_ORDER:] for e in errors]))
    return np.concatenate([[1.0], -a])


def whitened(signal: Vec, white: Vec) -> Vec:
    """A signal (T, ...) of one run through the filter; zero where its past is not known."""
    if white.size == 1:
        return white[0] * signal
    left = np.asarray(lfilter(white, [1.0], signal, axis=0))
    left[: white.size - 1] = 0.0
    return left
