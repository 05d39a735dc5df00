"""Hidden state from the commands really sent, output disturbance from the measurements."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .inputs import usable_angle
from .observer import Estimate, Observer

_RESOLUTION = 1e-9  # command changes below this share of the command range count as none


def kalman_gain(sensor_sigma_deg: float, drift_sigma_deg: float, dt_s: float) -> float:
    """Steady-state gain for a disturbance that walks at random: d+ = d + w, e = d + v.

    The Riccati equation P = P - P^2 / (P + r) + q with r = sensor_sigma^2 [deg^2] and q = drift_sigma^2 dt [deg^2]
    is the quadratic P^2 - q P - q r = 0; the gain is P / (P + r). A test holds it against `control.dlqe`, whose import
    alone costs a control process a second and 60 MB.

    Args:
        sensor_sigma_deg: standard deviation of the angle sensor [deg].
        drift_sigma_deg: standard deviation of the disturbance's change over one second [deg / sqrt(s)].
        dt_s: sample time [s].
    """
    r, q = sensor_sigma_deg**2, drift_sigma_deg**2 * dt_s
    covariance = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    return covariance / (covariance + r)


@dataclass(frozen=True)
class EstimatorOptions:
    """What the estimator assumes about sensor, device and model.

    Attributes:
        sensor_sigma_deg: standard deviation of the angle sensor [deg].
        drift_sigma_deg: standard deviation of the disturbance's change over one second [deg / sqrt(s)].
        motion_sigma_deg: standard deviation of its change over one unit of command travel [deg / sqrt(unit)]. What a
            model of hysteresis gets wrong shows while the command moves; in a hold there is time to average.
        delay_samples: whole samples of transport delay that the model does not contain.
        outlier_deg: measurements further than this from the prediction count as missing [deg].
        dead_band_gain: below this slope [deg per command unit] the model counts as inside the dead band.
        disturbance_limit_deg: bound of the estimated disturbance [deg].

    Raises:
        ControllerError: if a value is not finite, not positive, or the delay is negative.
    """

    sensor_sigma_deg: float = 0.15
    drift_sigma_deg: float = 0.4
    motion_sigma_deg: float = 0.0
    delay_samples: int = 0
    outlier_deg: float = 15.0
    dead_band_gain: float = 1.0
    disturbance_limit_deg: float = 30.0

    def __post_init__(self) -> None:
        for name in ("sensor_sigma_deg", "drift_sigma_deg", "outlier_deg", "disturbance_limit_deg"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ControllerError(f"estimator: got {name} {value}, expected a finite number > 0")
        for name in ("motion_sigma_deg", "dead_band_gain", "delay_samples"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ControllerError(f"estimator: got {name} {value}, expected a finite number >= 0")


@final
class OutputEstimator(Observer):
    """Model run on the commands really sent, plus a random-walk output disturbance.

        theta_k = model(commands up to k-1-D) + d_k,   d_{k+1} = d_k + w_k,   y_k = theta_k + v_k
        var(w_k) = drift_sigma^2 dt + motion_sigma^2 |u_k - u_{k-1}|,   var(v_k) = r = sensor_sigma^2
        K = P / (P + r),   d_k <- d_k + K (y_k - theta_k),   P <- (1 - K) P,   P_{k+1} = P + var(w_k)

    The model always holds every command sent; the D predicted angles on their way are kept in a queue, so a
    measurement meets the prediction made for its own instant, and plans start where the queue ends.

    Two things are not integrated: outliers, and samples in which the command moved but the model did not (the
    dead band of a play), where a wrong guess of the play's state would wind the disturbance up and hunt.
    """

    def __init__(self, predictor: Predictor, options: EstimatorOptions) -> None:
        self._predictor = predictor
        self._options = options
        self._gain = kalman_gain(options.sensor_sigma_deg, options.drift_sigma_deg, predictor.dt)
        self._sensor, self._drift = options.sensor_sigma_deg**2, options.drift_sigma_deg**2 * predictor.dt
        self._motion = options.motion_sigma_deg**2
        low, high = predictor.command_range
        self._resolution = _RESOLUTION * abs(high - low)
        self.delay_samples = options.delay_samples

    @property
    def gain(self) -> float:
        """Steady-state Kalman gain K while the command rests."""
        return self._gain

    def init(self, y: float, u: float) -> Estimate:
        """A device at rest: what the model cannot explain of `y` is the first disturbance.

        Raises:
            ControllerError: if the model is not finite, or further from `y` than the disturbance may be.
        """
        angle, state = self._predictor.advance(self._predictor.initial(y, u), u)
        if not (math.isfinite(angle) and math.isfinite(state.sum())):
            raise ControllerError(f"estimator: the model answers {angle} deg to a rest at command {u}, expected finite")
        if abs(y - angle) > self._options.disturbance_limit_deg:
            raise ControllerError(
                f"estimator: got {y:.6g} deg at rest with command {u:.6g}, the model expects {angle:.6g} deg, "
                f"accepted is a difference of {self._options.disturbance_limit_deg:.6g} deg"
            )
        queue = self.delay_samples + 1
        rest = self._sensor * self._gain / (1.0 - self._gain)  # P of the Riccati equation
        return Estimate(state, u, (float(angle),) * queue, (True,) * queue, (0.0,) * queue, y - angle, rest, y)

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        innovation = usable_angle(y) - estimate.angles[0] - estimate.disturbance
        if not abs(innovation) <= self._options.outlier_deg:  # also true where it is not a number
            return replace(estimate, missing=estimate.missing + 1)
        prior = estimate.variance
        gain = prior / (prior + self._sensor) if estimate.responsive[0] else 0.0
        disturbance = self._bounded(estimate.disturbance + gain * innovation)
        posterior = (1.0 - gain) * prior
        return replace(estimate, disturbance=disturbance, variance=posterior, measured=float(y), missing=0)

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        angle, state = self._predictor.advance(estimate.state, u)
        if not (math.isfinite(angle) and math.isfinite(state.sum())):
            raise ArithmeticError(f"the model answers {angle} deg to command {u:.6g}")
        return self._shifted(estimate, u, float(angle), state)

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self._shifted(estimate, u, estimate.angles[-1], estimate.state, estimate.stalled + 1)

    def _shifted(self, estimate: Estimate, u: float, angle: float, state: Vec, stalled: int = 0) -> Estimate:
        moved = abs(u - estimate.command)
        coming = estimate.moves[1] if len(estimate.moves) > 1 else moved
        answers = abs(angle - estimate.angles[-1]) >= self._options.dead_band_gain * moved
        variance = estimate.variance + self._drift + self._motion * coming
        return Estimate(  # `replace` takes ten times as long
            state=state,
            command=u,
            angles=(*estimate.angles[1:], angle),
            responsive=(*estimate.responsive[1:], answers or moved <= self._resolution),
            moves=(*estimate.moves[1:], moved),
            disturbance=estimate.disturbance,
            variance=min(variance, self._options.disturbance_limit_deg**2),
            measured=estimate.measured,
            missing=estimate.missing,
            stalled=stalled,
            covariance=estimate.covariance,
            features=estimate.features,
        )

    def _bounded(self, disturbance: float) -> float:
        limit = self._options.disturbance_limit_deg
        return min(max(disturbance, -limit), limit)
