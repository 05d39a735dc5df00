"""Harmonic balance of a PID loop beyond the first harmonic."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.linear.harmonic import HarmonicModel, through
from hystmpc.models.stages import prepared
from hystmpc.trials.types import Vec

from ..feedback import PidSettings

Complex = NDArray[np.complex128]

_POINTS, _HARMONICS, _CYCLES = 241, 15, 3  # a prime number: samples of any period then stand at all phases
_ROUNDS, _AGREE = 20, 1e-3
_WILD = 2.0  # higher harmonics of more than that of the first: they grow from round to round


class Around(NamedTuple):
    """What comes around a loop whose command has a given first harmonic.

    Attributes:
        factor: L = -V_1 / U_1 with the higher harmonics that come around, over that without them (A,).
        reach: half the peak-to-peak angle (A,) [deg].
        distortion: all higher harmonics of the command as a share of the first (A,).
        settled: whether they repeat themselves (A,).
    """

    factor: Complex
    reach: Vec
    distortion: Vec
    settled: NDArray[np.bool_]


def come_around(model: HarmonicModel, gains: PidSettings, delay_samples: int, amplitudes: Vec, omega: Vec) -> Around:
    """Follow a command around the loop until its higher harmonics repeat themselves.

        u = c + Re sum_k U_k exp(i k phi),  U_1 = -i A,   U_k = V_k for k > 1,   V = -C theta(u)

    The waveform passes the linear parts harmonic by harmonic, below half the sample rate, and the hysteresis sample by
    sample, so that it misses peaks between samples. The dead zone of the integral acts on samples, too.

    Args:
        amplitudes: A of the first harmonic (A,) [cmd].
        omega: frequency of each (A,) [rad/s].

    Source: Mees, Dynamics of Feedback Systems, 1981, chapter 5.
    """
    dt, k = model.predictor.dt, np.arange(1, _HARMONICS + 1)
    angle = np.outer(omega * dt, k)
    z, heard = np.exp(1j * angle), angle < np.pi
    first, last, run = _model(model, z)
    linear, integral = _controller(gains, dt, z, delay_samples)
    periods = np.maximum(np.rint(_POINTS * omega * dt / (2.0 * np.pi)), 1.0)
    turn = np.outer(periods, 2.0 * np.pi * np.arange(_POINTS) / _POINTS)  # in the order of the samples
    wave = np.exp(1j * k[None, :, None] * turn[:, None, :])
    back = np.asarray(np.conj(np.swapaxes(wave, 1, 2)) * (2.0 / _POINTS), dtype=np.complex128)
    u = np.zeros(z.shape, dtype=np.complex128)
    u[:, 0] = -1j * amplitudes
    before, v = u, u
    settled, theta = np.zeros(amplitudes.shape, dtype=bool), np.zeros((amplitudes.size, _POINTS))
    for turned in range(_ROUNDS):
        passed = model.centre + _shown(first * u, wave)
        driven = run(np.tile(passed, _CYCLES))[:, -_POINTS:]
        output = last * _harmonics(driven, back)
        error = -_shown(output, wave)
        counted = np.where(np.abs(error) > gains.dead_zone_deg, error, 0.0)
        v = -linear * output + integral * _harmonics(counted, back)
        before = v if turned == 0 else before
        following = np.where(heard, v, 0.0)
        following[:, 0] = u[:, 0]
        settled = np.abs(following - u).sum(axis=1) <= _AGREE * amplitudes
        wild = np.abs(following[:, 1:]).sum(axis=1) > _WILD * amplitudes
        following[wild, 1:] = 0.0
        settled &= ~wild
        u, theta = 0.5 * (u + following), -error
        if np.all(settled):
            break
    distortion = np.abs(u[:, 1:]).sum(axis=1) / amplitudes
    return Around(np.where(settled, v[:, 0] / before[:, 0], 1.0), 0.5 * np.ptp(theta, axis=1), distortion, settled)


def _model(model: HarmonicModel, z: Complex) -> tuple[Complex, Complex, Callable[[Vec], Vec]]:
    """What is linear before the hysteresis and behind it at points z; and the response (A, T) to waveforms (A, T).

    A model without a closed form is run as a whole; its memory of the first cycles has to be gone by the last one.
    """
    if model.parts is None:
        one, start = np.ones(z.shape, dtype=np.complex128), model.predictor.initial(0.0, model.centre)
        return one, one, lambda plans: model.predictor.rollout(start, plans)
    before, operator, after = model.parts
    rest = np.asarray(operator.at_rest(model.centre, model.centre, list(operator.values)), dtype=np.float64).ravel()
    run, dt = prepared((operator,), 1.0).run, model.predictor.dt
    return through(before, z, dt), through(after, z, dt), lambda w: run(np.tile(rest, (len(w), 1)), w)[0]


def _shown(harmonics: Complex, wave: Complex) -> Vec:
    """Waveforms (A, N) of harmonics (A, K)."""
    return np.asarray(np.real(np.einsum("ak,akn->an", harmonics, wave)))


def _harmonics(values: Vec, back: Complex) -> Complex:
    """Harmonics (A, K) of waveforms (A, N)."""
    return np.asarray(np.einsum("an,ank->ak", values, back))


def _controller(gains: PidSettings, dt: float, z: Complex, delay_samples: int) -> tuple[Complex, Complex]:
    """P and D parts, and the I part, of C z^-(1 + D) at points z."""
    share = dt / (gains.filter_s + dt)
    derivative = gains.kd_s_per_deg * share / dt * (z - 1.0) / (z + share - 1.0)
    late = z ** -(1 + delay_samples)
    return (gains.kp_per_deg + derivative) * late, gains.ki_per_deg_s * dt / (z - 1.0) * late


def controller_response(gains: PidSettings, dt: float, omega: Vec, errors: Vec, delay_samples: int) -> Complex:
    """Controller and delay C z^-(1 + D) at frequencies (F,) [rad/s] for error amplitudes (F, A) [deg].

    C = kp + kd a / dt (z - 1) / (z + a - 1) + ki dt / (z - 1) N_dz(e),   a = dt / (filter_s + dt)
    """
    linear, integral = _controller(gains, dt, np.exp(1j * omega * dt)[:, None], delay_samples)
    return np.asarray(linear + integral * dead_zone(errors, gains.dead_zone_deg), dtype=np.complex128)


def dead_zone(amplitudes: Vec, width: float) -> Vec:
    """Describing function of  e if |e| > width else 0:  1 - 2/pi (asin s - s sqrt(1 - s^2)),  s = min(width / A, 1)."""
    s = np.minimum(width / np.maximum(amplitudes, np.finfo(float).tiny), 1.0)
    return 1.0 - 2.0 / np.pi * (np.arcsin(s) - s * np.sqrt(1.0 - s * s))
