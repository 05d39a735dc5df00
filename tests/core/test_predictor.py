"""Laws of predictors, inverses and learned models in the engine, over one list of all kinds, Python's included."""

from __future__ import annotations

import copy
import gc
import pickle
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from hystmpc.core.library import engine
from hystmpc.core.outside import faults, forget_faults
from hystmpc.core.rooms import in_room
from hystmpc.core.structs import Struct, struct
from hystmpc.ctrl.learning.bank import LEARNED_SIZE, OF_WEIGHTS
from hystmpc.ctrl.learning.predictor import LearnedFollower, LearnedInverse, LearnedPredictor
from hystmpc.ctrl.mpc_settings import AdaptationSettings
from hystmpc.models.fronts import EnginePredictor
from hystmpc.models.inverse.drive import Drive
from hystmpc.models.inverse.inverses import (
    AccompaniedPredictor,
    Bounds,
    CompanionInverse,
    CompiledInverse,
    Follower,
    follower_for,
)
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.networks.lstm import LstmLayer
from hystmpc.models.networks.nodes import Scaling
from hystmpc.models.networks.packed import NetworkWeights
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.prediction.build import ControllerModel, ParallelPredictor, SeriesPredictor
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.prediction.exported import RoutedPredictor
from hystmpc.trials.types import Vec

from ..ctrl.plays import Backlash, BacklashInverse, Faulty, raising
from ..models.lstm_examples import facts, make_route, random_weights
from ..models.zoo import CHAINS, DT, simulator

H = 12
BOUNDS = Bounds(0.0, 6.0, 0.3)
WEIGHTS = random_weights(7, 2)
FACTS = facts(WEIGHTS)


def chain(name: str = "backlash") -> CompiledPredictor:
    return CompiledPredictor.of_simulator(simulator(CHAINS[name]))


def exact() -> CompiledInverse:
    return CompiledInverse(chain(), BOUNDS.low, BOUNDS.high)


def lstm(level: str | None = None) -> RoutedPredictor:
    return RoutedPredictor(FACTS, "conditioned", make_route(WEIGHTS, level or "plain"))


def gru() -> RoutedPredictor:
    random = np.random.default_rng(1)
    layers = [LstmLayer(random.normal(size=(28, n)), random.normal(size=(28, 7)) / 3, np.zeros(28)) for n in (1, 7)]
    weights = NetworkWeights("gru", tuple(layers), random.normal(size=7), 0.2, Scaling(3.0, 3.0, 60.0, 32.0))
    rest = FACTS.initial.model_copy(update={"offset": (0.0,) * 14, "slope": (0.0,) * 14})
    known = FACTS.model_copy(update={"initial": rest, "conditioned": rest, "warmup_samples": 0, "state_size": 14})
    return RoutedPredictor(known, "conditioned", NetworkRoute(weights))


def drive(*operators: Lag | Delay) -> Drive:
    return Drive(operators, simulator(CHAINS["backlash"]).metadata())


def accompanied() -> tuple[Predictor, Inverse]:
    both = AccompaniedPredictor(lstm(), chain())
    return both, CompanionInverse(both, exact())


def driven(predictor: Predictor, inverse: Inverse) -> tuple[Predictor, Inverse]:
    known, pair = simulator(CHAINS["backlash"]).metadata(), (predictor, inverse)
    return ControllerModel(known, pair, pair).behind((Delay(2 * DT, 2), Lag(0.08)), known).predictive


def beside(predictor: Predictor) -> tuple[Predictor, Inverse]:
    both = AccompaniedPredictor(predictor, chain())
    return both, CompanionInverse(both, exact())


def learned(predictor: Predictor, inverse: Inverse) -> tuple[Predictor, Inverse]:
    model = LearnedPredictor(predictor, AdaptationSettings())
    return model, LearnedInverse(model, inverse)


def written() -> tuple[Predictor, Inverse]:
    return Backlash(), BacklashInverse(Backlash())


# With an inverse: followed sample by sample or at once, behind drives, from Python.
PAIRS: dict[str, Callable[[], tuple[Predictor, Inverse]]] = {
    "chain": lambda: (chain(), exact()),
    "accompanied": accompanied,
    "parallel": lambda: beside(ParallelPredictor(chain(), lstm())),
    "driven": lambda: driven(chain(), exact()),
    "driven network": lambda: driven(*accompanied()),
    "written": written,
    "driven written": lambda: driven(*written()),
    "learned": lambda: learned(*accompanied()),
    "learned written": lambda: learned(*driven(*written())),
}
ALL: dict[str, Callable[[], Predictor]] = {
    **{name: lambda name=name: PAIRS[name]()[0] for name in PAIRS},  # type: ignore[misc]
    "plays": lambda: chain("pi"),
    "lstm": lstm,
    "gru": gru,
    "series": lambda: SeriesPredictor(drive(Lag(0.1)), lstm()),
    "series of a sum": lambda: SeriesPredictor(drive(Lag(0.1)), ParallelPredictor(chain(), lstm())),
    "engine in Python in the engine": lambda: SeriesPredictor(
        drive(Lag(0.1)), Faulty(driven(*accompanied())[0], np.copy)
    ),
    "sum with Python": lambda: ParallelPredictor(Backlash(), chain()),
}
made = cache(lambda name: ALL[name]())
paired = cache(lambda name: PAIRS[name]())
everything = pytest.mark.parametrize("name", ALL)
pairs = pytest.mark.parametrize("name", PAIRS)


def moved(predictor: Predictor, seed: int = 0) -> Vec:
    """A state with a past; something is learned where something can be."""
    random, u = np.random.default_rng(seed), 2.0
    state = predictor.initial(45.0, u)
    for _ in range(9):
        u = float(np.clip(u + random.normal(0.0, 0.4), 0.2, 5.8))
        _, state = predictor.advance(state, u)
    if isinstance(predictor, LearnedPredictor):
        part = state[state.size - LEARNED_SIZE :]
        part[OF_WEIGHTS] = random.normal(0.0, 0.2, part[OF_WEIGHTS].size)
        part[-2:] = 0.4, 2.0
    return state


def plans_of(count: int, seed: int = 1) -> Vec:
    steps = np.random.default_rng(seed).normal(0.0, 0.4, (count, H))
    return np.clip(np.cumsum(steps, axis=1) + 2.5, 0.1, 5.9)


def called(function: str, part: Struct, size: int, *given: object) -> int:
    return int(in_room(size, getattr(engine(), function), part.address, *given))


def advanced(part: Struct, state: Vec, plan: Vec) -> Vec:
    """Angles along a plan, sample by sample in the engine."""
    x, theta, angles = state.copy(), np.empty(1), np.empty(plan.size)
    size = engine().predictor_bytes(part.address, 1, 1)
    for k, u in enumerate(plan):
        assert called("predictor_advance", part, size, x, u, theta) == 0
        angles[k] = theta[0]
    return angles


def run(part: Struct, state: Vec, plans: Vec) -> Vec:
    angles = np.empty(plans.shape)
    size = engine().predictor_bytes(part.address, *plans.shape)
    assert called("predictor_run", part, size, state, *plans.shape, plans, angles) == 0
    return angles


@everything
def test_a_run_is_one_sample_after_the_other(name: str) -> None:
    predictor, plans = made(name), plans_of(5)
    state, part = moved(predictor), predictor.part
    kept = state.copy()
    angles = run(part, state, plans)
    for plan, row in zip(plans, angles, strict=True):
        np.testing.assert_allclose(advanced(part, state, plan), row, rtol=0, atol=1e-4 if "lstm" in name else 1e-5)
        np.testing.assert_array_equal(run(part, state, plan[None])[0], row)
    np.testing.assert_array_equal(state, kept)


@everything
def test_the_front_answers_as_the_part(name: str) -> None:
    predictor, plans = made(name), plans_of(3)
    state = moved(predictor)
    assert predictor.part.fields["states"] == state.size == predictor.state_size
    np.testing.assert_array_equal(predictor.rollout(state, plans), run(predictor.part, state, plans))
    theta, after = predictor.advance(state, 3.0)
    assert theta == advanced(predictor.part, state, np.array([3.0]))[0]
    assert after.shape == state.shape
    angles, slopes = np.empty(H), np.empty((H, H))
    size = engine().predictor_bytes(predictor.part.address, 1, H)
    assert called("predictor_linearise", predictor.part, size, state, H, plans[0], angles, slopes) == 0
    along, by = predictor.linearise(state, plans[0])
    np.testing.assert_array_equal(along, angles)
    np.testing.assert_array_equal(np.tril(by), np.tril(slopes))
    np.testing.assert_array_equal(np.triu(slopes, 1), 0.0)


@everything
def test_slopes_are_differences_of_angles(name: str) -> None:
    predictor, plan, step = made(name), plans_of(1, 3)[0], 1e-3
    state = moved(predictor)
    angles, slopes = predictor.linearise(state, plan)
    np.testing.assert_allclose(angles, predictor.rollout(state, plan[None])[0], atol=1e-4)
    both = [predictor.rollout(state, plan + sign * step * np.eye(H)) for sign in (1.0, -1.0)]
    ahead, behind = ((side - angles) / (sign * step) for side, sign in zip(both, (1.0, -1.0), strict=True))
    ends = np.sort([ahead.T, behind.T], axis=0)  # at the edge of a play they are two
    assert np.all((slopes > ends[0] - 0.05) & (slopes < ends[1] + 0.05))


@everything
def test_what_is_not_finite_goes_on(name: str) -> None:
    """Not-a-number in a state or a plan is one in the angles behind it, and other rows do not see it."""
    predictor, plans = made(name), plans_of(4)
    state = moved(predictor)
    bad = plans.copy()
    bad[1, 3], bad[2, 0] = np.nan, np.inf
    with np.errstate(all="ignore"):
        angles = run(predictor.part, state, bad)
        np.testing.assert_array_equal(angles[[0, 3]], run(predictor.part, state, plans)[[0, 3]])
        for hostile in (np.full(state.size, np.nan), np.full(state.size, 1e308), np.full(state.size, 5e-324)):
            run(predictor.part, hostile, plans)
            predictor.linearise(hostile, plans[0])
    if name in ("lstm", "gru", "series"):
        assert np.isnan(angles[1, -1])
        assert np.isnan(angles[2]).all()
        assert np.isnan(run(predictor.part, np.full(state.size, np.nan), plans)).all()


def step_by_step(predictor: Predictor, inverse: Inverse, state: Vec, wanted: Vec, u: float, reach: float) -> Vec:
    plan = np.empty(wanted.size)
    for k, theta in enumerate(wanted):
        goal = min(max(inverse.command(state, theta, u), BOUNDS.low), BOUNDS.high)
        u = min(max(goal, u - reach), u + reach)
        _, state = predictor.advance(state, u)
        plan[k] = u
    return plan


def follower_of(predictor: Predictor, inverse: Inverse) -> Follower:
    return LearnedFollower(inverse) if isinstance(inverse, LearnedInverse) else follower_for(predictor, inverse)


@pytest.mark.parametrize("name", [name for name in PAIRS if "driven" not in name and "learned" not in name])
def test_a_preview_is_followed_as_one_sample_after_the_other(name: str) -> None:
    predictor, inverse = paired(name)
    follower = follower_of(predictor, inverse)
    for seed in range(4):
        state, wanted = moved(predictor, seed), 50.0 + 20.0 * np.sin(0.4 * np.arange(H) + seed)
        free, limited = follower.follow(state, wanted, 2.0, BOUNDS)
        given = predictor, inverse, state, wanted, 2.0
        np.testing.assert_allclose(free, step_by_step(*given, np.inf), atol=1e-8)
        np.testing.assert_allclose(limited, step_by_step(*given, BOUNDS.reach), atol=1e-8)


@pairs
def test_limits_hold_whatever_is_wanted(name: str) -> None:
    predictor, inverse = paired(name)
    follower, state = follower_of(predictor, inverse), moved(predictor)
    hostile = np.array([50.0, np.nan, 1e308, -np.inf, np.inf, 60.0])
    with np.errstate(all="ignore"):
        for wanted in (hostile, np.random.default_rng(0).normal(50.0, 200.0, H)):
            for plan in follower.follow(state, wanted, 2.0, BOUNDS):
                known = plan[np.isfinite(plan)]
                assert np.all((known >= BOUNDS.low) & (known <= BOUNDS.high))
            limited = follower.follow(state, wanted, 2.0, BOUNDS)[1]
            assert not np.any(np.abs(np.diff(limited, prepend=2.0)) > BOUNDS.reach * (1 + 1e-12))
        np.testing.assert_array_equal(
            follower.follow(np.full(state.size, np.nan), np.full(5, 60.0), 1.25, BOUNDS), 1.25
        )


@pytest.mark.parametrize("name", ["accompanied", "written"])
def test_without_a_weight_nothing_is_learned(name: str) -> None:
    plain, inverted = paired(name)
    model, inverse = learned(plain, inverted)
    assert isinstance(inverse, LearnedInverse)
    state = moved(model)
    state[state.size - LEARNED_SIZE :][OF_WEIGHTS] = 0.0
    below, plans, wanted = state[: state.size - LEARNED_SIZE], plans_of(3), np.linspace(40.0, 60.0, H)
    np.testing.assert_array_equal(model.rollout(state, plans), plain.rollout(below, plans))
    np.testing.assert_array_equal(model.linearise(state, plans[0])[1], plain.linearise(below, plans[0])[1])
    assert inverse.command(state, 55.0, 2.0) == inverted.command(below, 55.0, 2.0)
    expected = follower_for(plain, inverted).follow(below, wanted, 2.0, BOUNDS)
    np.testing.assert_array_equal(LearnedFollower(inverse).follow(state, wanted, 2.0, BOUNDS), expected)


@pytest.mark.parametrize("name", ["accompanied", "written"])
def test_an_inverse_asks_its_model_for_what_is_not_learned(name: str) -> None:
    plain, inverted = paired(name)
    model, inverse = learned(plain, inverted)
    state = moved(model)
    part = float(model.learned(state, np.full((1, 1), 2.0))[0, 0])
    assert abs(part) > 1e-3
    expected = inverted.command(state[: state.size - LEARNED_SIZE], 55.0 - part, 2.0)
    assert inverse.command(state, 55.0, 2.0) == pytest.approx(expected, abs=1e-9)


def test_a_network_of_any_level_has_a_part() -> None:
    predictor = lstm("plain")
    state, plans = moved(predictor), plans_of(3)
    np.testing.assert_array_equal(run(predictor.part, state, plans), predictor.rollout(state, plans))


@pytest.mark.parametrize("second", [True, False])
@pytest.mark.parametrize("kind", ["alone", "parallel", "accompanied", "series"])
def test_a_model_that_raises_answers_so_and_its_state_stands_still(kind: str, second: bool) -> None:
    broken, sound = Faulty(Backlash(), raising, 1.0), chain()
    order = (sound, broken) if second else (broken, sound)
    kinds: dict[str, Callable[[], Predictor]] = {
        "alone": lambda: broken,
        "parallel": lambda: ParallelPredictor(*order),
        "accompanied": lambda: AccompaniedPredictor(*order),
        "series": lambda: SeriesPredictor(drive(Lag(0.1)), broken),
    }
    predictor = kinds[kind]()
    state, theta = predictor.initial(30.0, 0.5), np.empty(1)
    x, part, last_words = state.copy(), predictor.part, "ValueError: out of the trained range"
    size = engine().predictor_bytes(part.address, 2, H)
    forget_faults()
    for u, answer in ((0.6, 0), (6.0, 1)):
        commands = np.full(10, u)
        found = [called("predictor_advance", part, size, x, one, theta) for one in commands]
        assert any(found) == bool(answer)
    assert set(faults()) == {last_words}
    before = x.copy()
    assert called("predictor_advance", part, size, x, 6.0, theta)
    np.testing.assert_array_equal(x, before)
    angles = np.empty((2, H))
    heard = not (kind == "accompanied" and second)  # along a plan a companion is not asked
    assert bool(called("predictor_run", part, size, state, 2, H, np.full((2, H), 6.0), angles)) == heard
    forget_faults()
    if isinstance(predictor, EnginePredictor):
        with pytest.raises(ValueError, match="out of the trained range"):
            predictor.advance(before, 6.0)
        assert faults() == []


def test_what_is_no_answer_is_a_fault() -> None:
    for spoilt in (lambda value: value[:0], lambda value: np.append(value, 1.0)):
        part = Faulty(Backlash(), spoilt, 1.0).part
        size = engine().predictor_bytes(part.address, 1, 3)
        given = np.array([30.0]), 1, 3, np.full((1, 3), 2.0), np.empty((1, 3))
        assert called("predictor_run", part, size, *given)
        assert "expected" in faults()[0]


def test_an_inverse_that_raises_answers_so() -> None:
    class Lost(Inverse):
        def command(self, state: Vec, theta: float, u_last: float) -> float:
            raise ValueError(f"lost at {state.size}, {theta}, {u_last}")

    predictor = chain()
    follower, state = follower_for(predictor, Lost()), predictor.initial(40.0, 1.0)
    with pytest.raises(ValueError, match=f"lost at {state.size}, 50.0, 1.0"):
        follower.follow(state, np.full(3, 50.0), 1.0, BOUNDS)
    assert faults() == []
    without = struct("hystmpc_model", predictor=predictor.part)
    with pytest.raises(RuntimeError, match="without an exception"):
        Follower(without).follow(state, np.full(3, 50.0), 1.0, BOUNDS)


@pairs
def test_a_copy_outlives_its_original(name: str) -> None:
    predictor, inverse = PAIRS[name]()
    follower = follower_of(predictor, inverse)
    state, plans, wanted = moved(predictor), plans_of(3), np.linspace(40.0, 60.0, H)
    angles, u = predictor.rollout(state, plans), inverse.command(state, 55.0, 2.0)
    expected = follower.follow(state, wanted, 2.0, BOUNDS)
    both = copy.deepcopy((predictor, inverse, follower))
    packed = pickle.dumps(follower)
    del predictor, inverse, follower
    gc.collect()
    np.testing.assert_array_equal(both[0].rollout(state, plans), angles)
    assert both[1].command(state, 55.0, 2.0) == u
    for made_anew in (both[2], pickle.loads(packed)):
        np.testing.assert_array_equal(made_anew.follow(state, wanted, 2.0, BOUNDS), expected)
