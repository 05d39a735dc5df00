"""Laws of devices that ring: the linear limit, energy, the input between samples, and a device found again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.decades import Decades
from hystmpc.models.identify import least_squares
from hystmpc.models.identify.chain_fit import OperatorFitSettings, identify_chain
from hystmpc.models.identify.chain_kinds import Ringing
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.operators.dynamics import Servo
from hystmpc.models.operators.oscillator import Oscillator, StateNetwork
from hystmpc.trials.errors import ModelError
from hystmpc.trials.trial import Trial, Units

from .running import run_chain

DT = 1 / 200
DEVICE = Oscillator(2.0, 4.0, 3e3, 2e3, 40.0, -25.0)


def noise_like(samples: int, top_hz: float, seed: int = 0, dt: float = DT) -> np.ndarray:
    """A periodic force of unit deviation without steps, of random phases up to a frequency [Hz]."""
    lines = np.zeros(samples // 2 + 1, dtype=complex)
    used = slice(1, int(top_hz * samples * dt))
    lines[used] = np.exp(2j * np.pi * np.random.default_rng(seed).random(lines[used].size))
    force = np.fft.irfft(lines, samples)
    return np.asarray(force / force.std())


def recorded(device: Oscillator, force: np.ndarray) -> Trial:
    answer = run_chain(Chain(device), force, dt=DT)
    return Trial(np.arange(force.size) * DT, force, answer, units=Units("N", "m"))


def test_without_memory_it_is_the_exact_response_of_second_order() -> None:
    """m y'' + c y' + k y = u beside the closed form for an input in straight lines, y and y' included."""
    w, damping = 12.0, 0.1
    mass = 0.5
    linear = Oscillator(mass, 2 * damping * w * mass, w * w * mass, 0.0, 0.0, 0.0, hold=1, steps=4)
    force = np.concatenate([np.zeros(3), noise_like(400, 10.0)])
    exact = run_chain(Chain(Servo(2 * damping / w, damping)), force, dt=DT)
    np.testing.assert_allclose(w * w * mass * run_chain(Chain(linear), force, dt=DT), exact, atol=1e-7)


@given(
    state=st.tuples(*(st.floats(-1.0, 1.0),) * 3),
    gamma=st.floats(0.0, 50.0),
    share=st.floats(-1.0, 1.0),
)
def test_the_hysteretic_force_creates_no_energy(state: tuple[float, float, float], gamma: float, share: float) -> None:
    """With |delta| <= gamma, m v^2 / 2 + k y^2 / 2 + z^2 / (2 alpha) never rises while no force acts."""
    mass, stiffness, alpha = 2.0, 3e3, 2e3
    device = Oscillator(mass, 0.0, stiffness, alpha, gamma, share * gamma, hold=1, steps=4)
    chain, x, energies = Chain(device), np.array([0.05, 2.0, 100.0]) * state, []
    x = np.append(x, 0.0)
    for _ in range(60):
        y, v, z, _ = x
        energies.append(mass * v * v / 2 + stiffness * y * y / 2 + z * z / (2 * alpha))
        x = np.asarray(chain.transition(x, 0.0, chain.values, DT)[1]).ravel()
    assert np.all(np.diff(energies) <= 1e-6 * energies[0] + 1e-15)


def test_at_rest_it_stays() -> None:
    seen, device = 0.02, DEVICE
    force = np.full(50, (device.stiffness + device.alpha) * seen)
    np.testing.assert_allclose(run_chain(Chain(device), force, seen=seen, dt=DT), seen, rtol=1e-12)


def test_a_cubic_follows_a_force_without_steps_better_than_straight_lines() -> None:
    """Beside the same device whose force is sampled sixteen times as fast."""
    many = 16
    fine = 100.0 * noise_like(1600 * many, 20.0, dt=DT / many)
    truth = run_chain(Chain(DEVICE), fine, dt=DT / many)[::many]
    errors = []
    for hold in (1, 2, 3):
        device = Oscillator(*DEVICE.values, hold=hold)
        errors.append(np.std((run_chain(Chain(device), fine[::many], dt=DT) - truth)[800:]) / np.std(truth))
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < 0.3 * errors[0]


def test_the_resonance_is_read_off_the_trials() -> None:
    linear = Oscillator(2.0, 12.0, 5e3, 0.0, 0.0, 0.0)
    found = Ringing.of([recorded(linear, noise_like(8000, 30.0))])
    assert found.rad_per_s == pytest.approx(50.0, rel=0.05)
    assert found.stiffness == pytest.approx(5e3, rel=0.5)
    assert found.lead_s < 10.0


@pytest.mark.slow
@pytest.mark.parametrize("metre", [1.0, 1e6], ids=["m", "um"])
def test_a_device_is_found_again_in_any_unit(metre: float) -> None:
    """From a log that starts in motion, whose first fifth does not count."""
    trial = recorded(DEVICE, 100.0 * noise_like(4000, 20.0)).select(100)
    trial = Trial(trial.t - trial.t[0], trial.command, trial.angle * metre, units=Units("N", "m"))
    chain, fit = identify_chain("oscillator", [trial], settings=OperatorFitSettings(restarts=0))
    assert fit.rmse_deg < 1e-4 * float(np.std(trial.angle)), fit.report.line()
    np.testing.assert_allclose(chain.values * metre, DEVICE.values, rtol=1e-3)


def test_many_samples_are_condensed_without_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = recorded(DEVICE, 100.0 * noise_like(2000, 20.0))
    found = []
    for many in (10**9, 10):
        monkeypatch.setattr(least_squares, "_MANY", many)
        settings = OperatorFitSettings(restarts=0, evaluations=4)
        found.append(identify_chain("oscillator", [trial], settings=settings)[0].values)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)


def test_units_that_are_products_are_brought_back() -> None:
    decades = Decades(command=100.0, angle=1e-3)
    assert decades.in_log("cmd s^2/deg") == pytest.approx(1e5)
    assert decades.in_log("cmd s/deg^2") == pytest.approx(1e8)
    assert decades.in_log("s") == 1.0


def test_a_state_network_without_neurons_is_its_linear_system() -> None:
    a, b = np.array([[0.9, 0.2], [-0.2, 0.8]]), np.array([[0.1, 0.05], [0.0, 0.3]])
    blank = {"w": (0.0,) * 4, "vx": (1.0,) * 4, "vu": (1.0,) * 4, "c": (0.5, -0.5)}
    network = StateNetwork(tuple(a.ravel()), tuple(b.ravel()), **blank, order=2, hidden=2)
    u = noise_like(60, 20.0)
    x, before, expected = np.zeros(2), u[0], []
    for force in u:
        x, before = a @ x + b @ (force, before), force
        expected.append(x[0])
    np.testing.assert_allclose(run_chain(Chain(network), u, dt=DT), expected, atol=1e-12)


def test_a_matrix_that_does_not_fit_is_named() -> None:
    with pytest.raises(ModelError, match=r"state_network.vx: 3 numbers, expected 4"):
        StateNetwork((0.0,) * 4, (0.0,) * 4, (0.0,) * 4, (0.0,) * 3, (0.0,) * 4, (0.0,) * 2, order=2, hidden=2)


def test_runs_of_a_chain_and_of_its_step_agree_over_a_whole_record() -> None:
    force = 100.0 * noise_like(500, 20.0)
    staged = StagedChain(Chain(DEVICE))
    start = staged.rest(force[:1], np.zeros(1))
    together = staged.simulate(force[:, None], DT, start)[0][:, 0]
    np.testing.assert_allclose(together, run_chain(Chain(DEVICE), force, dt=DT), atol=1e-12)
