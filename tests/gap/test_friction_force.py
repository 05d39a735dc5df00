"""A friction force that leads its displacement: the quantities of its loop, and what a diagnosis says has moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.identify.baseline import baseline_of
from hystmpc.models.operators.friction import MaxwellSlip
from hystmpc.models.simulator import Residual, Simulator
from hystmpc.trials.trial import Units

from .engine_examples import moves, simulator_of, sine, trials_of

SEAL = MaxwellSlip(0.4, (20.0, 5.0), 0.1, 0.0, 30.0)
FORCE = Range(lower=26.0, upper=37.0)
FORM = Residual(log="other.csv", motion="continuous", samples=500, rmse_deg=0.1, bias_deg=0.0, lag_one=0.5)


@settings(max_examples=5)
@given(
    st.floats(-1.0, 1.0),
    st.lists(st.floats(0.1, 20.0), min_size=1, max_size=3),
    st.floats(0.01, 0.3),
    st.floats(-50.0, 50.0),
)
def test_the_quantities_are_those_of_the_sliders(k0: float, stiffness: list[float], spacing: float, b: float) -> None:
    """Sliding, each spring pulls with k_i r_i: friction is their sum, stiffness the spring beside them."""
    core = MaxwellSlip(k0, tuple(stiffness), spacing, 0.0, b)
    baseline = baseline_of(Chain(core), Range(lower=0.0, upper=10.0))
    found = baseline.quantities(baseline.nominal)
    friction = sum(k * spacing * i for i, k in enumerate(stiffness, start=1))
    expected = {"stiffness": k0, "offset": b + 5.0 * k0, "friction": friction}
    assert found == {name: pytest.approx(value, rel=1e-2, abs=0.05) for name, value in expected.items()}
    assert baseline.loop_height(baseline.nominal) == pytest.approx(2 * found["friction"])
    assert baseline.loop_width(baseline.nominal) == pytest.approx(2 * spacing * len(stiffness))


def seal() -> Simulator:
    """The simulator of a seal, displacement in mm to force in N."""
    return replace(simulator_of(SEAL, (FORM,)), angle_unit="N", inverse=False, trained_angle_deg=FORCE)


@pytest.mark.slow
def test_friction_that_has_grown_is_said_as_friction() -> None:
    grown = replace(SEAL, stiffness=tuple(1.5 * k for k in SEAL.stiffness), b=40.0)
    trials = trials_of(Chain(grown), [moves(1, 20.0, 1.0), sine(0.1), moves(2, 20.0, 1.0), sine(0.2)])
    trials = [replace(trial, units=Units("mm", "N", inverse=False)) for trial in trials]
    diagnosis, _ = conclude(find_causes(trials, seal(), seed=1, only=("creep", "lag")))
    assert diagnosis.verdict == "retuned"
    moved = {row.name: row for row in diagnosis.moved}
    assert moved["friction"].unit == "N"
    np.testing.assert_allclose((moved["friction"].given, moved["friction"].value), (3.0, 4.5), rtol=0.05)
    assert moved["offset"].value - moved["offset"].given == pytest.approx(10.0, abs=0.2)
    assert "friction 3" in diagnosis.reason
    assert " deg" not in diagnosis.reason
