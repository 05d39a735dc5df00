"""Output disturbance and learned weights together by one Kalman filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from ..estimator import EstimatorOptions, OutputEstimator
from ..inputs import usable_angle
from ..observer import Estimate, Observer
from .predictor import LearnedPredictor

_BOUND_SIGMAS = 4.0


@dataclass(frozen=True)
class LearningOptions:
    """How far the weights may be from zero, and how fast they may change.

    Attributes:
        share_sigma: standard deviation of every weight of line and plays, their sum being given, as a share of the
            model's mean slope: how the answer is shared out between small and large plays.
        slope_sigma: standard deviation of their sum, as the same share: how wrong the slope outside dead bands may be.
        rate_sigma_s: standard deviation of the weight of the model's rate [s]: how wrong lag and delay may be.
        walk: change over one unit of command travel, as a share of these.

    Raises:
        ControllerError: if a value is negative or not finite.
    """

    share_sigma: float = 0.25
    slope_sigma: float = 0.2
    rate_sigma_s: float = 0.05
    walk: float = 0.05

    def __post_init__(self) -> None:
        values = self.share_sigma, self.slope_sigma, self.rate_sigma_s, self.walk
        if not all(math.isfinite(value) and value >= 0 for value in values):
            raise ControllerError(f"adaptation: got {self}, expected finite numbers >= 0")


@final
class LearningEstimator(Observer):
    """`OutputEstimator` with the weights w of a `LearnedPredictor` as further states.

        y_k = model_k + phi_k' w + d_k + v_k,   d_{k+1} = d_k + n_k,   w_{k+1} = w_k + m_k
        z = (d, w),  h = (1, phi),  s = h' P h + r,  z <- z + P h (y - model - h' z) / s,  P <- P - P h h' P / s

    n_k is that of the plain estimator; m_k grows with the command's travel alone, so that in a hold, where one sum of
    weights is seen and no single one, nothing is forgotten. Weights stay within four standard deviations of zero.
    Outliers count as missing, and the disturbance is not corrected inside the model's dead band, as there.

    Args:
        predictor: model and learned part.
        options: of the plain estimator.
        learning: of the weights.
    """

    def __init__(self, predictor: LearnedPredictor, options: EstimatorOptions, learning: LearningOptions) -> None:
        self._predictor, self._options = predictor, options
        self._plain = OutputEstimator(predictor, options)
        self.delay_samples = options.delay_samples
        self._prior = _prior(predictor, learning)
        self._walk = learning.walk**2 * self._prior
        self._bound = _BOUND_SIGMAS * np.sqrt(np.diag(self._prior))

    def init(self, y: float, u: float) -> Estimate:
        plain = self._plain.init(y, u)
        covariance = np.zeros((self._predictor.size + 1,) * 2)
        covariance[0, 0], covariance[1:, 1:] = plain.variance, self._prior
        return replace(plain, covariance=covariance, features=(np.zeros(self._predictor.size),) * len(plain.angles))

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        innovation = usable_angle(y) - estimate.angles[0] - estimate.disturbance
        if not abs(innovation) <= self._options.outlier_deg:  # also true where it is not a number
            return replace(estimate, missing=estimate.missing + 1)
        along = np.concatenate([[1.0], estimate.features[0]])
        spread = estimate.covariance @ along
        variance = float(along @ spread) + self._options.sensor_sigma_deg**2
        gain = spread / variance
        before = self._predictor.weights(estimate.state)
        weights = np.clip(before + gain[1:] * innovation, -self._bound, self._bound)
        limit, moved = self._options.disturbance_limit_deg, gain[0] * innovation * estimate.responsive[0]
        covariance = estimate.covariance - np.outer(spread, spread) / variance
        shown = zip(estimate.angles, estimate.features, strict=True)
        return Estimate(  # `replace` takes ten times as long, here and below
            state=self._predictor.with_weights(estimate.state, weights),
            command=estimate.command,
            angles=tuple(float(angle + phi @ (weights - before)) for angle, phi in shown),
            responsive=estimate.responsive,
            moves=estimate.moves,
            disturbance=min(max(float(estimate.disturbance + moved), -limit), limit),
            variance=_variance(covariance, estimate.features[-1]),
            measured=float(y),
            stalled=estimate.stalled,
            covariance=covariance,
            features=estimate.features,
        )

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        after = self._plain.advance(estimate, u)
        return self._grown(estimate, after, self._predictor.features(after.state, estimate.state))

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self._grown(estimate, self._plain.coast(estimate, u), estimate.features[-1])

    def _grown(self, estimate: Estimate, after: Estimate, phi: Vec) -> Estimate:
        """With the covariance one sample later."""
        options, coming = self._options, after.moves[0]
        covariance = estimate.covariance.copy()
        covariance[0, 0] += options.drift_sigma_deg**2 * self._predictor.dt + options.motion_sigma_deg**2 * coming
        covariance[0, 0] = min(covariance[0, 0], options.disturbance_limit_deg**2)
        covariance[1:, 1:] += self._walk * coming
        shown = (*estimate.features[1:], phi)
        return Estimate(
            state=after.state,
            command=after.command,
            angles=after.angles,
            responsive=after.responsive,
            moves=after.moves,
            disturbance=after.disturbance,
            variance=_variance(covariance, phi),
            measured=after.measured,
            missing=after.missing,
            stalled=after.stalled,
            covariance=covariance,
            features=shown,
        )


def _prior(predictor: LearnedPredictor, learning: LearningOptions) -> Vec:
    """Covariance of the weights at first: slope is shared out freely between them, their sum is known better."""
    count = predictor.size - 1
    mean = np.full((count, count), 1.0 / count)
    shares = learning.share_sigma**2 * (np.eye(count) - mean) + learning.slope_sigma**2 * mean / count
    found = np.zeros((count + 1, count + 1))
    found[:count, :count], found[count, count] = predictor.slope**2 * shares, learning.rate_sigma_s**2
    return found


def _variance(covariance: Vec, phi: Vec) -> float:
    """Variance of disturbance and learned part together at rest [deg^2]."""
    along = np.concatenate([[1.0], phi[:-1], [0.0]])
    return max(float(along @ covariance @ along), 0.0)
