"""Fits of play kernels to long trials: what is held at once, and that blocks of samples change no number."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.play_kernel import fit
from hystmpc.models.play_kernel.fit import PlayKernelKind, PlayKernelSettings, fit_play_kernel
from hystmpc.models.play_kernel.predictor import follow_plays
from hystmpc.models.play_kernel.weights import PlayKernelStep
from hystmpc.trials.trial import Trial


def long_trial(seed: int, size: int) -> Trial:
    """A loop of one play along three sines, with noise."""
    random, t = np.random.default_rng(seed), np.arange(size) / 25
    command = 3 + 1.2 * np.sin(0.7 * t + seed) + 1.1 * np.sin(0.23 * t) + 0.5 * np.sin(1.9 * t)
    angle = 10 * follow_plays(command, 1.0, np.array([0.3]), np.full(2, command[0]))[:, 1]
    return Trial(t, command, angle + random.normal(0, 0.1, size), source=f"{seed}.csv")


FEW = PlayKernelSettings(plays=4, segments=5, lags_s=(0.0, 0.04), smoothness=(3e-6, 3e-5))


@pytest.mark.slow
def test_a_fit_holds_the_features_of_one_block_only() -> None:
    """Of these 100,000 samples the features alone are 146 MB; what is held must not grow with them."""
    trials = [long_trial(k, 50_000) for k in range(2)]
    settings = PlayKernelSettings(lags_s=(0.0, 0.02), smoothness=(3e-6,))
    fit_play_kernel([t.select(0, 500) for t in trials], settings)  # what is imported once
    tracemalloc.start()
    try:
        fit_play_kernel(trials, settings)
        assert tracemalloc.get_traced_memory()[1] < 120e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("skip_first_flexure", [False, True])
def test_blocks_change_no_number(skip_first_flexure: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    trials = [long_trial(k, 1_200) for k in range(3)]
    whole = fit_play_kernel(trials, FEW, skip_first_flexure)
    monkeypatch.setattr(fit, "BLOCK", 37)
    parts = fit_play_kernel(trials, FEW, skip_first_flexure)
    assert parts.choice == whole.choice
    assert parts.rmse == pytest.approx(whole.rmse, rel=1e-9)
    for choice, error in whole.judged.items():
        assert parts.judged[choice] == pytest.approx(error, rel=1e-9)
    np.testing.assert_allclose(parts.weights.slopes, whole.weights.slopes, rtol=1e-6, atol=1e-9)


def free_run(step: PlayKernelStep, commands: np.ndarray) -> np.ndarray:
    """Angles (T,) of the reference step, from rest."""
    state, theta = np.full((1, step.state_size), commands[0]), np.empty(commands.size)
    for k, u in enumerate(commands.tolist()):
        shown, state = step.advance(state, np.array([[u]]))
        theta[k] = shown.item()
    return theta


def test_the_error_is_that_of_the_model_that_is_returned() -> None:
    """Each trial about its own offset, run freely by the reference step."""
    trials = [long_trial(k, 600) for k in range(3)]
    found = fit_play_kernel(trials, FEW)
    step = PlayKernelStep(found.weights)
    left = [np.std(free_run(step, own.command) - own.angle) for own in trials]
    assert found.rmse == pytest.approx(float(np.mean(left)), rel=1e-6)


def test_only_a_long_fit_is_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    trials = [long_trial(k, 1_200) for k in range(2)]
    request = FitRequest(training="best")
    assert PlayKernelKind().estimate(trials, request) is None
    monkeypatch.setattr(fit, "_SOON", 2_000)
    seconds = PlayKernelKind().estimate(trials, request)
    assert seconds is not None
    assert seconds > 0
