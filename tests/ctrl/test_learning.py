"""Laws of learning on top of a model: nothing at first, exact derivatives, finds a changed device, fades when right."""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hystmpc.core.library import engine
from hystmpc.core.structs import layout
from hystmpc.ctrl.build import build_controller, learning_pair
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.estimation.observer import EstimatorSettings
from hystmpc.ctrl.learning.bank import (
    DELAYS,
    DRIVES,
    FEATURES,
    FILTERS,
    LAGS_S,
    LEARNED_SIZE,
    OF_WEIGHTS,
    BankState,
    FilterBank,
)
from hystmpc.ctrl.learning.predictor import LearnedInverse, LearnedPredictor
from hystmpc.ctrl.mpc_settings import AdaptationSettings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .observing import Seen, Watcher
from .plays import DT, SOUND, Backlash, with_entries

LIMITS = CommandLimits(0.0, 6.0, 10.0)
OPTIONS = EstimatorSettings()
SPAN = 6.0


def learned() -> LearnedPredictor:
    return LearnedPredictor(Backlash(), AdaptationSettings())


def full(covariance: Vec) -> Vec:
    """Covariance matrix (K, K) of each drive, from the lower triangles that the bank holds."""
    size = FEATURES + 2
    both = np.zeros((DRIVES, size, size))
    rows, columns = np.tril_indices(size)
    both[:, rows, columns] = both[:, columns, rows] = np.moveaxis(covariance, 1, 2).reshape(DRIVES, -1)
    return both


def moved(predictor: LearnedPredictor, weights: Vec, lag: int, delay: int, seed: int = 0) -> Vec:
    """A state with a past, under some weights and a drive."""
    bank = predictor.filters(0)
    state, model = bank.init(30.0, 1.0, 30.0), Backlash().initial(30.0, 1.0)
    for u in 1.0 + np.cumsum(np.random.default_rng(seed).normal(0.0, 0.15, 40)):
        _, model = Backlash().advance(model, float(np.clip(u, 0.0, 6.0)))
        state = bank.advance(state, float(np.clip(u, 0.0, 6.0)))
    z = state.z.copy()
    z[delay, 1:, lag] = weights
    state = with_entries(state, z=z, best=lag * DELAYS + delay, share=1.0)
    return np.concatenate([model, bank.acting(state, (0.0,))[1]])


def plans(count: int, horizon: int, seed: int = 3) -> Vec:
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.2, (count, horizon)), axis=1)
    return np.clip(1.0 + walk, 0.0, 6.0)


def some_weights(seed: int) -> Vec:
    random = np.random.default_rng(seed)
    return np.concatenate([random.normal(0.0, 0.3, 1), random.normal(0.0, 10.0, FEATURES)])


drives = st.tuples(st.integers(0, LAGS_S.size - 1), st.integers(0, DELAYS - 1))


@given(drives, st.integers(0, 100))
def test_without_weights_it_is_the_model(drive: tuple[int, int], seed: int) -> None:
    predictor, trial = learned(), plans(4, 12, seed)
    state = moved(predictor, np.zeros(1 + FEATURES), *drive, seed)
    below = predictor.below(state)
    np.testing.assert_array_equal(predictor.rollout(state, trial), Backlash().rollout(below, trial))
    np.testing.assert_allclose(predictor.linearise(state, trial[0])[1], Backlash().linearise(below, trial[0])[1])


def test_python_and_c_lay_out_the_same_numbers() -> None:
    sizes = np.zeros(4, np.intc)
    engine().learning_bytes(sizes)
    read = [ctypes.sizeof(layout(f"hystmpc_{name}")) for name in ("basis", "learner", "filters", "learned")]
    assert sizes.tolist() == read
    assert read[2:] == [FILTERS.itemsize, 8 * LEARNED_SIZE]


@given(st.floats(0.0, 6.0), st.integers(0, 100))
def test_at_rest_at_the_start_all_features_are_zero(u: float, seed: int) -> None:
    """Also where the device has come from above, at more than half of the range."""
    predictor = learned()
    rest = predictor.initial(30.0, u)
    rest[rest.size - LEARNED_SIZE :][OF_WEIGHTS] = [0.0, *some_weights(seed)[1:]]
    np.testing.assert_allclose(predictor.learned(rest, np.full((1, 8), u)), 0.0, atol=1e-11)


@given(drives, st.integers(0, 100))
def test_a_roll_out_is_its_single_steps(drive: tuple[int, int], seed: int) -> None:
    predictor = learned()
    start, plan = moved(predictor, some_weights(seed), *drive, seed), plans(1, 15, seed)
    state, single = start, []
    for u in plan[0]:
        angle, state = predictor.advance(state, float(u))
        single.append(angle)
    np.testing.assert_allclose(predictor.rollout(start, plan)[0], single, atol=1e-9)
    np.testing.assert_allclose(predictor.linearise(start, plan[0])[0], single, atol=1e-9)


@given(drives, st.integers(0, 40))
@settings(max_examples=40, deadline=None)
def test_the_jacobian_is_the_difference_quotient(drive: tuple[int, int], seed: int) -> None:
    predictor, step = learned(), 1e-7
    state, plan = moved(predictor, some_weights(seed), *drive, seed), plans(1, 12, seed)[0]
    _, jacobian = predictor.linearise(state, plan)
    both = predictor.rollout(state, np.concatenate([plan + step * np.eye(12), plan - step * np.eye(12)]))
    quotient = ((both[:12] - both[12:]) / (2 * step)).T
    smooth = np.isclose(
        (predictor.rollout(state, plan + step * np.eye(12)) - predictor.rollout(state, plan[None])).T / step,
        quotient,
        atol=1e-3,
    )  # at a kink the two one-sided quotients differ
    np.testing.assert_allclose(jacobian[smooth], quotient[smooth], atol=1e-3)
    assert smooth.mean() > 0.7


class Device:
    """y = gain (play of r on a first-order lag of the command d samples ago) + noise, what no model here is."""

    def __init__(self, gain: float, play: float, lag_s: float, delay: int, seed: int = 0) -> None:
        self.gain, self.play, self.share = gain, play, 1.0 if lag_s == 0 else -math.expm1(-DT / lag_s)
        self.queue, self.v, self.p = [0.0] * (delay + 1), 0.0, -play
        self.random = np.random.default_rng(seed)

    @property
    def true_deg(self) -> float:
        return 25.0 + self.gain * (self.p + self.play)

    def apply(self, u: float) -> float:
        self.queue = [*self.queue[1:], u]
        self.v += self.share * (self.queue[0] - self.v)
        self.p = min(max(self.p, self.v - self.play), self.v + self.play)
        return self.true_deg + 0.05 * float(self.random.standard_normal())


CHANGED = {
    "half the gain": (5.2, 0.4, 0.0, 0),
    "twice the gain": (20.0, 0.4, 0.0, 0),
    "three times the play": (10.3, 1.2, 0.0, 0),
    "lag of 0.2 s": (10.3, 0.4, 0.2, 0),
    "delay of 5 samples": (10.3, 0.4, 0.0, 5),
    "all of it": (17.0, 0.8, 0.12, 3),
}


def recorded(device: Device, seconds: float = 14.0) -> tuple[Vec, Vec]:
    """Two flexures and a sine: commands, and the angle measured when each was sent."""
    up = np.linspace(0.0, 5.8, 90)
    quick = np.linspace(0.0, 5.8, 30)
    sine = 2.5 - 2.5 * np.cos(np.linspace(0.0, 10.0, round((seconds - 9.6) / DT)))
    commands = np.concatenate([up, up[::-1], quick, quick[::-1], sine])
    angles, y = [], device.apply(0.0)
    for u in commands.tolist():
        angles.append(y)
        y = device.apply(u)
    return commands, np.array(angles)


def after(estimator: Watcher, commands: Vec, angles: Vec) -> Seen:
    estimate = estimator.init(float(angles[0]), float(commands[0]))
    for u, y in zip(commands.tolist(), angles.tolist(), strict=True):
        estimate = estimator.advance(estimator.correct(estimate, y), u)
    return estimate


@pytest.mark.parametrize("name", CHANGED)
def test_a_changed_device_is_foretold_after_two_flexures(name: str) -> None:
    """A second of motion that was never seen: an error below half of the model's."""
    device = Device(*CHANGED[name])
    predictor = learned()
    estimate = after(Watcher(predictor, OPTIONS), *recorded(device))
    plan = float(estimate.command) + np.cumsum(np.concatenate([np.full(12, 0.12), np.full(13, -0.1)]))
    foretold = predictor.rollout(estimate.state, plan[None])[0] + estimate.disturbance
    model = estimate.model
    alone = Backlash().rollout(predictor.below(estimate.state), plan[None])[0] + model.disturbance
    device.random = np.random.default_rng(9)
    truth = []
    for u in plan.tolist():
        device.apply(u)
        truth.append(device.true_deg)
    learned_error, own_error = (float(np.sqrt(np.mean((found - truth) ** 2))) for found in (foretold, alone))
    assert learned_error < 0.5 * own_error
    assert estimate.learned.share == 1.0
    assert estimate.forecast_error < 0.4


def test_a_delay_that_is_told_is_not_learned_again() -> None:
    """The angles on their way have the learned part, and are nearer to what is measured then than the model's."""
    delay, device = 3, Device(10.3, 1.2, 0.0, 3)
    estimator = Watcher(learned(), OPTIONS.model_copy(update={"delay_samples": delay}))
    commands, angles = recorded(device)
    estimate, foretold, alone = estimator.init(float(angles[0]), 0.0), [], []
    for u, y in zip(commands.tolist(), angles.tolist(), strict=True):
        estimate = estimator.advance(estimator.correct(estimate, y), u)
        model = estimate.model
        foretold.append(estimate.angles[-1] + estimate.disturbance)
        alone.append(model.angles[-1] + model.disturbance)
    assert estimate.learned.share == 1.0
    assert estimate.learned.delay == 0
    ahead, sine = delay + 1, slice(240, -delay - 1)
    errors = [np.array(found)[sine] - angles[240 + ahead :] for found in (foretold, alone)]
    assert np.mean(errors[0] ** 2) < 0.25 * np.mean(errors[1] ** 2)


def test_a_measurement_never_moves_the_angle_of_now_away_from_itself() -> None:
    """Also not where weights and share change: the disturbance takes up the difference."""
    estimator, shares = Watcher(learned(), OPTIONS), set()
    commands, angles = recorded(Device(*CHANGED["all of it"]))
    estimate = estimator.init(float(angles[0]), float(commands[0]))
    for u, y in zip(commands.tolist(), angles.tolist(), strict=True):
        before = estimate.angles[0] + estimate.disturbance
        estimate = estimator.correct(estimate, y)
        now = estimate.angles[0] + estimate.disturbance
        assert min(before, y) - 1e-9 <= now <= max(before, y) + 1e-9
        shares.add(estimate.learned.share)
        estimate = estimator.advance(estimate, u)
    assert {0.0, 1.0} <= shares


def test_where_the_model_is_right_nothing_acts() -> None:
    """The device is the model, with noise: the learned part keeps silent, and the estimate is the model's own."""
    model, random = Backlash(), np.random.default_rng(4)
    state, estimator = model.initial(28.98, 0.0), Watcher(learned(), OPTIONS)
    commands, _ = recorded(Device(10.0, 0.4, 0.0, 0))
    y, shares, estimate = 28.98, [], estimator.init(28.98, 0.0)
    for u in commands.tolist():
        estimate = estimator.advance(estimator.correct(estimate, y + 0.1 * random.standard_normal()), u)
        y, state = model.advance(state, u)
        shares.append(estimate.learned.share)
    assert np.mean(shares) < 0.05
    assert estimate.forecast_error < 0.3


def test_in_a_hold_no_weight_is_forgotten() -> None:
    bank = FilterBank(DT, (0.0, 6.0), 62.0, 0.1, 0, AdaptationSettings())
    state = bank.init(30.0, 1.0, 30.0)
    before = full(state.covariance)[:, 1:, 1:]
    for _ in range(200):
        state = bank.correct(bank.advance(state, 1.0), 30.0, 30.0, 0.0)
    assert np.all(full(state.covariance)[:, 1:, 1:] <= before + 1e-9)
    assert np.max(np.abs(state.z[:, 1:])) < 1e-9


def test_within_a_block_forecasts_see_no_measurement() -> None:
    """An angle that is 1 deg off a model at rest is 1 deg off every forecast of the block."""
    bank = FilterBank(DT, (0.0, 6.0), 62.0, 0.1, 0, AdaptationSettings())
    state = bank.init(30.0, 1.0, 30.0)
    for k in range(1, round(0.24 / DT)):
        state = bank.correct(bank.advance(state, 1.0), 31.0, 30.0, 0.0)
        np.testing.assert_allclose(state.sums, k)


def flexed(bank: FilterBank) -> BankState:
    """A bank that has seen a device of half the model's gain once up and down."""
    state, model = bank.init(29.0, 0.0, 29.0), Backlash()
    below = model.initial(29.0, 0.0)
    for u in [*np.linspace(0.0, 5.8, 60), *np.linspace(5.8, 2.0, 40)]:
        angle, below = model.advance(below, float(u))
        state = bank.correct(bank.advance(state, float(u)), 29.0 + 0.5 * (angle - 29.0), angle, 0.0)
    return state


def test_a_jump_in_a_hold_is_an_offset_and_no_weight() -> None:
    bank = FilterBank(DT, (0.0, 6.0), 62.0, 0.1, 0, AdaptationSettings())
    state = flexed(bank)
    below, model = Backlash().initial(29.0, 0.0), Backlash()
    angle, _ = model.advance(below, 2.0)
    for _ in range(20):
        state = bank.correct(bank.advance(state, 2.0), 40.0, angle, 0.0)
    before = state
    for _ in range(20):
        state = bank.correct(bank.advance(state, 2.0), 48.0, angle, 0.0)
    moved = float((state.z - before.z)[state.delay, 0, state.best // DELAYS])
    assert moved == pytest.approx(8.0, abs=0.5)
    assert np.max(np.abs(state.weights - before.weights)) < 0.5


def test_a_hold_is_not_judged() -> None:
    """Where nothing moves every forecast is good: share, drive, scores and forecast_error stay as they are."""
    bank = FilterBank(DT, (0.0, 6.0), 62.0, 0.1, 0, AdaptationSettings())
    state = flexed(bank)
    before = state = with_entries(state, sums=0.0, count=0, references=(0.0, 40.0))
    for _ in range(100):
        state = bank.correct(bank.advance(state, 2.0), 40.0, 45.0, 0.0)
    assert (state.share, state.best, state.forecast_error, state.blocks) == (
        before.share,
        before.best,
        before.forecast_error,
        before.blocks,
    )
    np.testing.assert_array_equal(state.scores, before.scores)


@given(
    st.lists(
        st.tuples(
            st.one_of(st.floats(-40.0, 120.0), st.sampled_from([math.nan, math.inf, 1e300, -1e4])), st.floats(0.0, 6.0)
        ),
        min_size=1,
        max_size=80,
    ),
    st.integers(0, 2),
)
@settings(max_examples=30, deadline=None)
def test_any_measurements_leave_everything_finite(seen: list[tuple[float, float]], delay: int) -> None:
    estimator = Watcher(learned(), OPTIONS.model_copy(update={"delay_samples": delay}))
    estimate = estimator.init(30.0, 1.0)
    for y, u in seen:
        estimate = estimator.advance(estimator.correct(estimate, y), u)
        assert np.isfinite(estimate.learned.z).all()
        assert np.all(np.diagonal(full(estimate.learned.covariance), axis1=1, axis2=2) > 0)
        assert 0.0 <= estimate.learned.share <= 1.0
        assert 0.0 <= estimate.forecast_error <= 1.2
        assert math.isfinite(estimate.departure)
        assert np.isfinite(estimate.state).all()


ANGLES = st.one_of(st.floats(-40.0, 120.0), st.sampled_from([-1e4, 1e4]))  # beyond, an angle or a model is refused


@example([(30.0 + k, 1e4, 1.0) for k in range(12)])  # a block of forecasts that are off by far more than the motion
@given(st.lists(st.tuples(ANGLES, ANGLES, st.floats(0.0, 6.0)), min_size=1, max_size=60))
@settings(max_examples=30, deadline=None)
def test_any_model_leaves_everything_finite(seen: list[tuple[float, float, float]]) -> None:
    bank = FilterBank(DT, (0.0, 6.0), 62.0, 0.1, 0, AdaptationSettings())
    state = bank.init(30.0, 1.0, 30.0)
    for y, angle, u in seen:
        state = bank.correct(bank.advance(state, u), y, angle, 0.0)
        assert np.isfinite(state.z).all()
        assert np.all(np.diagonal(full(state.covariance), axis1=1, axis2=2) > 0)
        assert np.isfinite(state.scores).all()
        assert 0.0 <= state.share <= 1.0
        assert 0.0 <= state.forecast_error <= 1.2


@pytest.mark.slow
def test_covariances_stay_sound_over_a_long_run() -> None:
    """20,000 samples of all kinds of motion: no covariance loses its sign by rounding."""
    bank, random = FilterBank(DT, (0.0, 6.0), 62.0, 0.02, 0, AdaptationSettings()), np.random.default_rng(5)
    state, model = bank.init(29.0, 0.0, 29.0), Backlash()
    below = model.initial(29.0, 0.0)
    for k in range(20_000):
        u = 3.0 + 2.9 * math.sin(0.02 * k * (1.0 + 0.3 * math.sin(1e-3 * k)))
        angle, below = model.advance(below, u)
        state = bank.correct(bank.advance(state, u), 1.1 * angle + 0.02 * random.standard_normal(), angle, 0.0)
    least = min(float(np.linalg.eigvalsh(p)[0]) for p in full(state.covariance))
    most = max(float(np.linalg.eigvalsh(p)[-1]) for p in full(state.covariance))
    assert least > -1e-9 * most


@pytest.mark.parametrize("y", [math.nan, math.inf, 1e9])
def test_nonsense_is_missing(y: float) -> None:
    estimator = Watcher(learned(), OPTIONS.model_copy(update={"delay_samples": 2}))
    estimate = estimator.advance(estimator.init(30.0, 1.0), 1.2)
    after = estimator.correct(estimate, y)
    assert after.missing == 1
    assert after.disturbance == estimate.disturbance


def test_a_jump_is_an_outlier_at_rest_and_none_behind_a_fast_command() -> None:
    estimator = Watcher(learned(), OPTIONS)
    rest = estimator.init(30.0, 1.0)
    for _ in range(10):
        rest = estimator.advance(estimator.correct(rest, 30.0), 1.0)
    assert estimator.correct(rest, 60.0).missing == 1
    fast = rest
    for u in (1.4, 1.8, 2.2):
        fast = estimator.advance(estimator.correct(fast, 30.0), u)
    assert estimator.correct(fast, 60.0).missing == 0


@pytest.mark.parametrize("kind", ["linearised_mpc", "sampling_mpc"])
def test_the_loop_goes_on_alike_from_a_snapshot_and_keeps_limits(kind: str) -> None:
    case = SOUND[0]
    settings = CONTROLLERS[kind].parse({"kind": kind, "horizon": 10})
    controller = build_controller(settings, case.predictor, case.inverse, LIMITS)
    random, y = np.random.default_rng(0), case.y_rest
    state, answers = controller.init(case.y_rest, case.u_rest), []
    held = {}
    for k in range(60):
        held[k] = state, y
        wanted = case.y_rest + 8.0 * np.sin(0.1 * (k + np.arange(controller.horizon)))
        before = state.estimate.command
        command, state = controller.step(state, y, wanted)
        y = case.y_rest + 9.0 * (command.u - case.u_rest) + 0.1 * random.standard_normal()
        assert abs(command.u - before) <= LIMITS.rate * DT + 1e-12
        assert LIMITS.lower <= command.u <= LIMITS.upper
        answers.append(command.u)
    state, y = held[30]
    wanted = case.y_rest + 8.0 * np.sin(0.1 * (30 + np.arange(controller.horizon)))
    assert controller.step(state, y, wanted)[0].u == answers[30]


def followed(device: Device, settings: dict[str, object], prepare: bool) -> float:
    """Root mean square of the true error on a motion with holds, the device taken up behind two flexures or at rest."""
    parsed = CONTROLLERS["linearised_mpc"].parse({"kind": "linearised_mpc", **settings})
    case = SOUND[0]
    controller = build_controller(parsed, case.predictor, case.inverse, LIMITS)
    if prepare:
        commands, angles = recorded(device)
        state = controller.replay(commands, angles)
        y = device.true_deg
    else:
        y = device.apply(0.0)
        state = controller.init(y, 0.0)
    errors, ahead = [], np.arange(1, controller.horizon + 1)
    middle = 25.0 + 2.0 * device.gain * device.play + 14.0  # within reach from above and from below
    for k in range(500):
        t = DT * (k + ahead)
        wanted = middle + 6.0 * np.clip(np.sin(0.8 * t) * 2.0, -1.0, 1.0)
        command, state = controller.step(state, y, wanted)
        y = device.apply(command.u)
        if k >= 75:
            errors.append(device.true_deg - wanted[0])
    return float(np.sqrt(np.mean(np.square(errors))))


HALVED = ("half the gain", "three times the play", "delay of 5 samples", "all of it")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "prepare"), [*((name, True) for name in CHANGED), ("lag of 0.2 s", False), ("all of it", False)]
)
def test_learning_never_destabilises_a_changed_device_and_mends_it_behind_two_flexures(
    name: str, prepare: bool
) -> None:
    off = followed(Device(*CHANGED[name]), {"adaptation": None}, prepare)
    on = followed(Device(*CHANGED[name]), {}, prepare)
    assert on < (1.1 if not prepare else 0.5 if name in HALVED else 0.9) * off


def test_a_pair_is_wrapped_once_and_only_where_it_learns() -> None:
    case = SOUND[0]
    asked = CONTROLLERS["linearised_mpc"].parse({"kind": "linearised_mpc"})
    pair = learning_pair(asked, case.predictor, case.inverse)
    assert isinstance(pair[1], LearnedInverse)
    assert learning_pair(asked, *pair) == pair
    for block in ({"adaptation": None}, {"estimator": {"sensor": "none"}}):
        plain = CONTROLLERS["linearised_mpc"].parse({"kind": "linearised_mpc", **block})
        assert learning_pair(plain, case.predictor, case.inverse) == (case.predictor, case.inverse)
        assert CONTROLLERS["linearised_mpc"].parse(plain.model_dump(mode="json")) == plain


def test_the_grid_has_a_drive_for_every_lag_and_delay() -> None:
    assert LAGS_S.size * DELAYS == DRIVES
    assert LAGS_S[-1] >= 0.2
    assert DELAYS - 1 >= 5


def test_settings_refuse_nonsense() -> None:
    with pytest.raises(ConfigError, match="sigma_share"):
        AdaptationSettings.parse({"sigma_share": 0.0})
    with pytest.raises(ConfigError, match="walk_share"):
        AdaptationSettings.parse({"walk_share": -1.0})
