"""What is known of the device: settings of the observer, its numbers for the engine, and the estimate."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from hystmpc.core.structs import Struct, constants, layout, struct
from hystmpc.models.model import Predictor
from hystmpc.trials.brief import brief
from hystmpc.trials.config import NotNegative, NotNegativeInt, Positive, Settings
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from ..command import EMPTY, number_of
from .noise import NoiseBank

Bytes = NDArray[np.uint8]

ANGLE_BOUND_DEG = 1e4  # far beyond any joint; keeps squares and sums of angles finite

_EARNED_S, _DOUBT = 10.0, 5.0  # time constant of forgetting; prior doubt, as many measurements of pure noise
_KNOWN = layout("hystmpc_known")
_BEHIND_KNOWN = -(-ctypes.sizeof(_KNOWN) // 8) * 8
_RESOLUTION = 1e-9  # command changes below this share of the command range count as none


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known of the device in one state of a controller; read from its memory.

    Attributes:
        command: the command really sent last [mm or bar].
        angles: predicted angles [deg] without disturbance: now, then at the ends of the samples whose commands
            are still on their way; `delay_samples + 1` entries, none without a model.
        responsive: for each of these angles, whether it answers to the command (False: dead band of a play).
        moves: command travel of the sample that led to each of these angles [command unit].
        disturbance, variance: estimated output disturbance [deg], and the variance of its error [deg^2].
        measured: the last accepted measurement [deg].
        missing: number of samples since the last accepted measurement.
        stalled: number of samples since the model was last advanced; above zero it has failed.
        added: learned part of the first of the angles [deg].
        forecast_error: of the best forecast of the last seconds, relative to that of no change (root mean squares,
            Theil's U); 0 before there was motion, and of an observer that does not judge its forecasts.
        bank: of the noise filters (3, M), see `NoiseBank`.
        since: share of a sample by which the last accepted measurement is younger than `missing` samples.
    """

    command: float
    angles: tuple[float, ...]
    responsive: tuple[bool, ...]
    moves: tuple[float, ...]
    disturbance: float
    variance: float
    measured: float
    missing: int = 0
    stalled: int = 0
    added: float = 0.0
    forecast_error: float = 0.0
    bank: Vec = field(default_factory=lambda: EMPTY)
    since: float = 0.0
    __repr__ = brief

    @property
    def age(self) -> float:
        """Age of the last accepted measurement [samples]."""
        return self.missing - self.since

    @property
    def departure(self) -> float:
        """Difference between device and given model [deg]: disturbance and learned part."""
        return self.disturbance + self.added


class Places(NamedTuple):
    """Sizes of the estimate in a memory: states of the model, angles on their way and now, noise filters."""

    states: int
    angles: int
    filters: int


def read_estimate(memory: Bytes, places: Places) -> Estimate:
    """Read the estimate that begins a memory (B,): see `hystmpc_estimate` in core/observer.h."""
    k, numbers = _KNOWN.from_address(memory.ctypes.data), memory[_BEHIND_KNOWN:].view(np.float64)
    ends = np.cumsum([places.states, *[places.angles] * 3, 3 * places.filters]).tolist()
    angles, responsive, moves, bank = (numbers[a:b] for a, b in pairwise(ends))
    return Estimate(
        command=k.command,
        angles=tuple(angles.tolist()),
        responsive=tuple(bool(one) for one in responsive.tolist()),
        moves=tuple(moves.tolist()),
        disturbance=k.disturbance,
        variance=k.variance,
        measured=k.measured,
        missing=k.missing,
        stalled=k.stalled,
        added=k.added,
        forecast_error=k.forecast_error,
        bank=bank.reshape(3, -1),
        since=k.since,
    )


@final
class Observer:
    """Observer of the model's state, and of a random-walk output disturbance, as the engine has it.

        theta_k = model(commands up to k-1-D) + d_k,   d_{k+1} = d_k + w_k,   y_k = theta_k + v_k
        var(w_k) = drift_sigma^2 dt + motion_sigma^2 |u_k - u_{k-1}|,   var(v_k) = sensor_sigma^2

    Its equations are those of core/observer.h: a continuous sensor, late frames, no sensor, or the newest measurement
    alone. `core/observer.c` says what is not integrated, `core/frames.c` how late frames are used.

    Args:
        part: `hystmpc_sensing`.
        predictor: of the model alone; None for the newest measurement.
        bank: of noise filters; None where there is none.
    """

    def __init__(self, part: Struct, predictor: Predictor | None = None, bank: NoiseBank | None = None) -> None:
        self.part, self._predictor, self._bank = part, predictor, bank
        self._sensor, self._oldest = part.fields["sensor"], int(part.fields.get("oldest", 0))
        self.delay_samples = int(part.fields.get("delay", 0))
        states = 0 if predictor is None else int(predictor.part.fields["states"])
        angles = 0 if predictor is None else self.delay_samples + 1
        self.places = Places(states, angles, 0 if bank is None else bank.size)

    @property
    def greatest_gain(self) -> float:
        """Greatest settled gain of the disturbance by a measurement, see `NoiseBank`; 0 without a bank."""
        return 0.0 if self._bank is None else self._bank.greatest_gain

    @property
    def has_model(self) -> bool:
        """Whether it advances a model."""
        return self._predictor is not None

    def sigma_deg(self, estimate: Estimate) -> float:
        """Standard deviation of the error of the estimated angle [deg]; not-a-number where it is not known."""
        if self._predictor is None:
            return math.nan
        return self._predictor.model_sigma_deg if self._bank is None else math.sqrt(estimate.variance)

    def sigma_ahead_deg(self, estimate: Estimate, travels: Vec) -> Vec:
        """Standard deviation of the error of the angles predicted for the coming command travels (H,) [deg]."""
        if self._bank is None:
            return np.full(travels.size, self.sigma_deg(estimate))
        return np.asarray(np.sqrt(self._bank.ahead(estimate.bank, travels, estimate.disturbance)))

    def not_at_rest(self, x: Vec | None, y: float, u: float) -> ControllerError:
        """Return the error of a start at the angle `y` [deg] that the model at rest in the state x does not expect."""
        angle = math.nan if self._predictor is None or x is None else self._predictor.advance(x, u)[0]
        if not math.isfinite(angle):
            return ControllerError(
                f"estimator: the model answers {angle} deg to a rest at command {u}, expected finite"
            )
        limit = self.part.fields["rest_tolerance"]
        return ControllerError(
            f"estimator: got {y:.6g} deg at rest with command {u:.6g}, the model expects {angle:.6g} deg, "
            f"accepted is a difference of {limit:.6g} deg (estimator.rest_tolerance_deg)"
        )

    def refused(self, y: float, age: float) -> str:
        """Return why a measurement `y` [deg] of `age` samples ago cannot be used."""
        if self._sensor in (_SENSORS["HYSTMPC_FRAMES"], _SENSORS["HYSTMPC_NEWEST_FRAME"]):
            return (
                f"measure: got {y} deg of {age:.4g} samples ago, expected a finite angle of the last {self._oldest} "
                "samples since the start"
            )
        return (
            f"measure: got {y} deg of {age:.4g} samples ago, expected a controller with estimator.sensor intermittent"
        )


_SENSORS = constants()


class SensorKindSettings(Settings):
    """Block `estimator` of a controller without a model: kind of sensor.

    Attributes:
        sensor: `continuous`; `intermittent` for frames of an imaging system, now and then and late; `none` for a device
            without an angle sensor, whose angle at rest is declared when the controller starts.
        oldest_frame_s: age up to which an intermittent sensor's frame is used [s].
        longest_gap_s: time without a usable frame that is bridged [s]; of a continuous sensor
            `ladder.max_missing_samples` says it.
    """

    sensor: Literal["continuous", "intermittent", "none"] = "continuous"
    oldest_frame_s: Positive = 1.0
    longest_gap_s: Positive = 2.0

    def bridged_samples(self, usual: int, dt_s: float) -> int:
        """Number of bridged samples without a usable measurement; `usual` unless the sensor is intermittent."""
        return round(self.longest_gap_s / dt_s) if self.sensor == "intermittent" else usual

    def observer(self, predictor: Predictor) -> Observer:
        """Build the observer: without a model it holds the newest measurement."""
        kind = "HYSTMPC_NEWEST" if self.sensor == "continuous" else "HYSTMPC_NEWEST_FRAME"
        oldest = self.oldest_samples(predictor.dt)
        return Observer(struct("hystmpc_sensing", sensor=_SENSORS[kind], oldest=oldest, forgets=1.0))

    def oldest_samples(self, dt_s: float) -> int:
        """Age of the oldest frame that is used, in whole samples of `dt_s` [s]; 0 unless the sensor is intermittent."""
        return math.ceil(self.oldest_frame_s / dt_s) if self.sensor == "intermittent" else 0


class EstimatorSettings(SensorKindSettings):
    """Block `estimator`: assumptions about sensor, device and model.

    A sigma that is left out starts at what the model file says of it, or at a usual value, and is corrected while the
    loop runs; see `NoiseBank`. One that is given is kept.

    Attributes:
        sensor_sigma_deg: standard deviation of the angle sensor [deg].
        drift_sigma_deg_per_sqrt_s: standard deviation of the disturbance's change over one second [deg / sqrt(s)].
        motion_sigma_deg_per_sqrt_unit: standard deviation of its change over one unit of command travel. What a model
            of hysteresis gets wrong shows while the command moves; in a hold there is time to average.
        delay_samples: whole samples of transport delay that the model does not contain.
        outlier_deg: measurements further than this from the prediction count as missing [deg].
        dead_band_gain_deg_per_unit: below this slope the model counts as inside the dead band.
        disturbance_limit_deg: bound of the estimated disturbance [deg].
        rest_tolerance_deg: greatest difference between model and first measurement at which a controller starts [deg].
    """

    sensor_sigma_deg: Positive | None = None
    drift_sigma_deg_per_sqrt_s: Positive | None = None
    motion_sigma_deg_per_sqrt_unit: NotNegative | None = None
    delay_samples: NotNegativeInt = 0
    outlier_deg: Positive = 15.0
    dead_band_gain_deg_per_unit: NotNegative = 0.0
    disturbance_limit_deg: Positive = 90.0
    rest_tolerance_deg: Positive = 30.0

    def observer(self, predictor: Predictor) -> Observer:
        """Build the observer of a model, without a learned part."""
        known: dict[str, Any] = {"delay": self.delay_samples, "rest_tolerance": self.rest_tolerance_deg}
        if self.sensor == "none":
            part = struct("hystmpc_sensing", sensor=_SENSORS["HYSTMPC_NO_SENSOR"], forgets=1.0, **known)
            return Observer(part, predictor)
        frames = self.sensor == "intermittent"
        sigmas = self.sensor_sigma_deg, self.drift_sigma_deg_per_sqrt_s, self.motion_sigma_deg_per_sqrt_unit
        bank = NoiseBank(sigmas, predictor, self.disturbance_limit_deg)
        low, high = predictor.command_range
        part = struct(
            "hystmpc_sensing",
            **known,
            sensor=_SENSORS["HYSTMPC_FRAMES" if frames else "HYSTMPC_CONTINUOUS"],
            oldest=self.oldest_samples(predictor.dt),
            outlier=self.outlier_deg,
            dead_band_gain=self.dead_band_gain_deg_per_unit,
            resolution=_RESOLUTION * abs(high - low),
            forgets=math.exp(-predictor.dt / _EARNED_S),
            doubt=_DOUBT,
            logs=bank.sensor_logs if bank.size > 1 else None,
            noise=bank.struct(),
        )
        return Observer(part, predictor, bank)


def usable_angle(y: object) -> float:
    """Return the measured angle [deg], or not-a-number if it is missing, no number or absurdly large."""
    angle = number_of(y)
    return angle if angle is not None and abs(angle) <= ANGLE_BOUND_DEG else math.nan
