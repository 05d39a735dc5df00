"""Motions on the device: recordings for identification, references for verification, and their device time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.rig.axes import NAMES, PerAxis, each, together
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.phases import Past, PhaseInput, PrepareStep
from hystmpc.rig.safety.ramp import ramp_commands
from hystmpc.trajectories.config import AnyPlaneMotion, CircleSettings, PointsSettings
from hystmpc.trajectories.excitation import (
    LEFT_OUT,
    PLANE_WHOLE_S,
    WHOLE_S,
    identification_motions,
    plane_identification_motions,
)
from hystmpc.trajectories.motion import MotionLimits, MotionSettings
from hystmpc.trajectories.point_to_point import PointToPoint
from hystmpc.trajectories.scan import SinusoidScan
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .config import MOST_MINUTES, MOST_PLANE_MINUTES, CommissionSettings
from .phases import Dash, climb_seconds, placed

CONTROLLERS = ("mpc", "inverse", "pid")
"""What is verified, in the order of the runs along each motion."""

SCANS_HZ = {"scan": 0.2, "fast_scan": 0.6}
_RECORDINGS, _PLANE_RECORDINGS = 6, 5  # of each axis, and of both at once
CORNER_STEPS = 4
"""Steps of a climb of both axes at once towards a corner."""

_SHAKES = (0.5, -0.4, 0.3, -0.2, 0.1, -0.05, 0.0)  # of the way from the safe command to the limits, to and fro
_SHAKE_RATE = 0.6  # of the greatest rate
_RECORD_SHARE, _PLANE_RECORD_SHARE = 0.55, 0.7  # of the device time that preparation and range leave
_REST_S = 1.0  # at the safe command, before and after a recording
_RETURN = 0.3  # share of the greatest rate on the ways to and from rest
_BETWEEN_S = 0.6  # contact, hand-over and confirmation of each run
_PLANE_LEAD_S = 2.0  # holds before and after the approach to a reference in the plane
_LONGEST_OF_BOTH_S = 40.0  # of the recordings of both axes at full length
_SLOPE_SHARE = 0.35  # of the greatest speed that a fast scan may ask for
_WHOLE_SHARE = (0.5, 0.85)  # of the reached angles that a reference takes
_EDGE = 0.08  # of the reached angles at either end, which references leave out
_LEAST_MOTION_S = 4.0
_RESERVE_S = 1.0  # for a contact or a way back that takes longer than expected
LEAST_SHARE = 0.15
"""Of the full recordings: with less a device is not identified."""


@dataclass(frozen=True)
class ReachedAngles:
    """Range of angles that the device reaches at rest, and its speed."""

    low_deg: float
    high_deg: float
    speed_deg_s: float  # mean slope times the greatest command rate

    @property
    def motion(self) -> MotionLimits:
        """Limits of a target's motion that the device can follow: 35 % of its speed, reached within 0.2 s."""
        velocity = float(f"{min(60.0, _SLOPE_SHARE * self.speed_deg_s):.3g}")
        return MotionLimits(
            velocity_deg_s=velocity,
            acceleration_deg_s2=float(f"{min(300.0, velocity / 0.2):.3g}"),
            jerk_deg_s3=float(f"{min(3000.0, velocity / 0.02):.3g}"),
        )


@dataclass(frozen=True)
class ReachedPlane:
    """Range of both angles that the device reaches at rest, and their speeds."""

    x: ReachedAngles
    y: ReachedAngles

    @property
    def motion(self) -> MotionLimits:
        """Limits of a target's motion that the slower axis can follow."""
        return min((self.x.motion, self.y.motion), key=lambda limits: limits.velocity_deg_s)


AnyReached = ReachedAngles | ReachedPlane
AnyMotion = MotionSettings | AnyPlaneMotion


def recordings(bench: BenchSettings, share: float, seed: int) -> dict[str, Vec]:
    """Commands (N,) of each recording, from rest at the safe command and back, within the limits of the bench.

    Of two axes (N, 2): the recordings of one axis for each alone, and those in which both move. They take turns, so
    that every part of them tells of both axes: the identification is judged on one part after another.

    `share` is that of the full three minutes, of two axes of the full eight.
    """
    random, axes = np.random.default_rng([seed, 1]), bench.axes_limits
    if len(axes) == 1:
        return dict(_of_axis(axes[0], bench.safe_command, bench.dt_s, share, random))
    each_axis = [
        [
            (f"{name}_{NAMES[i]}", placed(bench, i, one))
            for name, one in _of_axis(limits, safe, bench.dt_s, share, random)
        ]
        for i, (limits, safe) in enumerate(zip(axes, each(bench.safe_command), strict=True))
    ]
    groups = zip_longest(*each_axis, _of_both(bench, share, random))
    return dict(sorted((run for group in groups for run in group if run), key=lambda run: run[0] == LEFT_OUT))


def _of_axis(
    limits: CommandLimits, safe: float, dt: float, share: float, random: np.random.Generator
) -> Iterator[tuple[str, Vec]]:
    """Recordings (N,) of one axis."""
    stroke, mirrored = limits.upper - limits.lower, limits.upper - safe < safe - limits.lower
    start = limits.upper if mirrored else limits.lower
    for name, motion in identification_motions(stroke, limits.rate, random, share):
        moves = motion(dt * np.arange(round(motion.duration_s / dt) + 1, dtype=np.float64))
        wanted = start - moves if mirrored else start + moves
        there = np.concatenate([_rest(safe, dt), _line(safe, start, limits.rate, dt), wanted])
        played = limits.clip_plans(there, safe, dt)
        yield name, np.concatenate([played, _line(float(played[-1]), safe, limits.rate, dt), _rest(safe, dt)])


def recordings_of_both(bench: BenchSettings, longest_s: float, seed: int) -> dict[str, Vec]:
    """Commands (N, 2) of motions of both axes by name, about that long, without the one that a check leaves out."""
    random = np.random.default_rng([seed, 1])
    runs = dict(_of_both(bench, longest_s / _LONGEST_OF_BOTH_S, random))
    return {name: commands for name, commands in runs.items() if name != LEFT_OUT}


def _of_both(bench: BenchSettings, share: float, random: np.random.Generator) -> Iterator[tuple[str, Vec]]:
    """Recordings (N, 2) in which both axes move."""
    dt, axes, safe = bench.dt_s, bench.axes_limits, np.array(each(bench.safe_command))
    lower, rates = np.array([one.lower for one in axes]), np.array([one.rate for one in axes])
    strokes, rest = np.array([one.upper for one in axes]) - lower, np.tile(safe, (_rest(0.0, dt).size, 1))
    for name, motion in plane_identification_motions(strokes.tolist(), rates.tolist(), random, share):
        wanted = lower + motion(dt * np.arange(round(motion.duration_s / dt) + 1, dtype=np.float64))
        there = np.vstack([rest, _straight(safe, wanted[0], _RETURN * rates * dt), wanted])
        limited = [one.clip_plans(u, float(at), dt) for one, u, at in zip(axes, there.T, safe, strict=True)]
        played = np.stack(limited, axis=1)
        yield name, np.vstack([played, _straight(played[-1], safe, _RETURN * rates * dt), rest])


def shaken(bench: BenchSettings) -> Vec:
    """Commands (N, 2) that take the memory of a device away: both axes to and fro, less each time, then a rest.

    Its plays then stand near their middle, as a model takes them at the start of a recording.
    """
    dt, safe = bench.dt_s, np.array(each(bench.safe_command))
    ways = [min(one.upper - at, at - one.lower) for one, at in zip(bench.axes_limits, safe, strict=True)]
    most = _SHAKE_RATE * dt * np.array([one.rate for one in bench.axes_limits])
    stops = [safe, *(safe + part * np.array(ways) for part in _SHAKES)]
    moves = [_straight(start, end, most) for start, end in pairwise(stops)]
    return np.vstack([*moves, np.tile(safe, (_rest(0.0, dt).size, 1))])


def shake_seconds(bench: BenchSettings) -> float:
    """Duration of `shaken` [s]; 0 for one axis, whose recordings begin without it."""
    return 0.0 if len(bench.axes_limits) == 1 else len(shaken(bench)) * bench.dt_s


def _straight(start: Vec, end: Vec, most: Vec) -> Vec:
    """Commands (N, 2) on a straight line, the start left out, with at most this change of each axis in a sample."""
    steps = math.ceil(float(np.max(np.abs(end - start) / most)))
    return np.linspace(start, end, steps + 1)[1:]


def _line(start: float, end: float, rate: float, dt: float) -> Vec:
    steps = math.ceil(abs(end - start) / (_RETURN * rate * dt))
    return np.linspace(start, end, steps + 1)[1:]


def _rest(at: float, dt: float) -> Vec:
    return np.full(max(round(_REST_S / dt), 1), at)


@dataclass(frozen=True)
class Budget:
    """Device time by stage [s], without preparation, which occurs once in each of three stages."""

    prepare_s: float
    range_s: float
    record_s: float
    verify_s: float
    share: float  # of the full recordings
    motion_s: float  # duration of each reference without approach and return

    @property
    def total_s(self) -> float:
        """Device time in all [s]."""
        return 3 * self.prepare_s + self.range_s + self.record_s + self.verify_s


def budget(settings: CommissionSettings) -> Budget:
    """Division of the device time: preparation and range as needed, the rest to recordings and verification.

    The range is assumed to be that of the limits; a narrower one takes less.

    Raises:
        ConfigError: if the minutes are too few.
    """
    whole, prepare = 60.0 * settings.commission.minutes, prepare_seconds(settings)
    most = MOST_MINUTES if len(settings.axes_limits) == 1 else MOST_PLANE_MINUTES
    first, whole_s = range_seconds(settings), whole_seconds(settings)
    left = whole - 3 * prepare - first
    ways_s = recordings_seconds(settings, 0.0)
    recorded = _RECORD_SHARE if len(settings.axes_limits) == 1 else _PLANE_RECORD_SHARE
    share = min((recorded * left - ways_s) / whole_s, 1.0)
    given = settings.commission.motions
    count = len(CONTROLLERS) * (len(given) if given else 1 + len(SCANS_HZ))
    around = _BETWEEN_S + return_seconds(settings) + 1.5 + (_PLANE_LEAD_S if len(settings.axes_limits) > 1 else 0.0)
    record = ways_s + whole_s * share
    motion = (left - record) / count - around
    least = (
        f"expected more minutes (at most {most:g}), faster ramps or less preparation; commission.minutes is "
        f"{whole / 60:g}"
    )
    if share < LEAST_SHARE:
        raise ConfigError(
            f"commission: got {max(whole_s * share, 0.0):.0f} s for recordings after {first + 3 * prepare:.0f} s of "
            f"preparation and range, {least}"
        )
    if given is not None:
        longest = max(m.build().duration_s for m in given.values())
        motion, needed = longest, sum(m.build().duration_s + around for m in given.values()) * len(CONTROLLERS)
        if needed > left - record:
            raise ConfigError(f"commission: got motions of {needed:.0f} s, expected {left - record:.0f} s; {least}")
        return Budget(prepare, first, record, needed, share, motion)
    if motion < _LEAST_MOTION_S:
        raise ConfigError(f"commission: got {motion:.1f} s for each motion of the verification, {least}")
    return Budget(prepare, first, record, count * (motion + around), share, motion)


def range_seconds(settings: CommissionSettings) -> float:
    """Device time of all climbs and dashes, over the whole range of the limits [s]."""
    ways, steps, away = directions(settings), settings.commission.range_steps, away_seconds(settings)
    seconds = sum(climb_seconds(settings, end, steps) + away for end in ways)
    seconds += sum(climb_seconds(settings, end, CORNER_STEPS) + away for end in corners(settings))
    return seconds + sum(Dash(settings, end).seconds + away for end in farthest(settings))


def directions(bench: BenchSettings) -> tuple[PerAxis, ...]:
    """Limits of the command to climb to, the farther first; only one if the safe command is at the other.

    Of two axes those of x, then those of y, each with the other command at the safe one.
    """
    ways = list[PerAxis]()
    safe = each(bench.safe_command)
    for i, limits in enumerate(bench.axes_limits):
        low, high = limits.lower, limits.upper
        ends = sorted((low, high), key=lambda end, at=safe[i]: -abs(end - at))  # type: ignore[misc]
        far = [end for end in ends if abs(end - safe[i]) > 0.02 * (high - low)]
        ways += [together((*safe[:i], end, *safe[i + 1 :])) for end in far]
    return tuple(ways)


def farthest(bench: BenchSettings) -> tuple[PerAxis, ...]:
    """Of each axis the first of its directions."""
    safe, ways = each(bench.safe_command), directions(bench)
    return tuple(next(way for way in ways if each(way)[i] != safe[i]) for i in range(len(safe)))


def corners(bench: BenchSettings) -> tuple[PerAxis, ...]:
    """Corners of the range of two axes to climb to; none of one axis."""
    if len(bench.axes_limits) == 1:
        return ()
    safe = each(bench.safe_command)
    x, y = ([each(way)[i] for way in directions(bench) if each(way)[i] != safe[i]] for i in range(2))
    return tuple(together((a, b)) for a in x for b in y)


def away_seconds(bench: BenchSettings) -> float:
    """Device time of a run without its motion [s]: contact, approach and end at the safe command."""
    return _BETWEEN_S + 7 * bench.dt_s


def run_seconds(bench: BenchSettings, commands: int) -> float:
    """Upper bound on the device time of a run with this number of commands [s]."""
    return commands * bench.dt_s + away_seconds(bench) + shake_seconds(bench) + _RESERVE_S


def whole_seconds(bench: BenchSettings) -> float:
    """Duration of all recordings at full length, without the ways [s]."""
    axes = len(bench.axes_limits)
    return axes * WHOLE_S + (PLANE_WHOLE_S if axes > 1 else 0.0)


def recordings_seconds(bench: BenchSettings, share: float) -> float:
    """Upper bound on the device time of all recordings [s]; `share` 0 counts only approaches and rests."""
    around, total, ways = 2 * _REST_S + away_seconds(bench) + shake_seconds(bench), 0.0, 0.0
    for limits, safe in zip(bench.axes_limits, each(bench.safe_command), strict=True):
        low, high = limits.lower, limits.upper
        way = (min(safe - low, high - safe) + max(safe - low, high - safe)) / (_RETURN * limits.rate)
        total, ways = total + _RECORDINGS * (around + way), max(ways, way)
    if len(bench.axes_limits) > 1:
        total += _PLANE_RECORDINGS * (around + ways)
    return total + whole_seconds(bench) * share


def return_seconds(bench: BenchSettings) -> float:
    """Duration of the return to the safe command from the farther limit [s]."""
    safe = bench.safe_command
    pairs = zip(each(safe), bench.axes_limits, strict=True)
    far = [one.lower if at - one.lower > one.upper - at else one.upper for at, one in pairs]
    still = together([0.0] * len(far))
    return len(ramp_commands(together(far), still, safe, bench.ramps, bench.dt_s)) * bench.dt_s


def prepare_seconds(bench: BenchSettings) -> float:
    """Duration of the preparation, begun at the safe command [s]."""
    held, samples = bench.safe_command, 0
    for step in bench.prepare:
        held, taken = _walk(step, bench, held)
        samples += taken
    return samples * bench.dt_s


def _walk(step: PrepareStep, bench: BenchSettings, held: PerAxis) -> tuple[PerAxis, int]:
    """Command after a preparation step, and its number of samples; angle checks count as passed."""
    phase = step.phase(bench.ramps, bench.dt_s)
    low, high = getattr(step, "least_move_deg", 0.0), getattr(step, "most_move_deg", 0.0)
    zero = together([0.0] * len(each(held)))
    phase.begin(PhaseInput(zero, held), Past([], []))
    samples, moved = 0, 0.5 * (low + high)
    while True:
        angle = moved if samples and len(each(held)) == 1 else zero
        decision = phase.step(PhaseInput(angle, held))
        held, samples = decision.u, samples + 1
        if decision.finished or decision.fault:
            return held, samples


def references(
    reached: AnyReached, motion_s: float, seed: Sequence[int], given: Mapping[str, AnyMotion] | None = None
) -> dict[str, AnyMotion]:
    """References over random parts of the reached angles: point to point with holds, scans at 0.2 and 0.6 Hz.

    Of two axes through points with holds, and circles at these frequencies.

    `motion_s` is the duration of each, about [s]; `given` ones replace them.
    """
    if given is not None:
        return dict(given)
    if isinstance(reached, ReachedPlane):
        return dict(_drawn_in_plane(reached, motion_s, np.random.default_rng(list(seed))))
    return dict(_drawn(reached, motion_s, np.random.default_rng(list(seed))))


def _drawn(
    reached: ReachedAngles, motion_s: float, random: np.random.Generator
) -> Iterator[tuple[str, MotionSettings]]:
    limits = reached.motion
    low, high = _range(reached, random)
    moves = max(2, round(motion_s / 3.0))
    way_s = 0.5 * (high - low) / limits.velocity_deg_s + 0.3
    rest_s = max(motion_s / moves - way_s, 1.2)
    # Alternately in the lower and the upper half, so that every move is one.
    shares = random.uniform(0.0, 0.4, moves + 1) + np.resize([0.0, 0.6], moves + 1)
    angles = (low + shares * (high - low)).tolist()
    start, targets, holds = angles[0], tuple(angles[1:]), (rest_s,) * moves
    yield "point_to_point", PointToPoint(start_deg=start, targets_deg=targets, holds_s=holds, limits=limits)
    for name, hz in SCANS_HZ.items():
        low, high = _range(reached, random)
        amplitude = min(0.5 * (high - low), _SLOPE_SHARE * reached.speed_deg_s / (2 * math.pi * hz))
        centre = 0.5 * (low + high)
        cycles = max(0.5 * math.floor(2 * motion_s * hz), 1.0)
        yield (
            name,
            SinusoidScan(
                start_deg=centre - amplitude, centre_deg=centre, amplitude_deg=amplitude, frequency_hz=hz, cycles=cycles
            ),
        )


def _drawn_in_plane(
    reached: ReachedPlane, motion_s: float, random: np.random.Generator
) -> Iterator[tuple[str, AnyPlaneMotion]]:
    limits, spans = reached.motion, [_range(one, random) for one in (reached.x, reached.y)]
    moves = max(2, round(motion_s / 3.0))
    way_s = 0.7 * max(high - low for low, high in spans) / limits.velocity_deg_s + 0.3
    rest_s = max(motion_s / moves - way_s, 0.8)
    points = [(float(random.uniform(*spans[0])), float(random.uniform(*spans[1]))) for _ in range(moves + 1)]
    yield "point_to_point", PointsSettings(points=tuple(points), hold_s=rest_s, limits=limits)
    for name, hz in SCANS_HZ.items():
        spans = [_range(one, random) for one in (reached.x, reached.y)]
        centre = (0.5 * sum(spans[0]), 0.5 * sum(spans[1]))
        slowest = min(reached.x.speed_deg_s, reached.y.speed_deg_s)
        radius = min(*(0.5 * (high - low) for low, high in spans), _SLOPE_SHARE * slowest / (2 * math.pi * hz))
        turns = max(0.5 * math.floor(2 * motion_s * hz), 1.0)
        yield name, CircleSettings(centre=centre, radius=radius, period_s=1 / hz, turns=turns)


def _range(reached: ReachedAngles, random: np.random.Generator) -> tuple[float, float]:
    whole = reached.high_deg - reached.low_deg
    low, usable = reached.low_deg + _EDGE * whole, (1 - 2 * _EDGE) * whole
    width = float(random.uniform(*_WHOLE_SHARE)) * usable
    low += float(random.uniform(0.0, 1.0)) * (usable - width)
    return low, low + width
