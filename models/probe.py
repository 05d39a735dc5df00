"""The motion on which a model is tried: a decaying sinusoid over its trained range."""

from __future__ import annotations

import math

import numpy as np

from .contract.metadata import ModelMetadata
from .model import Array

CYCLES, FREQUENCY_HZ = 7, 0.2


def probe_commands(facts: ModelMetadata) -> Array:
    """Commands (T,) at the model's sample time: S2 eq. (9)-(10) with zero baseline, 0.2 Hz, seven cycles.

    u = low + (high - low) / 2 e^{-tau t} (sin(2 pi f t - pi / 2) + 1),  tau = f ln(7) / 6; slower where the device
    was never driven as fast, so that the probe stays inside what the model was trained on.
    """
    low, high = facts.trained_command.lower, facts.trained_command.upper
    half = 0.5 * (high - low)
    frequency = min(FREQUENCY_HZ, facts.trained_rate / (2 * math.pi * half))
    t = np.arange(0.0, CYCLES / frequency, facts.dt_s)
    decay = np.exp(-frequency / 6 * math.log(7) * t)
    return np.clip(low + half * decay * (np.sin(2 * np.pi * frequency * t - np.pi / 2) + 1), low, high)
