"""Settings of the predictive controllers; imports no solver."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from hystmpc.trials.config import Count, NotNegative, Positive, Settings
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat, Vec

from .estimation.observer import EstimatorSettings
from .feedback import SupervisorSettings
from .law import LawSettings

_DISCOUNT_FROM_A_GUESS = 0.75


class WeightsSettings(Settings):
    """Weights of the planning cost.

    Attributes:
        tracking: squared angle error [1/deg^2].
        discount: factor on `tracking` from one sample of the preview to the next; null for 1, or 0.75 where the inverse
            is only a first guess, see `steady_inverse`. The program then has many local minima: the angle of the next
            sample is not to be given up for those of far ones.
        terminal: factor on `tracking` at the last sample.
        rate: squared command change per sample [1/mm^2 or 1/bar^2].
        rate_close: the same where the model is as close to the device as its file says, and without a sensor; `rate`
            where that alone is given. In between their logarithms are weighted by the probability of that, see
            `NoiseBank`. A noisy estimate at a reference that rests has `rate`: moves would be those of the noise,
            many times greater behind a lag.
        effort: squared distance from the inverse plan [1/mm^2 or 1/bar^2].
        soft_limit: squared excess over the soft angle limits [1/deg^2].
        angle_lower_deg, angle_upper_deg: soft limits of the angle [deg]; null for none.
    """

    tracking: Positive = 1.0
    discount: Annotated[float, Field(gt=0, le=1)] | None = None
    terminal: NotNegative = 1.0
    rate: Positive = 3.0
    rate_close: Positive = 0.01
    effort: NotNegative = 0.0
    soft_limit: NotNegative = 100.0
    angle_lower_deg: float | None = None
    angle_upper_deg: float | None = None

    @model_validator(mode="before")
    @classmethod
    def _one_rate(cls, data: Any) -> Any:
        """Fill in one weight on moves where one is given."""
        rate = data.get("rate") if isinstance(data, dict) else None
        if isinstance(rate, int | float) and rate > 0:  # a wrong one is said once
            data = {"rate_close": rate, **data}
        return data

    @property
    def angle_limits_deg(self) -> tuple[float, float]:
        """Soft limits of the angle [deg], infinite for none.

        Raises:
            ControllerError: if they cross.
        """
        low = -math.inf if self.angle_lower_deg is None else self.angle_lower_deg
        high = math.inf if self.angle_upper_deg is None else self.angle_upper_deg
        if not low < high:
            raise ControllerError(f"weights: got angle_limits_deg {low} to {high}, expected lower < upper")
        return low, high

    @property
    def limits_angle(self) -> bool:
        """Whether there is a soft angle limit."""
        return self.soft_limit > 0 and any(math.isfinite(v) for v in self.angle_limits_deg)

    def discounted(self, first_guess: bool) -> WeightsSettings:
        """Return these weights with a discount; `first_guess`: whether the inverse is only a first guess of a plan."""
        usual = _DISCOUNT_FROM_A_GUESS if first_guess else 1.0
        return self if self.discount is not None else self.model_copy(update={"discount": usual})

    def over(self, horizon: int) -> Vec:
        """Return the tracking weights along the horizon, shape (H,)."""
        along: Vec = self.tracking * np.power(self.discount or 1.0, np.arange(horizon, dtype=np.float64))
        along[-1] *= self.terminal
        return along


class HoldSettings(Settings):
    """Hold of the command, and slow correction of a remaining error; see core/predictive.c, which counts samples.

    Attributes:
        tolerance_deg: distance from the reference that always counts as reached [deg]; null for 0.01 to 0.003 by the
            probability that the model is close, see `rate_close`, 0.001 without a sensor, and 0.03 where the model's
            file says that the sensor's readings have steps.
        patience_s: time of constant reference for which one more standard deviation is allowed for [s].
        settle_after_s: time of constant reference after which corrections are limited [s].
        settle_s: time over which a limited correction removes an error at the model's static gain [s]; 0 for no limit.
    """

    tolerance_deg: NotNegative | None = None
    patience_s: NotNegative = 0.4
    settle_after_s: NotNegative = 0.4
    settle_s: NotNegative = 0.12


class AdaptationSettings(Settings):
    """Block `adaptation`: rate of change of the learned part of a model, see `LearnedPredictor`.

    Attributes:
        sigma_share: standard deviation of the free learned weights at first, as a share of the angle over the range.
        walk_share: their change over one stroke of the command, as a share of this.
    """

    sigma_share: Positive = 0.28
    walk_share: NotNegative = 0.01


_LEAST_SAMPLES, _MOST_SAMPLES, _PREVIEW_S = 20, 60, 0.24  # of a preview whose length is not given
_ALIKE = 3  # blocks of one length
_SIGMA_SHARE = 0.1  # of the greatest move of a sample: larger perturbations would cross kinks of the model


class PredictiveSettings(LawSettings):
    """Common settings of both predictive controllers.

    Attributes:
        adaptation: learning on top of the model; null for none, which it is without a sensor.
        supervisor: switches to feedback where no forecast is of use; null for none, as without learning.
        horizon: samples of the preview; null for 20, or 0.24 s where that is more, but no more than 60.
        estimator: how state and disturbance are estimated from the measurements.
        weights: of the planning cost.
        hold: when a command is held.
    """

    predicts: ClassVar[bool] = True

    estimator: EstimatorSettings = EstimatorSettings()  # pyright: ignore[reportIncompatibleVariableOverride]  # frozen
    adaptation: AdaptationSettings | None = AdaptationSettings()
    supervisor: SupervisorSettings | None = SupervisorSettings()
    horizon: Count | None = None
    iterations: Count = 1
    weights: WeightsSettings = WeightsSettings()
    hold: HoldSettings = HoldSettings()

    @model_validator(mode="before")
    @classmethod
    def _defaults_of_the_sensor(cls, data: Any) -> Any:
        """Fill in defaults without a continuous sensor: no supervisor; without any, no learning."""
        if not isinstance(data, dict):
            return data
        estimator = data.get("estimator")
        sensor = estimator.get("sensor") if isinstance(estimator, dict) else getattr(estimator, "sensor", None)
        if sensor in ("intermittent", "none"):
            data = {**data, "supervisor": None}  # a `tip.yaml` has one for its continuous sensor
            if sensor == "none":
                data = {"adaptation": None, **data}
        return {"supervisor": None, **data} if data.get("adaptation", {}) is None else data

    @model_validator(mode="after")
    def _learns_from_a_sensor(self) -> PredictiveSettings:
        if self.adaptation is not None and self.estimator.sensor == "none":
            raise ValueError("got adaptation with estimator.sensor none, expected a sensor, which learning needs")
        if self.supervisor is not None and self.adaptation is None:
            raise ValueError(
                "got supervisor with adaptation null, expected supervisor null: forecasts are judged by learning"
            )
        return self

    def preview_samples(self, dt_s: float) -> int:
        """Return the number of samples of the preview at sample time `dt_s` [s]."""
        return self.horizon or min(max(_LEAST_SAMPLES, round(_PREVIEW_S / dt_s)), _MOST_SAMPLES)


class LinearisedMpcSettings(PredictiveSettings):
    """Linearised predictive controller (real-time iteration); see core/planner.c.

    Attributes:
        iterations: linearisations per step; at least two where the model is close to the device, or there is no sensor.
        solver: of the quadratic programs.
        solver_eps: tolerance of OSQP; the active-set solver is exact.
        move_blocking: samples of each block of moves, see `MoveBlocking`; null lets every sample move, but for a
            preview of more than 20 samples whose length is not given, see `blocks`.
    """

    kind: Literal["linearised_mpc"] = "linearised_mpc"
    solver: Literal["active_set", "osqp"] = "active_set"
    solver_eps: Annotated[float, Field(gt=0, le=1e-4)] = 1e-5
    move_blocking: Annotated[tuple[Count, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _blocks_fit(self) -> LinearisedMpcSettings:
        together, horizon = sum(self.move_blocking or ()), self.horizon or _LEAST_SAMPLES
        if together > horizon:
            raise ValueError(
                f"got move_blocking of {together} samples together, expected at most the horizon of {horizon}"
            )
        return self

    def blocks(self, dt_s: float) -> tuple[int, ...] | None:
        """Return the samples of each block of moves at sample time `dt_s` [s]; None if every sample may move.

        Blocks of a default preview of more than 20 samples are 1, 2, 4, ... samples long, three of each, as they fit.
        """
        horizon = self.preview_samples(dt_s)
        if self.move_blocking is not None or self.horizon is not None or horizon <= _LEAST_SAMPLES:
            return self.move_blocking
        return doubling_blocks(horizon)


# A noise is a matrix F (H, K): samples are F w with w standard normal (K,). Rows have unit norm, so that every sample
# of a plan is perturbed with the same variance.
class SplineNoiseSettings(Settings):
    """Noise as a cubic spline through `knots` independent normals, evenly spaced over the horizon.

    Attributes:
        knots: number of independent normals, at most the horizon.
    """

    kind: Literal["spline"] = "spline"
    knots: Annotated[int, Field(ge=2)] = 6

    def matrix(self, horizon: int) -> Mat:
        """Return the noise matrix F (H, knots).

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

    Attributes:
        exponent: of the power spectrum.
    """

    kind: Literal["coloured"] = "coloured"
    exponent: NotNegative = 2.0

    def matrix(self, horizon: int) -> Mat:
        """Return the noise matrix F (H, 2H)."""
        cycles = np.arange(1, horizon + 1, dtype=np.float64)
        phase = 2.0 * np.pi * np.outer(np.arange(horizon), cycles) / (2 * horizon)
        amplitude = cycles ** (-self.exponent / 2.0)
        return _unit_rows(np.hstack([amplitude * np.cos(phase), amplitude * np.sin(phase)]))


class SamplingMpcSettings(PredictiveSettings):
    """Sampling predictive controller: model-predictive path integral control (MPPI) or the cross-entropy method (CEM).

    Attributes:
        method: MPPI or CEM.
        samples: plans per iteration N; at least twice the number of blocks, so that every direction is tested twice.
        iterations: times the distribution is moved per step; at least two where the model is close to the device.
        sigma: largest standard deviation of the perturbations [mm or bar]; null for a tenth of a sample's greatest
            move.
        finest: smallest one as a share of `sigma`.
        temperature: of MPPI's weights exp(-(J - J_min) / lambda), with lambda = temperature (median J - J_min).
        elites: share of the samples that mean and deviation of CEM are fitted to, at least two plans.
        seed: of the random numbers.
        noise: shape of the perturbations, at the ends of the blocks, see `blocks`.
    """

    kind: Literal["sampling_mpc"] = "sampling_mpc"
    method: Literal["mppi", "cem"] = "mppi"
    samples: Count = 44
    sigma: Positive | None = None
    finest: Annotated[float, Field(gt=0, le=1)] = 0.01
    temperature: Positive = 0.02
    elites: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    seed: Annotated[int, Field(ge=0)] = 0
    noise: Annotated[SplineNoiseSettings | ColouredNoiseSettings, Field(discriminator="kind")] = ColouredNoiseSettings(
        exponent=1.0
    )

    def deviation(self, reach: float) -> float:
        """Largest standard deviation of the perturbations, if a sample may move by `reach`, both [mm or bar]."""
        return _SIGMA_SHARE * reach if self.sigma is None else self.sigma

    def blocks(self, dt_s: float) -> tuple[int, ...]:
        """Return the samples of each block of moves at sample time `dt_s` [s]; 1 up to a preview of 20 samples.

        A longer preview has those of the linearised controller, so that the samples have few directions to explore.
        """
        horizon = self.preview_samples(dt_s)
        return (1,) * horizon if horizon <= _LEAST_SAMPLES else doubling_blocks(horizon)


def doubling_blocks(horizon: int) -> tuple[int, ...]:
    """Return blocks of 1, 2, 4, 8, ... samples, three of each length, as long as they fit the horizon."""
    lengths: list[int] = []
    while sum(lengths) + (following := 2 ** (len(lengths) // _ALIKE)) <= horizon:
        lengths.append(following)
    return tuple(lengths)


def _unit_rows(factor: Mat) -> Mat:
    return factor / np.linalg.norm(factor, axis=1, keepdims=True)
