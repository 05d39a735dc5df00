"""Start values of a PID from the margins of its loop, in place of numbers that fit one device."""

from __future__ import annotations

import math

import numpy as np

from hystmpc.models.operators.dynamics import Lag, Servo
from hystmpc.trials.errors import ControllerError

from ..command import CommandLimits
from ..feedback import PidSettings
from .analysis import DeviceModel
from .balance import controller_response
from .limit_cycles import PidLoop

_SHARE = 0.25  # of the range
_LOWERED, _TRIES = 0.7, 20


def gains_by_margin(
    device: DeviceModel, limits: CommandLimits, given: PidSettings, phase_deg: float = 60.0
) -> PidSettings:
    """PI gains whose loop has a phase margin at half of the range, lowered until the hysteresis makes no limit cycle.

        kp / ki = T,   angle L(omega_c) = -180 deg + phase_deg,   |L(omega_c)| = 1,   L = C N(A, omega) z^-(1 + D)

    T is the sum of the lags, which the zero of the PI cancels (lambda tuning). N is the describing function of the
    model at an amplitude A of a quarter of the range, so that the lag of its hysteresis counts. Dead zone, filter and
    anti-windup stay as they are given.

    Args:
        device: the identified model at its operating point.
        limits: of the command, within which a limit cycle counts.
        given: all other numbers of the PID.
        phase_deg: phase margin.

    Raises:
        ControllerError: if the model does not answer to such a command.

    Source: Astrom and Hagglund, Advanced PID Control, 2006, sections 6.5 and 7.5.
    """
    model, dt = device.harmonics, device.model.dt
    amplitude = np.array([_SHARE * (limits.upper - limits.lower)])
    plant = model.response(amplitude)
    if not np.all(np.abs(plant) > 0.0):
        raise ControllerError(f"pid: got no answer of the model to {amplitude[0]:.4g} around {device.command:.4g}")
    drives = (o.inner for o in (*device.drive, *device.model.operators))
    lag = sum(o.tau_s for o in drives if isinstance(o, Lag | Servo))
    unit = PidSettings(kp_per_deg=lag, ki_per_deg_s=1.0, dead_zone_deg=0.0)
    ones = np.ones_like(plant, dtype=np.float64)
    loop = (plant * controller_response(unit, dt, model.frequencies, ones, device.delay_samples))[:, 0]
    late = np.flatnonzero(np.unwrap(np.angle(loop)) <= math.radians(phase_deg - 180.0))
    ki = 1.0 / abs(loop[late[0] if late.size else -1])
    gains = given
    for _ in range(_TRIES):
        two = {"kp_per_deg": float(f"{lag * ki:.4g}"), "ki_per_deg_s": float(f"{ki:.4g}"), "kd_s_per_deg": 0.0}
        gains = given.model_copy(update=two)
        if not PidLoop(model, gains, limits, device.delay_samples).analyse().oscillates:
            return gains
        ki *= _LOWERED
    return gains
