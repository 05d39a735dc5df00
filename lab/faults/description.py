"""Description of a device of the campaign: its body, its faults with their times, and a row of its log."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Literal

WEIGHTS = (3.6283, 3.2260, 1.8436, 1.0266, 0.7115)
"""Of the command itself and of four plays, as in `builtin:pi` [deg/mm]."""

SPACING_MM = 0.2415
"""Of the thresholds of these plays [mm]."""

_REST_DEG = 25.35


@dataclass(frozen=True)
class Body:
    """Motion of the tip by the drive's position x.

        theta = rest_deg + gain (w_0 x' + sum_i w_i play_i(x')),   x' = x after dead time, lag and backlash

    Attributes:
        gain: against the nominal device's; negative for one that is inverted.
        rest_deg: angle at rest [deg].
        weights: w [deg/mm].
        spacing_mm: of the thresholds of the plays [mm].
        backlash_mm: width of a play before all of them: so far the drive goes without any motion of the tip [mm].
        lag_s, dead_s: of the tip behind the drive [s].
        own_hz, damping: of a second-order oscillation of the tip; 0 Hz for none.
        creep, creep_s: share of the motion that comes later, and its time constant [s].
    """

    gain: float = 1.0
    rest_deg: float = _REST_DEG
    weights: tuple[float, ...] = WEIGHTS
    spacing_mm: float = SPACING_MM
    backlash_mm: float = 0.0
    lag_s: float = 0.03
    dead_s: float = 0.0
    own_hz: float = 0.0
    damping: float = 0.1
    creep: float = 0.0
    creep_s: float = 20.0

    @property
    def slope(self) -> float:
        """Greatest absolute slope of the angle over the command [deg/mm]."""
        return abs(self.gain) * sum(self.weights)

    @property
    def slow_s(self) -> float:
        """Duration of the tip's motion after the end of the drive's [s]."""
        return self.lag_s + self.dead_s


NOMINAL = Body()
"""The body that models of the campaign are of."""


@dataclass
class BodyState:
    """Variable state of a body."""

    x: float
    slack: float
    plays: list[float]
    angle_deg: float
    tip_deg: float
    speed_deg_s: float = 0.0
    slow_deg: float = 0.0
    time_s: float = 0.0
    past: deque[tuple[float, float]] = field(default_factory=deque)


def at_rest(body: Body, x: float) -> BodyState:
    """State at rest at a position [mm]."""
    angle = body.rest_deg + body.gain * sum(body.weights) * x
    return BodyState(x, x, [x] * (len(body.weights) - 1), angle, angle, slow_deg=angle)


def moved(body: Body, state: BodyState, position: float, dt_s: float) -> float:
    """Angle after a step with the drive at that position [deg]; updates the state."""
    state.time_s += dt_s
    if body.dead_s:
        state.past.append((state.time_s, position))
        while len(state.past) > 1 and state.past[1][0] <= state.time_s - body.dead_s:
            state.past.popleft()
        position = state.past[0][1]
    state.x += (position - state.x) * (1.0 - math.exp(-dt_s / body.lag_s) if body.lag_s else 1.0)
    half = 0.5 * body.backlash_mm
    state.slack = max(state.x - half, min(state.x + half, state.slack))
    angle = body.weights[0] * state.slack
    for i, weight in enumerate(body.weights[1:]):
        threshold = body.spacing_mm * (i + 1)
        z = state.plays[i] = max(state.slack - threshold, min(state.slack + threshold, state.plays[i]))
        angle += weight * z
    angle = body.rest_deg + body.gain * angle
    if body.own_hz:
        omega = 2.0 * math.pi * body.own_hz
        pull = omega * omega * (angle - state.tip_deg) - 2.0 * body.damping * omega * state.speed_deg_s
        state.speed_deg_s += pull * dt_s
        state.tip_deg += state.speed_deg_s * dt_s
        angle = state.tip_deg
    if body.creep:
        state.slow_deg += (angle - state.slow_deg) * (1.0 - math.exp(-dt_s / body.creep_s))
        angle -= body.creep * (angle - state.slow_deg)
    state.angle_deg = angle
    return angle


SAFE = 0.0
"""The command that a device holds at first, and to which its watchdog leads it [mm]."""

FaultKind = Literal[
    "stuck",  # the tip does not move
    "dithers",  # the tip oscillates about a fixed angle by `size` deg at `period_s`
    "outside",  # the sensor is out of range for every other `period_s`; permanently if that is 0
    "shifted",  # a loose sensor: its angle is shifted by `size` deg
    "spikes",  # every tenth reading is shifted by `size` deg
    "silent",  # no further readings
    "ages",  # the delay of readings grows by `size` s a second
    "held",  # reports a held command of `size` mm
    "held_nan",  # no report of the held command for every other `period_s`
    "deaf",  # rejects commands, as its reported held command shows
    "restarts",  # power cycle: another session, at rest
    "leaves",  # its watchdog acts in spite of commands
    "wanders",  # moves by itself, up and down, with true reports
    "steepens",  # gain of the tip multiplied by `size`
    "reads_slowly",  # `read` takes `size` s and always returns a reading
    "writes_slowly",  # `write` takes `size` s
    "stalls",  # the controlling program stalls once for `size` s
]


@dataclass(frozen=True)
class DeviceFault:
    """Fault of a device and its time.

    Attributes:
        at_s: when it begins, counted from the first command of a connection [s].
        motion: that connection, or a later one: a commissioning makes one for each motion, all others a single one.
        lasts_s: how long it lasts [s].
    """

    kind: FaultKind
    at_s: float = 3.0
    motion: int = 0
    lasts_s: float = math.inf
    size: float = 0.0
    period_s: float = 0.0


@dataclass(frozen=True)
class DeviceSpec:
    """Description of a device.

    Attributes:
        body: from the drive's position to the tip's angle.
        drive_rate: of the drive, whose position is the held command [mm/s].
        noise_deg, quantum_deg: of the sensor [deg].
        stream_hz: readings a second, independent of the loop.
        flight_s: time of flight of a reading [s].
        sessions: whether it accepts commands only after a greeting, and a new greeting after an action of its watchdog;
            else it accepts all commands.
        watchdog_s, return_rate: silence after which it returns to rest, and the rate of the return [mm/s].
    """

    name: str
    body: Body = NOMINAL
    drive_rate: float = math.inf
    noise_deg: float = 0.1
    quantum_deg: float = 0.0
    stream_hz: float = 100.0
    flight_s: float = 0.001
    tells: bool = True
    sessions: bool = True
    watchdog_s: float = 0.5
    return_rate: float = 2.0
    faults: tuple[DeviceFault, ...] = ()
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the log of a device.

    Attributes:
        t_s: its time [s].
        motion: number of the connection, from 0; -1 between two.
        received: accepted command, NaN in a row without one.
        before: held command right before [mm].
        held: held command, or the target of the drive [mm].
        x_mm: position at the tip's end of the drive, after lag and dead time.
        angle_deg, shown_deg: angle of the tip, and last one of the sensor.
        age_s: of the newest reading that was read, without the initial time of flight [s].
    """

    t_s: float
    motion: int
    received: float
    before: float
    held: float
    told: float
    x_mm: float
    angle_deg: float
    shown_deg: float
    age_s: float
