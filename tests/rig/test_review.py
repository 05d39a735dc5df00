"""What is due after a run: nothing, new numbers, or another model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.monitor import ChangeMonitor
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.rig.experiment.review import ReviewedRun, review
from hystmpc.trials.errors import LogError

T = 0.04 * np.arange(500)
FREE = 50 + 20 * np.sin(T)
NOISE = np.random.default_rng(0).normal(0, 0.1, T.size)


def run_with(measured: np.ndarray) -> ReviewedRun:
    usual = NoiseModel(
        sensor_sigma_deg=0.1,
        drift_sigma_deg_per_sqrt_s=0.1,
        motion_sigma_deg_per_sqrt_unit=0.1,
        model_sigma_deg=0.2,
    )
    monitor = ChangeMonitor(usual, 0.04, (30.0, 70.0))
    return ReviewedRun(T, np.zeros(T.size), measured, FREE, FREE, FREE, np.isfinite(measured), monitor)


def test_a_right_model_needs_nothing() -> None:
    found = review(run_with(FREE + NOISE), 1.0)
    assert found.advice.startswith("nothing is due")
    assert found.free_run_deg == pytest.approx(0.1, abs=0.02)
    assert found.change.startswith("the device is as it was identified")


def test_a_device_that_has_changed_is_said_to_have() -> None:
    found = review(run_with(50 + 0.8 * (FREE - 50) + NOISE), 1.0)
    assert found.change.startswith("the device has changed since identification (p = 1.000; stiffness")
    assert found.lines == ("tracking error 2.80 deg RMS, 4.20 deg at most", found.advice, found.change)


@given(gain=st.floats(0.5, 0.9), offset=st.floats(2, 10))
def test_a_line_between_model_and_device_asks_for_an_identification(gain: float, offset: float) -> None:
    found = review(run_with(50 + offset + gain * (FREE - 50) + NOISE), 1.0)
    assert found.advice.startswith("a new identification is due")
    assert found.gain == pytest.approx(gain, abs=0.01)
    assert found.corrected_deg == pytest.approx(0.1, abs=0.02)


def test_a_loop_that_the_model_lacks_asks_for_a_diagnosis() -> None:
    found = review(run_with(FREE + 4 * np.cos(T) + NOISE), 1.0)
    assert found.advice.startswith("a diagnosis is due")


def test_missing_angles_do_not_count_and_too_few_are_refused() -> None:
    measured = FREE + NOISE
    measured[::3] = np.nan
    assert review(run_with(measured), 1.0).advice.startswith("nothing is due")
    with pytest.raises(LogError, match="expected at least 10"):
        review(run_with(np.where(T < 0.2, FREE, np.nan)), 1.0)
