"""Motions on the device: recordings for identification, references for verification, and their device time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.phases import Past, PhaseInput, PrepareStep
from hystmpc.rig.safety.ramp import ramp_commands
from hystmpc.trajectories.excitation import WHOLE_S, identification_motions
from hystmpc.trajectories.motion import MotionLimits, MotionSettings
from hystmpc.trajectories.point_to_point import PointToPoint
from hystmpc.trajectories.scan import SinusoidScan
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .config import CommissionSettings
from .phases import Dash, climb_seconds

CONTROLLERS = ("mpc", "inverse", "pid")
"""What is verified, in the order of the runs along each motion."""

SCANS_HZ = {"scan": 0.2, "fast_scan": 0.6}
_RECORDINGS = 6
_RECORD_SHARE = 0.55  # of the device time that preparation and range leave
_REST_S = 1.0  # at the safe command, before and after a recording
_RETURN = 0.3  # share of the greatest rate on the ways to and from rest
_BETWEEN_S = 0.6  # contact, hand-over and confirmation of each run
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


def recordings(bench: BenchSettings, share: float, seed: int) -> dict[str, Vec]:
    """Commands (N,) of each recording, from rest at the safe command and back, within the limits of the bench.

    `share` is that of the full three minutes.
    """
    limits, dt, safe = bench.limits.build(), bench.dt_s, bench.safe_command
    random = np.random.default_rng([seed, 1])
    stroke, mirrored = limits.upper - limits.lower, limits.upper - safe < safe - limits.lower
    start = limits.upper if mirrored else limits.lower
    runs: dict[str, Vec] = {}
    for name, motion in identification_motions(stroke, limits.rate, random, share):
        moves = motion(dt * np.arange(round(motion.duration_s / dt) + 1, dtype=np.float64))
        wanted = start - moves if mirrored else start + moves
        there = np.concatenate([_rest(safe, dt), _line(safe, start, limits.rate, dt), wanted])
        played = limits.clip_plans(there, safe, dt)
        runs[name] = np.concatenate([played, _line(float(played[-1]), safe, limits.rate, dt), _rest(safe, dt)])
    return runs


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
    ways = directions(settings)
    first = sum(climb_seconds(settings, end, settings.commission.range_steps) + away_seconds(settings) for end in ways)
    first += Dash(settings, ways[0]).seconds + away_seconds(settings)
    left = whole - 3 * prepare - first
    ways_s = recordings_seconds(settings, 0.0)
    share = min((_RECORD_SHARE * left - ways_s) / WHOLE_S, 1.0)
    given = settings.commission.motions
    count = len(CONTROLLERS) * (len(given) if given else 1 + len(SCANS_HZ))
    around = _BETWEEN_S + return_seconds(settings) + 1.5
    record = ways_s + WHOLE_S * share
    motion = (left - record) / count - around
    least = f"expected more minutes (at most 5), faster ramps or less preparation; commission.minutes is {whole / 60:g}"
    if share < LEAST_SHARE:
        raise ConfigError(
            f"commission: got {max(WHOLE_S * share, 0.0):.0f} s for recordings after {first + 3 * prepare:.0f} s of "
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


def directions(bench: BenchSettings) -> tuple[float, ...]:
    """Limits of the command to climb to, the farther first; only one if the safe command is at the other."""
    low, high, safe = bench.limits.lower, bench.limits.upper, bench.safe_command
    ends = sorted((low, high), key=lambda end: -abs(end - safe))
    return tuple(end for end in ends if abs(end - safe) > 0.02 * (high - low))


def away_seconds(bench: BenchSettings) -> float:
    """Device time of a run without its motion [s]: contact, approach and end at the safe command."""
    return _BETWEEN_S + 7 * bench.dt_s


def run_seconds(bench: BenchSettings, commands: int) -> float:
    """Upper bound on the device time of a run with this number of commands [s]."""
    return commands * bench.dt_s + away_seconds(bench) + _RESERVE_S


def recordings_seconds(bench: BenchSettings, share: float) -> float:
    """Upper bound on the device time of all recordings [s]; `share` 0 counts only approaches and rests."""
    low, high, safe = bench.limits.lower, bench.limits.upper, bench.safe_command
    ways = (min(safe - low, high - safe) + max(safe - low, high - safe)) / (_RETURN * bench.limits.rate_per_s)
    return _RECORDINGS * (2 * _REST_S + away_seconds(bench) + ways) + WHOLE_S * share


def return_seconds(bench: BenchSettings) -> float:
    """Duration of the return to the safe command from the farther limit [s]."""
    safe, low, high = bench.safe_command, bench.limits.lower, bench.limits.upper
    far = low if safe - low > high - safe else high
    return ramp_commands(far, 0.0, safe, bench.ramps, bench.dt_s).size * bench.dt_s


def prepare_seconds(bench: BenchSettings) -> float:
    """Duration of the preparation, begun at the safe command [s]."""
    held, samples = bench.safe_command, 0
    for step in bench.prepare:
        held, taken = _walk(step, bench, held)
        samples += taken
    return samples * bench.dt_s


def _walk(step: PrepareStep, bench: BenchSettings, held: float) -> tuple[float, int]:
    """Command after a preparation step, and its number of samples; angle checks count as passed."""
    phase = step.phase(bench.ramps, bench.dt_s)
    low, high = getattr(step, "least_move_deg", 0.0), getattr(step, "most_move_deg", 0.0)
    phase.begin(PhaseInput(0.0, held), Past([], []))
    samples, moved = 0, 0.5 * (low + high)
    while True:
        decision = phase.step(PhaseInput(moved if samples else 0.0, held))
        held, samples = decision.u, samples + 1
        if decision.finished or decision.fault:
            return held, samples


def references(
    reached: ReachedAngles, motion_s: float, seed: Sequence[int], given: Mapping[str, MotionSettings] | None = None
) -> dict[str, MotionSettings]:
    """References over random parts of the reached angles: point to point with holds, scans at 0.2 and 0.6 Hz.

    `motion_s` is the duration of each, about [s]; `given` ones replace them.
    """
    if given is not None:
        return dict(given)
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


def _range(reached: ReachedAngles, random: np.random.Generator) -> tuple[float, float]:
    whole = reached.high_deg - reached.low_deg
    low, usable = reached.low_deg + _EDGE * whole, (1 - 2 * _EDGE) * whole
    width = float(random.uniform(*_WHOLE_SHARE)) * usable
    low += float(random.uniform(0.0, 1.0)) * (usable - width)
    return low, low + width
