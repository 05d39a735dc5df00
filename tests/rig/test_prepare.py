"""Preparation as configured: where each step leads the command, and what the pretension check refuses."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.rig.experiment.phases import (
    Decision,
    FlexureSettings,
    MoveSettings,
    Past,
    PhaseInput,
    PretensionSettings,
    RelaxationSettings,
)
from hystmpc.rig.safety.ramp import RampSettings
from hystmpc.trials.errors import ConfigError

DT = 0.04
RAMPS = RampSettings()


def played(step: Any, held: float, gain: float = 10.0) -> list[Decision]:
    """A step's decisions on a device whose angle is 30 deg + gain * command."""
    phase, decisions = step.phase(RAMPS, DT), []
    phase.begin(PhaseInput(30.0 + gain * held, held), Past([], []))
    while not decisions or not (decisions[-1].finished or decisions[-1].fault):
        held = decisions[-1].u if decisions else held
        decisions.append(phase.step(PhaseInput(30.0 + gain * held, held)))
    return decisions


def fastest(held: float, decisions: list[Decision]) -> float:
    return max(abs(b - a) / DT for a, b in pairwise([held, *(d.u for d in decisions)]))


@given(st.floats(0, 6), st.floats(0, 6))
def test_a_move_ends_where_it_has_to_within_the_ramps(held: float, to: float) -> None:
    decisions = played(MoveSettings.parse({"step": "move", "to": to}), held)
    assert decisions[-1].u == pytest.approx(to, abs=1e-9)
    assert fastest(held, decisions) <= RAMPS.velocity_per_s * (1 + 1e-6)


@pytest.mark.parametrize("cycles", [1, 2])
def test_a_flexure_goes_up_and_comes_back_as_often_as_it_has_to(cycles: int) -> None:
    flexure = {"step": "flexure", "lower": 0.5, "upper": 3.0, "cycles": cycles, "hold_s": 0.2}
    commands = [d.u for d in played(FlexureSettings.parse(flexure), 0.0)]
    tops = sum(a < 2.999 <= b for a, b in pairwise(commands))
    assert (tops, max(commands), commands[-1]) == (cycles, pytest.approx(3.0), pytest.approx(0.5))


def test_a_relaxation_holds_the_command_for_its_time() -> None:
    decisions = played(RelaxationSettings.parse({"step": "relaxation", "duration_s": 1.0}), 2.0)
    assert {d.u for d in decisions} == {2.0}
    assert len(decisions) == 25


PRETENSION = {"step": "pretension_check", "by": 1.0, "hold_s": 0.2, "least_move_deg": 5.0, "most_move_deg": 15.0}


def test_a_pretension_check_that_passes_leads_back_to_where_it_began() -> None:
    decisions = played(PretensionSettings.parse(PRETENSION), 2.0)
    assert max(d.u for d in decisions) == pytest.approx(3.0)
    assert decisions[-1].u == pytest.approx(2.0)
    assert decisions[-1].fault == ""


@pytest.mark.parametrize("gain", [0.0, 4.0, 16.0, -10.0])
def test_an_angle_that_moves_too_little_too_far_or_the_other_way_is_a_fault(gain: float) -> None:
    assert f"the angle moved {gain:.2f} deg" in played(PretensionSettings.parse(PRETENSION), 2.0, gain)[-1].fault


@pytest.mark.parametrize("change", [{"by": 0.0}, {"least_move_deg": 15.0}, {"most_move_deg": 4.0}])
def test_a_pretension_check_that_can_find_nothing_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="expected"):
        PretensionSettings.parse(PRETENSION | change)
