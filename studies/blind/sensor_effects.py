"""Withheld effects of the sensor: coarse quantiser with dither, heavy-tailed noise, dropouts."""

from __future__ import annotations

import numpy as np

from hystmpc.trials.types import Vec

from .generator import Generator, Shape, between
from .scene import Scene


def dithered_quantiser(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Steps of `size` [deg] after a triangular dither of a share of a step."""
    random = scene.random("dithered_quantiser")
    dither = shape["dither"] * size * (random.random(angle.size) - random.random(angle.size))
    return np.round((angle + dither) / size) * size


def heavy_tails(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Noise of `size` [deg] with Student's t of 2 to 4 degrees of freedom."""
    return angle + size * np.clip(scene.random("heavy_tails").standard_t(shape["freedom"], angle.size), -30, 30)


def dropouts(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Stretches of `length_s`, about `size` of them a minute, in which the last value stands still."""
    random = scene.random("dropouts")
    length = max(round(25 * shape["length_s"]), 2)
    # One number a sample, compared with the size: a larger size keeps every dropout of a smaller one.
    starts = np.flatnonzero(random.random(angle.size) < size / 60 / 25)
    keep = np.arange(angle.size)
    for start in starts:
        keep[start + 1 : start + length] = np.minimum(keep[start + 1 : start + length], keep[start])
    return angle[keep]


SENSOR_EFFECTS = (
    Generator("dithered_quantiser", "sensor", "sensor", 1.0, 30.0, between(dither=(0.1, 0.5)), dithered_quantiser),
    Generator("heavy_tails", "sensor", "sensor", 0.2, 5.0, between(freedom=(2.2, 4.0)), heavy_tails),
    Generator("dropouts", "sensor", "sensor", 10.0, 200.0, between(length_s=(0.3, 0.8)), dropouts),
)
