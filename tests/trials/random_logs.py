"""Random recordings of random devices, for laws: a command that never repeats itself, and a device that answers it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec


@dataclass(frozen=True)
class Device:
    """Delay, first-order lag, play, creep, gain, offset, and a sensor with noise and steps; all may be nothing."""

    delay_s: float = 0.0
    lag_s: float = 0.0
    play: float = 0.0
    play_share: float = 1.0
    creep: float = 0.0
    creep_s: float = 10.0
    set: float = 0.0
    gain: float = 10.0
    offset: float = 14.0
    noise: float = 0.0
    step: float = 0.0


def device(random: np.random.Generator, creeps: bool = False) -> Device:
    """A healthy device that may be slow, loose, inverted, noisy or read in steps."""

    def some(most: float) -> float:
        return float(random.choice([0.0, random.uniform(0.0, most)]))

    gain = float(random.uniform(4, 15) * random.choice([-1, 1]))
    return Device(
        delay_s=some(1.0), lag_s=some(0.6), play=some(1.5), play_share=float(random.uniform(0.2, 1.0)),
        creep=some(0.3) if creeps else 0.0, creep_s=float(10 ** random.uniform(0, 2)),
        gain=gain, offset=float(random.uniform(-30, 60)), noise=some(0.3), step=some(1.0),
    )  # fmt: skip


def answer(command: Vec, dt: float, device: Device, random: np.random.Generator, play_at: float = 0.0) -> Vec:
    """Angle (T,) of a device that rested at the first command; `play_at` is where in its play it began, -1 to 1."""
    late = round(device.delay_s / dt)
    u = np.concatenate([np.full(late, command[0]), command])[: command.size]
    keep = np.exp(-dt / device.lag_s) if device.lag_s else 0.0
    slow = np.exp(-dt / device.creep_s)
    x, z = u[0], u[0] + play_at * device.play
    first = greatest = crept = (1 - device.play_share) * x + device.play_share * z
    y = np.empty(command.size)
    for k, value in enumerate(u):
        x = keep * x + (1 - keep) * value
        z = min(max(z, x - device.play), x + device.play)
        bend = (1 - device.play_share) * x + device.play_share * z
        greatest = max(greatest, bend)
        crept = slow * crept + (1 - slow) * bend
        y[k] = bend + device.creep * (crept - first) + device.set * (greatest - first)
    y = device.offset + device.gain * y + device.noise * random.normal(size=y.size)
    return device.step * np.rint(y / device.step) if device.step else y


def wandering(random: np.random.Generator, seconds: float, dt: float, low: float = 0.5, high: float = 5.5) -> Vec:
    """A command that goes from one random value to the next at random speeds, and rests now and then."""
    parts, at = [np.full(round(random.uniform(0.0, 2.0) / dt) + 1, 0.5 * (low + high))], 0.5 * (low + high)
    total = 0.0
    while total < seconds:
        to = float(random.uniform(low, high))
        count = max(2, round(random.uniform(0.4, 3.0) / dt))
        shape = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, count + 1) / count)
        parts.append(at + (to - at) * shape)
        rest = round(float(random.choice([0.0, random.uniform(0.3, 2.0)])) / dt)
        parts.append(np.full(rest, to))
        total, at = total + (count + rest) * dt, to
    return np.concatenate(parts)[: round(seconds / dt)]


def log(random: np.random.Generator, rate_hz: float = 50.0, seconds: float = 60.0) -> Trial:
    """A healthy recording."""
    dt = 1 / rate_hz
    command = wandering(random, seconds, dt)
    angle = answer(command, dt, device(random), random)
    return Trial(dt * np.arange(command.size), command, angle, units=Units("mm", "deg"))
