"""Features of a play-kernel model along a trial, a block of samples at a time, and their moments."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..contract.metadata import Range
from .predictor import follow_plays
from .weights import ramps

BLOCK = 16_384
"""Samples whose features are held at once, 25 MB."""


@dataclass(frozen=True)
class Frame:
    """What makes commands and angles dimensionless, and what the features are made of.

    Attributes:
        command, angle: trained ranges [cmd], [deg].
        radii, knots: of plays and ramps, in units of the command range.
        stops: whether what the plays leave is a feature, too.
        dt: sample interval [s].
    """

    command: Range
    angle: Range
    radii: Vec
    knots: Vec
    stops: bool
    dt: float

    def gain(self, lag_s: float) -> float:
        """Share of the way to the command that a lag with this time constant [s] makes in a sample."""
        return 1.0 if lag_s == 0 else 1 - math.exp(-self.dt / lag_s)


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean products of one trial's features (F,) with each other and with its scaled angle, from the first sample that
    counts on: all that a fit takes from it."""

    gram: Vec
    mean: Vec
    right: Vec
    angle: float


@final
class Course:
    """One trial on its way through the plays, a block of samples at a time.

    The features of a sample are some 200 numbers: of five million samples they would be 8 GB.
    """

    def __init__(self, trial: Trial, start: int, frame: Frame, lag_s: float) -> None:
        self._trial, self._start, self._frame, self._gain = trial, start, frame, frame.gain(lag_s)

    def blocks(self) -> Iterator[tuple[Vec, Vec]]:
        """Features (T, F) and scaled angle (T,) of the samples that count; the plays run from rest over all."""
        trial, frame = self._trial, self._frame
        state = np.full(frame.radii.size + 1, scaled(trial.command[0], frame.command))
        for first in range(0, len(trial), BLOCK):
            block = slice(first, first + BLOCK)
            states = follow_plays(scaled(trial.command[block], frame.command), self._gain, frame.radii, state)
            state, cut = states[-1].copy(), max(self._start - first, 0)
            if cut < len(states):
                yield self._features(states[cut:]), scaled(trial.angle[block], frame.angle)[cut:]

    @cached_property
    def moments(self) -> Moments:
        """Of all blocks together."""
        count, angle = 0, 0.0
        gram, mean, right = (np.zeros(()) for _ in range(3))
        for x, y in self.blocks():
            count, angle = count + y.size, angle + float(y.sum())
            gram, mean, right = gram + x.T @ x, mean + x.sum(axis=0), right + x.T @ y
        return Moments(gram / count, mean / count, right / count, angle / count)

    def scatter(self, slopes: Vec) -> Vec:
        """Standard deviation (S,) of the errors of models with slopes (F, S): each may have an offset of its own."""
        count, mean, square = 0, np.zeros(slopes.shape[1]), np.zeros(slopes.shape[1])
        for x, y in self.blocks():
            errors = x @ slopes - y[:, None]
            own = errors.mean(axis=0)
            share = y.size / (count + y.size)  # joined as in Chan, Golub, LeVeque, Amer. Statist. 37 (1983)
            square += np.sum((errors - own) ** 2, axis=0) + count * share * (own - mean) ** 2
            mean, count = mean + share * (own - mean), count + y.size
        return np.asarray(np.sqrt(square / count), dtype=np.float64)

    def _features(self, states: Vec) -> Vec:
        features = ramps(states, self._frame.knots).reshape(len(states), -1)
        if not self._frame.stops:
            return features
        stop = states[:, :1] - states[:, 1:]
        return np.hstack([features, np.minimum(stop, 0.0), np.maximum(stop, 0.0)])


def scaled(values: Any, bounds: Range) -> Any:
    """Values in units of a range, 0 at its lower end."""
    return (values - bounds.lower) / span(bounds)


def span(bounds: Range) -> float:
    """Width of a range."""
    return bounds.upper - bounds.lower
