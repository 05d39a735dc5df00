"""The environment of two axes: gymnasium's checker, a state that is the whole state, limits, and two single axes."""

from __future__ import annotations

import warnings
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.loop import NoSensorSettings
from hystmpc.models.contract.metadata import Range
from hystmpc.sim.plants.simulated import SimulatedPlant
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant
from hystmpc.trajectories.plane import circle, spiral
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError

from ..ctrl.test_two_axes import JOINED, TENDONS
from ..models.two_axis_examples import DT, RATE, REACH, two_axes
from .small import study

gym_ = pytest.importorskip("hystmpc.sim.gym_", reason="gymnasium is an extra")

MOTIONS = {"circle": circle((0.0, 0.0), 10.0, 2.0), "spiral": spiral((0.0, 0.0), 12.0, 2.0, 1.0)}
LIMITS = [CommandLimits(-REACH, REACH, RATE)] * 2
NOISY = TwoAxisPlantSettings(simulator="model", noise_deg=0.2, lag_s=0.05)
actions = st.lists(st.tuples(st.floats(-1.0, 1.0, width=32), st.floats(-1.0, 1.0, width=32)), min_size=1, max_size=20)


def environment(**options: Any) -> Any:
    return gym_.HysteresisEnv(TwoAxisPlant(JOINED, NOISY), MOTIONS, LIMITS, rate_weight=0.1, **options)


ENV, OTHER = environment(), environment()


def played(env: Any, sequence: Any) -> list[tuple[Any, ...]]:
    """Everything that a sequence of actions gives."""
    made = []
    for action in sequence:
        seen, reward, terminated, truncated, info = env.step(np.array(action, dtype=np.float32))
        facts = {name: value.tolist() for name, value in info.items()}
        made.append((seen.tolist(), reward, terminated, truncated, facts))
    return made


def test_gymnasiums_own_checker_finds_nothing() -> None:
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        check_env(environment())
    assert [str(one.message) for one in noted if "render modes" not in str(one.message)] == []


def test_shapes_are_those_of_both_axes() -> None:
    seen, info = ENV.reset(seed=1, options={"motion": "spiral"})
    assert (ENV.action_space.shape, seen.shape) == ((2,), (2 + 2 + 2 * 10,))
    wanted = MOTIONS["spiral"](DT * np.arange(1, 11))
    np.testing.assert_allclose(seen[4:].reshape(10, 2), wanted, atol=1e-5)
    assert {name: value.shape for name, value in info.items()} == dict.fromkeys(info, (2,))


@settings(max_examples=10, deadline=None)
@given(before=actions, after=actions, other=actions, seed=st.integers(0, 2**31 - 1))
def test_a_state_put_back_has_the_same_future(before: Any, after: Any, other: Any, seed: int) -> None:
    ENV.reset(seed=seed)
    played(ENV, before)
    state = ENV.get_state()
    first = played(ENV, after)
    ENV.reset()
    played(ENV, other)
    ENV.set_state(state)
    assert played(ENV, after) == first
    OTHER.set_state(state)
    assert played(OTHER, after) == first
    copied = deepcopy(ENV)
    assert played(copied, after) == played(ENV, after)


def test_what_info_holds_can_be_changed_without_harm() -> None:
    first = ENV.reset(seed=4)[0]
    for value in ENV.step(np.zeros(2, dtype=np.float32))[-1].values():
        value += 100.0
    for value in ENV.reset(seed=4)[1].values():
        value += 100.0
    np.testing.assert_array_equal(ENV.reset(seed=4)[0], first)


@settings(max_examples=10, deadline=None)
@given(sequence=st.lists(st.tuples(st.floats(), st.floats()), min_size=1, max_size=20))
def test_no_action_takes_a_command_beyond_its_limits(sequence: Any) -> None:
    ENV.reset(seed=2)
    last = np.zeros(2)
    with np.errstate(over="ignore"):
        done = played(ENV, sequence)
    for *_, info in done:
        u = np.array(info["command"])
        assert np.all(np.abs(u) <= REACH)
        assert np.all(np.abs(u - last) <= RATE * DT * (1 + 1e-12))
        last = u


def test_an_action_that_is_no_number_holds_its_command_alone() -> None:
    ENV.reset(seed=1)
    first, second = (np.array(facts["command"]) for *_, facts in played(ENV, [(0.1, 0.1), (float("nan"), 1.0)]))
    assert second[0] == first[0]
    assert second[1] > first[1]


def test_the_reward_sums_both_axes() -> None:
    ENV.reset(seed=3)
    last = np.zeros(2)
    for _, reward, _, _, info in played(ENV, [(0.5, -0.5), (1.0, 0.3)]):
        u, error = np.array(info["command"]), np.array(info["error_deg"])
        assert reward == pytest.approx(-np.sum(error**2) - 0.1 * np.sum((u - last) ** 2))
        np.testing.assert_allclose(error, np.subtract(info["true_angle_deg"], info["reference_deg"]))
        last = u


def test_without_a_joint_each_axis_is_the_environment_of_one() -> None:
    model = two_axes()
    both = gym_.HysteresisEnv(TwoAxisPlant(model, TwoAxisPlantSettings(simulator="model")), MOTIONS, LIMITS)
    both.reset(seed=1)
    plants = [SimulatedPlant(replace(axis, command_limits=Range(lower=-REACH, upper=REACH))) for axis in model.axes]
    alone = [gym_.HysteresisEnv(plant, {"scan": study().motions["move"].build()}, LIMITS[0]) for plant in plants]
    starts = [one.reset(seed=1)[1]["true_angle_deg"] for one in alone]
    random = np.random.default_rng(1)
    np.testing.assert_allclose(both.reset(seed=1)[1]["true_angle_deg"], starts, rtol=0, atol=1e-6)
    for _ in range(30):
        action = random.uniform(-1, 1, 2).astype(np.float32)
        info = both.step(action)[-1]
        for i, one in enumerate(alone):
            single = one.step(action[i : i + 1])[-1]
            assert info["command"][i] == single["command"]
            assert info["true_angle_deg"][i] == pytest.approx(single["true_angle_deg"], abs=1e-6)


def test_disturbances_act_on_angles_and_commands_of_both() -> None:
    ENV.reset(seed=5, options={"motion": "circle"})
    start = ENV.get_state()
    plain = played(ENV, [(0.2, 0.1)] * 5)
    for load, shift in ((lambda t: 3.0, [3.0, 3.0]), (lambda t: (1.0, -2.0), [1.0, -2.0])):
        ENV.set_state(start)
        ENV.disturb(gym_.Disturbance(angle_deg=load))
        pushed = played(ENV, [(0.2, 0.1)] * 5)
        off = np.array([b[0][:2] for b in pushed]) - np.array([a[0][:2] for a in plain])
        np.testing.assert_allclose(off, [shift] * 5, atol=1e-4)
    ENV.set_state(start)
    ENV.disturb(gym_.Disturbance(command=lambda t: (0.0, 1.5)))
    slipped = played(ENV, [(0.2, 0.1)] * 5)
    ENV.disturb(None)
    assert slipped[-1][-1]["command"] == plain[-1][-1]["command"]
    assert slipped[-1][-1]["true_angle_deg"][1] > plain[-1][-1]["true_angle_deg"][1] + 1.0


def test_four_tendons_have_four_actions() -> None:
    limits = [CommandLimits(0.2, 4.0, RATE)] * 4
    env = gym_.HysteresisEnv(TwoAxisPlant(TENDONS, NOISY), MOTIONS, limits, preview=3)
    seen, info = env.reset(seed=1)
    assert (env.action_space.shape, seen.shape, info["command"].tolist()) == ((4,), (2 + 4 + 6,), [1.0] * 4)
    hold = 2.0 * (1.0 - 0.2) / 3.8 - 1.0
    seen, *_, info = env.step(np.full(4, hold, dtype=np.float32))
    np.testing.assert_allclose(info["command"], 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"limits": LIMITS[:1]}, "got 1 limits, expected those of 2 commands"),
        ({"limits": LIMITS[0]}, "got 1 limits, expected those of 2 commands"),
        ({"limits": LIMITS, "sensor": NoSensorSettings()}, "got the sensor none and two axes"),
    ],
)
def test_what_does_not_fit_two_axes_is_refused_in_a_line(options: dict[str, Any], line: str) -> None:
    with pytest.raises(ConfigError, match=line):
        gym_.HysteresisEnv(TwoAxisPlant(JOINED, NOISY), MOTIONS, **options)


def test_an_action_of_too_few_numbers_is_refused_in_a_line() -> None:
    ENV.reset(seed=1)
    with pytest.raises(ConfigError, match="got an action of 1 numbers, expected 2"):
        ENV.step(np.zeros(1, dtype=np.float32))


def test_a_study_of_two_axes_is_an_environment(tmp_path: Path) -> None:
    JOINED.save(tmp_path / "both.yaml")
    data = {
        "plant": {"simulator": "both.yaml", "noise_deg": 0.1},
        "model": "both.yaml",
        "motions": {"star": {"kind": "star", "centre": [0, 0], "radius": 8}},
        "controllers": {"inverse": {"kind": "inverse"}},
    }
    (tmp_path / "study.yaml").write_text(dump_yaml(data), encoding="utf-8")
    env = gym_.HysteresisEnv.from_config(tmp_path / "study.yaml", preview=2)
    seen, _ = env.reset(seed=1)
    assert seen.shape == (2 + 2 + 4,)
    steps = 0
    while not env.step(env.action_space.sample())[3]:
        steps += 1
    assert steps > 50
