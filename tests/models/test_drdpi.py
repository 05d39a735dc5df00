"""Dead zones, the DRDPI model that is made with them, and Bouc-Wen: their laws."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.chain import Chain, operator_from, operator_spec
from hystmpc.models.evaluate import free_run
from hystmpc.models.inverse.inverses import CompiledInverse
from hystmpc.models.load import load_model
from hystmpc.models.operators.hysteresis import BoucWen
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import Drdpi
from hystmpc.models.operators.static_curves import Deadband
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import ChainModel, export_simulator, load_simulator, save_simulator
from hystmpc.trials.errors import ModelError

from .running import operator_rest, run_operator
from .test_operator_laws import polyline
from .zoo import BOUC_WEN, DEADBAND, DRDPI, DT, simulator

pytestmark = pytest.mark.slow

STATIC = replace(DRDPI, beta=0.0)
corners = st.lists(st.floats(0.0, 6.0), min_size=3, max_size=8)
gaps = st.floats(0.1, 20.0)
slopes = st.floats(0.05, 5.0)
few = settings(max_examples=25)  # for whole free runs


@st.composite
def deadbands(draw: st.DrawFn) -> Deadband:
    sides = [tuple(draw(part) for _ in range(n)) for part in (slopes, gaps) for n in (2, 1)]
    return Deadband(draw(slopes), *sides, draw(st.floats(-50, 50)), draw(st.floats(-50, 50)))


@few
@given(band=deadbands(), v=st.lists(st.floats(-100, 100), min_size=2, max_size=20))
def test_a_deadband_is_kuhnens_sum_of_one_sided_dead_zones(band: Deadband, v: list[float]) -> None:
    x = np.array(v) - band.centre
    expected = np.full(x.size, band.offset)
    for weight, d in zip(band.weights, band.thresholds, strict=True):
        zone = x if d == 0 else np.maximum(x - d, 0) if d > 0 else np.minimum(x - d, 0)
        expected += weight * zone
    np.testing.assert_allclose(run_operator(band, np.array(v)), expected, atol=1e-9)


@few
@given(band=deadbands(), v=st.lists(st.floats(-100, 100), min_size=2, max_size=20))
def test_deadband_and_its_inverse_are_the_identity_either_way(band: Deadband, v: list[float]) -> None:
    u = np.array(v)
    np.testing.assert_allclose(run_operator(band.inverse(), run_operator(band, u)), u, atol=1e-8)
    np.testing.assert_allclose(run_operator(band, run_operator(band.inverse(), u)), u, atol=1e-8)


@given(band=deadbands())
def test_the_inverse_has_kuhnens_weights_and_thresholds(band: Deadband) -> None:
    """w'_0 = 1/w_0, w'_j = -w_j / (sum_{i<=j} w_i sum_{i<j} w_i), d'_j = sum_{i<=j} w_i (d_j - d_i), either side."""
    k = band.below
    for sign in (1, -1):
        w = np.array(band.weights[k::sign] if sign > 0 else band.weights[k::-1])
        d = np.array(band.thresholds[k::sign] if sign > 0 else band.thresholds[k::-1])
        found = band.inverse()
        got_w = np.array(found.weights[k::sign] if sign > 0 else found.weights[k::-1])
        got_d = np.array(found.thresholds[k::sign] if sign > 0 else found.thresholds[k::-1])
        sums = np.cumsum(w)
        np.testing.assert_allclose(got_w[0], 1 / w[0])
        np.testing.assert_allclose(got_w[1:], -w[1:] / (sums[1:] * sums[:-1]), atol=1e-9)
        np.testing.assert_allclose(got_d, [np.sum(w[: j + 1] * (d[j] - d[: j + 1])) for j in range(w.size)], atol=1e-9)


def test_a_deadband_has_no_memory() -> None:
    u = np.array([10.0, 80.0, 35.0, 80.0, 10.0])
    y = run_operator(DEADBAND, u)
    assert (y[1], y[0]) == (y[3], y[4])


def test_drdpi_is_the_chain_of_plays_and_dead_zones() -> None:
    """Step by step, from any state: the equation of each part stands where it stood before."""
    band = Deadband(1.0, DRDPI.slopes_below, DRDPI.slopes_above, DRDPI.gaps_below, DRDPI.gaps_above, 0.0, DRDPI.offset)
    one, chain = Chain(DRDPI), Chain(DRDPI.hysteresis, after=(band,))
    rng = np.random.default_rng(0)
    for state, u in zip(rng.uniform(0, 6, (30, one.state_size)), rng.uniform(0, 6, 30), strict=True):
        theta, following = one.transition(state, u, one.values, DT)
        expected, both = chain.transition([*state, 0.0], u, chain.values, DT)
        assert float(theta) == pytest.approx(float(expected), abs=1e-12)
        np.testing.assert_allclose(np.asarray(following), np.asarray(both)[:-1], atol=1e-12)


@few
@given(points=corners)
def test_static_inverse_after_drdpi_is_the_identity(points: list[float]) -> None:
    """Both start from the virgin state at the first command, where every play is centred."""
    u = polyline(points, 9)
    np.testing.assert_allclose(run_operator(STATIC.inverse(), run_from_virgin(STATIC, u), seen=u[0]), u, atol=1e-8)


def run_from_virgin(operator: Drdpi, u: np.ndarray) -> np.ndarray:
    """Free run from plays that are centred on the first command."""
    model = CompiledPredictor.of_simulator(simulator(Chain(operator)))
    state, theta = np.full(operator.plays + 1, u[0]), np.empty(u.size)
    for k, command in enumerate(u):
        theta[k], state = model.advance(state, command)
    return theta


@few
@given(history=st.lists(st.floats(0.0, 6.0), min_size=1, max_size=6), wanted=st.floats(28.0, 75.0))
def test_one_step_inverse_is_exact_with_rate_dependence(history: list[float], wanted: float) -> None:
    predictor = CompiledPredictor.of_simulator(simulator(Chain(DRDPI)))
    inverse = CompiledInverse(predictor, -20.0, 40.0)
    state = predictor.initial(40.0, history[0])
    for u in history:
        _, state = predictor.advance(state, u)
    command = inverse.command(state, wanted, history[-1])
    assert predictor.advance(state, command)[0] == pytest.approx(wanted, abs=1e-8)


@pytest.mark.parametrize("operator", [DRDPI, BOUC_WEN], ids=lambda o: o.name)
@few
@given(points=corners)
def test_a_hold_gives_a_constant_output(operator: Operator, points: list[float]) -> None:
    held = np.concatenate([polyline(points, 5), np.full(20, points[-1])])
    assert np.ptp(run_operator(operator, held, seen=40.0)[-20 + operator.settling_samples :]) <= 1e-12


@few
@given(points=corners)
def test_rate_independence_without_beta(points: list[float]) -> None:
    slow, fast = run_operator(STATIC, polyline(points, 17))[::17], run_operator(STATIC, polyline(points, 3))[::3]
    np.testing.assert_allclose(slow, fast, atol=1e-9)


@few
@given(low=st.floats(1.0, 2.0), high=st.floats(4.0, 5.0), inner=st.floats(2.2, 3.8))
def test_return_point_memory_without_beta(low: float, high: float, inner: float) -> None:
    with_loop = run_operator(STATIC, polyline([0.0, high, low, inner, low, low - 0.5], 11))
    without = run_operator(STATIC, polyline([0.0, high, low, low - 0.5], 11))
    np.testing.assert_allclose(with_loop[-11:], without[-11:], atol=1e-9)


def closed_loop(operator: Operator, hertz: float) -> tuple[np.ndarray, np.ndarray]:
    """Command and angle over the last period of a sinusoid over the whole range."""
    samples = round(1 / (hertz * DT))
    u = 3 - 3 * np.cos(2 * np.pi * np.arange(4 * samples) / samples)
    return u[-samples:], run_operator(operator, u)[-samples:]


def skew(operator: Operator) -> float:
    """How far the loop is from its own point reflection, as a share of its height."""
    _, theta = closed_loop(operator, 0.25)
    reflected = theta.max() + theta.min() - np.roll(theta, theta.size // 2)
    return float(np.abs(theta - reflected).max() / np.ptp(theta))


def test_dead_zones_make_the_loop_asymmetric() -> None:
    assert skew(DRDPI.hysteresis) < 1e-9
    assert skew(replace(DRDPI, slopes_above=(1.0, 1.0))) > 0.1


def test_the_loop_is_dead_at_the_bottom_and_saturates_at_the_top() -> None:
    u, theta = closed_loop(STATIC, 0.1)
    rising = slice(0, u.size // 2)
    slope = np.gradient(theta[rising], u[rising])
    bottom, middle, top = (slope[np.abs(u[rising] - at) < 0.3].mean() for at in (1.0, 3.0, 5.6))
    assert bottom < 0.3 * middle
    assert top < 0.3 * middle


def test_both_turning_points_show_a_plateau() -> None:
    """Within 2 r_1 after a turn all plays stand still: the angle moves by a0 and the end's slope alone."""
    stiff = replace(STATIC, a0=0.05)
    theta = run_operator(stiff, polyline([0.0, 6.0, 6.0 - 2 * stiff.alpha, 0.0, 2 * stiff.alpha], 12))
    for first in (12, 36):
        assert np.ptp(theta[first : first + 12]) <= 0.05 * 2 * stiff.alpha + 1e-12
    assert np.ptp(theta) > 20


@few
@given(y=st.floats(48.3, 52.9))
def test_at_rest_the_model_shows_what_was_measured(y: float) -> None:
    """At command 3 the loop is open from 48.23 to 52.97 deg, and no kink lies in between."""
    np.testing.assert_allclose(run_operator(STATIC, np.full(4, 3.0), seen=y), y, atol=1e-8)


def test_the_rest_rule_is_linear_in_the_angle_and_exact_on_both_branches() -> None:
    at = [operator_rest(DRDPI, 3.0, y).ravel() for y in (20.0, 40.0, 60.0)]
    np.testing.assert_allclose(at[1], 0.5 * (at[0] + at[2]), atol=1e-12)
    for sign in (1, -1):
        on_branch = np.array([3.0 + sign * DRDPI.alpha * i for i in range(1, DRDPI.plays + 1)])
        v = DRDPI.a0 * 3.0 + np.dot(DRDPI.weights, on_branch) + DRDPI.b
        _, pieces, offset = DRDPI.parts(list(DRDPI.values))
        np.testing.assert_allclose(
            operator_rest(DRDPI, 3.0, float(pieces.at(v)) + offset).ravel()[1:], on_branch, atol=1e-8
        )


@pytest.mark.parametrize("operator", [DEADBAND, DRDPI, BOUC_WEN], ids=lambda o: o.name)
def test_the_exported_model_is_the_operator(operator: Operator, tmp_path: Path) -> None:
    before = simulator(Chain(operator))
    assert load_simulator(save_simulator(before, tmp_path / "sim.yaml")) == before
    gate = export_simulator(before, tmp_path / "model.onnx")
    assert max(gate.runtime_deg, gate.casadi_deg) <= 1e-9
    u = 3 - 3 * np.cos(2 * np.pi * 0.3 * np.arange(0, 8, DT))
    reference, exported = ChainModel(before), load_model(tmp_path / "model.onnx")
    np.testing.assert_allclose(free_run(exported, u, 40.0), free_run(reference, u, 40.0), atol=1e-9)


def test_bouc_wen_is_the_recursion_of_the_code() -> None:
    """Per sample of a command normalised by 6 mm at 25 Hz, written out with its exponentials."""
    u = 3 - 3 * np.cos(2 * np.pi * 0.3 * np.arange(0, 20, DT)) * np.exp(-0.05 * np.arange(0, 20, DT))
    a, delta, v, alpha_1, alpha_2, _, b = BOUC_WEN.values
    h, expected = 40.0 - 0.5 * (alpha_1 + alpha_2) * u[0] - b, []
    for k, du in enumerate(np.diff(u, prepend=u[0])):
        h = (a * du + delta * abs(du) + h) / (1 + v * abs(du))
        grown = np.exp(2 * du / 6)
        expected.append((alpha_1 * grown + alpha_2) / (grown + 1) * u[k] + h + b)
    np.testing.assert_allclose(run_operator(BOUC_WEN, u, seen=40.0), expected, atol=1e-9)


def test_bouc_wen_tends_to_one_line_up_and_one_down() -> None:
    """h tends to (a + delta) / v and (delta - a) / v along a slow path."""
    slow = BoucWen(-9.0, 0.8, 2.2, 10.5, 10.5, 0.04 / 6, 25.0)
    theta = run_operator(slow, polyline([0.0, 6.0, 0.0], 3000))
    assert theta[3000] - (10.5 * 6 + 25) == pytest.approx((-9.0 + 0.8) / 2.2, abs=0.01)
    assert theta[-1] - 25 == pytest.approx((0.8 + 9.0) / 2.2, abs=0.01)


def test_bouc_wen_keeps_its_meaning_at_another_sample_rate() -> None:
    def run(dt: float) -> np.ndarray:
        u = 3 - 3 * np.cos(2 * np.pi * 0.2 * np.arange(0, 10, dt))
        return run_operator(BOUC_WEN, u, seen=25.0, dt=dt)

    np.testing.assert_allclose(run(0.04)[1:], run(0.01)[4::4], atol=0.35)  # of 60; second order in the step of h
    np.testing.assert_allclose(run(0.004)[10:], run(0.001)[40::4][: run(0.004).size - 10], atol=0.05)


@pytest.mark.parametrize("jump", [1e3, -1e3])
def test_a_jump_of_the_command_does_not_overflow(jump: float) -> None:
    assert np.all(np.isfinite(run_operator(BOUC_WEN, np.array([0.0, jump, jump]))))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slope_above_1": 0.0}, "drdpi.slope_above_1 is 0 deg/deg, expected 0.001 to 10"),
        ({"gap_below_2": -1.0}, "drdpi.gap_below_2 is -1 deg"),
        ({"beta": float("nan")}, "drdpi.beta is nan"),
        ({"slope_abov_1": 1.0}, "did you mean 'slope_above_1'"),
    ],
)
def test_a_wrong_drdpi_is_one_clear_line(change: dict[str, float], message: str) -> None:
    spec = operator_spec(DRDPI)
    spec["parameters"] |= change
    with pytest.raises(ModelError) as error:
        operator_from(spec, "sim.yaml: chain.core")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("gaps_below", [(), (1.0,), (1.0, 2.0, 3.0)])
def test_a_side_needs_as_many_gaps_as_slopes(gaps_below: tuple[float, ...]) -> None:
    with pytest.raises(ModelError, match=r"deadband: 2 slopes and . gaps below, expected as many"):
        Deadband(1.0, (0.5, 0.1), (1.0,), gaps_below, (1.0,), 0.0, 0.0)
