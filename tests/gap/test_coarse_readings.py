"""Coarse readings beside the simulator's own form error: their squares add up, and rounding is no shift of a trial."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hystmpc.gap.diagnose import find_causes
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import DeviceLimits
from hystmpc.models.identify.simulators import simulator_of
from hystmpc.models.operators.static_curves import NonlinearGain
from hystmpc.trials.trial import Trial

from ..models.zoo import STATIC_PI
from .engine_examples import moves, sine, trials_of

STEP_DEG = 2.0
CURVED = Chain(STATIC_PI, after=(NonlinearGain(0.001, 0.0, 50.0),))
"""Device with a slight curve that its simulator lacks: the form error."""


def recorded(first: int) -> list[Trial]:
    """Trials of the device with a fine sensor."""
    motions = [*(moves(first + k, 24.0, 2.0) for k in range(6)), sine(0.1), sine(0.17)]
    return trials_of(CURVED, motions, seed=first)


@pytest.mark.slow
def test_only_the_sensor_is_named_where_readings_became_coarse() -> None:
    simulator = simulator_of(Chain(STATIC_PI), recorded(100), DeviceLimits(), "known")
    coarse = [replace(t, angle=np.round(t.angle / STEP_DEG) * STEP_DEG) for t in recorded(0)]
    findings = find_causes(coarse, simulator)
    form_mse, facts = findings.prepared.form_mse, findings.attribution.facts
    assert facts.floor_mse == pytest.approx(form_mse + findings.prepared.excess_mse)
    assert findings.prepared.excess_mse == pytest.approx(STEP_DEG**2 / 12, rel=0.02)
    assert findings.conclusion.decision.case == "sensor_alone"
    assert "trial_shift" not in {name for names in findings.attribution.selection.tried for name in names}
