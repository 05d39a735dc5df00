"""Describing functions: closed forms of single operators, and settled cycles of whole models.

The describing function is the first harmonic of the output over that of a sinusoidal input u = c + A sin(phi):

    N(A) = i / (pi A) int_0^{2 pi} y(phi) exp(-i phi) d phi

Source: Gelb and Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, chapter 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

from ..model import InvertiblePredictor, Predictor
from ..operators.friction import MaxwellSlip
from ..operators.hysteresis import Backlash, Play, Stop
from ..operators.operator import Operator
from ..operators.prandtl_ishlinskii import PrandtlIshlinskii
from ..operators.static_curves import Deadband, Line

Complex = NDArray[np.complex128]
O = TypeVar("O", bound=Operator)  # noqa: E741 - an operator

_SETTLED = 1e-10, 1e-4  # change of the first harmonic from cycle to cycle, as a share of it: of operators, others
_CYCLES = 2, 256  # driven at first, and at most
_SHORTEST = 3  # samples of a period
_LONGEST = 6000  # samples of a transient of a network: the memory of a roll-out grows with its square
_AT_ONCE = 100_000  # samples of all rows of a roll-out, and of a transient of operators


class SettledCycle(NamedTuple):
    """Response of a model to a sinusoidal command once its transient is over.

    Attributes:
        first: first harmonic of the angle over that of the command N (A,) [deg/cmd].
        reach: half the peak-to-peak angle (A,) [deg].
        third: amplitude of the third harmonic as a share of the first (A,); 0 where it cannot be sampled.
        settled: whether the last two cycles agree (A,).
    """

    first: Complex
    reach: Vec
    third: Vec
    settled: NDArray[np.bool_]


def settled_cycle(predictor: Predictor, centre: float, amplitudes: Vec, samples: int, periods: int = 1) -> SettledCycle:
    """Drive a model by u_k = centre + A sin(2 pi P k / n) from rest until its cycle repeats.

        N(A) = 2 i / (n A) sum_k theta_k exp(-2 pi i P k / n)

    theta_k is the angle at the end of the sample in which u_k acts.

    Args:
        centre: mean of the command.
        amplitudes: A > 0, shape (A,).
        samples: n of one cycle, at least 3 in each period.
        periods: periods P in these samples, so that a period need not be a whole number of samples.

    Raises:
        ModelError: if an amplitude is not positive or there are too few samples.
    """
    amplitudes = np.atleast_1d(np.asarray(amplitudes, dtype=np.float64))
    if not np.all(amplitudes > 0) or periods < 1 or samples < _SHORTEST * periods:
        raise ModelError(
            f"describing function: got amplitudes from {np.min(amplitudes):.6g}, {samples} samples of {periods} "
            f"periods, expected amplitudes above 0 and at least {_SHORTEST} samples a period"
        )
    start, (cycles, most) = predictor.initial(0.0, centre), _CYCLES
    exact = isinstance(predictor, InvertiblePredictor)
    longest, close = (_AT_ONCE, _SETTLED[0]) if exact else (_LONGEST, _SETTLED[1])
    most = max(min(most, longest // samples), 2 * cycles)
    while True:
        turn = 2.0 * np.pi * periods * np.arange(cycles * samples) / samples
        parts = np.array_split(amplitudes, min(-(-amplitudes.size * turn.size // _AT_ONCE), amplitudes.size))
        angles = np.vstack([predictor.rollout(start, centre + part[:, None] * np.sin(turn)) for part in parts])
        before, last = angles[:, -2 * samples : -samples], angles[:, -samples:]
        wave = np.exp(-1j * turn[:samples])
        first, earlier = last @ wave, before @ wave
        floor = np.finfo(float).eps * samples * (1.0 + np.abs(last).max(axis=1))
        settled = np.abs(first - earlier) <= close * np.abs(first) + floor
        if np.all(settled) or cycles >= most:
            break
        cycles *= 2
    third = np.abs(last @ wave**3) / np.maximum(np.abs(first), floor) if samples > 6 * periods else 0.0 * amplitudes
    scaled = np.asarray(2j * first / (samples * amplitudes), dtype=np.complex128)
    return SettledCycle(scaled, 0.5 * np.ptp(last, axis=1), third, settled)


def whole_cycle(omega_dt: float, longest: int = 8) -> tuple[int, int]:
    """Samples n and periods P <= `longest` with 2 pi P / n nearest to an angle per sample [rad].

    Raises:
        ModelError: if it is not above 0, or beyond 2 pi / 3: fewer than three samples a period.
    """
    if not 0 < omega_dt <= 2.0 * np.pi / _SHORTEST * (1.0 + 1e-9):
        raise ModelError(
            f"describing function: got {omega_dt:.6g} rad per sample, expected above 0 and up to {2 / _SHORTEST:.3g} pi"
        )
    tries = [(max(round(2.0 * np.pi * p / omega_dt), _SHORTEST * p), p) for p in range(1, longest + 1)]
    return min(tries, key=lambda pair: (round(abs(pair[0] * omega_dt / (2.0 * np.pi * pair[1]) - 1.0), 6), pair[1]))


def of_play(amplitudes: Vec, half_width: float) -> Complex:
    """Describing function of a play of half-width r: 0 for A <= r, else with s = 1 - 2 r / A

        N = 1/2 + (asin s + s sqrt(1 - s^2)) / pi - i (1 - s^2) / pi

    `control.friction_backlash_nonlinearity(b)` is the play of full width b = 2 r.
    """  # fmt: skip
    s = 1.0 - 2.0 * half_width / np.maximum(amplitudes, np.finfo(float).tiny)
    s = np.clip(s, -1.0, 1.0)
    swept = 0.5 + (np.arcsin(s) + s * np.sqrt(1.0 - s * s)) / np.pi
    return np.asarray(swept - 1j * (1.0 - s * s) / np.pi, dtype=np.complex128)


def of_ramp(amplitudes: Vec, threshold: float) -> Vec:
    """Describing function of max(u - d, 0) about u = 0, real: 1/2 - (asin s + s sqrt(1 - s^2)) / pi, s = d / A."""
    s = np.clip(threshold / np.maximum(amplitudes, np.finfo(float).tiny), -1.0, 1.0)
    return np.asarray(0.5 - (np.arcsin(s) + s * np.sqrt(1.0 - s * s)) / np.pi)


def _of_backlash(operator: Backlash, amplitudes: Vec, centre: float) -> Complex | None:
    """Two lines of different slopes with flat paths between them; None where the lines cross in the range."""
    o, values = operator, np.zeros(amplitudes.shape, dtype=np.complex128)
    if o.m_lo == o.m_up and o.c_lo >= o.c_up:
        return np.asarray(o.m_lo * of_play(amplitudes, 0.5 * (o.c_lo - o.c_up)), dtype=np.complex128)
    for k, amplitude in enumerate(amplitudes):
        low, high = centre - amplitude, centre + amplitude
        if min(o.gap(low), o.gap(high)) < 0:
            return None
        top, bottom = o.m_up * (high + o.c_up), o.m_lo * (low + o.c_lo)
        if bottom >= top:
            continue  # the range lies within the dead band
        leaves = np.arcsin(np.clip((top / o.m_lo - o.c_lo - centre) / amplitude, -1.0, 1.0))
        meets = np.arcsin(np.clip((bottom / o.m_up - o.c_up - centre) / amplitude, -1.0, 1.0))
        pieces = (
            (0.5 * np.pi, np.pi - leaves, top, 0.0),
            (np.pi - leaves, 1.5 * np.pi, o.m_lo * (centre + o.c_lo), o.m_lo * amplitude),
            (1.5 * np.pi, 2.0 * np.pi + meets, bottom, 0.0),
            (2.0 * np.pi + meets, 2.5 * np.pi, o.m_up * (centre + o.c_up), o.m_up * amplitude),
        )
        values[k] = sum(_integral(*piece) for piece in pieces) / (np.pi * amplitude)
    return values


def _integral(start: float, end: float, constant: float, sine: float) -> complex:
    """i int (constant + sine sin phi) exp(-i phi) d phi from `start` to `end`."""

    def primitive(phi: float) -> complex:
        swept = 0.5 * phi - 0.25 * np.sin(2.0 * phi) + 0.5j * np.sin(phi) ** 2
        return complex(-constant * np.exp(-1j * phi) + sine * swept)

    return primitive(end) - primitive(start)


def _of_plays(operator: PrandtlIshlinskii, amplitudes: Vec, centre: float) -> Complex | None:
    del centre
    if operator.beta or operator.rate:
        return None
    terms = [a * of_play(amplitudes, i * operator.alpha) for i, a in enumerate(operator.weights, 1)]
    return operator.a0 + sum(terms, np.zeros(amplitudes.shape, dtype=np.complex128))


def _of_sliders(operator: MaxwellSlip, amplitudes: Vec, centre: float) -> Complex | None:
    """The load that grows along the stroke makes even harmonics only, so its mean counts. A slider that never slips is
    taken to rest in its middle."""
    loads = 1.0 + operator.growth * centre - abs(operator.growth) * amplitudes
    if operator.rate or np.any(loads < 0):
        return None
    stops = [k * (1.0 - of_play(amplitudes, i * operator.spacing)) for i, k in enumerate(operator.stiffness, 1)]
    total = sum(stops, np.zeros(amplitudes.shape, dtype=np.complex128))
    return operator.k0 + (1.0 + operator.growth * centre) * total


def _of_dead_zones(operator: Deadband, amplitudes: Vec, centre: float) -> Complex:
    total = operator.slope + np.zeros(amplitudes.shape, dtype=np.complex128)
    sides = ((operator.slopes_above, operator.gaps_above, 1.0), (operator.slopes_below, operator.gaps_below, -1.0))
    for slopes, gaps, sign in sides:
        threshold, last = sign * (operator.centre - centre), operator.slope
        for slope, gap in zip(slopes, gaps, strict=True):
            threshold += gap
            total += (slope - last) * of_ramp(amplitudes, threshold)
            last = slope
    return total


_Form = Callable[[Any, Vec, float], "Complex | None"]
_FORMS: Mapping[type[Operator], _Form] = {
    Play: lambda o, a, c: of_play(a, o.r),
    Stop: lambda o, a, c: 1.0 - of_play(a, o.r),
    Line: lambda o, a, c: np.full(a.shape, o.gain, dtype=np.complex128),
    Backlash: _of_backlash,
    PrandtlIshlinskii: _of_plays,
    MaxwellSlip: _of_sliders,
    Deadband: _of_dead_zones,
}


def closed_form(operator: Operator, amplitudes: Vec, centre: float = 0.0) -> Complex | None:
    """Describing function N (A,) of an operator in closed form; None where there is none.

    Play, stop, line, backlash, Prandtl-Ishlinskii sum, Maxwell slip and dead zones have one; those with a rate have
    none, nor has a backlash whose lines cross within the range.

    Args:
        amplitudes: A > 0 of the input, shape (A,).
        centre: mean of the input.
    """
    form = _FORMS.get(type(operator))
    return None if form is None else form(operator, np.asarray(amplitudes, dtype=np.float64), centre)
