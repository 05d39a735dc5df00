"""The environment: gymnasium's own checker, a state that is the whole state, and disturbances."""

from __future__ import annotations

import warnings
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.sim.config import SimulationConfig
from hystmpc.sim.results import violations
from hystmpc.sim.study import prepare
from hystmpc.trajectories import PreviewTable
from hystmpc.trials.errors import ConfigError

from .small import MOVE, SCAN, study, study_data

gym_ = pytest.importorskip("hystmpc.sim.gym_", reason="gymnasium is an extra")

STUDY = SimulationConfig.parse(
    study_data(
        plant={"simulator": "builtin:tendon-catheter", "lag_s": 0.08, "noise_deg": 0.15},
        motions={"move": MOVE, "scan": SCAN},
    )
)
READY = prepare(STUDY)
ENV = gym_.HysteresisEnv.from_config(STUDY, rate_weight=0.1)
OTHER = gym_.HysteresisEnv.from_config(STUDY, rate_weight=0.1)
actions = st.lists(st.floats(-1.0, 1.0, width=32), min_size=1, max_size=25)


def played(env: Any, sequence: list[float]) -> list[tuple[Any, ...]]:
    """Everything that a sequence of actions gives."""
    found = []
    for action in sequence:
        seen, reward, terminated, truncated, info = env.step(np.array([action], dtype=np.float32))
        found.append((seen.tolist(), reward, terminated, truncated, tuple(info.items())))
    return found


def test_gymnasiums_own_checker_finds_nothing() -> None:
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        check_env(gym_.HysteresisEnv.from_config(STUDY))
    # It cannot remake an environment that is not in gymnasium's register.
    assert [str(one.message) for one in noted if "render modes" not in str(one.message)] == []


@settings(max_examples=10)
@given(before=actions, after=actions, other=actions, seed=st.integers(0, 2**31 - 1))
def test_a_state_put_back_has_the_same_future(
    before: list[float], after: list[float], other: list[float], seed: int
) -> None:
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


def test_a_state_holds_the_coming_resets_too() -> None:
    ENV.reset(seed=3)
    state = ENV.get_state()
    first = [ENV.reset()[0].tolist() for _ in range(4)]
    ENV.set_state(state)
    assert [ENV.reset()[0].tolist() for _ in range(4)] == first


@settings(max_examples=10)
@given(sequence=actions, seed=st.integers(0, 2**31 - 1))
def test_no_action_takes_the_command_beyond_its_limits(sequence: list[float], seed: int) -> None:
    ENV.reset(seed=seed)
    commands = np.array([dict(info)["command"] for *_, info in played(ENV, sequence)])
    assert violations(commands, READY.plant.rest_command, READY.limits, ENV.dt) == 0


def test_an_action_that_is_no_number_holds_the_command() -> None:
    ENV.reset(seed=1)
    (*_, info), (*_, held) = played(ENV, [0.0, float("nan")])
    assert dict(held)["command"] == dict(info)["command"]


def test_an_episode_ends_with_its_motion() -> None:
    _, info = ENV.reset(seed=1, options={"motion": "scan"})
    assert info["command"] == 0.0
    steps = PreviewTable(STUDY.motions["scan"].build(), ENV.dt, 1).steps
    ends = [truncated for _, _, _, truncated, _ in played(ENV, [0.0] * steps)]
    assert ends == [False] * (steps - 1) + [True]
    with pytest.raises(ConfigError, match="did you mean 'scan'"):
        ENV.reset(options={"motion": "scann"})


def test_disturbances_act_on_angle_and_command() -> None:
    ENV.reset(seed=5, options={"motion": "move"})
    start = ENV.get_state()
    plain = played(ENV, [0.2] * 5)
    ENV.set_state(start)
    ENV.disturb(gym_.Disturbance(angle_deg=lambda t: 3.0))
    pushed = played(ENV, [0.2] * 5)
    shift = [b[0][0] - a[0][0] for a, b in zip(plain, pushed, strict=True)]
    assert shift == pytest.approx([3.0] * 5, abs=1e-4)
    assert dict(pushed[-1][-1])["true_angle_deg"] - dict(plain[-1][-1])["true_angle_deg"] == pytest.approx(3.0)
    ENV.set_state(start)
    ENV.disturb(gym_.Disturbance(command=lambda t: 1.5))
    slipped = played(ENV, [0.2] * 5)
    assert dict(slipped[-1][-1])["command"] == dict(plain[-1][-1])["command"]
    assert dict(slipped[-1][-1])["true_angle_deg"] > dict(plain[-1][-1])["true_angle_deg"] + 1.0
    ENV.disturb(None)


def test_an_environment_shows_the_frame_taken_last_and_can_be_rewound() -> None:
    env = gym_.HysteresisEnv.from_config(
        study(sensor={"kind": "intermittent", "latency_s": 0.2, "jitter_s": 0.05, "noise_deg": 0.2})
    )
    env.reset(seed=1)
    up = np.array([0.2], dtype=np.float32)
    shown = [float(env.step(up)[0][0]) for _ in range(30)]
    assert len(set(shown)) <= 7
    state = env.get_state()
    coming = [float(env.step(up)[0][0]) for _ in range(15)]
    env.set_state(state)
    assert [float(env.step(up)[0][0]) for _ in range(15)] == coming
    blind = gym_.HysteresisEnv.from_config(study(controllers={"inverse": {"kind": "inverse"}}, sensor={"kind": "none"}))
    rest = float(blind.reset(seed=1)[0][0])
    assert {float(blind.step(up)[0][0]) for _ in range(10)} == {rest}
