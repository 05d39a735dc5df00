"""Changes that are likely as a whole: what the model does behind another drive, or with another friction."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from hystmpc.ctrl.learning.bank import DELAYS, LAGS_S, SIZE, FilterBank
from hystmpc.ctrl.learning.likely import likely_changes
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.ctrl.mpc_settings import AdaptationSettings
from hystmpc.trials.types import Vec

from .plays import DT, Backlash, Faulty, not_a_number, raising, with_entries

MODEL = Backlash()
WIDER = Backlash(c_lo=3.232, c_up=1.594)  # twice the dead band, about the same middle
SPAN, SCALE = 6.0, 62.0  # mm, deg
REST_DEG = MODEL.m_lo * MODEL.c_lo


def motion(seconds: float, seed: int = 0) -> Vec:
    """Commands between random turning points, at random speeds."""
    random, commands = np.random.default_rng(seed), [0.0]
    while len(commands) < seconds / DT:
        goal, speed = random.uniform(0.0, SPAN), random.uniform(0.5, 2.0)
        count = max(1, math.ceil(abs(goal - commands[-1]) / (speed * DT)))
        commands.extend(np.linspace(commands[-1], goal, count + 1)[1:].tolist())
    return np.array(commands[: round(seconds / DT)])


def lagged(commands: Vec, lag_s: float) -> Vec:
    share = 1.0 if lag_s == 0 else -math.expm1(-DT / lag_s)
    return np.asarray(lfilter([share], [1.0, share - 1.0], commands))


def along(plant: Backlash, commands: Vec, lag_s: float = 0.0) -> Vec:
    """Angles of a device behind a first-order lag, from rest at the command 0 after a larger one."""
    rest = plant.initial(plant.m_lo * plant.c_lo, 0.0)
    return plant.rollout(rest, lagged(commands, lag_s)[None])[0]


def with_change(change: Vec, lag: int, commands: Vec) -> Vec:
    """Angles of the model with a whole change of z behind one drive of the grid, from rest at the command 0."""
    predictor = LearnedPredictor(MODEL, AdaptationSettings())
    bank = predictor.filters(0)
    state = bank.init(REST_DEG, 0.0, REST_DEG)
    z = state.z.copy()
    z[0, 1:, lag] = change[1:]
    state = with_entries(state, z=z, best=lag * DELAYS, share=1.0)
    start = np.concatenate([MODEL.initial(REST_DEG, 0.0), bank.acting(state, (REST_DEG,))[1]])
    return predictor.rollout(start, commands[None])[0]


def spread(x: Vec) -> float:
    """Standard deviation: an offset is the disturbance's."""
    return float(np.std(x))


@pytest.mark.parametrize("lag", [0, 3, 6])
def test_the_change_of_drive_is_the_model_behind_that_drive(lag: int) -> None:
    commands = motion(20.0)
    foretold = with_change(likely_changes(MODEL, SCALE)[1], lag, commands)
    assert spread(foretold - along(MODEL, commands, float(LAGS_S[lag]))) < 0.01 * SCALE


def test_the_change_of_friction_is_a_wider_dead_band() -> None:
    commands = motion(20.0)
    model, wider = along(MODEL, commands), along(WIDER, commands)
    added = with_change(likely_changes(MODEL, SCALE)[0], 0, commands) - model
    assert spread(added - (wider - model)) < 0.5 * spread(wider - model)


@pytest.mark.parametrize("fault", [raising, not_a_number])
def test_a_model_that_fails_has_no_likely_change(fault: Callable[[Vec], Vec]) -> None:
    np.testing.assert_array_equal(likely_changes(Faulty(MODEL, fault), SCALE), np.zeros((2, SIZE)))


def missed_after(seconds: float, truth: Callable[[Vec], Vec], lag: int, likely: Vec | None) -> float:
    """Error of what is foretold of a fresh motion after frames with .5 deg of noise in every fifth sample [deg]."""
    commands, random = motion(seconds, 1), np.random.default_rng(2)
    seen, alone = truth(commands), along(MODEL, commands)
    bank = FilterBank(DT, MODEL.command_range, SCALE, 0.5, 0, AdaptationSettings(), likely)
    state = bank.init(REST_DEG, 0.0, REST_DEG)
    for k, u in enumerate(commands.tolist()):
        state = bank.advance(state, u)
        if k % 5 == 0:
            state = bank.correct(state, seen[k] + 0.5 * float(random.standard_normal()), float(alone[k]), 0.0)
    ahead = motion(20.0, 7)
    return spread(with_change(state.z[0, :, lag], lag, ahead) - truth(ahead))


@pytest.mark.parametrize(
    ("truth", "lag", "seconds"),
    [(lambda u: along(MODEL, u, float(LAGS_S[6])), 6, 4.0), (lambda u: along(WIDER, u), 0, 8.0)],
    ids=["another drive", "another friction"],
)
def test_few_frames_tell_a_likely_change(truth: Callable[[Vec], Vec], lag: int, seconds: float) -> None:
    """After a few seconds of frames: a smaller error than with free weights alone."""
    free, whole = (missed_after(seconds, truth, lag, likely) for likely in (None, likely_changes(MODEL, SCALE)))
    assert whole < 0.8 * free


def test_an_error_of_the_start_does_not_hide_who_foretells_better() -> None:
    """Before anything is learned all forecasts are the model's: what they miss then is not counted."""
    bank = FilterBank(DT, MODEL.command_range, SCALE, 0.1, 0, AdaptationSettings())
    commands = motion(1.2, 3)
    state = bank.init(REST_DEG, 0.0, REST_DEG + 40.0)
    for u, y in zip(commands.tolist(), along(MODEL, commands).tolist(), strict=True):
        state = bank.correct(bank.advance(state, u), y, y, 0.0)
    assert 1 <= state.blocks <= 4
    assert max(state.scores) < 10.0


@pytest.mark.parametrize("seed", range(12))
def test_one_block_lets_nothing_act_where_noise_is_all_that_is_missed(seed: int) -> None:
    bank = FilterBank(DT, MODEL.command_range, SCALE, 0.3, 0, AdaptationSettings(), likely_changes(MODEL, SCALE))
    commands, random = motion(20.0, seed), np.random.default_rng(seed)
    state = bank.init(REST_DEG, 0.0, REST_DEG)
    for u, angle in zip(commands.tolist(), along(MODEL, commands).tolist(), strict=True):
        off = 0.3 * float(random.standard_normal())
        state = bank.correct(bank.advance(state, u), angle + off, angle, off)
        if state.blocks == 1:
            assert state.share == 0.0
