"""The prediction-error filter over runs of any length, and over signals side by side."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hystmpc.models.identify.runs import whitened


@pytest.mark.parametrize("shape", [(50,), (50, 3), (7,), (6,), (4,)])
def test_it_filters_along_time_and_is_zero_where_the_past_is_missing(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(1)
    white, signal = np.concatenate([[1.0], random.normal(size=6)]), random.normal(size=shape)
    expected = np.asarray(lfilter(white, [1.0], signal, axis=0))
    expected[:6] = 0.0
    np.testing.assert_allclose(whitened(signal, white), expected, rtol=1e-12, atol=1e-14)
