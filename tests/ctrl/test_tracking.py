"""What the closed loop promises on exactly known plants, with and without noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.loop import LoopLog, run_loop

from .plays import DT, LINEAR, PLAY, SOUND, Backlash, BacklashInverse, Case, ModelPlant

LIMITS = CommandLimits(0.0, 6.0, 12.0)
PREDICTIVE = ["linearised_mpc", "sampling_mpc"]


def scan(t: np.ndarray) -> np.ndarray:
    return 55.0 - 20.0 * np.cos(2 * np.pi * 0.25 * t)


def smooth_moves(t: np.ndarray) -> np.ndarray:
    """Minimum-jerk moves and holds: up to 60, down to 48 deg, up to 68."""

    def move(by: float, start: float, duration: float) -> np.ndarray:
        s = np.clip((t - start) / duration, 0.0, 1.0)
        return by * s**3 * (10 - 15 * s + 6 * s**2)

    return 29.0 + move(31.0, 0.0, 1.0) + move(-12.0, 3.0, 0.6) + move(20.0, 6.0, 0.8)


def track(
    controller: GuardedController,
    plant: ModelPlant,
    motion: Callable[[np.ndarray], np.ndarray],
    seconds: float,
    **options: Any,
) -> tuple[LoopLog, np.ndarray]:
    """The log, and the true angles less the reference (noise is in the log alone)."""

    def preview(k: int) -> np.ndarray:
        return motion(DT * (k + 1 + np.arange(controller.horizon)))

    log = run_loop(controller, plant, preview, round(seconds / DT), u_start=plant.u, **options)
    return log, np.array(plant.true[1:]) - log.reference_deg


def built(kind: str, case: Case, limits: CommandLimits = LIMITS, **options: Any) -> GuardedController:
    settings = CONTROLLERS[kind].parse({"kind": kind, **options})
    return build_controller(settings, case.predictor, case.inverse, limits)


def resting(case: Case, **options: Any) -> ModelPlant:
    return ModelPlant(case.predictor, case.y_rest, case.u_rest, **options)


@pytest.mark.slow
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("kind", PREDICTIVE)
@pytest.mark.parametrize(("motion", "rmse"), [(scan, 0.02), (smooth_moves, 0.03)])
def test_exact_model_tracks(kind: str, case: Case, motion: Callable[[np.ndarray], np.ndarray], rmse: float) -> None:
    _, error = track(built(kind, case), resting(case), motion, 9.0)
    assert math.sqrt(np.mean(error[25:] ** 2)) < rmse
    assert np.max(np.abs(error[25:])) < 0.15


@pytest.mark.parametrize("kind", PREDICTIVE)
@pytest.mark.parametrize("noise", [0.0, 0.15])
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
def test_a_hold_holds(kind: str, noise: float, seed: int) -> None:
    log, error = track(built(kind, PLAY), resting(PLAY, noise_deg=noise, seed=seed), smooth_moves, 14.0)
    for start, end in [(1.8, 2.15), (4.5, 5.15), (7.8, 14.0)]:  # the next move is not in the preview yet
        during = (log.time_s > start) & (log.time_s < end)
        assert np.ptp(log.command[during]) < 0.01  # mm; a tenth of the half-width is 0.03
        assert np.max(np.abs(error[during])) < (0.05 if noise == 0 else 0.3)


@pytest.mark.parametrize("kind", ["inverse", *PREDICTIVE])
def test_reversal_crosses_the_dead_band_as_fast_as_the_rate_limit_allows(kind: str) -> None:
    model = Backlash()
    limits = CommandLimits(0.0, 6.0, 2.0)
    u = 60.0 / model.m_up - model.c_up
    reach = limits.rate * DT
    fewest = math.ceil(model.width(u) / reach)
    assert fewest > 5
    controller = built(kind, PLAY, limits)
    state, plant = controller.init(60.0, u), ModelPlant(model, 60.0, u)
    y = plant.reset()
    for _ in range(5):
        command, state = controller.step(state, y, np.full(controller.horizon, 60.0))
        y = plant.apply(command.u)
        assert command.u == pytest.approx(u, abs=1e-6)
    for n in range(1, fewest + 1):
        command, state = controller.step(state, y, np.full(controller.horizon, 56.0))
        y = plant.apply(command.u)
        assert command.u == pytest.approx(u - n * reach, abs=1e-6)
    assert y < 60.0


def test_preview_crosses_the_dead_band_before_the_reference_turns() -> None:
    limits = CommandLimits(0.0, 6.0, 4.0)
    _, late = track(built("inverse", PLAY, limits), resting(PLAY), scan, 9.0)
    _, ahead = track(built("linearised_mpc", PLAY, limits), resting(PLAY), scan, 9.0)
    assert np.max(np.abs(ahead[30:])) < 0.5 * np.max(np.abs(late[30:]))


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("kind", PREDICTIVE)
@pytest.mark.parametrize(("learns", "close_deg"), [(False, 0.01), (True, 0.03)])  # a hold tolerates 0.03 deg
def test_constant_output_offset_leaves_no_error(kind: str, case: Case, learns: bool, close_deg: float) -> None:
    plant, settings = resting(case), {} if learns else {"adaptation": None}

    def push(sample: Any) -> None:
        plant.offset_deg = 3.0 if sample.time_s > 2.5 else 0.0

    log, error = track(built(kind, case, **settings), plant, smooth_moves, 9.0, on_sample=push)
    assert log.disturbance_deg[-1] == pytest.approx(3.0, abs=close_deg)
    assert np.max(np.abs(error[-20:])) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("kind", ["inverse", *PREDICTIVE])
def test_known_delay_costs_nothing_but_the_beginning(kind: str, case: Case) -> None:
    controller = built(kind, case, estimator={"delay_samples": 3})
    log, error = track(controller, resting(case, delay_samples=3), scan, 9.0)
    assert math.sqrt(np.mean(error[25:] ** 2)) < 0.03
    np.testing.assert_allclose(log.predicted_deg, log.measured_deg, atol=1e-6)


def test_ignored_delay_is_felt() -> None:
    _, error = track(built("linearised_mpc", PLAY), resting(PLAY, delay_samples=3), scan, 9.0)
    assert math.sqrt(np.mean(error[25:] ** 2)) > 0.1


@pytest.mark.parametrize("kind", PREDICTIVE)
def test_soft_angle_limit_is_kept_where_it_can_be(kind: str) -> None:
    controller = built(kind, PLAY, weights={"angle_upper_deg": 65.0, "soft_limit": 1e4})
    log, _ = track(controller, resting(PLAY), scan, 5.0)
    assert log.reference_deg.max() > 74.0
    assert log.measured_deg.max() < 65.05
    assert set(log.source) == {"mpc"}


@pytest.mark.parametrize("kind", ["pid", "inverse_pid"])
def test_integral_action_removes_an_offset(kind: str) -> None:
    plant = resting(LINEAR, offset_deg=0.0)

    def push(sample: Any) -> None:
        plant.offset_deg = 2.0

    _, error = track(built(kind, LINEAR), plant, lambda t: np.full_like(t, 50.0), 12.0, on_sample=push)
    assert np.max(np.abs(error[-20:])) <= 0.2 + 1e-9  # the dead zone


@pytest.mark.parametrize("kind", ["pid", "inverse_pid"])
def test_integrator_does_not_wind_up_at_a_limit(kind: str) -> None:
    def unreachable(t: np.ndarray) -> np.ndarray:
        return np.where(t < 6.0, 200.0, 60.0)

    log, error = track(built(kind, LINEAR), resting(LINEAR), unreachable, 12.0)
    assert log.command.max() == 6.0
    assert np.max(np.abs(error[-25:])) < 0.5


@pytest.mark.parametrize("kind", list(CONTROLLERS))
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
def test_nothing_to_do_is_nothing_done(kind: str, case: Case) -> None:
    log, _ = track(built(kind, case), resting(case), lambda t: np.full_like(t, case.y_rest), 1.0)
    np.testing.assert_allclose(log.command, case.u_rest, atol=1e-9)


def test_inverse_ignores_a_reference_that_only_trembles() -> None:
    model = Backlash()
    u = 60.0 / model.m_up - model.c_up
    controller = build_controller(CONTROLLERS["inverse"](), model, BacklashInverse(model), LIMITS)
    random = np.random.default_rng(0)
    state = controller.init(60.0, u)
    for _ in range(50):
        command, state = controller.step(state, 60.0, 60.0 + random.uniform(-0.02, 0.02, 1))
        assert command.u == pytest.approx(u)
