"""A gap that is numbers of the core alone is retuned: no unknown gap, and no effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.decide.retuning import reidentified_share, retuned_with, retuning_of, width_grown
from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.diagnosis import RetunedParameter
from hystmpc.gap.logs.motion_type import play_states
from hystmpc.gap.logs.preparation import prepare
from hystmpc.gap.report.words import headline
from hystmpc.gap.residual import friction_share
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.identify.baseline import BacklashBaseline, FreeCoreBaseline, baseline_of
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.runs import runs_of
from hystmpc.models.identify.uncertainty import core_rows
from hystmpc.models.operators.hysteresis import Backlash, CurvedPlays
from hystmpc.models.operators.static_curves import NonlinearGain
from hystmpc.models.simulator import Residual
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.zoo import BACKLASH, CURVED, STATIC_PI
from .engine_examples import DT, moves, simulator_of, sine, trials_of

RANGE = Range(lower=0.0, upper=6.0)
LOOP_MM = BACKLASH.values[2] - BACKLASH.values[3]
COMMANDS = [moves(1, 20.0), sine(0.1), moves(2, 20.0), sine(0.2), moves(3, 20.0)]
KNOWN = (Residual(log="a.csv", motion="continuous", samples=100, rmse_deg=0.06, bias_deg=0.0, lag_one=0.1),)


def wider(more: float) -> Backlash:
    """The device with a width that is larger by this [mm]."""
    m_lo, m_up, c_lo, c_up = BACKLASH.values
    return Backlash(m_lo, m_up, c_lo + more / 2, c_up - more / 2)


TRIALS = [Trial(DT * np.arange(u.size), u, np.zeros(u.size), source=f"{k}") for k, u in enumerate(COMMANDS)]


@pytest.mark.slow
def test_a_friction_that_has_grown_is_retuned_and_said_with_its_interval() -> None:
    trials = trials_of(Chain(wider(0.8)), COMMANDS)
    found = conclude(find_causes(trials, simulator_of(BACKLASH, KNOWN)))[0]
    assert (found.verdict, found.effects) == ("retuned", ())
    (width,) = [row for row in found.moved if row.name == "backlash_width"]
    assert (width.unit, width.given) == ("mm", found.retuned["backlash_width"][0])
    assert width.value == pytest.approx(width.given + 0.8, abs=0.03)
    assert width.ci90[0] <= width.value <= width.ci90[1] < width.given + 0.9
    assert "backlash width" in headline(found)
    assert f"{width.given:.3g} to {width.value:.3g} mm" in found.reason
    assert found.as_json()["moved"][0].keys() == RetunedParameter.__dataclass_fields__.keys()
    same = conclude(find_causes(trials_of(Chain(BACKLASH), COMMANDS), simulator_of(BACKLASH, KNOWN)))[0]
    assert (same.verdict, same.moved) == ("none", ())


@settings(max_examples=15, deadline=None)
@given(st.floats(0.05, 1.0), st.floats(0.5, 3), st.sampled_from([-1.0, 0.0, 1.0]))
def test_plays_of_any_width_are_friction(half: float, weight: float, side: float) -> None:
    assert share([weight * (play_states(t.command, np.array([half]), side)[:, 0] - t.command) for t in TRIALS]) > 0.6


def test_a_curve_a_wave_and_noise_are_no_friction() -> None:
    assert share([0.1 * (t.command - 3.0) ** 2 for t in TRIALS]) < 0.5
    assert share([np.sin(2.0 * t.t) for t in TRIALS]) < 0.2
    assert share([0.0 * t.t for t in TRIALS]) < 0.4


def share(residuals: list[Vec]) -> float:
    """Share of these residuals with noise [deg] that plays explain, as a number that can be compared."""
    random = np.random.default_rng(1)
    return float(friction_share(TRIALS, [y + 0.05 * random.standard_normal(y.size) for y in residuals], 0.049))


def test_friction_explains_no_more_form_error_than_a_loop_of_this_device_can_have() -> None:
    """A loop that has gone has no friction, and one that is six times higher is not that of the same device."""
    grown, shares = {}, {}
    for times in (0.1, 2.0, 6.0):
        trials = trials_of(Chain(wider((times - 1.0) * LOOP_MM)), COMMANDS)
        prepared = prepare(trials, simulator_of(BACKLASH, KNOWN))
        retuned = CrossValidation(prepared.baseline, prepared.development).retuned()
        found = retuning_of(prepared, retuned, float(retuned.mse))
        grown[times], shares[times] = found.grown_form_mse / prepared.form_mse, found.friction_share
    assert grown[0.1] == 1.0
    assert shares[0.1] == 0.0
    assert 1.5 < grown[2.0] < 4.0 < grown[6.0] <= 16.0


def test_a_core_identified_anew_follows_any_static_loop_and_no_wave() -> None:
    """A dead zone of the command is static; a wave of its own clock is not."""
    blunt = [np.maximum(u, 2.0) for u in COMMANDS]
    dead = [replace(trial, command=u) for trial, u in zip(trials_of(Chain(BACKLASH), blunt), COMMANDS, strict=True)]
    whole = trials_of(Chain(BACKLASH), COMMANDS)
    waved = [replace(t, angle=t.angle + 5.0 * np.sin(3.0 * t.t + k)) for k, t in enumerate(whole)]
    shares = []
    for trials in (dead, waved):
        prepared = prepare(trials, simulator_of(BACKLASH, KNOWN))
        validation = CrossValidation(prepared.baseline, prepared.development)
        judged = validation.judge(validation.retuned())
        shares.append(reidentified_share(prepared, validation, judged, prepared.form_mse))
    assert shares[0] > 0.9
    assert shares[1] < 0.2


@given(st.floats(0.5, 3.0))
def test_the_width_has_grown_by_what_was_added(times: float) -> None:
    baseline = baseline_of(Chain(BACKLASH), Range(lower=0.0, upper=6.0))
    assert isinstance(baseline, BacklashBaseline)
    before = baseline.quantities(baseline.nominal)["backlash_width"]
    problem = Problem(baseline)
    z = baseline.nominal + np.array([0.0, 0.0, (times - 1.0) * before, 0.0])
    assert width_grown(Hypothesis(problem, problem.start(z, []), 1.0)) == pytest.approx(times, rel=0.01)


def test_each_trial_weighs_by_its_size_and_not_by_its_energy() -> None:
    """A wave in one trial of five leaves the share of friction in the other four, however large it is."""
    friction = [play_states(t.command, np.array([0.3]), 1.0)[:, 0] - t.command for t in TRIALS]
    few = share(
        [
            y + (9.0 * np.sin(7.0 * t.t) if k == 0 else 0.0)
            for k, (t, y) in enumerate(zip(TRIALS, friction, strict=True))
        ]
    )
    energy = sum(float(y @ y) for y in friction)
    wave = float(np.sum((9.0 * np.sin(7.0 * TRIALS[0].t)) ** 2))
    assert energy / (energy + wave) < 0.1 < few < share(friction)


def test_widths_of_curved_plays_are_freed_where_the_error_asks_for_it() -> None:
    values = CURVED.values
    spread = CURVED.with_values(
        [v * (2.5 if p.name == "r2" else 1.0) for v, p in zip(values, CURVED.parameters, strict=True)]
    )
    assert isinstance(spread, CurvedPlays)
    for device, free in ((spread, True), (CURVED, False)):
        prepared = prepare(trials_of(Chain(device), COMMANDS), simulator_of(CURVED, KNOWN))
        plain = CrossValidation(prepared.baseline, prepared.development)
        after, validation, retuned = retuned_with(prepared, plain)
        assert (after.baseline is not prepared.baseline) == free
        assert validation.baseline is after.baseline is retuned.problem.baseline
        assert retuned.mse <= plain.retuned().mse * (0.5 if free else 1.0)


CURVE = NonlinearGain(0.03, -0.002, 3.0)


def test_a_curve_of_the_simulator_moves_with_its_core() -> None:
    """Friction or stiffness that has changed moves its travels: a curve that stayed looked like a nonlinear gain."""
    given = Chain(STATIC_PI, (CURVE,), (NonlinearGain(0.002, 0.0, 50.0),))
    moved = replace(given, before=(NonlinearGain(0.038, -0.003, 3.0),), after=(NonlinearGain(0.0015, 1e-6, 50.0),))
    trials = trials_of(moved, COMMANDS, noise_deg=0.0)
    retuned = CrossValidation(baseline_of(given, RANGE), runs_of(trials)).retuned()
    assert retuned.mse**0.5 < 0.002
    without = CrossValidation(baseline_of(Chain(STATIC_PI), RANGE), runs_of(trials)).retuned()
    assert without.mse**0.5 > 0.05
    assert {row.name for row in core_rows(retuned, runs_of(trials))} >= {"a1"}


def test_a_further_nonlinear_gain_is_no_retuning() -> None:
    """It is larger than what friction and stiffness move a curve by."""
    given = Chain(STATIC_PI, (CURVE,))
    trials = trials_of(Chain(STATIC_PI, (NonlinearGain(0.12, -0.002, 3.0),)), COMMANDS, noise_deg=0.0)
    retuned = CrossValidation(baseline_of(given, RANGE), runs_of(trials)).retuned()
    assert retuned.mse**0.5 > 0.3


def test_curved_plays_have_one_friction() -> None:
    """Half-widths that are larger by one factor are retuned as such: with fixed ones other slopes only come near."""
    widths = [p.name.startswith("r") for p in CURVED.parameters]
    device = CURVED.with_values([v * (1.6 if w else 1.0) for v, w in zip(CURVED.values, widths, strict=True)])
    runs = runs_of(trials_of(Chain(device), COMMANDS, noise_deg=0.0))
    fixed, free = (
        CrossValidation(baseline, runs).retuned()
        for baseline in (FreeCoreBaseline(Chain(CURVED), RANGE), baseline_of(Chain(CURVED), RANGE))
    )
    assert free.mse**0.5 < 0.01
    assert fixed.mse**0.5 > 5 * free.mse**0.5
    assert free.z[widths.index(True)] == pytest.approx(1.6 * CURVED.radii[0], rel=0.02)


@pytest.mark.parametrize("chain", [Chain(CURVED, (CURVE,)), Chain(BACKLASH, (), (CURVE,)), Chain(CURVED)])
def test_the_derivative_of_the_chain_by_the_unknowns_is_exact(chain: Chain) -> None:
    baseline = baseline_of(chain, RANGE)
    z = baseline.nominal + 0.01 * baseline.scale
    values, slope = baseline.chain_values(z)
    assert slope.shape == (chain.values.size, z.size)
    for k, step in enumerate(1e-6 * np.maximum(np.abs(z), 1.0)):
        up, down = (baseline.chain_values(z + way * step * np.eye(z.size)[k])[0] for way in (1, -1))
        np.testing.assert_allclose((up - down) / (2 * step), slope[:, k], atol=1e-6)
    np.testing.assert_allclose(baseline.chain_values(baseline.nominal)[0], chain.values, rtol=1e-12)
    assert np.isfinite(values).all()
