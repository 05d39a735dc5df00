"""What a simulator's file says on its own form error counts only where it comes from other trials."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from hystmpc.gap.logs.preparation import model_form_mse, nominal_noise_deg
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import DeviceLimits
from hystmpc.models.identify.runs import fingerprint
from hystmpc.models.identify.simulators import simulator_of
from hystmpc.models.simulator import Identification, Residual, Simulator, load_simulator, save_simulator
from hystmpc.trials.trial import Trial, resample

from ..models.zoo import BACKLASH
from .engine_examples import moves, trials_of

TRIALS = trials_of(Chain(BACKLASH), [moves(1), moves(2)])
OTHERS = trials_of(Chain(BACKLASH), [moves(3), moves(4)])
MOTIONS = ("sine", "holds")
DT = TRIALS[0].dt


def residual(
    motion: Literal["holds", "continuous"], rmse_deg: float, print_of: int | None = None, lag_one: float = 0.5
) -> Residual:
    """One line of a simulator's file."""
    mark = "" if print_of is None else fingerprint([OTHERS[print_of]])
    return Residual(
        log="a.csv", motion=motion, samples=100, rmse_deg=rmse_deg, bias_deg=0.0, lag_one=lag_one, fingerprint=mark
    )


def test_a_file_that_does_not_say_has_no_form_error() -> None:
    assert model_form_mse(Identification(method="known"), TRIALS, MOTIONS, DT) == 0.0
    assert nominal_noise_deg(Identification(method="known")) is None


def test_it_is_taken_by_motion_type() -> None:
    stored = (residual("continuous", 1.0, 0), residual("continuous", 2.0, 1), residual("holds", 3.0))
    known = Identification(method="fit", residuals=stored)
    assert model_form_mse(known, TRIALS, ("sine", "sines"), DT) == pytest.approx(2.5)
    assert model_form_mse(known, TRIALS, ("holds", "point_to_point"), DT) == pytest.approx(9.0)
    assert model_form_mse(known, TRIALS, MOTIONS, DT) == pytest.approx((2.5 + 9.0) / 2)


def test_a_motion_it_never_saw_takes_the_mean_of_all() -> None:
    known = Identification(method="fit", residuals=(residual("continuous", 1.0), residual("continuous", 3.0)))
    assert model_form_mse(known, TRIALS, ("holds", "steps"), DT) == pytest.approx(5.0)


def test_trials_that_it_was_identified_from_say_nothing() -> None:
    """Their residuals hold the gap itself."""
    stored = (residual("continuous", 2.0, 0), residual("holds", 2.0, 1))
    known = Identification(method="fit", residuals=stored)
    assert model_form_mse(known, TRIALS, MOTIONS, DT) > 0
    assert model_form_mse(known, [TRIALS[0], OTHERS[1]], MOTIONS, DT) == 0.0
    older = Identification(method="fit", residuals=(residual("holds", 2.0),), training_data_hash=fingerprint(TRIALS))
    assert model_form_mse(older, TRIALS, MOTIONS, DT) == 0.0
    assert model_form_mse(older, OTHERS, MOTIONS, DT) > 0


def logs_at(hz: float, seed: int, decimals: int = 9) -> list[Trial]:
    """Two trials as a logger of that rate would write them down, its clock started before the first sample."""
    logs = []
    for trial in trials_of(Chain(BACKLASH), [moves(seed), moves(seed + 1)]):
        t = np.round(3.7 + np.arange(round(trial.duration_s * hz)) / hz, decimals)
        own = t - 3.7
        logs.append(Trial(t, np.interp(own, trial.t, trial.command), np.interp(own, trial.t, trial.angle)))
    return logs


def identified_on(logs: list[Trial], rate_hz: float, folder: Path) -> Simulator:
    """What `fit` makes of logs, read back from its file."""
    made = simulator_of(Chain(BACKLASH), [resample(log, rate_hz) for log in logs], DeviceLimits(), "fit")
    return load_simulator(save_simulator(made, folder / "sim.yaml"))


@pytest.mark.parametrize("rate_hz", [25.0, 29.97, 30.0, 1 / 0.03, 50.0, 60.0])
@pytest.mark.parametrize(("logger", "decimals"), [(500.0, 4), (1.0, 9), (1.0, 3)])
def test_it_knows_the_logs_that_it_was_identified_from(
    rate_hz: float, logger: float, decimals: int, tmp_path: Path
) -> None:
    """Whatever the rate, the logger's own rate (500 Hz, or the same rate) and the digits of its time stamps."""
    own_hz = logger if logger > rate_hz else rate_hz
    logs, others = logs_at(own_hz, 1, decimals), logs_at(own_hz, 3, decimals)
    made = identified_on(logs, rate_hz, tmp_path)
    assert model_form_mse(made.identification, logs, MOTIONS, made.dt_s) == 0.0
    assert model_form_mse(made.identification, logs, MOTIONS, round(made.dt_s, 9)) == 0.0  # as older files have it
    assert model_form_mse(made.identification, [others[0], logs[1]], MOTIONS, made.dt_s) == 0.0
    assert model_form_mse(made.identification, others, MOTIONS, made.dt_s) > 0.0


def test_it_knows_logs_slower_than_itself(tmp_path: Path) -> None:
    """`fit` takes 20 Hz logs at its 25 Hz."""
    logs = logs_at(20.0, 1)
    made = identified_on(logs, 25.0, tmp_path)
    assert model_form_mse(made.identification, logs, MOTIONS, made.dt_s) == 0.0


def test_logs_that_it_could_not_have_taken_are_others(tmp_path: Path) -> None:
    made = identified_on(logs_at(60.0, 1), 60.0, tmp_path)
    assert model_form_mse(made.identification, logs_at(25.0, 1), MOTIONS, made.dt_s) > 0.0


def test_white_noise_is_bounded_by_the_correlation_of_neighbours() -> None:
    """AR(1) of correlation a, variance s^2, and white noise w^2: the bound is s^2 (1 - a) + w^2."""
    random, a, s, w = np.random.default_rng(0), 0.97, 0.5, 0.1
    slow = np.zeros(200_000)
    steps = s * np.sqrt(1 - a**2) * random.standard_normal(slow.size)
    for k in range(1, slow.size):
        slow[k] = a * slow[k - 1] + steps[k]
    signal = slow + w * random.standard_normal(slow.size)
    lag_one = float(np.corrcoef(signal[1:], signal[:-1])[0, 1])
    rmse = float(np.std(signal))
    noise = nominal_noise_deg(Identification(method="fit", residuals=(residual("holds", rmse, lag_one=lag_one),)))
    assert noise == pytest.approx(np.sqrt(s**2 * (1 - a) + w**2), rel=0.05)
    assert noise is not None
    assert noise > w
