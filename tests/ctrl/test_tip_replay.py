"""A recording of another's commands and angles, taken up by a controller that has not run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl import Source
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.trials.errors import ControllerError

from .plays import PLAY
from .test_tip_controller import controller_for, plant_for


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_a_replayed_recording_is_as_if_the_controller_had_run(kind: str) -> None:
    """Model state, disturbance and its variance are equal to the last bit; a missing measurement is one there too."""
    tip, other = controller_for(kind=kind), controller_for(kind=kind)
    tip.reset(PLAY.y_rest)
    tip.set_target(45.0)
    plant, commands, angles = plant_for(), [], []
    y = plant.reset()
    for k in range(40):
        seen = math.nan if k in (11, 12) else y
        commands.append(tip.step(seen).u)
        angles.append(seen)
        y = plant.apply(commands[-1])
    other.replay([0.0, *commands], [math.nan, *angles])
    ours, theirs = (t.snapshot().control for t in (tip, other))
    assert ours is not None
    assert theirs is not None
    states = [t._controller.model_state(t.snapshot().control) for t in (tip, other)]
    np.testing.assert_array_equal(*states)
    assert states[0].any() or kind == "pid"
    assert ours.estimate.angles == theirs.estimate.angles
    assert (ours.estimate.disturbance, ours.estimate.variance) == (
        theirs.estimate.disturbance,
        theirs.estimate.variance,
    )
    assert other.state().command == commands[-1]
    assert other.state().reference_deg == angles[-1]
    other.set_target(60.0)
    assert other.step(y).source in (Source.MPC, Source.CONTROLLER)


@pytest.mark.parametrize(
    ("commands", "angles"),
    [([], []), ([1.0, 2.0], [30.0]), ([1.0], [math.nan]), ([7.0], [30.0]), ([math.nan], [30.0]), ([[1.0]], [30.0])],
)
def test_a_recording_that_cannot_be_used_is_refused_and_changes_nothing(commands: Any, angles: Any) -> None:
    tip = controller_for()
    tip.reset(PLAY.y_rest)
    before = tip.snapshot()
    with pytest.raises(ControllerError, match="replay: got"):
        tip.replay(commands, angles)
    assert tip.snapshot() is before
