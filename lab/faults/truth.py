"""Verdict on a played device from its log: commands, rate, angle limits, time of the fault's effect, last motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hystmpc.bench.phases import ANGLE_MARGIN, MEDIAN
from hystmpc.rig.safety.plausibility import PlausibilitySettings
from hystmpc.trials.types import Vec

from .description import SAFE, DeviceFault, FaultKind, Row
from .hostile import HostileDevice

Rows = NDArray[np.intp]
Mover = Literal["run", "record", "commission", "investigate", "ros2"]
MOVERS: tuple[Mover, ...] = ("run", "record", "commission", "investigate", "ros2")
NOTICE_S = 1.5
"""Greatest time from the moment at which a fault shows to the last motion away from the safe command [s]."""

_CLOSE = 1e-6
_WATCH = PlausibilitySettings()
_DASH = 1  # motion of a commissioning from which on the narrowed range holds
_AGE_S = 0.1  # `sensor.age_limit_s`
_FOLLOWS_S, _FOLLOWS_MM = 0.5, 0.1  # `sensor.dead_after_s`, `sensor.held_tolerance`
_SHARE, _WINDOW_S = 0.25, 4.0  # of a time in which that share without an angle shows
_BY_ITSELF_S = 60.0
_AGAINST = 0.025  # of the sensor's range, by which an inverted tip has to move
_STILL_MM = 0.05
_WATCHED_S = 3.0  # after the tip has passed its limits


@dataclass(frozen=True)
class Asked:
    """Conditions of a device's use.

    Attributes:
        lower, upper, rate_per_s: limits of the command [mm, mm/s].
        dt_s: sample time [s].
        overshoot: permitted overshoot of a stop [mm].
        sensor_deg: range of plausible angles [deg].
        angle_limits_deg: permitted range of the tip; None if the mover has none [deg].
        grace_s: tolerance of the arrival times of commands, on a clock that is not computed [s].
    """

    mover: Mover
    lower: float
    upper: float
    rate_per_s: float
    dt_s: float
    overshoot: float
    sensor_deg: tuple[float, float]
    angle_limits_deg: tuple[float, float] | None = None
    grace_s: float = 0.0


@dataclass(frozen=True)
class Ending:
    """End of a mover.

    Attributes:
        how: regular end, stopped, ended early, refused with a reason, or an exception that is not the package's own.
        words: the cause, in the words of the program.
        in_c: samples executed wholly in C; -1 where none was required.
    """

    how: Literal["ended", "stopped", "early", "refused", "raised"]
    words: str = ""
    latched: bool = False
    in_c: int = -1


@dataclass(frozen=True)
class DeviceVerdict:
    """One row of the table.

    Attributes:
        commands: accepted by the device; `beyond` of them beyond limits or rate.
        shows_s: first visible effect of a fault, on the device's clock; NaN without one [s].
        moved_s: time from then to the last motion away from the safe command; 0 without one [s].
        past_deg: overshoot of the tip beyond the angle limits, without the unavoidable part [deg].
    """

    name: str
    mover: str
    healthy: bool
    how: str
    words: str
    commands: int
    beyond: int
    shows_s: float
    moved_s: float
    past_deg: float
    failures: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether all requirements are met."""
        return not self.failures


@dataclass(frozen=True, eq=False)
class Truth:
    """Log of a device as columns (N,), and the conditions of its use."""

    asked: Asked
    device: HostileDevice
    t: Vec
    motion: Vec
    received: Vec
    before: Vec
    held: Vec
    told: Vec
    x: Vec
    angle: Vec
    age: Vec

    @classmethod
    def of(cls, device: HostileDevice, asked: Asked) -> Truth:
        """Truth of a used device."""
        rows: list[Row] = device.rows

        def column(name: str) -> Vec:
            return np.array([getattr(row, name) for row in rows], dtype=np.float64)

        names = ("t_s", "motion", "received", "before", "held", "told", "x_mm", "angle_deg", "age_s")
        return cls(asked, device, *(column(name) for name in names))

    @property
    def commands(self) -> Rows:
        """Indices of the rows with a command."""
        return np.flatnonzero(np.isfinite(self.received))


def beyond(truth: Truth) -> int:
    """Commands beyond the value limits, or farther from the held command than the rate allows in the elapsed time.

    A device that refuses commands is judged by the previous command, too. A false report after a silence in which the
    watchdog may have acted is believed if it lies on the watchdog's path.
    """
    asked, at = truth.asked, truth.commands
    span = asked.upper - asked.lower
    slack = _CLOSE * span
    u, t = truth.received[at], truth.t[at]
    count = int(np.count_nonzero(~((u >= asked.lower - slack) & (u <= asked.upper + slack))))
    kinds = {fault.kind for fault in truth.device.spec.faults}
    for k, row in enumerate(at):
        since = t[k] - t[k - 1] if k and truth.motion[row] == truth.motion[at[k - 1]] else math.nan
        before, told = truth.before[row], truth.told[row]
        origins = [before]
        if math.isfinite(since) and kinds & {"deaf", "wanders"}:
            origins.append(u[k - 1])
        if since > truth.device.spec.watchdog_s and "held" in kinds and min(SAFE, before) <= told <= max(SAFE, before):
            origins.append(told)
        elapsed = asked.dt_s if math.isnan(since) else min(max(since, 0.1 * asked.dt_s), asked.dt_s)
        step = min(abs(u[k] - origin) for origin in origins)
        count += bool(step > asked.rate_per_s * (elapsed + asked.grace_s) + slack)
    return count


def past_deg(truth: Truth) -> float:
    """Overshoot of the tip beyond the angle limits, minus the unavoidable part [deg]; 0 without limits.

    Unavoidable are the 2 % of `Bounded`, the motion in one sample and in the one for its median, the tip's remaining
    motion by commands already sent, and the overshoot of a stop; twice of it for an oscillating tip.
    """
    limits, asked, spec = truth.asked.angle_limits_deg, truth.asked, truth.device.spec
    steeper = max((fault.size for fault in spec.faults if fault.kind == "steepens"), default=1.0)
    slope, own_hz = steeper * spec.body.slope, spec.body.own_hz
    if limits is None:
        return 0.0
    low, high = limits
    beside = ANGLE_MARGIN * (high - low)
    outside = np.maximum(truth.angle - (high + beside), (low - beside) - truth.angle)
    worst = 0.0
    for k in np.flatnonzero((outside[1:] > 0) & (outside[:-1] <= 0)) + 1:
        after = truth.t >= truth.t[k]
        late_s = (MEDIAN - 1) * asked.dt_s + 1.0 / spec.stream_hz + spec.flight_s
        seen = after & (truth.t <= truth.t[k] + late_s)
        ahead = float(np.abs(truth.held[seen] - truth.x[k]).max()) + asked.overshoot
        speed = abs(float(truth.angle[k] - truth.angle[k - 1])) / max(float(truth.t[k] - truth.t[k - 1]), 1e-3)
        swings = 2.0 * slope * ahead + speed / (2.0 * math.pi * own_hz) if own_hz else 0.0
        allowed = max(swings, slope * ahead)
        while_s = after & (truth.t < truth.t[k] + _WATCHED_S)
        worst = max(worst, float(outside[while_s].max()) - allowed)
    return worst


def away_s(truth: Truth) -> Vec:
    """Times (N,) of commands that move the device away from the safe command by more than the overshoot in total.

    The reference level falls with each command towards the safe one; motions of the device by itself do not change it.
    """
    level = least = 0.0
    found = []
    for k in truth.commands:
        level += abs(truth.received[k] - SAFE) - abs(truth.before[k] - SAFE)
        least = min(least, level)
        if level - least > truth.asked.overshoot + _CLOSE:
            found.append(float(truth.t[k]))
            least = level - truth.asked.overshoot
    return np.array(found)


def moved_after(truth: Truth, since_s: float) -> float:
    """Time from `since_s` to the last command away from the safe one by more than the overshoot [s]."""
    late = truth.t >= since_s
    part = Truth(truth.asked, truth.device, *(getattr(truth, n)[late] for n in _COLUMNS))
    times = away_s(part)
    return float(times[-1]) - since_s if times.size else 0.0


_COLUMNS = ("t", "motion", "received", "before", "held", "told", "x", "angle", "age")


def shows_s(truth: Truth) -> float:
    """Time of a fault's first visible effect [s]; NaN without one. The rule of each kind is in its function."""
    found = [_RULES[fault.kind](truth, fault) for fault in truth.device.spec.faults if fault.kind in _RULES]
    if not truth.asked.grace_s or any(fault.kind == "ages" for fault in truth.device.spec.faults):
        found.append(_ages(truth))  # a device in real time may stall without a fault
    if truth.device.spec.body.gain < 0 and truth.asked.mover in ("run", "ros2"):
        found.append(_against(truth))
    return min((t for t in found if math.isfinite(t)), default=math.nan)


def _began(truth: Truth, fault: DeviceFault) -> float:
    return truth.device.began_s(fault.kind)


def _at_once(truth: Truth, fault: DeviceFault) -> float:
    """Start of the fault."""
    return _began(truth, fault)


def _first(truth: Truth, where: NDArray[np.bool_]) -> float:
    rows = np.flatnonzero(where)
    return float(truth.t[rows[0]]) if rows.size else math.nan


def _stands(truth: Truth, fault: DeviceFault) -> float:
    """Time at which the lagged command (`plausibility.travel_s`) has covered `travel` since the tip stopped."""
    began, asked = _began(truth, fault), truth.asked
    for motion in np.unique(truth.motion[(truth.t >= began) & (truth.motion >= 0)]):
        rows = np.flatnonzero(truth.motion == motion)
        narrowed = asked.mover == "commission" and motion >= _DASH
        span = float(np.ptp(truth.held[: rows[0]])) if narrowed else asked.upper - asked.lower
        followed = _lagged(truth.held[rows], truth.t[rows])[truth.t[rows] >= began]
        rows = rows[truth.t[rows] >= began]
        gone = np.maximum.accumulate(followed) - np.minimum.accumulate(followed)
        far = np.flatnonzero(gone >= _WATCH.travel_of(span))
        if far.size:
            return float(truth.t[rows[far[0]]])
    return math.nan


def _lagged(held: Vec, t: Vec) -> Vec:
    """Command after the slowest lag that `plausibility.travel_s` allows."""
    found = held.copy()
    for k in range(1, held.size):
        found[k] = found[k - 1] + (held[k] - found[k - 1]) * -math.expm1(-(t[k] - t[k - 1]) / _WATCH.travel_s)
    return found


def _leaves(truth: Truth, fault: DeviceFault) -> float:
    """Start of the fault, unless the device was at rest anyway."""
    began = _began(truth, fault)
    held = truth.held[truth.t < began]
    return began if held.size and abs(float(held[-1]) - SAFE) > _FOLLOWS_MM else math.nan


def _outside(truth: Truth, fault: DeviceFault) -> float:
    """Start of a permanent fault; for an alternating one, when a quarter of four seconds was without an angle."""
    began = _began(truth, fault)
    if not fault.period_s:
        return began
    needed = _SHARE * _WINDOW_S
    turns_inside = math.ceil(needed / fault.period_s - _CLOSE) - 1
    shows = began + needed + fault.period_s * turns_inside
    return shows if shows <= truth.t[-1] else math.nan


def _ages(truth: Truth) -> float:
    """First command for which all angles are older than `sensor.age_limit_s`, a period and a sample not counted."""
    youngest = _AGE_S + max(truth.asked.dt_s, 1.0 / truth.device.spec.stream_hz)
    sent = np.isfinite(truth.received)
    found = []
    for motion in np.unique(truth.motion[sent]):
        rows = sent & (truth.motion == motion)
        found.append(_first(truth, rows & (truth.age - truth.age[rows].min() > youngest)))
    return min((t for t in found if math.isfinite(t)), default=math.nan)


def _stray(truth: Truth, fault: DeviceFault) -> float:
    """Time from which the reported command differs from all commands of the last `sensor.dead_after_s`."""
    began, at = _began(truth, fault), truth.commands
    if fault.lasts_s < _FOLLOWS_S:
        return math.nan
    for k in at[truth.t[at] >= began]:
        recent = at[(truth.t[at] > truth.t[k] - _FOLLOWS_S) & (at <= k)]
        sent = truth.received[recent]
        if not sent.min() - _FOLLOWS_MM <= truth.told[k] <= sent.max() + _FOLLOWS_MM:
            return float(truth.t[k])
    return math.nan


def _by_itself(truth: Truth, fault: DeviceFault) -> float:
    """One minute after the start of the fault."""
    return _began(truth, fault) + _BY_ITSELF_S


def _awake(truth: Truth, fault: DeviceFault) -> float:
    """Time at which the program continues."""
    return _began(truth, fault) + fault.size


def _against(truth: Truth) -> float:
    """Time at which the lagged command has risen by `plausibility.travel`, and the tip fallen by 2.5 % of the range."""
    asked = truth.asked
    used = truth.motion >= 0
    low, high = asked.sensor_deg
    held = _lagged(truth.held, truth.t)
    up = held - np.minimum.accumulate(held) >= _WATCH.travel_of(asked.upper - asked.lower)
    down = np.maximum.accumulate(truth.angle) - truth.angle >= _AGAINST * (high - low)
    return _first(truth, used & up & down)


_RULES: Mapping[FaultKind, Callable[[Truth, DeviceFault], float]] = {
    "stuck": _stands,
    "dithers": _stands,
    "outside": _outside,
    "silent": _at_once,
    "held": _stray,
    "deaf": _stray,
    "restarts": _at_once,
    "leaves": _leaves,
    "wanders": _by_itself,
    "stalls": _awake,
}


def silent_s(truth: Truth) -> float:
    """Longest time without a command after the first one of a connection, until its end [s]."""
    longest = 0.0
    for motion in np.unique(truth.motion[truth.motion >= 0]):
        on = truth.t[truth.motion == motion]
        sent = truth.t[(truth.motion == motion) & np.isfinite(truth.received)]
        if sent.size:
            longest = max(longest, float(np.diff([*sent, on[-1]]).max()))
    return longest


def judged(name: str, device: HostileDevice, asked: Asked, ending: Ending, healthy: bool) -> DeviceVerdict:
    """Verdict on a device after its use, followed by a wait for its watchdog."""
    truth = Truth.of(device, asked)
    wrong, shows, past = beyond(truth), math.nan if healthy else shows_s(truth), past_deg(truth)
    moved = moved_after(truth, shows) if math.isfinite(shows) else 0.0
    at = truth.commands
    last = float(truth.t[at[-1]]) if at.size else math.nan
    slow = any(fault.kind in ("reads_slowly", "writes_slowly") for fault in device.spec.faults)
    wanders = any(fault.kind == "wanders" for fault in device.spec.faults)
    on_s = last if ending.how == "ended" else math.nan  # time of the regular end
    failures = {
        f"raised: {ending.words[:120]}": ending.how == "raised",
        f"{wrong} commands beyond limits or rate": wrong > 0,
        f"{past:.1f} deg past the angle limits": past > 0,
        f"healthy, but {ending.how}: {ending.words[:160]}": healthy and ending.how != "ended",
        f"moved on for {moved:.2f} s": moved > NOTICE_S,
        f"not stopped, {on_s - shows:.1f} s long": on_s - shows > NOTICE_S,
        "inverted, and not found": device.spec.body.gain < 0 and asked.mover == "commission" and ending.how == "ended",
        f"nothing sent for {silent_s(truth):.1f} s" if slow else "": slow and silent_s(truth) > NOTICE_S,
        f"left at {truth.held[-1]:.2f} mm": abs(float(truth.held[-1]) - SAFE) > _STILL_MM and not wanders,
        f"nothing was sent: {ending.words[:160]}": at.size == 0,
        "no sample was taken in C": ending.in_c == 0,
        "stopped without a cause": ending.how != "ended" and not ending.words,
        "stopped, and not latched": ending.how == "stopped" and not ending.latched,
    }
    return DeviceVerdict(
        name,
        asked.mover,
        healthy,
        ending.how,
        ending.words,
        int(at.size),
        wrong,
        shows,
        moved,
        max(past, 0.0),
        tuple(text for text, failed in failures.items() if failed),
    )
