"""Harmonic balance of a PID loop around a model with hysteresis: limit cycles, and the delay that the loop survives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.linear.harmonic import HarmonicModel
from hystmpc.models.model import Predictor
from hystmpc.models.operators.operator import Operator
from hystmpc.trials.types import Vec

from ..command import CommandLimits
from ..feedback import PidSettings
from .balance import Around, come_around, controller_response

Complex = NDArray[np.complex128]

_AMPLITUDES, _SMALLEST = (80, 32, 16), 4e-3  # by the effort of the model; the smallest of half the command range
_BISECTIONS = 12, 5, 4
_MOST_DISTORTED = 0.6  # higher harmonics that come around as a share of the first
_CORRECTIONS, _FAINT = (
    (3, 1, 1),
    0.4,
)  # of the higher harmonics; a loop gain below this, or above its inverse, needs none
_LONGEST_DELAY = 200
_FASTEST = 2.0 * math.pi / 9.0  # of a cycle [rad per sample], from drawn devices: lab/benchmarks/limit_cycles.py


@dataclass(frozen=True)
class LimitCycle:
    """Predicted limit cycle.

    Attributes:
        command: amplitude of the command [cmd].
        angle_deg: half the peak-to-peak angle [deg].
        frequency_hz: frequency [Hz].
        stable: whether the loop comes back to it; from an unstable one it grows or decays.
        distortion: higher harmonics that come around the loop, as a share of the first.
        doubts: why the method is not valid here, empty if nothing is known against it.
    """

    command: float
    angle_deg: float
    frequency_hz: float
    stable: bool = True
    distortion: float = 0.0
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class LoopAnalysis:
    """Result of the harmonic balance of a loop.

    Attributes:
        cycles: all limit cycles, by rising amplitude of the command.
        gain: greatest loop gain at a phase of -180 degrees over all amplitudes; below 1 nothing can oscillate.
        diverges: whether the loop is unstable at the greatest amplitude: an oscillation grows to the command limits.
    """

    cycles: tuple[LimitCycle, ...]
    gain: float
    diverges: bool

    @property
    def cycle(self) -> LimitCycle | None:
        """The stable limit cycle of greatest amplitude; None where there is none."""
        return next((cycle for cycle in reversed(self.cycles) if cycle.stable), None)

    @property
    def oscillates(self) -> bool:
        """Whether an oscillation lasts: a stable limit cycle, or one that only the command limits bound."""
        return self.diverges or self.cycle is not None

    @property
    def starts_at(self) -> float:
        """Amplitude of the command below which the oscillation decays to rest; 0 where it starts from any [cmd]."""
        return max((cycle.command for cycle in self.cycles if not cycle.stable), default=0.0)

    def __str__(self) -> str:
        if self.diverges:
            return "grows to the command limits"
        if self.cycle is None:
            return "no limit cycle"
        doubts = f", doubtful: {'; '.join(self.cycle.doubts)}" if self.cycle.doubts else ""
        return f"limit cycle of {self.cycle.angle_deg:.3g} deg at {self.cycle.frequency_hz:.3g} Hz{doubts}"


@final
@dataclass(frozen=True, eq=False)
class PidLoop:
    """Loop of a PID around a model, also of a PID beside an inverse, whose feedforward rests in a hold.

        C(z, |N| A) N(A, omega) z^-(1 + D) = -1,   z = exp(i omega dt)

    C is the sampled controller with the describing function of its integral's dead zone, N that of the model with its
    lag; the loop delay is 1 + D samples. An amplitude is unstable where the curve of L over omega goes around -1; it
    grows there. A limit cycle is where that changes: a stable one if smaller amplitudes grow. Limits of command and
    rate are not in the equation: a cycle that meets them has a doubt.

    Attributes:
        model: describing function of the model.
        gains: of the PID.
        limits: the distance of the centre from them is the greatest amplitude.
        delay_samples: transport delay D that the model does not contain.

    Source: Gelb and Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, chapters 2, 3.
    """

    model: HarmonicModel
    gains: PidSettings
    limits: CommandLimits
    delay_samples: int = 0

    @property
    def reach(self) -> float:
        """Greatest amplitude of the command within its limits [cmd]."""
        return min(self.limits.upper - self.model.centre, self.model.centre - self.limits.lower)

    @cached_property
    def _amplitudes(self) -> Vec:
        return (
            0.5 * (self.limits.upper - self.limits.lower) * np.geomspace(_SMALLEST, 1.0, _AMPLITUDES[self.model.effort])
        )

    @cached_property
    def _response(self) -> Complex:
        return self.model.response(self._amplitudes)

    def delayed(self, samples: int) -> PidLoop:
        """The same loop with another delay; the describing function is not evaluated anew."""
        other = replace(self, delay_samples=samples)
        other.__dict__["_response"] = self._response
        return other

    def loop(self, amplitudes: Vec, response: Complex) -> Complex:
        """L (F, A) from the describing function (F, A) of the model, corrected where it crosses -180 degrees."""
        omega = self.model.frequencies
        dt, errors = self.model.predictor.dt, np.abs(response) * amplitudes
        first = response * controller_response(self.gains, dt, omega, errors, self.delay_samples)
        whole = first
        for _ in range(_CORRECTIONS[self.model.effort]):
            crossings = np.array([_crossing(whole[:, k], omega) for k in range(amplitudes.size)])
            far = np.flatnonzero((crossings[:, 0] > _FAINT) & (crossings[:, 0] < 1.0 / _FAINT))
            if not far.size:
                return whole
            whole = first.copy()
            whole[:, far] *= self.around(amplitudes[far], crossings[far, 1]).factor
        return whole

    def around(self, amplitudes: Vec, omega: Vec) -> Around:
        """The loop with all harmonics at frequencies (A,) [rad/s], see `come_around`."""
        return come_around(self.model, self.gains, self.delay_samples, amplitudes, omega)

    def analyse(self) -> LoopAnalysis:
        """Find all limit cycles over the amplitudes within the limits."""
        amplitudes = self._amplitudes
        loop = self.loop(amplitudes, self._response)
        unstable = [_encircles(loop[:, k]) for k in range(amplitudes.size)]
        crossings = [_crossing(loop[:, k], self.model.frequencies) for k in range(amplitudes.size)]
        changes = [k for k in range(amplitudes.size - 1) if unstable[k] != unstable[k + 1]]
        cycles = [self._refined(amplitudes[k], amplitudes[k + 1], unstable[k]) for k in changes]
        known = tuple(cycle for cycle in cycles if cycle is not None)
        return LoopAnalysis(known, max(gain for gain, _ in crossings), unstable[-1])

    def _refined(self, below: float, above: float, grows_below: bool) -> LimitCycle | None:
        """Limit cycle between two amplitudes, by bisection; None for one slower than all frequencies."""
        loop: Complex = np.empty(0, dtype=np.complex128)
        for _ in range(_BISECTIONS[self.model.effort]):
            middle = np.array([math.sqrt(below * above)])
            loop = self.loop(middle, self.model.response(middle))[:, 0]
            below, above = (float(middle[0]), above) if _encircles(loop) == grows_below else (below, float(middle[0]))
        _, omega = _crossing(loop, self.model.frequencies, nearest=True)
        if omega == 0.0:
            return None
        return self._cycle(math.sqrt(below * above), omega, grows_below)

    def _cycle(self, amplitude: float, omega: float, stable: bool) -> LimitCycle:
        dt, around = self.model.predictor.dt, self.around(np.array([amplitude]), np.array([omega]))
        reach, distortion, settled = (values[0].item() for values in around[1:])
        doubts = []
        if distortion > _MOST_DISTORTED:
            doubts.append(f"{100 * distortion:.0f} % higher harmonics come around")
        if amplitude > self.reach:
            doubts.append("the command limits act")
        if amplitude * omega > self.limits.rate:
            doubts.append("the rate limit acts")
        if omega * dt > _FASTEST:
            doubts.append(f"{2.0 * math.pi / (omega * dt):.2g} samples a period, so that the cycle may lock to them")
        if not settled:
            doubts.append("no cycle repeats itself")
        return LimitCycle(amplitude, reach, omega / (2.0 * np.pi), stable, distortion, tuple(doubts))

    def delay_margin(self) -> int | None:
        """Greatest further delay without a lasting oscillation [samples]; -1 if there is one already, None for 200."""
        for more in range(_LONGEST_DELAY):
            if self.delayed(self.delay_samples + more)._lasts():
                return more - 1
        return None

    def _lasts(self) -> bool:
        loop = self.loop(self._amplitudes, self._response)
        return any(_encircles(loop[:, k]) for k in range(self._amplitudes.size))


def analyse_pid(
    predictor: Predictor,
    gains: PidSettings,
    limits: CommandLimits,
    delay_samples: int = 0,
    centre: float | None = None,
    operators: Sequence[Operator] = (),
) -> LoopAnalysis:
    """Predict the limit cycles of a PID loop around a model, see `PidLoop`.

    Args:
        centre: mean of the command; the middle of the limits where left out.
        operators: that the model consists of, in series, for the closed form; settled cycles without.
    """
    middle = 0.5 * (limits.lower + limits.upper) if centre is None else centre
    return PidLoop(HarmonicModel(predictor, operators, middle), gains, limits, delay_samples).analyse()


def _encircles(loop: Complex) -> bool:
    """Whether a loop curve (F,) over rising frequency goes around -1: its quasi-linear loop is unstable.

    The poles of the loop are those of a stable model and one integrator. The curve then begins below the real axis;
    where it begins above and left of -1, it has crossed before its first point. Its mirror image at negative
    frequencies joins its end, so that a crossing there counts half.
    """
    count = 2 * int(loop[0].imag > 0 and loop[0].real < -1.0)
    if loop[-1].real < -1.0:
        count += 1 if loop[-1].imag < 0 else -1
    for k in np.flatnonzero(loop.imag[:-1] * loop.imag[1:] < 0):
        share = loop.imag[k] / (loop.imag[k] - loop.imag[k + 1])
        if loop.real[k] + share * (loop.real[k + 1] - loop.real[k]) < -1.0:
            count += 2 if loop.imag[k] < 0 else -2
    return count > 0


def _crossing(loop: Complex, omega: Vec, nearest: bool = False) -> tuple[float, float]:
    """Greatest loop gain at -180 degrees and its frequency [rad/s]; of the gain `nearest` to 1; zeros for none."""
    best = (-float(loop[-1].real), float(omega[-1])) if loop[-1].real < 0 else (0.0, 0.0)
    for k in np.flatnonzero(loop.imag[:-1] * loop.imag[1:] < 0):
        share = loop.imag[k] / (loop.imag[k] - loop.imag[k + 1])
        gain = -float(loop.real[k] + share * (loop.real[k + 1] - loop.real[k]))
        to_one = nearest and gain > 0 and best[0] > 0
        if abs(math.log(gain)) < abs(math.log(best[0])) if to_one else gain > best[0]:
            best = gain, float(omega[k] * (omega[k + 1] / omega[k]) ** share)
    return best
