"""Small simulators that the tests of the next motion choose between."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from hystmpc.gap.next.motion_design import OpenHypothesis, Simulate
from hystmpc.trials.types import Vec


def low_pass(signal: Vec, tau_s: float, dt: float) -> Vec:
    """First-order lag that starts at rest."""
    share = 1 - np.exp(-dt / tau_s)
    start = [(1 - share) * signal[0]]
    return np.asarray(lfilter([share], [1, share - 1], signal, zi=start)[0])


def play(command: Vec, width: float) -> Vec:
    """Backlash of a half width, started at its upper edge."""
    out = np.empty_like(command)
    z = command[0] - width
    for k, u in enumerate(command.tolist()):
        z = min(max(z, u - width), u + width)
        out[k] = z
    return out


def angle(command: Vec) -> Vec:
    """A backlash of 10 deg/mm."""
    return 20 + 10 * play(command, 0.3)


def lag(tau_s: float) -> Simulate:
    """The backlash behind a first-order lag."""
    return lambda command, dt: angle(low_pass(command, tau_s, dt))


def delay(seconds: float) -> Simulate:
    """The backlash behind a pure delay."""

    def simulate(command: Vec, dt: float) -> Vec:
        t = np.arange(command.size) * dt
        return angle(np.interp(t - seconds, t, command))

    return simulate


def creep(share: float, tau_s: float) -> Simulate:
    """The backlash with a part of the command that arrives late."""
    return lambda command, dt: angle((1 - share) * command + share * low_pass(command, tau_s, dt))


def baseline(command: Vec, dt: float) -> Vec:
    """The backlash alone."""
    del dt
    return angle(command)


LAG = OpenHypothesis("lag", lag(0.12), (lag(0.13),))
DELAY = OpenHypothesis("delay", delay(0.1), (delay(0.11),))
CREEP = OpenHypothesis("creep", creep(0.15, 5.0), (creep(0.16, 5.0), creep(0.15, 5.5)))
