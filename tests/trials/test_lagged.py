"""A first-order lag is that of `scipy.signal`, from rest at the first value."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hystmpc.trials.types import lagged


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.999])
def test_a_lag_is_a_filter_of_one_pole_at_rest_at_the_first_value(keep: float) -> None:
    signal = np.random.default_rng(0).normal(size=200)
    expected, _ = lfilter([1.0 - keep], [1.0, -keep], signal, zi=[keep * signal[0]])
    np.testing.assert_array_equal(lagged(signal, keep), expected)


def test_a_signal_of_no_samples_has_none_behind_a_lag() -> None:
    assert lagged(np.empty(0), 0.5).shape == (0,)
