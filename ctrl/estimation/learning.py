"""A learned Prandtl-Ishlinskii part on top of a model: predictor, inverse, and the Kalman filter of its weights."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, final

import numpy as np

from hystmpc.models.inverse.follow import Bounds, Follower, follower_for
from hystmpc.models.kernels.numba_ import njit
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from ..analysis import static_gain
from ..planning_settings import AdaptationSettings
from .observer import Estimate, EstimatorSettings, Observer, OutputEstimator, usable_angle

_EDGE = 1e-12

_ROUNDS = 2

_BOUND_SIGMAS = 4.0


@final
class LearnedPredictor(Predictor):
    """theta = model(u) + w_0 (v - v_0) + sum_i w_i (p_i - p_i0) + w_v d model / dt.

    v is the command behind the lag, p_i plays of half-width r_i on v: a Prandtl-Ishlinskii operator whose weights may
    have either sign, since it is added to a model that is nearly right. The last term is what a lag or delay slightly
    other than the model's leaves over, to first order. The weights stand still in a roll-out; an estimator changes
    them. Where all are zero, this is the model.

    The state is [model state, p (K), v, model angle, v_0, side, w (K + 2)].
    """

    def __init__(self, model: Predictor, settings: AdaptationSettings) -> None:
        self.dt, self.command_range, self.noise, self.model = model.dt, model.command_range, model.noise, model
        low, high = model.command_range
        self.radii = (high - low) * settings.widest_share * np.arange(1, settings.plays + 1) / max(settings.plays, 1)
        self.gain = 1.0 if settings.lag_s == 0 else 1.0 - math.exp(-model.dt / settings.lag_s)
        self.size = settings.plays + 2
        self._pace = 1.0 / model.dt
        self.slope = static_gain(model)
        self._own = settings.plays + 4 + self.size

    def initial(self, y: float, u: float) -> Vec:
        base = self.model.initial(y, u)
        low, high = self.command_range
        # a device that rests near one end of its command has come from the other side
        side = 1.0 if u < 0.5 * (low + high) else -1.0
        return np.concatenate([base, u + side * self.radii, [u, y, u, side], np.zeros(self.size)])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        angle, below = self.model.advance(self.below(state), u)
        own, count = self._part(state).copy(), self.radii.size
        v = own[count] + self.gain * (u - own[count])
        own[:count] = np.clip(own[:count], v - self.radii, v + self.radii)
        own[count], own[count + 1] = v, angle
        following = np.concatenate([below, own])
        return float(angle + self.features(following, state) @ self.weights(state)), following

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        angles = np.ascontiguousarray(self.model.rollout(self.below(state), plans))
        self._add(state, plans, angles)
        return angles

    def learned(self, state: Vec, plans: Vec) -> Vec:
        """What the learned part adds (N, H) [deg] along the plans (N, H)."""
        model = self.model.rollout(self.below(state), plans)
        angles = np.array(model, order="C")
        self._add(state, plans, angles)
        return angles - model

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        angles, jacobian = self.model.linearise(self.below(state), plan)
        angles, jacobian = angles.copy(), np.ascontiguousarray(jacobian).copy()
        self._add(state, plan[None], angles[None])
        plays, travel, _ = self._memory(state)
        add_slopes(plays, self.radii, self.weights(state), travel, self.gain, self._pace, plan, jacobian)
        return angles, jacobian

    def below(self, state: Vec) -> Vec:
        """The model's own state."""
        return state[: state.size - self._own]

    def weights(self, state: Vec) -> Vec:
        """w (K + 2) [deg per command unit; the last in s]."""
        return state[state.size - self.size :]

    def with_weights(self, state: Vec, weights: Vec) -> Vec:
        """The state with other weights."""
        return np.concatenate([state[: state.size - self.size], weights])

    def features(self, state: Vec, before: Vec) -> Vec:
        """What the weights are multiplied by (K + 2) in a state that follows another."""
        own, count = self._part(state), self.radii.size
        rate = (own[count + 1] - self._part(before)[count + 1]) * self._pace
        v0, side = own[count + 2], own[count + 3]
        return np.concatenate([[own[count] - v0], own[:count] - v0 - side * self.radii, [rate]])

    def rest(self, state: Vec) -> float:
        """What the learned part adds to the model at rest in a state [deg]."""
        return float(self.features(state, state) @ self.weights(state))

    def _add(self, state: Vec, plans: Vec, angles: Vec) -> None:
        """The learned part along the plans (N, H), added to the model's angles (N, H) in place."""
        plays, travel, start = self._memory(state)
        add_learned(plays, self.radii, self.weights(state), travel, start, self.gain, self._pace, plans, angles)

    def _part(self, state: Vec) -> Vec:
        return state[state.size - self._own :]

    def _memory(self, state: Vec) -> tuple[Vec, float, Vec]:
        own, count = self._part(state), self.radii.size
        return own[:count], float(own[count]), np.array([own[count + 2], own[count + 3], own[count + 1]])


@final
class LearnedInverse(Inverse):
    """The model's inverse at the angle less what the learned part adds at present; see `LearnedFollower` for plans."""

    def __init__(self, predictor: LearnedPredictor, inverse: Inverse) -> None:
        self.predictor, self.inverse = predictor, inverse

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        return self.inverse.command(self.predictor.below(state), theta - self.predictor.rest(state), u_last)


@final
class LearnedFollower(Follower):
    """The model's inverse followed at the angles less the learned part, first as it is at present, then as along the
    plan found: a fixed point where the learned part is the smaller one.
    """

    def __init__(self, inverse: LearnedInverse) -> None:
        self._predictor = inverse.predictor
        self._inner = follower_for(inverse.predictor.model, inverse.inverse)

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        predictor = self._predictor
        below = predictor.below(state)
        targets = self._inner.follow(below, wanted - predictor.rest(state), u_last, bounds)
        for _ in range(_ROUNDS):
            plan = targets[1:]
            targets = self._inner.follow(below, wanted - predictor.learned(state, plan)[0], u_last, bounds)
        return targets


@final
class LearningEstimator(Observer):
    """`OutputEstimator` with the weights w of a `LearnedPredictor` as further states.

        y_k = model_k + phi_k' w + d_k + v_k,   d_{k+1} = d_k + n_k,   w_{k+1} = w_k + m_k
        z = (d, w),  h = (1, phi),  s = h' P h + r,  z <- z + P h (y - model - h' z) / s,  P <- P - P h h' P / s

    n_k and r are those that a `NoiseBank` sees in what model and learned part together leave over. m_k grows with the
    command's travel alone, so that in a hold, where one sum of weights is seen and no single one, nothing is forgotten.
    Weights stay within four standard deviations of zero. Outliers count as missing, and the disturbance is not
    corrected inside the model's dead band, as there.
    """

    def __init__(
        self, predictor: LearnedPredictor, settings: EstimatorSettings, adaptation: AdaptationSettings
    ) -> None:
        self._predictor, self._settings = predictor, settings
        self._plain = OutputEstimator(predictor, settings)
        self._noise = self._plain.bank
        self.delay_samples = settings.delay_samples
        self._prior = _prior(predictor, adaptation)
        self._walk = adaptation.walk_share**2 * self._prior
        self._bound = _BOUND_SIGMAS * np.sqrt(np.diag(self._prior))

    def init(self, y: float, u: float) -> Estimate:
        plain = self._plain.init(y, u)
        covariance = np.zeros((self._predictor.size + 1,) * 2)
        covariance[0, 0], covariance[1:, 1:] = plain.variance, self._prior
        return replace(plain, covariance=covariance, features=(np.zeros(self._predictor.size),) * len(plain.angles))

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        offset = usable_angle(y) - estimate.angles[0]
        innovation = offset - estimate.disturbance
        if not abs(innovation) <= self._settings.outlier_deg:  # also true where it is not a number
            return replace(estimate, missing=estimate.missing + 1)
        bank = self._noise.correct(estimate.bank, offset)[0] if estimate.responsive[0] else estimate.bank
        along = np.concatenate([[1.0], estimate.features[0]])
        spread = estimate.covariance @ along
        variance = float(along @ spread) + self._noise.sensor_variance(bank)
        gain = spread / variance
        before = self._predictor.weights(estimate.state)
        weights = np.clip(before + gain[1:] * innovation, -self._bound, self._bound)
        limit, moved = self._settings.disturbance_limit_deg, gain[0] * innovation * estimate.responsive[0]
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
            bank=bank,
        )

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        after = self._plain.advance(estimate, u)
        return self._grown(estimate, after, self._predictor.features(after.state, estimate.state))

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self._grown(estimate, self._plain.coast(estimate, u), estimate.features[-1])

    def _grown(self, estimate: Estimate, after: Estimate, phi: Vec) -> Estimate:
        """With the covariance one sample later."""
        coming = after.moves[0]
        covariance = estimate.covariance.copy()
        covariance[0, 0] += self._noise.growth(after.bank, coming)
        covariance[0, 0] = min(covariance[0, 0], self._settings.disturbance_limit_deg**2)
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
            bank=after.bank,
        )


def _prior(predictor: LearnedPredictor, adaptation: AdaptationSettings) -> Vec:
    """Covariance of the weights at first: slope is shared out freely between them, their sum is known better."""
    count = predictor.size - 1
    mean = np.full((count, count), 1.0 / count)
    shares = adaptation.share_sigma**2 * (np.eye(count) - mean) + adaptation.slope_sigma**2 * mean / count
    found = np.zeros((count + 1, count + 1))
    found[:count, :count], found[count, count] = predictor.slope**2 * shares, adaptation.rate_sigma_s**2
    return found


def _variance(covariance: Vec, phi: Vec) -> float:
    """Variance of disturbance and learned part together at rest [deg^2]."""
    along = np.concatenate([[1.0], phi[:-1], [0.0]])
    return max(float(along @ covariance @ along), 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def add_learned(
    plays: Any, radii: Any, weights: Any, travel: float, start: Any, gain: float, pace: float, plans: Any, angles: Any
) -> None:
    """angles (N, H) += w_0 (v - v_0) + sum_i w_i (p_i - p_i0) + w_v d theta / dt along the plans (N, H), in place.

    start: v_0, the side s of p_i0 = v_0 + s r_i, and the model's angle before the plans; pace: samples per second.
    """
    count = radii.size
    now = np.empty(count)
    for n in range(plans.shape[0]):
        v, before = travel, start[2]
        now[:] = plays
        for k in range(plans.shape[1]):
            v += gain * (plans[n, k] - v)
            total = weights[0] * (v - start[0])
            for i in range(count):
                now[i] = min(max(now[i], v - radii[i]), v + radii[i])
                total += weights[1 + i] * (now[i] - start[0] - start[1] * radii[i])
            theta = angles[n, k]
            angles[n, k] = theta + total + weights[1 + count] * (theta - before) * pace
            before = theta


@njit(cache=True, error_model="numpy", nogil=True)
def add_slopes(
    plays: Any, radii: Any, weights: Any, travel: float, gain: float, pace: float, plan: Any, jacobian: Any
) -> None:
    """The derivative of `add_learned` along one plan (H,), added to that of the model (H, H) in place.

    Both are lower triangular.

    A play at its edge counts as driven: that is the branch on which a motion goes on.
    """
    count, size = radii.size, plan.size
    now, by_v, by_p, slope = plays.copy(), np.zeros(size), np.zeros((count, size)), np.zeros(size)
    v, before, on_rate = travel, np.zeros(size), weights[1 + count] * pace
    for k in range(size):
        v += gain * (plan[k] - v)
        for j in range(k):
            by_v[j] *= 1.0 - gain
        by_v[k] = gain
        for j in range(k + 1):
            slope[j] = weights[0] * by_v[j]
        for i in range(count):
            if v - radii[i] >= now[i] - _EDGE or v + radii[i] <= now[i] + _EDGE:
                now[i] = min(max(now[i], v - radii[i]), v + radii[i])
                for j in range(k + 1):
                    by_p[i, j] = by_v[j]
            for j in range(k + 1):
                slope[j] += weights[1 + i] * by_p[i, j]
        for j in range(k + 1):
            own = jacobian[k, j]
            jacobian[k, j] = own + (slope[j] + on_rate * (own - before[j]))
            before[j] = own
