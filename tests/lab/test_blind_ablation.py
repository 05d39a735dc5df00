"""Ablation: what the logs need is asked for by name, what they do not need is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.operators.dynamics import Delay, Lag, Servo
from hystmpc.models.operators.static_curves import NonlinearGain
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.errors import ConfigError
from hystmpc_lab.blind.ablation import RESULT, Ablated, ablate, answered, components, effect_of, without
from hystmpc_lab.blind.reading import DiagnosisReading

from ..gap.engine_examples import moves, simulator_of, sine, trials_of
from ..models.zoo import BACKLASH

ROW = Ablated("lag", 0.1, 0.5, 0.05, 9.0)
WHOLE = Chain(BACKLASH, (Lag(0.2), Delay(1e-5, 1)))


def test_components_are_the_effects_around_the_core_by_their_public_names() -> None:
    chain = Chain(BACKLASH, (Servo(0.1, 0.7), Lag(0.1)), (NonlinearGain(0.1, 0.0, 24.0),))
    assert components(chain) == ("lag", "nonlinear_gain")
    assert components(Chain(BACKLASH)) == ()
    assert effect_of("deadband") == effect_of("backlash") == ""
    less = without(replace(simulator_of(BACKLASH), chain=chain), "lag")
    assert [o.name for o in less.chain.operators] == ["backlash", "nonlinear_gain"]
    assert less.identification.residuals == ()


@pytest.mark.slow
def test_what_is_needed_is_named_and_what_is_not_needed_is_not_asked_for(tmp_path: Path) -> None:
    trials = trials_of(WHOLE, [moves(1, 8.0), moves(2, 8.0), sine(0.5, 8.0)])
    whole = replace(simulator_of(BACKLASH), chain=WHOLE)
    lag, delay = ablate(trials, whole, tmp_path)
    assert (lag.component, lag.needed, lag.right, lag.found) == ("lag", True, True, True)
    assert lag.with_deg < 0.06 < 5 * lag.with_deg < lag.without_deg
    assert lag.standard_errors > 3
    assert (delay.component, delay.needed, delay.verdict) == ("delay", False, "")
    assert [o.name for o in load_simulator(tmp_path / "lag" / "sim.yaml").chain.before] == ["delay"]
    assert not (tmp_path / "delay").exists()
    kept = json.loads((tmp_path / RESULT).read_text())["components"]
    assert [(row["component"], row["needed"], row["right"]) for row in kept] == [
        ("lag", True, True),
        ("delay", False, None),
    ]


def test_a_core_alone_has_nothing_to_take_out(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a core without effects"):
        ablate(trials_of(Chain(BACKLASH), [moves(1)]), simulator_of(BACKLASH), tmp_path)


@pytest.mark.parametrize(
    ("said", "right", "found"),
    [
        (DiagnosisReading("named", ("lag", "creep"), (0.9, 0.8)), True, True),
        (DiagnosisReading("named", ("creep", "lag"), (0.9, 0.8)), False, True),
        (DiagnosisReading("one_of", ("delay",), (0.5,), (frozenset(("delay", "lag")),)), False, True),
        (DiagnosisReading("named", ("creep",), (0.9,)), False, False),
        (DiagnosisReading("unknown", ("lag",), (0.2,), (frozenset(("delay", "lag")),)), False, False),
        (DiagnosisReading("none"), False, False),
    ],
)
def test_an_answer_is_right_by_its_first_name_and_found_among_its_names(
    said: DiagnosisReading, right: bool, found: bool
) -> None:
    row = answered(ROW, said)
    assert (row.right, row.found, row.verdict) == (right, found, said.verdict)


def test_a_component_is_needed_from_the_floor_on() -> None:
    assert replace(ROW, without_deg=0.1501).needed
    assert not replace(ROW, without_deg=0.1499).needed
    assert not replace(ROW, without_deg=0.05).needed
