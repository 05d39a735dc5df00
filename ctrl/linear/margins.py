"""Margins of a linear loop in discrete time, by python-control: gain, phase, disk, delay and lag."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hystmpc.models.linear.systems import LinearPart
from hystmpc.trials.types import Mat, Vec

System = Any
"""A system of python-control, which has no types."""

_FREQUENCIES = 400
_LONGEST_DELAY, _LONGEST_LAG_S, _LAGS = 200, 20.0, 40
_ON_THE_CIRCLE, _SETTLED, _BORNE = 1e-9, 0.02, 2.0


@dataclass(frozen=True)
class LoopMargins:
    """Robustness of a closed loop in discrete time.

    Attributes:
        stable: whether the loop is stable as it is; other figures of an unstable loop are no margins.
        gain: factor by which the loop gain may grow; infinite where it may grow without bound.
        phase_deg: phase that may be lost at the crossover [deg].
        crossover_hz: frequency at which the loop gain is 1 [Hz]; not-a-number where it never is.
        disk: radius of the balanced disk margin, 0 to 2.
        disk_gain, disk_phase_deg: gain (factor) and phase [deg] that may be lost at the same time.
        sensitivity: peak M_s of 1 / (1 + L).
        delay_samples: whole samples of further delay that the loop survives; None for more than 200, -1 if unstable.
        lag_s: time constant of a further lag of the drive up to which the peak M_s stays within 2 [s]; infinite for
            20 s and more, 0 where it is above 2 already. Stable is a loop with a longer one, too, but hardly damped.
        settling_s: time to 2 % of a disturbance by the slowest pole [s]; infinite if unstable.

    Source: Seiler, Packard and Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020).
    """

    stable: bool
    gain: float
    phase_deg: float
    crossover_hz: float
    disk: float
    disk_gain: float
    disk_phase_deg: float
    sensitivity: float
    delay_samples: int | None
    lag_s: float
    settling_s: float


def margins_of(loop: System) -> LoopMargins:
    """Margins of a loop L(z), one input and one output, negative feedback."""
    import control

    dt = float(loop.dt)
    omega = np.geomspace(1e-3 / dt, math.pi / dt * (1.0 - 1e-6), _FREQUENCIES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of infinite margins
        gain, phase, _, crossover = control.margin(control.frequency_response(loop, omega))
        disk, disk_gain, disk_phase = (float(np.min(value)) for value in control.disk_margins(loop, omega))
        by_sensitivity, _, _ = control.disk_margins(loop, omega, skew=1.0)
    last = complex(loop(-1.0)).real  # a crossing at half the sample rate is none of a response over frequencies
    if last < 0:
        gain = min(gain, -1.0 / last)
    stable = is_stable(loop)
    return LoopMargins(
        stable=stable,
        gain=float(gain),
        phase_deg=float(phase),
        crossover_hz=float(crossover) / (2.0 * math.pi),
        disk=disk,
        disk_gain=10.0 ** (disk_gain / 20.0),  # the library has it in dB
        disk_phase_deg=disk_phase,
        sensitivity=1.0 / max(float(np.min(by_sensitivity)), 1e-12),
        delay_samples=delay_survived(loop) if stable else -1,
        lag_s=_lag_borne(loop) if stable else 0.0,
        settling_s=_settling_s(loop),
    )


def is_stable(loop: System) -> bool:
    """Whether all poles of L / (1 + L) lie within the unit circle; those that L hides from its output do not count."""
    return bool(np.all(_closed_poles(loop) < 1.0 - _ON_THE_CIRCLE))


def delay_survived(loop: System, longest: int = _LONGEST_DELAY) -> int | None:
    """Greatest further delay with which a stable loop stays stable, with all shorter ones [samples]; None beyond."""
    for samples in range(1, longest + 1):
        if not is_stable(_after(loop, _delay(samples))):
            return samples - 1
    return None


def _lag_borne(loop: System) -> float:
    dt = float(loop.dt)
    z = np.exp(1j * np.geomspace(1e-3, math.pi, _FREQUENCIES))
    shown = loop(z)

    def survives(lag_s: float) -> bool:
        left = math.exp(-dt / lag_s)
        lag = LinearPart(np.array([[left]]), np.array([[1.0 - left]]), np.array([[left]]), np.array([[1.0 - left]]))
        behind = (1.0 - left) * z / (z - left)
        peak = 1.0 / float(np.min(np.abs(1.0 + shown * behind)))
        return peak <= _BORNE and is_stable(_after(loop, lag))

    lags = np.geomspace(0.05 * dt, _LONGEST_LAG_S, _LAGS)
    ends = [k for k, lag in enumerate(lags) if not survives(float(lag))]
    if not ends:
        return math.inf
    return _bisected(survives, float(lags[ends[0] - 1]) if ends[0] else 0.0, float(lags[ends[0]]))


def _settling_s(loop: System) -> float:
    slowest = float(np.max(_closed_poles(loop), initial=0.0))
    return (
        math.inf
        if slowest >= 1.0 - _ON_THE_CIRCLE
        else float(loop.dt) * math.log(_SETTLED) / math.log(max(slowest, 1e-9))
    )


def _bisected(holds: Callable[[float], bool], low: float, high: float) -> float:
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _delay(samples: int) -> LinearPart:
    shift = np.eye(samples, k=-1)
    return LinearPart(shift, np.eye(samples)[:, :1], np.eye(samples)[-1:], np.zeros((1, 1)))


def _after(loop: System, part: LinearPart) -> System:
    from control import ss

    return loop * ss(*part, loop.dt, remove_useless_states=False)


def _closed_poles(loop: System) -> Vec:
    """Magnitudes of the poles of L / (1 + L)."""
    from control import ss

    system: System = ss(loop)
    through = 1.0 + float(np.asarray(system.D).item())
    a: Mat = system.A - system.B @ system.C / through
    return np.asarray(np.abs(np.linalg.eigvals(a)), dtype=np.float64)
