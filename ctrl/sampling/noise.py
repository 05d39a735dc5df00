"""Smooth random perturbations of plans.

A noise is a matrix F (H, K): samples are F w with w standard normal (K,). Rows have unit norm, so that every sample of
the plan is perturbed with the same variance.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat

from ..limits import NotNegative


class SplineNoiseSettings(Settings):
    """Cubic spline through `knots` independent normals, evenly spaced over the horizon."""

    kind: Literal["spline"] = "spline"
    knots: Annotated[int, Field(ge=2)] = 6

    def matrix(self, horizon: int) -> Mat:
        """F (H, knots).

        Raises:
            ControllerError: if there are more knots than samples.
        """
        if self.knots > horizon:
            raise ControllerError(f"spline noise: got {self.knots} knots, expected 2 to the horizon of {horizon}")
        from scipy.interpolate import make_interp_spline  # takes half a second, which the linearised controller spares

        at = np.linspace(0.0, 1.0, self.knots)
        spline = make_interp_spline(at, np.eye(self.knots), k=min(3, self.knots - 1))
        return _unit_rows(spline(np.linspace(0.0, 1.0, horizon)))


class ColouredNoiseSettings(Settings):
    """Noise with power spectrum 1 / f^exponent: 0 white, 1 pink, 2 red.

    Amplitudes f^(-exponent / 2) on the frequencies of a window of 2H samples, so that ends are not tied together
    (Pinneri et al., "Sample-efficient cross-entropy method for real-time planning", CoRL 2020).
    """

    kind: Literal["coloured"] = "coloured"
    exponent: NotNegative = 2.0

    def matrix(self, horizon: int) -> Mat:
        """F (H, 2H)."""
        cycles = np.arange(1, horizon + 1, dtype=np.float64)
        phase = 2.0 * np.pi * np.outer(np.arange(horizon), cycles) / (2 * horizon)
        amplitude = cycles ** (-self.exponent / 2.0)
        return _unit_rows(np.hstack([amplitude * np.cos(phase), amplitude * np.sin(phase)]))


def random_numbers(seed: int, step: int) -> np.random.Generator:
    """The generator of one step, fixed by seed and step alone."""
    # a counter-based generator: the third word counts steps, the lower two what one step draws
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, step, 0]))


def _unit_rows(factor: Mat) -> Mat:
    return factor / np.linalg.norm(factor, axis=1, keepdims=True)
