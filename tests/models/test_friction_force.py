"""Forces that turn their sign with the motion: laws of stops and sliders, and fits of logs that do not rise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import DeviceLimits
from hystmpc.models.identify.auto import identify_auto
from hystmpc.models.identify.baseline import FreeCoreBaseline
from hystmpc.models.identify.chain_kinds import FRICTION_KINDS
from hystmpc.models.identify.cross_validation import CrossValidation, fit_problem
from hystmpc.models.identify.runs import command_range, runs_of
from hystmpc.models.identify.simulators import simulator_of
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.friction import MaxwellSlip
from hystmpc.models.operators.hysteresis import Play, Stop
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Line
from hystmpc.models.simulator import ChainModel, load_simulator, save_simulator
from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.trial import Trial, Units

from .running import run_operator
from .zoo import DT, RATE_SLIDERS, SLIDERS

paths = st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=30).map(np.array)
widths = st.floats(0.0, 3.0)


@given(paths, widths)
def test_stop_and_play_are_the_identity(u: np.ndarray, r: float) -> None:
    seen = float(u[0])  # both rest with the play centred
    np.testing.assert_allclose(run_operator(Stop(r), u) + run_operator(Play(r), u, seen), u, atol=1e-12)


@given(paths, widths, st.floats(-9.0, 9.0))
def test_a_stop_never_exceeds_its_width_however_it_was_left(u: np.ndarray, r: float, seen: float) -> None:
    assert np.all(np.abs(run_operator(Stop(r), u, seen)) <= r + 1e-12)


def friction(operator: MaxwellSlip) -> MaxwellSlip:
    """Sliders and viscous part alone, without the spring and the force beside them."""
    return replace(operator, k0=0.0, b=0.0)


@pytest.mark.parametrize("operator", [Stop(0.4), replace(friction(SLIDERS), growth=0.0), friction(RATE_SLIDERS)])
@given(u=paths)
def test_dissipated_work_is_never_negative(operator: Operator, u: np.ndarray) -> None:
    """From relaxed springs, whatever the path: force times displacement, at every moment of it."""
    fine = np.interp(np.arange(0.0, u.size - 0.5, 0.002), np.arange(u.size), u)
    work = np.cumsum(run_operator(operator, fine)[1:] * np.diff(fine))
    assert work.min() >= -0.02  # of a growth that changes within a step


def test_sliders_of_one_stop_are_that_stop() -> None:
    u = 2.0 * np.sin(0.3 * np.arange(80.0))
    one = MaxwellSlip(0.0, (1.0,), 0.4, 0.0, 0.0)
    np.testing.assert_allclose(run_operator(one, u), run_operator(Stop(0.4), u), atol=1e-12)


@given(st.floats(-5.0, 5.0), st.floats(-0.9, 0.9))
def test_sliders_at_rest_show_the_force_that_was_seen(u: float, share: float) -> None:
    """As far as they can hold it."""
    hold = (1 + SLIDERS.growth * u) * sum(k * SLIDERS.spacing for k in SLIDERS.stiffness)
    seen = SLIDERS.b + SLIDERS.k0 * u + share * hold
    np.testing.assert_allclose(run_operator(SLIDERS, np.full(3, u), seen), seen, atol=1e-9)


def test_numbers_of_the_speed_come_together() -> None:
    with pytest.raises(ModelError, match="maxwell_slip: 2 numbers of the speed, expected none or 3"):
        MaxwellSlip(0.0, (1.0,), 0.1, 0.0, 0.0, (0.1, 0.2))


def recorded(stiffness: float = 0.0, unit: str = "N", noise: float = 0.05) -> list[Trial]:
    """Strokes over a slider with some sliders that break away early, beside a spring of either sign."""
    device = MaxwellSlip(stiffness, (8.0, 4.0, 1.0), 0.2, 0.0, 150.0)
    trials, random = [], np.random.default_rng(5)
    for k, period in enumerate((5.0, 7.0, 6.0)):
        t = np.arange(0.0, 24.0, DT)
        u = 3.0 + 2.5 * np.sin(2 * np.pi * t / period) + 0.5 * np.sin(2 * np.pi * t / 1.7)
        force = run_operator(device, u, 150.0) + noise * random.standard_normal(t.size)
        trials.append(Trial(t, u, force, units=Units("mm", unit, inverse=False), source=f"run_{k}.csv"))
    return trials


@pytest.mark.parametrize(
    ("kind", "stiffness"),
    [
        ("maxwell_slip", -4.0),
        pytest.param("maxwell_slip", 0.5, marks=pytest.mark.slow),
        pytest.param("maxwell_slip_rate", -4.0, marks=pytest.mark.slow),
    ],
)
def test_a_force_of_either_sign_is_fitted(kind: str, stiffness: float, tmp_path: Path) -> None:
    trials = recorded(stiffness)[:2]
    found = kind_named(kind).fit(trials, FitRequest("best"))
    assert found.simulator is not None
    read = load_simulator(save_simulator(found.simulator, tmp_path / "seal.yaml"))
    error = ChainModel(read).run(trials[1].command, float(trials[1].angle[0])) - trials[1].angle
    assert np.sqrt(np.mean(error**2)) < 0.08  # of 0.05 noise and 2.4 N friction


@pytest.mark.parametrize("kind", ["backlash", "pi", "drdpi", "bouc_wen", "play_kernel"])
def test_kinds_that_have_to_rise_name_those_that_fit(kind: str) -> None:
    with pytest.raises(FitError, match="such as a force, maxwell_slip and maxwell_slip_rate fit"):
        kind_named(kind).fit(recorded(-4.0), FitRequest("best"))


@pytest.mark.parametrize("kind", [*FRICTION_KINDS, "auto", "backlash"])
def test_an_angle_that_falls_has_a_wrong_sign_for_every_kind(kind: str) -> None:
    with pytest.raises(FitError, match=r"turn the sign of one channel$"):
        kind_named(kind).fit(recorded(-4.0, "deg"), FitRequest("best"))


@pytest.mark.slow
def test_auto_finds_friction_and_no_plays() -> None:
    choice = identify_auto([trial.select(0, 300) for trial in recorded(-4.0)[:2]]).choice
    assert choice.core.label.startswith("maxwell_slip")
    assert all(not form for form in choice.forms.values())


@pytest.mark.slow
def test_auto_takes_no_plays_for_a_device_without_hysteresis() -> None:
    """A slow lag behind a valve, one trial: what is judged on the time that a fit has seen always favours plays."""
    random = np.random.default_rng(11)
    t = np.arange(0.0, 40.0, DT)
    u = np.convolve(random.standard_normal(t.size), np.hanning(40), mode="same") / 3.0
    u -= u[0]
    theta = 30.0 * run_operator(Lag(6.0), u + 0.05 * u**2 + 0.02 * u**3) + 0.1 * random.standard_normal(t.size)
    units = Units("V", "mm", inverse=False)
    choice = identify_auto([Trial(t, u, theta, units=units, source="rig.csv")]).choice
    assert choice.core.label == "line"
    assert [c.effect for c in choice.forms["valve"]] == ["nonlinear_gain"]


def test_one_trial_is_judged_on_thirds_of_its_time() -> None:
    trials = recorded()[:1]
    runs = runs_of(trials)
    baseline = FreeCoreBaseline(Chain(SLIDERS), command_range(trials))
    seen, held_out = CrossValidation(baseline, runs), CrossValidation(baseline, runs, in_time=True)
    fit = seen.retuned()
    judged = held_out.judge(fit)
    assert len(judged.fold_q) == 3
    assert judged.errors[0].size == np.count_nonzero(runs[0].counts)
    assert judged.mse > seen.judge(fit).mse
    fits = [
        fit_problem(fit.problem, rest, q, 60, 1e-6)
        for (rest, _), q in zip(held_out._splits, judged.fold_q, strict=True)
    ]
    thirds = [found.error(third[0]) for found, (_, third) in zip(fits, held_out._splits, strict=True)]
    np.testing.assert_allclose(held_out.left_out(judged)[0], -np.concatenate(thirds), atol=1e-9)


def test_a_device_that_rests_in_the_middle_of_its_command_is_started_there(tmp_path: Path) -> None:
    """Behind a drive of 9 s a start at the lower end is felt for half a minute."""
    t = np.arange(0.0, 20.0, DT)
    u, units = 2.0 * np.sin(0.9 * t), Units("V", "mm", inverse=False)
    chain = Chain(Line(30.0, 5.0), (Lag(9.0),))
    angle = 30.0 * run_operator(Lag(9.0), u) + 5.0
    trial = Trial(t, u, angle, units=units, source="rig.csv")
    simulator = simulator_of(chain, [trial], DeviceLimits(), "by hand")
    assert simulator.rest_command == u[0]
    read = load_simulator(save_simulator(simulator, tmp_path / "rig.yaml"))
    assert read == simulator
    np.testing.assert_allclose(ChainModel(read).run(u, 5.0), angle, atol=1e-9)
    from_below = replace(trial, command=2.0 - 2.0 * np.cos(0.9 * t))
    assert simulator_of(chain, [from_below], DeviceLimits(), "by hand").rest_command is None
