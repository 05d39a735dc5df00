"""What a device is, what it does wrong and when, and a row of its own log."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from .body import NOMINAL, Body

SAFE = 0.0
"""The command that a device holds at first, and to which its watchdog leads it [mm]."""

FaultKind = Literal[
    "stuck",  # the tip stays where it is
    "dithers",  # it trembles there by `size` deg at `period_s`
    "outside",  # the sensor is out of its range for every other `period_s`; for good where that is 0
    "shifted",  # the sensor has come off: its angle is `size` deg beside
    "spikes",  # every tenth reading is `size` deg beside
    "silent",  # no reading comes any more
    "ages",  # readings come later and later, by `size` s a second
    "held",  # it says that it holds `size` mm
    "held_nan",  # every other `period_s` it does not say what it holds
    "deaf",  # it takes no command, and says so by what it holds
    "restarts",  # it is switched off and on: another session, at rest
    "leaves",  # its watchdog acts although commands come
    "wanders",  # it moves by itself, up and down, and says so
    "steepens",  # the tip goes `size` times as far as before
    "reads_slowly",  # `read` takes `size` s and always has something
    "writes_slowly",  # `write` takes `size` s
    "stalls",  # the program that controls it stands still for `size` s, once
]


@dataclass(frozen=True)
class DeviceFault:
    """What a device does wrong, and when.

    Attributes:
        at_s: when it begins, counted from the first command of a connection [s].
        motion: that connection, or a later one: a commissioning makes one for each motion, all others a single one.
        lasts_s: how long it lasts [s].
        size, period_s: see `FaultKind`.
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
        name: of it, in tables.
        body: from the drive's position to the tip's angle.
        drive_rate: of the drive; what it holds is its position [mm/s].
        noise_deg, quantum_deg: of the sensor [deg].
        stream_hz: readings a second, whatever the loop does.
        flight_s: time that a reading takes to arrive [s].
        tells: whether it says what it holds.
        sessions: whether it listens to those alone that have greeted, and to nobody after its watchdog has acted; else
            to everybody always.
        watchdog_s, return_rate: silence after which it returns to rest, and how fast [mm/s].
        faults: what it does wrong.
        seed: of its noise.
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
    """One row of a device's own log.

    Attributes:
        t_s: its time [s].
        motion: number of the connection, from 0; -1 between two.
        received: command that was taken, NaN in a row without one.
        before: what it held right before [mm].
        held: what it holds, or would once its drive is there [mm].
        told: what it says that it holds.
        x_mm: where the tip's own end of the drive is, after lag and dead time.
        angle_deg, shown_deg: of the tip, and the last one that the sensor gave.
        age_s: of the newest reading that was read, flight at the beginning left out [s].
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
