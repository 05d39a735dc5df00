"""The library of effects: complete, searchable, in plain data and back, with one line for every error."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain, operator_from, operator_spec, operators
from hystmpc.models.effects.catalogue import EFFECTS, candidates, diagnosable
from hystmpc.models.effects.effect import Scale
from hystmpc.models.effects.pictures import effect_figure, write_pictures
from hystmpc.models.effects.place import (
    EffectError,
    effect_from,
    effect_operator,
    effect_spec,
    library_data,
    neutral_operator,
    with_effect,
)
from hystmpc.models.simulator import load_simulator, save_simulator
from hystmpc.trials.errors import ModelError

from .zoo import BACKLASH, DT, simulator

NAMES = (
    *("lag", "delay", "rate_dependence", "dahl_drag", "creep", "drift", "first_flexure", "slack", "stick_slip"),
    *("contact", "nonlinear_gain", "asymmetry", "directional_gain", "trial_shift", "periodic_disturbance", "sensor"),
)
SIDES = [(name, side) for name, effect in EFFECTS.items() for side in effect.sides]


def test_the_library_is_the_table_of_the_design() -> None:
    assert tuple(EFFECTS) == NAMES
    assert {effect.operator for effect in EFFECTS.values()} <= set(operators().values())
    assert all(effect.shown for effect in EFFECTS.values())


def test_every_effect_but_those_with_a_test_of_their_own_has_forms() -> None:
    own = {"trial_shift", "periodic_disturbance", "sensor"}  # terms of each trial, signs of the sensor
    scale = Scale(0.0, 6.0, 20.0, 80.0, 60.0, 240.0, DT)
    assert {c.effect for c in candidates(scale, ())} == set(diagnosable()) - own
    assert set(EFFECTS) - set(diagnosable()) == {"dahl_drag", "directional_gain"}


def test_confounders_are_effects_and_mutual() -> None:
    for name, effect in EFFECTS.items():
        for fields in ("confounders", "also_taken_for"):
            assert all(name in getattr(EFFECTS[other], fields) for other in getattr(effect, fields)), name


@pytest.mark.parametrize("name", EFFECTS)
def test_plain_data_and_back(name: str) -> None:
    for k in range(len(EFFECTS[name].shown)):
        placed = effect_from({"effect": name, "parameters": dict(EFFECTS[name].shown[k])}, DT)
        again = effect_from(effect_spec(placed), DT)
        assert again.operator == placed.operator
        assert operator_from(operator_spec(placed.operator), "here") == placed.operator


def test_a_simulator_file_holds_effects_in_any_number_and_order(tmp_path: Path) -> None:
    chain = Chain(BACKLASH)
    for name, side in (*SIDES, *reversed(SIDES)):
        chain = with_effect(chain, effect_operator(name, EFFECTS[name].shown[0], DT), side)  # type: ignore[arg-type]
    assert len(chain.operators) == 2 * len(SIDES) + 1
    assert load_simulator(save_simulator(simulator(chain), tmp_path / "sim.yaml")).chain == chain


@pytest.mark.parametrize(
    ("spec", "message", "at"),
    [
        ({"effect": "crep"}, "no effect 'crep', available: asymmetry.*did you mean 'creep'", ("effect",)),
        ({"side": "command"}, "expected a mapping with the key 'effect'", ()),
        ({"effect": "creep", "parameters": {"share": 0.1, "tau_ms": 1}}, "'tau_s' in s", ("parameters", "tau_ms")),
        ({"effect": "creep", "parameters": {"tau": 1}}, "'tau_s' in s", ("parameters", "tau")),
        ({"effect": "creep", "parameters": {"shar": 1}}, "did you mean 'share'", ("parameters", "shar")),
        ({"effect": "creep", "parameters": {"share": 0.1}}, "tau_s is missing, got share.*in s", ("parameters",)),
        (
            {"effect": "slack", "parameters": {"slack": -1}},
            "is -1 cmd, expected 0 to 1000 cmd",
            ("parameters", "slack"),
        ),
        ({"effect": "contact", "parameters": {"angle": math.nan}}, "is nan deg", ("parameters", "angle")),
        ({"effect": "contact", "parameters": {"angle": "far"}}, "'far', expected a number", ("parameters", "angle")),
        ({"effect": "slack", "side": "output"}, "cannot act on the output side, only command: the angle", ("side",)),
        ({"effect": "sensor", "side": "command"}, "cannot act on the command side, only output", ("side",)),
        ({"effect": "lag", "side": "core"}, "side 'core', available: command, output", ("side",)),
        ({"effect": "lag", "parametres": {}}, "unknown key 'parametres'.*did you mean 'parameters'", ("parametres",)),
        ({"effect": "creep", "terms": 0}, "creep.terms is 0, expected a whole number", ()),
    ],
)
def test_a_wrong_effect_is_one_line_that_says_where(spec: dict[str, object], message: str, at: tuple[str, ...]) -> None:
    with pytest.raises(EffectError, match=message) as error:
        effect_from(spec)
    assert error.value.at == at
    assert "\n" not in str(error.value)


def test_a_chain_refuses_an_effect_on_the_wrong_side() -> None:
    with pytest.raises(ModelError, match="cannot act on the command side"):
        with_effect(Chain(BACKLASH), neutral_operator("sensor"), "command")


@given(size=st.floats(0.01, 100.0), low=st.floats(-50.0, 50.0))
def test_starts_scale_with_the_device(size: float, low: float) -> None:
    """A device in other units is searched in the same places."""
    unit, other = Scale(0, 1, 0.0, 1.0, 60.0, 60.0, DT), Scale(0, 1, low, low + size, 60.0, 60.0, DT)
    a, b = (np.array([s[0] for c in EFFECTS["contact"].forms(scale) for s in c.starts]) for scale in (unit, other))
    np.testing.assert_allclose(b, low + size * a, atol=1e-9)


def test_the_plain_data_of_the_library_name_units_on_each_side() -> None:
    data = {entry["name"]: entry for entry in library_data()}
    assert data["contact"]["parameters"][0]["unit"] == {"output": "deg", "command": "cmd"}
    assert data["sensor"]["sides"] == ["output"]


def test_a_picture_shows_the_plain_device_and_the_effect() -> None:
    loop, hold = effect_figure("creep").axes
    plain, changed = (line.get_ydata() for line in hold.lines)
    assert len(loop.lines) == 2
    assert np.ptp(plain[150:320]) < 1e-9
    assert np.ptp(changed[150:320]) > 1.0


@pytest.mark.slow
def test_pictures_and_page_of_every_effect(tmp_path: Path) -> None:
    page = write_pictures(tmp_path / "effects")
    assert {file.stem for file in page.parent.glob("*.png")} == set(EFFECTS)
    text = page.read_text()
    assert "http://" not in text
    assert "https://" not in text
    assert text.count("<svg") == len(EFFECTS)
