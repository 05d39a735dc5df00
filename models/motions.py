"""Test motions of a model: a decaying sinusoid, and the initialisation flexure that conditions it."""

from __future__ import annotations

import math

import numpy as np

from hystmpc.trials.types import Vec

from .contract.metadata import ModelMetadata, Range
from .model import StepFunction

CYCLES, FREQUENCY_HZ = 7, 0.2


def probe_commands(facts: ModelMetadata) -> Vec:
    """Decaying sinusoid (T,) of S2 (RA-L 2024) eq. (9)-(10): zero baseline, 0.2 Hz, seven cycles.

    u = low + (high - low) / 2 e^{-tau t} (sin(2 pi f t - pi / 2) + 1),  tau = f ln(7) / 6; slower where needed to
    stay within the trained rate.
    """
    low, high = facts.trained_command.lower, facts.trained_command.upper
    half = 0.5 * (high - low)
    frequency = min(FREQUENCY_HZ, facts.trained_rate / (2 * math.pi * half))
    t = np.arange(0.0, CYCLES / frequency, facts.dt_s)
    decay = np.exp(-frequency / 6 * math.log(7) * t)
    return np.clip(low + half * decay * (np.sin(2 * np.pi * frequency * t - np.pi / 2) + 1), low, high)


FLEXURE_HZ = 0.1
REST_S = 5.0


def flexed(step: StepFunction, state: Vec, commands: Range, dt_s: float, warmup_samples: int) -> Vec:
    """State (S,) after the initialisation flexure of S2 (RA-L 2024), simulated by the model from a state (S,)."""
    at = state[None]
    for u in initialisation_flexure(commands, dt_s, warmup_samples):
        _, at = step.advance(at, np.array([[u]]))
    return at[0]


def initialisation_flexure(commands: Range, dt_s: float, warmup_samples: int, rest: float | None = None) -> Vec:
    """Commands (T,) of a flexure: the lowest for the warm-up, a 0.1 Hz sine to the highest and back, 5 s at rest.

    A device with its rest between both ends, such as one that bends both ways, then moves from the lowest command to
    its rest along half a sine of the same duration.

    Args:
        rest: command at rest; the lowest where left out.
    """
    t = np.arange(0.0, 1.0 / FLEXURE_HZ, dt_s)
    sine = 0.5 - 0.5 * np.cos(2 * math.pi * FLEXURE_HZ * t)
    share = 0.0 if rest is None else (rest - commands.lower) / (commands.upper - commands.lower)
    back = share * sine[: t.size // 2] if share else sine[:0]
    shape = np.concatenate([np.zeros(warmup_samples), sine, back, np.full(round(REST_S / dt_s), share)])
    return commands.lower + (commands.upper - commands.lower) * shape
