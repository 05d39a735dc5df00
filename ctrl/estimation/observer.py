"""Observers of the model state, from the commands really sent, and of the output disturbance, from the measurements."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, final

import numpy as np

from hystmpc.models.model import Predictor
from hystmpc.trials.brief import brief
from hystmpc.trials.config import NotNegative, NotNegativeInt, Positive, Settings
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from ..command import EMPTY, number_of, replace

ANGLE_BOUND_DEG = 1e4  # far beyond any joint; keeps squares and sums of angles finite

_EARNED_S = 10.0  # time constant of forgetting
_DOUBT = 5.0  # prior doubt: as many frames of pure noise

_RESOLUTION = 1e-9  # command changes below this share of the command range count as none


@dataclass(frozen=True, eq=False)
class Estimate:
    """Snapshot of the state of an observer.

    Attributes:
        state: predictor state (S,) after every command sent so far, also those still on their way.
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
        learning: memory of an observer that learns, see `LearningEstimator`.
        forecast_error: of the best forecast of the last seconds, relative to that of no change (root mean squares,
            Theil's U); 0 before there was motion, and of an observer that does not judge its forecasts.
        earned: of frames, the sums of m z and m^2 [deg^2]; m is the mean of the bank before the offset z came.
        past: corrected estimates of the last instants, the newest last; see `Frames`.
        seen: measurements of this instant, used or not usable [deg].
        since: share of a sample by which the last accepted measurement is younger than `missing` samples.
    """

    state: Vec
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
    learning: object = None
    forecast_error: float = 0.0
    bank: Vec = field(default_factory=lambda: EMPTY)
    earned: tuple[float, float] = (0.0, 0.0)
    past: tuple[Estimate, ...] = ()
    seen: tuple[float, ...] = ()
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


class Observer(ABC):
    """Observer with explicit state: `correct` is the measurement update, `advance` the time update."""

    delay_samples: int  # transport delay between command and angle, beyond the one sample of every discrete loop

    @abstractmethod
    def init(self, y: float, u: float) -> Estimate:
        """Return the estimate at rest with measured angle `y` [deg] and held command `u`; model errors propagate."""

    def sigma_deg(self, estimate: Estimate) -> float:
        """Standard deviation of the error of the estimated angle [deg]; not-a-number where it is not known."""
        return math.sqrt(estimate.variance)

    def sigma_ahead_deg(self, estimate: Estimate, travels: Vec) -> Vec:
        """Standard deviation of the error of the angles predicted for the coming command travels (H,) [deg]."""
        return np.full(travels.size, self.sigma_deg(estimate))

    def disturbance_sigma_deg(self, estimate: Estimate) -> float:
        """Standard deviation of the noise of the estimated disturbance in a hold [deg]."""
        return math.sqrt(estimate.variance)

    @abstractmethod
    def correct(self, estimate: Estimate, y: float) -> Estimate:
        """Measurement update with `y` [deg]; not-a-number and outliers change nothing. Never raises."""

    def correct_late(self, estimate: Estimate, y: float, age: float) -> Estimate:
        """Measurement update with `y` [deg] of `age` samples ago.

        Raises:
            ControllerError: if this observer accepts no late measurements, or none of that age.
        """
        del estimate
        raise ControllerError(
            f"measure: got {y} deg of {age:.4g} samples ago, expected a controller with estimator.sensor intermittent"
        )

    @abstractmethod
    def advance(self, estimate: Estimate, u: float) -> Estimate:
        """Time update by one sample with the command `u`; may raise the model's errors."""

    @abstractmethod
    def coast(self, estimate: Estimate, u: float) -> Estimate:
        """Time update after a failed `advance`: the model state does not change. Never raises."""


class SensorKindSettings(Settings):
    """Block `estimator` of a controller without a model: kind of sensor.

    Attributes:
        sensor: `continuous`; `intermittent` for frames of an imaging system, now and then and late, see `Frames` and
            `LastMeasurement`; `none` for a device without an angle sensor, see `ModelAlone`.
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
        """Build the estimator."""
        if self.sensor == "none":
            return ModelAlone(predictor, self)
        estimator = OutputEstimator(predictor, self)
        if self.sensor == "continuous":
            return estimator
        return Frames(estimator, self.oldest_samples(predictor.dt))


@final
class OutputEstimator(Observer):
    """Observer of a random-walk output disturbance; its model is driven by the commands really sent.

        theta_k = model(commands up to k-1-D) + d_k,   d_{k+1} = d_k + w_k,   y_k = theta_k + v_k
        var(w_k) = drift_sigma^2 dt + motion_sigma^2 |u_k - u_{k-1}|,   var(v_k) = sensor_sigma^2

    d and its variance are those of a bank of Kalman filters, see `NoiseBank`, or of one filter if all sigmas are given.

    The model always holds every command sent; the D predicted angles on their way are kept in a queue, so a
    measurement meets the prediction made for its own instant, and plans start where the queue ends.

    The frames of an intermittent sensor are noisy, and few. Their disturbance estimate is scaled by how well it has
    predicted the offsets z_j of later frames (prior of 5 frames, memory of 10 s):

        d_k = s_k m_k,   s_k = sum_j m_j z_j / (sum_j m_j^2 + 5 sensor_sigma^2),   0 <= s_k <= 1

    m_j: the mean of the bank before frame j. Where the model is right within the noise of the frames, s stays near zero
    and the device is controlled as without a sensor.

    Two things are not integrated: outliers, and samples in which the command moved but the model did not (the
    dead band of a play), where a wrong guess of the play's state would wind the disturbance up and hunt.
    """

    def __init__(self, predictor: Predictor, settings: EstimatorSettings) -> None:
        from .noise import NoiseBank  # settings alone need no engine

        self._predictor = predictor
        self._settings = settings
        self._frames = settings.sensor == "intermittent"
        self._forgets = math.exp(-predictor.dt / _EARNED_S) if self._frames else 1.0
        known = predictor.noise.model_sigma_deg if predictor.noise and self._frames else None
        self.bank = NoiseBank(
            (
                settings.sensor_sigma_deg,
                settings.drift_sigma_deg_per_sqrt_s,
                settings.motion_sigma_deg_per_sqrt_unit,
            ),
            predictor,
            settings.disturbance_limit_deg,
            known,
        )
        low, high = predictor.command_range
        self._resolution = _RESOLUTION * abs(high - low)
        self.delay_samples = settings.delay_samples

    def numbers(self) -> Mapping[str, float | Vec]:
        """Return the numbers of the estimator and its bank, for code generation."""
        settings = self._settings
        return {
            **self.bank.numbers(),
            "outlier": settings.outlier_deg,
            "dead_band_gain": settings.dead_band_gain_deg_per_unit,
            "resolution": self._resolution,
        }

    def init(self, y: float, u: float) -> Estimate:
        """Return the estimate at rest, with `y` minus the model's angle as disturbance; zero with frames."""
        angle, state = rest_of_model(self._predictor, y, u, self._settings.rest_tolerance_deg)
        queue, first = self.delay_samples + 1, 0.0 if self._frames else y - angle
        bank, variance = self.bank.init(first)
        return Estimate(state, u, (angle,) * queue, (True,) * queue, (0.0,) * queue, first, variance, y, bank=bank)

    def sigma_ahead_deg(self, estimate: Estimate, travels: Vec) -> Vec:
        return np.asarray(np.sqrt(estimate.variance + self.bank.ahead(estimate.bank, travels)))

    def disturbance_sigma_deg(self, estimate: Estimate) -> float:
        return math.sqrt(estimate.variance) * self._share(estimate.earned, estimate.bank)

    def _share(self, earned: tuple[float, float], bank: Vec) -> float:
        if not self._frames:
            return 1.0
        return min(max(earned[0] / (earned[1] + _DOUBT * self.bank.sensor_variance(bank)), 0.0), 1.0)

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        angle, far = usable_angle(y), self._settings.outlier_deg
        offset = angle - estimate.angles[0]
        if not (abs(offset - estimate.disturbance) <= far or abs(angle - estimate.measured) <= far):  # or not a number
            return replace(estimate, missing=estimate.missing + 1)
        if not estimate.responsive[0]:
            return replace(estimate, measured=angle, missing=0)
        bank, mean, variance = self.bank.correct(estimate.bank, offset)
        earned = estimate.earned
        if self._frames:
            before = float(estimate.bank[0] @ estimate.bank[2])
            earned = (earned[0] + before * offset, earned[1] + before * before)
        share = self._share(earned, bank)
        return replace(
            estimate,
            bank=bank,
            earned=earned,
            disturbance=share * mean,
            variance=variance + ((1.0 - share) * mean) ** 2,
            measured=angle,
            missing=0,
        )

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        angle, state = next_of_model(self._predictor, estimate.state, u)
        return self._shifted(estimate, u, angle, state)

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self._shifted(estimate, u, estimate.angles[-1], estimate.state, estimate.stalled + 1)

    def _shifted(self, estimate: Estimate, u: float, angle: float, state: Vec, stalled: int = 0) -> Estimate:
        moved = abs(u - estimate.command)
        coming = estimate.moves[1] if len(estimate.moves) > 1 else moved
        answers = abs(angle - estimate.angles[-1]) >= self._settings.dead_band_gain_deg_per_unit * moved
        bank, variance = self.bank.advance(estimate.bank, coming, estimate.disturbance)
        return replace(
            estimate,
            state=state,
            command=u,
            angles=(*estimate.angles[1:], angle),
            responsive=(*estimate.responsive[1:], answers or moved <= self._resolution),
            moves=(*estimate.moves[1:], moved),
            variance=variance,
            stalled=stalled,
            bank=bank,
            earned=(self._forgets * estimate.earned[0], self._forgets * estimate.earned[1]),
        )


@final
class Frames(Observer):
    """Observer for delayed measurements, each used at the instant at which it was taken.

    A frame of age a lies between the instants k and k + 1, a = now - k - s. The model's own motion carries it to k,

        y_k = y + theta_k - ((1 - s) theta_k + s theta_{k+1}),   0 <= s < 1

    The estimate of that instant is corrected, and all later updates, by commands and measurements, are repeated. The
    order in which frames arrive makes no difference.

    Args:
        samples: age of the oldest frame.
    """

    def __init__(self, inner: Observer, samples: int) -> None:
        self._inner, self._samples, self.delay_samples = inner, samples, inner.delay_samples

    def sigma_ahead_deg(self, estimate: Estimate, travels: Vec) -> Vec:
        return self._inner.sigma_ahead_deg(estimate, travels)

    def disturbance_sigma_deg(self, estimate: Estimate) -> float:
        return self._inner.disturbance_sigma_deg(estimate)

    def init(self, y: float, u: float) -> Estimate:
        return replace(self._inner.init(y, u), seen=(float(y),))

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        after = self._inner.correct(estimate, y)
        missing = min(after.missing, estimate.missing) if estimate.seen else after.missing  # an instant counts once
        return replace(after, missing=missing, seen=(*estimate.seen, usable_angle(y)))

    def correct_late(self, estimate: Estimate, y: float, age: float) -> Estimate:
        """Measurement update with a frame of `age` samples ago.

        Raises:
            ControllerError: if it is older than the memory, not of the past, or no usable angle.
        """
        known, oldest = (*estimate.past, estimate), len(estimate.past)
        if not (0 <= age <= oldest and math.isfinite(usable_angle(y))):
            raise ControllerError(
                f"measure: got {y} deg of {age:.4g} samples ago, expected a finite angle of the last {oldest}"
            )
        back = math.ceil(age)
        here = known[oldest - back]
        carried = (back - age) * (here.angles[0] - known[min(oldest - back + 1, oldest)].angles[0])
        present = replace(self.correct(here, y + carried), past=estimate.past[: oldest - back])
        for after in known[oldest - back + 1 :]:
            present = self.advance(present, after.command)
            for seen in after.seen:
                present = self.correct(present, seen)
        return present

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        return self._later(estimate, self._inner.advance(estimate, u))

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self._later(estimate, self._inner.coast(estimate, u))

    def _later(self, before: Estimate, after: Estimate) -> Estimate:
        past = (*before.past, replace(before, past=()))[-self._samples :]
        return replace(after, past=past, seen=())


@final
class ModelAlone(Observer):
    """Open-loop observer of a device without an angle sensor: the model alone, driven by the commands sent.

        theta_k = model(commands up to k-1-D)

    The angle at which the device rests when the controller starts is declared (`TipController.reset`), or the first one
    of a recording (`TipController.replay`). It sets the initial state of the model; the remaining difference is not
    treated as a disturbance, and later measurements are ignored. The estimate does not fluctuate, so that holds are as
    without noise. The model's standard error is `sigma_deg`: the root mean square of the slow errors of its free runs,
    if the model file has it (`ModelMetadata.model_sigma_deg`).
    """

    def __init__(self, predictor: Predictor, settings: EstimatorSettings) -> None:
        self._predictor = predictor
        self.delay_samples, self._limit = settings.delay_samples, settings.rest_tolerance_deg
        self._sigma = predictor.model_sigma_deg

    def sigma_deg(self, estimate: Estimate) -> float:
        del estimate
        return self._sigma

    def init(self, y: float, u: float) -> Estimate:
        angle, state = rest_of_model(self._predictor, y, u, self._limit)
        queue = self.delay_samples + 1
        return Estimate(state, u, (angle,) * queue, (True,) * queue, (0.0,) * queue, 0.0, 0.0, angle)

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        del y
        return replace(estimate, measured=estimate.angles[0])

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        angle, state = next_of_model(self._predictor, estimate.state, u)
        moves = (*estimate.moves[1:], abs(u - estimate.command))
        angles = (*estimate.angles[1:], angle)
        return replace(estimate, state=state, command=u, angles=angles, moves=moves, stalled=0)

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        angles = (*estimate.angles[1:], estimate.angles[-1])
        return replace(estimate, command=u, angles=angles, stalled=estimate.stalled + 1)


@final
class LastMeasurement(Observer):
    """Observer of a controller without a model, which holds the newest measurement.

    A frame that arrives after one that was taken later changes nothing, so the order of arrival makes no difference.

    Args:
        frames: age of the oldest frame that is used [samples]; None for a continuous sensor, of which every sample
            without a usable measurement counts as missing.
    """

    delay_samples = 0

    def __init__(self, frames: int | None = None) -> None:
        self._frames = frames

    def sigma_deg(self, estimate: Estimate) -> float:
        del estimate
        return math.nan

    def init(self, y: float, u: float) -> Estimate:
        return Estimate(EMPTY, u, (), (), (), 0.0, 0.0, y)

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        angle = usable_angle(y)
        if not math.isnan(angle):
            return replace(estimate, measured=angle, missing=0, since=0.0)
        return estimate if self._frames is not None else replace(estimate, missing=estimate.missing + 1)

    def correct_late(self, estimate: Estimate, y: float, age: float) -> Estimate:
        """Measurement update with a frame of `age` samples ago.

        Raises:
            ControllerError: if there are no frames, or it is too old, not of the past, or no usable angle.
        """
        if self._frames is None:
            return super().correct_late(estimate, y, age)
        angle = usable_angle(y)
        if not (0 <= age <= self._frames and math.isfinite(angle)):
            raise ControllerError(
                f"measure: got {y} deg of {age:.4g} samples ago, expected a finite angle of the last {self._frames}"
            )
        if age >= estimate.age:
            return estimate
        whole = math.ceil(age)
        return replace(estimate, measured=angle, missing=whole, since=whole - age)

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        return replace(estimate, command=u, missing=estimate.missing + int(self._frames is not None))

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self.advance(estimate, u)


def rest_of_model(predictor: Predictor, y: float, u: float, limit_deg: float) -> tuple[float, Vec]:
    """Return angle [deg] and state of a model one sample after rest at the angle `y` [deg] and the command `u`.

    Raises:
        ControllerError: if the model is not finite, or further from `y` than `limit_deg`.
    """
    angle, state = predictor.advance(predictor.initial(y, u), u)
    if not (math.isfinite(angle) and math.isfinite(state.sum())):
        raise ControllerError(f"estimator: the model answers {angle} deg to a rest at command {u}, expected finite")
    if abs(y - angle) > limit_deg:
        raise ControllerError(
            f"estimator: got {y:.6g} deg at rest with command {u:.6g}, the model expects {angle:.6g} deg, "
            f"accepted is a difference of {limit_deg:.6g} deg (estimator.rest_tolerance_deg)"
        )
    return float(angle), state


def next_of_model(predictor: Predictor, state: Vec, u: float) -> tuple[float, Vec]:
    """Return angle [deg] and state of a model one sample later.

    Raises:
        ArithmeticError: if they are not finite, or the angle is absurdly large.
    """
    angle, following = predictor.advance(state, u)
    if not (abs(angle) <= ANGLE_BOUND_DEG and math.isfinite(following.sum())):
        raise ArithmeticError(f"the model answers {angle} deg to command {u:.6g}")
    return float(angle), following


def usable_angle(y: object) -> float:
    """Return the measured angle [deg], or not-a-number if it is missing, no number or absurdly large."""
    angle = number_of(y)
    return angle if angle is not None and abs(angle) <= ANGLE_BOUND_DEG else math.nan
