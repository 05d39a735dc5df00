"""What is known about the device between two samples: model state, command really sent, output disturbance."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import final

from hystmpc.trials.types import Vec

from .command import EMPTY
from .inputs import usable_angle


@dataclass(frozen=True, eq=False)
class Estimate:
    """A snapshot: restoring it restores the observer.

    Attributes:
        state: predictor state (S,) after every command sent so far, also those still on their way.
        command: the command really sent last [mm or bar].
        angles: predicted angles [deg] without disturbance: now, then at the ends of the samples whose commands
            are still on their way; `delay_samples + 1` entries, none without a model.
        responsive: for each of these angles, whether it answers to the command (False: dead band of a play).
        moves: command travel of the sample that led to each of these angles [command unit].
        disturbance: estimated output disturbance [deg].
        variance: of its error [deg^2].
        measured: the last accepted measurement [deg].
        missing: number of samples since the last accepted measurement.
        stalled: number of samples since the model was last advanced; above zero it has failed.
        covariance: of the errors of disturbance and learned weights, where weights are learned.
        features: what the weights are multiplied by, for each of the angles, where weights are learned.
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
    covariance: Vec = field(default_factory=lambda: EMPTY)
    features: tuple[Vec, ...] = ()


class Observer(ABC):
    """Estimate in, estimate out: `correct` with a measurement, `advance` with the command really sent."""

    delay_samples: int  # transport delay between command and angle, beyond the one sample of every discrete loop

    @abstractmethod
    def init(self, y: float, u: float) -> Estimate:
        """Estimate at rest with measured angle `y` [deg] and held command `u`; may raise what the model raises."""

    @abstractmethod
    def correct(self, estimate: Estimate, y: float) -> Estimate:
        """Use measurement `y` [deg]; not-a-number and outliers leave the prediction as it is. Never raises."""

    @abstractmethod
    def advance(self, estimate: Estimate, u: float) -> Estimate:
        """One sample later, `u` having been sent; may raise what the model raises."""

    @abstractmethod
    def coast(self, estimate: Estimate, u: float) -> Estimate:
        """One sample later where `advance` failed: the model state stands still. Never raises."""


@final
class WithoutModel(Observer):
    """The observer of a controller that has no model: keeps the last usable measurement."""

    delay_samples = 0

    def init(self, y: float, u: float) -> Estimate:
        return Estimate(EMPTY, u, (), (), (), 0.0, 0.0, y)

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        angle = usable_angle(y)
        if math.isnan(angle):
            return replace(estimate, missing=estimate.missing + 1)
        return replace(estimate, measured=angle, missing=0)

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        return replace(estimate, command=u)

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return replace(estimate, command=u)
