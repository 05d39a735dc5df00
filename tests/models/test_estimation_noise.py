"""Laws of the noise that a model file knows: found in residuals, kept in files, absent where nothing is known."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.contract.metadata import DeviceLimits, ModelMetadata, NoiseModel, slow_error
from hystmpc.models.identify.estimation_noise import estimation_noise
from hystmpc.models.identify.simulators import identify
from hystmpc.models.load import library_file, load_model
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.prediction.build import controller_model, predictor_for
from hystmpc.models.simulator import ChainModel, export_simulator, load_simulator, save_simulator
from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

DT = 0.04


def trials(count: int = 3, seconds: float = 40.0) -> list[Trial]:
    """Flexures of growing speed with rests in between."""
    t = np.arange(0.0, seconds, DT)
    travel = np.cumsum(np.where(np.sin(0.3 * t) > 0, DT, 0.0))
    return [
        Trial(t, u, 10.0 * u, source=f"flexure {k}")
        for k, u in enumerate(2.5 - 2.5 * np.cos(2 * np.pi * 0.1 * (k + 1) * travel) for k in range(count))
    ]


def residuals(given: list[Trial], noise: NoiseModel, seed: int = 5) -> list[Vec]:
    random, found = np.random.default_rng(seed), []
    for trial in given:
        moves = np.abs(np.diff(trial.command, prepend=trial.command[0]))
        steps = noise.drift_sigma_deg_per_sqrt_s**2 * DT + noise.motion_sigma_deg_per_sqrt_unit**2 * moves
        white = noise.sensor_sigma_deg * random.standard_normal(len(trial))
        found.append(np.cumsum(np.sqrt(steps) * random.standard_normal(len(trial))) + white)
    return found


def noise_of(sensor: float, drift: float, motion: float) -> NoiseModel:
    return NoiseModel(sensor_sigma_deg=sensor, drift_sigma_deg_per_sqrt_s=drift, motion_sigma_deg_per_sqrt_unit=motion)


@pytest.mark.parametrize(("sensor", "drift", "motion"), [(0.15, 0.3, 1.0), (0.03, 0.1, 0.5), (0.3, 0.2, 2.0)])
def test_the_noises_behind_residuals_are_found(sensor: float, drift: float, motion: float) -> None:
    given = trials()
    found = estimation_noise(given, residuals(given, noise_of(sensor, drift, motion)))
    assert found.sensor_sigma_deg == pytest.approx(sensor, rel=0.1)
    assert found.drift_sigma_deg_per_sqrt_s == pytest.approx(drift, rel=0.35)
    assert found.motion_sigma_deg_per_sqrt_unit == pytest.approx(motion, rel=0.2)


def test_white_residuals_are_the_sensor_s_alone() -> None:
    given = trials()
    found = estimation_noise(given, residuals(given, noise_of(0.2, 0.0, 0.0)))
    assert found.sensor_sigma_deg == pytest.approx(0.2, rel=0.05)
    assert found.drift_sigma_deg_per_sqrt_s < 0.02
    assert found.motion_sigma_deg_per_sqrt_unit < 0.02


def test_an_offset_of_a_trial_is_no_noise_but_an_error_without_a_sensor() -> None:
    given = trials()
    plain = residuals(given, noise_of(0.15, 0.1, 0.5))
    shifted = [residual + 3.0 * k for k, residual in enumerate(plain)]
    found, same = (estimation_noise(given, left) for left in (shifted, plain))
    noises = [list(noise.model_dump(exclude={"model_sigma_deg"}).values()) for noise in (found, same)]
    assert noises[0] == pytest.approx(noises[1], rel=1e-6)
    assert found.model_sigma_deg is not None
    assert found.model_sigma_deg > math.sqrt(np.mean(np.square([0.0, 3.0, 6.0])))


def test_residuals_of_what_was_fitted_count_for_more() -> None:
    """Drift and motion grow with the parameters, at most twofold; the sensor's noise does not."""
    given = trials()
    left = residuals(given, noise_of(0.15, 0.3, 1.0))
    found = [estimation_noise(given, left, fitted) for fitted in (0, 5, 10_000)]
    drifts = [noise.drift_sigma_deg_per_sqrt_s for noise in found]
    assert drifts[0] < drifts[1] < drifts[2]
    assert drifts[2] == pytest.approx(2.0 * drifts[0])
    assert len({noise.sensor_sigma_deg for noise in found}) == 1


@pytest.mark.parametrize("bad", [np.zeros(1), np.zeros(5000), np.full(30, np.nan)])
def test_unusable_residuals_are_refused(bad: Vec) -> None:
    with pytest.raises(FitError, match=r"flexure 0: got \d+ residuals, expected 2 to 1000 finite ones"):
        estimation_noise(trials(1), [bad])
    with pytest.raises(FitError, match="got no residuals"):
        estimation_noise([], [])


@pytest.mark.slow
def test_an_identified_simulator_knows_its_noise_and_keeps_it_in_both_files(tmp_path: Path) -> None:
    """The sensor's noise is found; file, export, predictor and what is built on it say the same."""
    truth, random = ChainModel(load_simulator(library_file("backlash"))), np.random.default_rng(3)
    seen = []
    for trial in trials(2):
        angle = truth.run(trial.command, float(truth.metadata.trained_angle.lower))
        seen.append(
            Trial(trial.t, trial.command, angle + 0.1 * random.standard_normal(angle.size), source=trial.source)
        )
    simulator, _ = identify("backlash", seen, limits=DeviceLimits())
    noise = simulator.identification.noise
    assert noise is not None
    assert noise.sensor_sigma_deg == pytest.approx(0.1, rel=0.1)
    save_simulator(simulator, tmp_path / "model.yaml")
    export_simulator(simulator, tmp_path / "model.onnx")
    for name in ("model.yaml", "model.onnx"):
        model = load_model(tmp_path / name)
        assert model.metadata.noise == noise
        known = controller_model(model)
        assert known.predictive[0].noise == noise
        assert known.behind((Lag(0.08),), model.metadata).predictive[0].noise == noise


def test_files_without_these_facts_load_as_before() -> None:
    for name in ("pi", "backlash"):
        model = load_model(library_file(name))
        assert model.metadata.noise is None
        assert predictor_for(model).noise is None
    properties = model.metadata.to_properties()
    del properties["hystmpc.noise"]
    assert ModelMetadata.from_properties(properties, "file") == model.metadata


def test_facts_out_of_bounds_are_refused() -> None:
    facts = load_model(library_file("pi")).metadata
    known = facts.model_copy(update={"noise": noise_of(0.1, 0.2, 0.3)}).to_properties()
    assert ModelMetadata.from_properties(known, "file").noise == noise_of(0.1, 0.2, 0.3)
    bad = known | {"hystmpc.noise": known["hystmpc.noise"].replace("0.1", "-0.1")}
    with pytest.raises(ModelError, match=r"noise\.sensor_sigma_deg"):
        ModelMetadata.from_properties(bad, "file")


def test_the_slow_error_of_a_model_is_told_from_the_noise_of_the_sensor() -> None:
    """A sine of .4 deg and an offset under white noise of .2 deg: the root mean square of the sine."""
    t, random = np.arange(3000) * DT, np.random.default_rng(3)
    trial = Trial(t, np.sin(t), np.zeros(t.size))
    slow = 0.4 * np.sin(0.7 * t)
    found = estimation_noise([trial], [slow + 0.1 + 0.2 * random.standard_normal(t.size)])
    assert found.model_sigma_deg == pytest.approx(math.sqrt(np.mean(slow**2)), rel=0.1)
    white = estimation_noise([trial], [0.2 * random.standard_normal(t.size)])
    assert white.model_sigma_deg is not None
    assert white.model_sigma_deg < 0.05


@given(st.lists(st.floats(-1.0, 10.0), min_size=1, max_size=9), st.integers(0, 5))
def test_trials_that_differ_say_less_of_other_motions(squares: list[float], seed: int) -> None:
    """The error is at least that of all samples. It is that where trials are alike, and does not know their order."""
    samples = np.random.default_rng(seed).integers(5, 500, len(squares)).tolist()
    mean = float(np.average(squares, weights=samples))
    error = slow_error(squares, samples)
    assert error**2 >= max(mean, 0.0) - 1e-9
    assert slow_error([mean] * len(squares), samples) == pytest.approx(math.sqrt(max(mean, 0.0)), abs=1e-6)
    assert slow_error(squares[::-1], samples[::-1]) == pytest.approx(error, abs=1e-6)


@pytest.mark.parametrize("spread", [0.0, 0.5, 1.0])
def test_the_band_holds_nine_in_ten_errors_of_motions_that_are_not_among_the_trials(spread: float) -> None:
    """Of motions whose sizes of error differ by `spread` in the logarithm; six trials under noise of the same size."""
    random, within = np.random.default_rng(7), []

    def slow() -> Vec:
        raw = random.standard_normal(500 + 12)
        smooth = np.convolve(raw, np.ones(12) / math.sqrt(12.0), "valid")[:500]
        return 0.1 * math.exp(spread * random.standard_normal()) * smooth

    t = np.arange(500) * DT
    for _ in range(60):
        left = [slow() + 0.1 * random.standard_normal(500) for _ in range(6)]
        sigma = estimation_noise([Trial(t, np.sin(t), np.zeros(500))] * 6, left).model_sigma_deg
        assert sigma is not None
        within += [np.abs(slow()) <= 1.645 * sigma for _ in range(5)]
    assert 0.885 <= float(np.mean(within)) <= 0.92


def test_one_trial_counts_as_its_thirds() -> None:
    t = np.arange(900) * DT
    trial = Trial(t, np.sin(t), np.zeros(900))
    residual = np.repeat([0.1, 0.2, 0.6], 300) * np.sign(np.sin(3.0 * t))
    whole, parts = (
        estimation_noise([trial.select(0, left.size) for left in lefts], lefts).model_sigma_deg
        for lefts in ([residual], np.array_split(residual, 3))
    )
    assert whole == pytest.approx(parts)
    assert whole is not None
    assert whole > math.sqrt(np.mean(residual**2))
