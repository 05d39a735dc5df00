"""Smooth random perturbations of plans."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat

# A noise is a matrix F (H, K): samples are F w with w standard normal (K,). Rows have unit norm, so that every
# sample of the plan is perturbed with the same variance.


def spline_noise(horizon: int, knots: int) -> Mat:
    """Cubic spline through `knots` independent normals, evenly spaced over the horizon; shape (H, knots).

    Raises:
        ControllerError: if there are fewer than 2 knots or more than samples.
    """
    if not 2 <= knots <= horizon:
        raise ControllerError(f"spline noise: got {knots} knots, expected 2 to the horizon of {horizon}")
    from scipy.interpolate import make_interp_spline  # takes half a second, which the linearised controller spares

    at = np.linspace(0.0, 1.0, knots)
    spline = make_interp_spline(at, np.eye(knots), k=min(3, knots - 1))
    return _unit_rows(spline(np.linspace(0.0, 1.0, horizon)))


def coloured_noise(horizon: int, exponent: float) -> Mat:
    """Noise with power spectrum 1 / f^exponent: 0 white, 1 pink, 2 red; shape (H, 2H).

    Amplitudes f^(-exponent / 2) on the frequencies of a window of 2H samples, so that ends are not tied together
    (Pinneri et al., "Sample-efficient cross-entropy method for real-time planning", CoRL 2020).

    Raises:
        ControllerError: if the exponent is negative.
    """
    if not exponent >= 0:
        raise ControllerError(f"coloured noise: got exponent {exponent}, expected >= 0")
    cycles = np.arange(1, horizon + 1, dtype=np.float64)
    phase = 2.0 * np.pi * np.outer(np.arange(horizon), cycles) / (2 * horizon)
    amplitude = cycles ** (-exponent / 2.0)
    return _unit_rows(np.hstack([amplitude * np.cos(phase), amplitude * np.sin(phase)]))


def random_numbers(seed: int, step: int) -> np.random.Generator:
    """The generator of one step, fixed by seed and step alone."""
    # a counter-based generator: the third word counts steps, the lower two what one step draws
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, step, 0]))


def _unit_rows(factor: Mat) -> Mat:
    return factor / np.linalg.norm(factor, axis=1, keepdims=True)
