"""Laws of the model of two axes: coordinates, shared friction, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.core.library import engine
from hystmpc.models.contract.metadata import Range
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.scheduled import Dependence, MeasuredInput, Scheduled
from hystmpc.models.simulator import ChainModel
from hystmpc.models.two_axes.cross import shared_friction
from hystmpc.models.two_axes.evaluate import evaluate_two_axes
from hystmpc.models.two_axes.identify import fit_two_axes
from hystmpc.models.two_axes.joints import choose_joint
from hystmpc.models.two_axes.model import CrossFriction, TwoAxisModel, has_two_axes, load_two_axes, run_axis
from hystmpc.trials.errors import FitError, LogError, ModelError
from hystmpc.trials.trial import Trial

from .two_axis_examples import COUPLED, IDENTITY, RATE, REACH, SHARED, Vec, recorded, two_axes, wandering

shares = st.floats(-0.5, 0.5)


@given(shares, shares, shares, shares, st.lists(st.floats(-3, 3), min_size=2, max_size=2))
def test_commands_and_travels_are_each_others_inverse(a: float, b: float, c: float, d: float, u: list[float]) -> None:
    model = two_axes(((1.0, a), (b, 1.0)), ((1.0, c), (d, 1.0)))
    np.testing.assert_allclose(model.commands(model.travels(u)), u, atol=1e-12)
    np.testing.assert_allclose(model.turn @ model.in_axes(u), u, atol=1e-12)


@given(st.integers(3, 6), st.floats(0, 60), st.lists(st.floats(-2, 2), min_size=2, max_size=2))
def test_tendons_pull_by_the_travels_with_the_least_distance_from_their_pretension(
    count: int, first: float, w: list[float]
) -> None:
    model = two_axes().with_tendons(
        [first + 360 * k / count for k in range(count)],
        pretension=0.5,
        limits=[(0.0, 4.0)] * count,
        rates_per_s=[5.0] * count,
    )
    u = model.commands(w)
    np.testing.assert_allclose(model.travels(u), w, atol=1e-12)
    np.testing.assert_allclose(model.travels(model.commands([0.0, 0.0])), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.mean(u), 0.5, atol=1e-12)  # a mean pull bends no axis


def test_two_axes_without_a_joint_are_two_devices_of_one_axis() -> None:
    model, u = two_axes(), wandering(3)
    angles = model.run(u, (0.0, 0.0))
    for i, one in enumerate(model.axes):
        np.testing.assert_array_equal(angles[:, i], ChainModel(one).run(np.ascontiguousarray(u[:, i]), 0.0))


@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1]))
def test_shared_friction_is_none_where_one_axis_moves_alone(seed: int, still: int) -> None:
    u = wandering(seed, 200)
    u[:, still] = 0.7
    np.testing.assert_allclose(SHARED.run(u, 0.04), 0.0, atol=1e-12)


def test_a_motion_of_one_axis_frees_the_other() -> None:
    """Behind a motion of x its play holds x back by its radius; a motion of y, ten radii long, gives that back."""
    friction = CrossFriction(lag_s=0.0, radii=(0.2,), weights=((1.0,), (1.0,)))
    x = np.concatenate([np.linspace(0, 1, 50), np.ones(200)])
    y = np.concatenate([np.zeros(50), np.linspace(0, 2, 200)])
    c = friction.run(np.stack([x, y], axis=1), 0.04)
    assert c[49] == pytest.approx([0.0, 0.0])
    assert c[-1, 0] == pytest.approx(0.2, abs=1e-3)


@given(st.integers(0, 2**32 - 1), st.integers(0, 6))
def test_derivatives_of_shared_friction_are_those_of_differences(seed: int, delay: int) -> None:
    random, core, samples, step = np.random.default_rng(seed), engine(), 12, 1e-7
    part = COUPLED.model_copy(update={"delay_s": 0.04 * delay}).struct(0.04)
    start = np.empty(int(core.cross_states(part.address)))
    core.cross_rest(part.address, np.zeros(2), start)
    core.cross_run(part.address, 30, np.cumsum(random.normal(0, 0.1, (2, 30)), axis=1), start, np.empty((2, 30)))
    w = np.cumsum(random.normal(0, 0.1, (2, samples)), axis=1)

    def answer(travels: Vec) -> Vec:
        c = np.empty((2, samples))
        core.cross_run(part.address, samples, np.ascontiguousarray(travels), start.copy(), c)
        return c

    slopes, c = np.zeros((2, 2, samples, samples)), np.empty((2, samples))
    room = np.empty(int(core.cross_room(part.address, samples)))
    core.cross_slopes(part.address, samples, w, start.copy(), c, slopes, room)
    np.testing.assert_array_equal(c, answer(w))
    for axis in range(2):
        for s in range(samples):
            bent = np.zeros_like(w)
            bent[axis, s] = step
            numeric = (answer(w + bent) - answer(w - bent)) / (2 * step)
            np.testing.assert_allclose(slopes[:, axis, :, s], numeric, atol=1e-4)


def test_static_coupling_is_a_polynomial_of_the_travels() -> None:
    coupling = ((0.1, 0.2, 0.3, 0.4, 0.5), (1.0, 0.0, 0.0, 0.0, -1.0))
    part = CrossFriction(lag_s=0.0, radii=(), weights=((), ()), coupling=coupling, delay_s=0.08)
    u = wandering(2, 100)
    x, y = np.vstack([u[:1], u[:1], u[:-2]]).T
    expected = [0.1 * x * y + 0.2 * y**2 + 0.3 * x * y**2 + 0.4 * x**2 * y + 0.5 * y**3, x * y - x**3]
    np.testing.assert_allclose(part.run(u, 0.04), np.stack(expected, axis=1), atol=1e-12)


@pytest.mark.parametrize("delay_s", [0.0, 0.08])
def test_friction_and_coupling_are_found_again(delay_s: float) -> None:
    """From what noise-free axes leave: parts of the trials that were not seen are answered."""
    true = COUPLED.model_copy(update={"delay_s": delay_s})
    travels = [wandering(seed) for seed in range(4)]
    found = shared_friction(travels[:3], [true.run(w, 0.04) for w in travels[:3]], 0.04)
    assert found is not None
    assert found.coupling is not None
    wanted, answer = true.run(travels[3], 0.04), found.run(travels[3], 0.04)
    left = wanted - answer
    assert np.std(left - left.mean(0)) < 0.2 * np.std(wanted - wanted.mean(0))


@given(st.integers(0, 2**32 - 1))
def test_shared_friction_is_bounded(seed: int) -> None:
    c = SHARED.run(wandering(seed, 300), 0.04)
    most = 2 * np.array(SHARED.weights) @ np.array(SHARED.radii)
    assert np.all(np.abs(c) <= most + 1e-9)


def test_a_file_gives_the_model_back(tmp_path: Path) -> None:
    model = two_axes(((1.0, 0.2), (-0.1, 1.0)), ((1.0, 0.0), (0.3, 1.0)), COUPLED)
    again = load_two_axes(model.save(tmp_path / "both.yaml"))
    assert has_two_axes(tmp_path / "both.yaml")
    u = wandering(5)
    np.testing.assert_array_equal(again.run(u, (0.0, 0.0)), model.run(u, (0.0, 0.0)))
    model.axes[0].save(tmp_path / "one.yaml")
    assert not has_two_axes(tmp_path / "one.yaml")
    with pytest.raises(ModelError, match="expected a model of two axes"):
        load_two_axes(tmp_path / "one.yaml")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mix": ((1.0, 1.0), (1.0, 1.01))}, "joins both axes into one"),
        ({"frame": ((1.0, 0.0), (0.0, float("nan")))}, "joins both axes into one"),
        ({"rest_commands": (0.0,)}, "got sizes"),
        ({"rest_commands": (9.0, 0.0)}, "rest_commands"),
        ({"frame": ((1.0,), (0.0,))}, "frame"),
    ],
)
def test_a_model_that_contradicts_itself_is_refused_in_a_line(changes: dict[str, object], words: str) -> None:
    with pytest.raises(ModelError, match=words) as refused:
        replace(two_axes(), **changes)  # type: ignore[arg-type]
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)


def test_limits_of_travels_hold_all_commands_within_theirs() -> None:
    model = two_axes(((1.0, 0.3), (-0.2, 1.0)))
    (low, high, rate), (low_y, high_y, _) = model.travel_limits()
    assert low == pytest.approx(-1.3 * REACH)
    assert high_y == pytest.approx(1.2 * REACH) == -low_y
    assert high == -low
    assert rate == pytest.approx(1.3 * RATE)


MIX, FRAME = ((1.0, 0.25), (-0.15, 1.0)), ((1.0, -0.2), (0.3, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mix", "frame"),
    [("none", IDENTITY, IDENTITY), ("tendons", MIX, IDENTITY), ("frame", IDENTITY, FRAME)],
)
def test_what_joins_the_axes_is_chosen_and_identified(name: str, mix: tuple[Vec, Vec], frame: tuple[Vec, Vec]) -> None:
    model = two_axes(mix, frame)  # type: ignore[arg-type]
    fit = fit_two_axes(kind_named("pi"), recorded(model, range(3)), FitRequest())
    assert fit.joint == name
    np.testing.assert_allclose(fit.model.mix, mix, atol=0.03)
    np.testing.assert_allclose(fit.model.frame, frame, atol=0.03)
    assert all(fit.rmse_deg < 1.0)


def test_exchanged_and_mirrored_commands_are_set_in_order() -> None:
    model = two_axes()
    trials = recorded(model, range(2))
    turned = [Trial(trial.t, -trial.commands[:, ::-1], trial.angles) for trial in trials]
    order = choose_joint(turned).joint.order
    np.testing.assert_array_equal(order, [[0, -1], [-1, 0]])


def test_trials_that_tell_nothing_of_a_second_axis_are_refused_in_a_line() -> None:
    u = wandering(1)
    still = u * [1.0, 0.0]
    t = 0.04 * np.arange(len(u))
    noise = np.random.default_rng(1).standard_normal(u.shape)
    for trial, words in (
        (Trial(t, still, u), "does not move"),
        (Trial(t, u, noise), "does not follow"),
        (Trial(t, u[:, 0], u[:, 0]), "expected two of each"),
    ):
        with pytest.raises(FitError, match=words) as refused:
            choose_joint([trial])
        assert len(str(refused.value)) <= 300


@pytest.mark.parametrize("at_deg", [(10.0, 130.0, 250.0), (0.0, 80.0, 180.0, 270.0)])
def test_tendons_at_unknown_angles_are_identified(at_deg: tuple[float, ...]) -> None:
    """The error on a motion left out is near that of a fit which is told where the tendons are."""
    n, random = len(at_deg), np.random.default_rng(4)
    device = two_axes().with_tendons(at_deg, pretension=1.0, limits=[(-2, 5)] * n, rates_per_s=[2 * RATE] * n)
    recorded_, told = [], []
    for seed in range(4):
        ways = np.arange(1000)[:, None] * (1 + 0.3 * np.arange(n)) / 60  # no two tendons alike
        u = device.commands(wandering(seed)) + 0.3 * np.sin(ways + seed)
        angles = device.run(u, np.zeros(2)) + 0.05 * random.standard_normal((1000, 2))
        recorded_.append(Trial(0.04 * np.arange(1000), u, angles))
        told.append(Trial(0.04 * np.arange(1000), device.travels(u), angles))
    fit, exact = (fit_two_axes(kind_named("pi"), trials[:3], FitRequest()) for trials in (recorded_, told))
    errors = [
        evaluate_two_axes(one.model, trials[3]).errors.rmse_deg for one, trials in ((fit, recorded_), (exact, told))
    ]
    assert errors[0] < 1.2 * errors[1]
    assert fit.model.matrix.shape == (2, n)
    got, true = (m / np.linalg.norm(m, axis=1, keepdims=True) for m in (fit.model.matrix, device.matrix))
    np.testing.assert_allclose(got, true, atol=0.02)


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=2), st.lists(st.floats(-1, 1), min_size=2, max_size=2))
def test_within_the_limits_of_travels_every_tendon_keeps_its_own(a: list[float], b: list[float]) -> None:
    tendons = two_axes(((1.0, 0.3), (-0.2, 1.0))).with_tendons(
        [10, 130, 250], pretension=2.0, limits=[(0.5, 6.0)] * 3, rates_per_s=[4.0] * 3
    )
    plain = tendons.in_travels()
    middle, half = (np.array([(sign * r.lower + r.upper) / 2 for r in plain.command_limits]) for sign in (1, -1))
    here, there = (tendons.commands(middle + np.array(share) * half) for share in (a, b))
    assert np.all((here >= 0.5 - 1e-9) & (here <= 6.0 + 1e-9))
    far = np.abs((np.array(b) - a) * half).max()
    most = max(4.0 * far / plain.command_rates_per_s[0], 1e-12)
    assert np.all(np.abs(there - here) <= most + 1e-9)  # at the rate of the travels no tendon is faster than its own
    w = np.tile(middle, (50, 1)) + np.linspace(0, 1, 50)[:, None] * np.array(a) * half
    np.testing.assert_allclose(plain.run(w, np.zeros(2)), tendons.run(tendons.commands(w), np.zeros(2)), atol=1e-9)


BAR = MeasuredInput("bar", 2.0, 1.0, 4.0)


def depending() -> TwoAxisModel:
    """Axis y has more friction under a higher pressure."""
    x, y = two_axes().axes
    core = Scheduled.of(y.chain.core, (Dependence(BAR, "friction"), Dependence(BAR, "gain")), (0.4, -0.1))
    return replace(two_axes(((1.0, 0.2), (-0.1, 1.0))), axes=(x, replace(y, chain=replace(y.chain, core=core))))


@given(st.floats(1.0, 4.0))
def test_at_a_constant_input_the_device_is_that_with_the_parameters_there(z: float) -> None:
    model, u = depending(), wandering(7, 300)
    axes = [replace(axis, chain=axis.chain.at_inputs({"bar": z})) for axis in model.axes]
    bar = {"bar": np.full(300, z)}
    there = [run_axis(ChainModel(axis), model.travels(u)[:, i], 0.0, bar) for i, axis in enumerate(axes)]
    np.testing.assert_allclose(model.run(u, np.zeros(2), bar), np.stack(there, axis=1))
    trial = Trial(0.04 * np.arange(300), u, np.stack(there, axis=1), inputs=bar)
    assert evaluate_two_axes(model, trial).errors.rmse_deg < 1e-9
    assert [one.name for one in model.inputs] == ["bar"]


def test_a_log_without_the_input_of_the_model_is_one_line() -> None:
    trial = recorded(two_axes(), range(1))[0]
    with pytest.raises(LogError, match="no input 'bar'") as refused:
        evaluate_two_axes(depending(), trial)
    assert len(str(refused.value)) <= 300


def test_inputs_reach_the_identification_of_each_axis() -> None:
    """So `auto` may depend on them; kinds that cannot refuse them in one line."""
    trial = recorded(two_axes(), range(1))[0]
    given_ = Trial(trial.t, trial.commands, trial.angles, inputs={"bar": np.full(len(trial), 2.0)})
    with pytest.raises(FitError, match="got the input bar, expected none") as refused:
        fit_two_axes(kind_named("backlash"), [given_], FitRequest())
    assert len(str(refused.value)) <= 300


def test_a_file_keeps_what_depends_on_an_input(tmp_path: Path) -> None:
    model, u = depending(), wandering(9, 200)
    again, bar = load_two_axes(model.save(tmp_path / "both.yaml")), {"bar": np.linspace(1.0, 4.0, 200)}
    assert again.inputs == model.inputs == (BAR,)
    np.testing.assert_array_equal(again.run(u, np.zeros(2), bar), model.run(u, np.zeros(2), bar))


def test_a_model_is_shown_in_brief() -> None:
    model: TwoAxisModel = replace(two_axes(), command_limits=(Range(lower=-3.0, upper=3.0),) * 2)
    assert "2 commands" in repr(model)
