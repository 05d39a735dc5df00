"""Linear analysis of models with hysteresis: static gain, describing function, limit cycles of a PID loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from .command import CommandLimits
from .feedback import PidSettings

Complex = NDArray[np.complex128]

_PERIODS = 2  # periods driven; the hysteresis loop is closed in the last one, which is evaluated
_AMPLITUDES, _SMALLEST = 40, 4e-3  # of half the command range
_SAMPLES_PER_PERIOD = (5, 400)
_FREQUENCIES = 48


@dataclass(frozen=True)
class LimitCycle:
    """Predicted limit cycle: amplitudes of command [cmd] and tip angle [deg], frequency [Hz]."""

    command: float
    angle_deg: float
    frequency_hz: float


@dataclass(frozen=True)
class LoopAnalysis:
    """Result of the harmonic balance of a loop."""

    cycle: LimitCycle | None  # the stable limit cycle of greatest amplitude; None where there is none
    gain: float  # greatest loop gain at a phase of -180 degrees over all amplitudes; below 1 nothing can oscillate
    diverges: bool  # whether the gain is still above 1 at the greatest amplitude: the oscillation grows to the limits

    def __str__(self) -> str:
        if self.cycle is not None:
            c = self.cycle
            return f"limit cycle of {c.angle_deg:.3g} deg at {c.frequency_hz:.3g} Hz"
        return "grows to the command limits" if self.diverges else "no limit cycle"


def describing_function(predictor: Predictor, centre: float, amplitudes: Vec, samples: int) -> Complex:
    """Describing function of a model: first harmonic of the angle over that of a sinusoidal command (A,) [deg/cmd].

        N(A) = 2 / (n A) sum_k theta_k exp(-i 2 pi k / n) / (-i),   u_k = centre + A sin(2 pi k / n)

    For a play of half-width b and slope m it is m times `control.friction_backlash_nonlinearity(2 b)`'s. theta_k is the
    angle at the end of the sample in which u_k acts; the model starts from rest at the centre.

    Args:
        centre: mean of the command.
        amplitudes: A > 0, shape (A,).
        samples: n per period, at least 3.

    Raises:
        ControllerError: if an amplitude is not positive or there are too few samples.
    """
    if not np.all(amplitudes > 0) or samples < 3:
        raise ControllerError(
            f"describing function: got amplitudes {amplitudes}, {samples} samples, expected > 0, >= 3"
        )
    phase = 2.0 * np.pi * np.arange(_PERIODS * samples) / samples
    commands = centre + amplitudes[:, None] * np.sin(phase)
    angles = predictor.rollout(predictor.initial(0.0, centre), commands)[:, -samples:]
    harmonic = angles @ np.exp(-1j * phase[-samples:])
    return np.asarray(2j * harmonic / (samples * amplitudes), dtype=np.complex128)


def analyse_pid(
    predictor: Predictor, gains: PidSettings, limits: CommandLimits, delay_samples: int = 0, centre: float | None = None
) -> LoopAnalysis:
    """Predict the limit cycle of a PID loop around a model by harmonic balance.

        C(z, |N| A) N(A, z) z^-(1 + D) = -1,   z = exp(i omega dt)

    C is the sampled controller with the describing function of its integral's dead zone; N is that of the model, its
    lag included; the loop delay is 1 + D samples. For each amplitude the loop gain is evaluated at a phase of -180
    degrees; where it falls through 1 with growing amplitude the oscillation is stable. Feedforward does not matter: in
    a hold it is constant. Limits on the rate are not accounted for.

    Args:
        limits: half of their range is the greatest amplitude.
        delay_samples: transport delay D that the model does not contain.
        centre: mean of the command; the middle of the limits where left out.

    Source: Gelb and Vander Velde, Multiple-Input Describing Functions, 1968, chapter 2.
    """
    middle = 0.5 * (limits.lower + limits.upper)
    reach = 0.5 * (limits.upper - limits.lower)
    amplitudes = reach * np.geomspace(_SMALLEST, 1.0, _AMPLITUDES)
    counts = np.unique(np.geomspace(*_SAMPLES_PER_PERIOD, _FREQUENCIES).round().astype(int))[::-1]
    response = np.array(
        [describing_function(predictor, middle if centre is None else centre, amplitudes, int(n)) for n in counts]
    )
    frequencies = 1.0 / (counts * predictor.dt)
    loop = response * _controller(gains, predictor.dt, frequencies, np.abs(response) * amplitudes, delay_samples)
    crossings = [_crossing(loop[:, k], frequencies, np.abs(response[:, k])) for k in range(amplitudes.size)]
    return _balance(amplitudes, np.array(crossings))


def _controller(gains: PidSettings, dt: float, frequencies: Vec, errors: Vec, delay_samples: int) -> Complex:
    """Controller and delay C z^-(1 + D) at the frequencies (F,) for error amplitudes (F, A) [deg]."""
    z = np.exp(2j * np.pi * frequencies * dt)[:, None]
    share = dt / (gains.filter_s + dt)
    derivative = gains.kd_s_per_deg * share / dt * (z - 1.0) / (z + share - 1.0)
    integral = gains.ki_per_deg_s * dt / (z - 1.0) * _dead_zone(errors, gains.dead_zone_deg)
    return np.asarray((gains.kp_per_deg + derivative + integral) * z ** -(1 + delay_samples), dtype=np.complex128)


def _dead_zone(amplitudes: Vec, width: float) -> Vec:
    """Describing function of  e if |e| > width else 0:  1 - 2/pi (asin s - s sqrt(1 - s^2)),  s = min(width / A, 1)."""
    s = np.minimum(width / np.maximum(amplitudes, np.finfo(float).tiny), 1.0)
    return 1.0 - 2.0 / np.pi * (np.arcsin(s) - s * np.sqrt(1.0 - s * s))


def _crossing(loop: Complex, frequencies: Vec, gain: Vec) -> tuple[float, float, float]:
    """Greatest loop gain at -180 degrees, its frequency [Hz] and the model's gain there; zeros where there is none."""
    best = (0.0, 0.0, 0.0)
    for k in np.flatnonzero(loop.imag[:-1] * loop.imag[1:] < 0):
        share = loop.imag[k] / (loop.imag[k] - loop.imag[k + 1])
        real = loop.real[k] + share * (loop.real[k + 1] - loop.real[k])
        if -real > best[0]:
            frequency = frequencies[k] * (frequencies[k + 1] / frequencies[k]) ** share
            best = (-float(real), float(frequency), float(gain[k] + share * (gain[k + 1] - gain[k])))
    return best


def _balance(amplitudes: Vec, crossings: Vec) -> LoopAnalysis:
    """Limit cycle at the amplitude above which the loop gain falls below one; rows as returned by `_crossing`."""
    gains, greatest = crossings[:, 0], float(crossings[:, 0].max())
    falls = np.flatnonzero((gains[:-1] > 1.0) & (gains[1:] <= 1.0) & (gains[1:] > 0.0))
    if not falls.size:
        return LoopAnalysis(None, greatest, bool(gains[-1] > 1.0))
    k = int(falls[-1])
    share = math.log(gains[k]) / math.log(gains[k] / gains[k + 1])
    _, frequency, slope = crossings[k] + share * (crossings[k + 1] - crossings[k])
    amplitude = float(amplitudes[k] * (amplitudes[k + 1] / amplitudes[k]) ** share)
    return LoopAnalysis(
        LimitCycle(amplitude, float(slope) * amplitude, float(frequency)), greatest, bool(gains[-1] > 1.0)
    )
