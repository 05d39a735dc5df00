"""Excitation commands for identification and tests: those of the papers, and a set of about three minutes for a device.

Where a paper is silent the value is an argument. S1 is Wu et al., RA-L 2021 (DOI 10.1109/LRA.2021.3061069): pressure
[bar], 0 to 3. S2 is RA-L 2024, PMC11633443: tendon displacement [mm], 0 to 6.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.config import Count, NotNegative, Positive
from hystmpc.trials.errors import TrajectoryError, did_you_mean
from hystmpc.trials.types import Vec

from .motion import (
    Bounds,
    MotionLimits,
    NotNegativeBounds,
    PathMotion,
    PiecewiseCubic,
    TrajectorySettings,
    hold,
    ramp,
)
from .plane import PlaneMotion, raster, spiral
from .trajectory import Trajectory, inside, require_positive


class DecayingSine(TrajectorySettings):
    """Decaying sinusoid u(t) = A e^(-tau t) ( sin(2 pi (f + c t) t - pi/2) + a ) + B, for 0 <= t <= T.

    The instantaneous frequency is f + 2 c t, not f + c t: a falling chirp (c < 0) stands still at t = -f / (2 c).
    Sources: Wu et al., RA-L 2021 (S1) eq. (5), (6), (10), (11); RA-L 2024, PMC11633443 (S2) eq. (9), (10).

    Attributes:
        amplitude: A [mm or bar].
        frequency_hz: f [Hz].
        decay_per_s: tau [1/s]; below zero the sinusoid grows.
        duration_s: T [s].
        lift: a, the part of the offset that decays with the sinusoid, in units of A.
        baseline: B, the part of the offset that stays [mm or bar].
        chirp_hz_per_s: c [Hz/s].

    Raises:
        TrajectoryError: if a number is not finite, or amplitude, frequency or duration is not positive.
    """

    amplitude: Positive
    frequency_hz: Positive
    decay_per_s: float
    duration_s: Positive
    lift: float = 1.0
    baseline: float = 0.0
    chirp_hz_per_s: float = 0.0

    def __call__(self, t: ArrayLike) -> Vec:
        """Return the command [mm or bar] at `t` [s]."""
        time = inside(t, self.duration_s)
        wave = np.sin(2 * np.pi * (self.frequency_hz + self.chirp_hz_per_s * time) * time - np.pi / 2)
        envelope = self.amplitude * np.exp(-self.decay_per_s * time)
        return np.asarray(envelope * (wave + self.lift) + self.baseline)


# Draws of one target before a step window counts as impossible; a window of 1 % of the range still succeeds.
_MOST_DRAWS = 10_000


class RampHold(PathMotion):
    """Command of alternating ramps and holds; a ramp from x to y at rate v takes |y - x| / v.

    Attributes:
        start: command at time 0 [mm or bar].
        targets: commands to reach, in order [mm or bar].
        rates: speed of each ramp [mm/s or bar/s].
        holds_s: time at each target [s].

    Raises:
        TrajectoryError: if the counts differ, a number is out of bounds, or nothing moves or holds at all.
    """

    start: float
    targets: tuple[float, ...]
    rates: tuple[Positive, ...]
    holds_s: tuple[NotNegative, ...]

    @cached_property
    def path(self) -> PiecewiseCubic:
        """Path of ramps and holds, one after another.

        Raises:
            TrajectoryError: if the counts differ, or nothing moves or holds.
        """
        counts = (len(self.targets), len(self.rates), len(self.holds_s))
        if len(set(counts)) != 1 or not counts[0]:
            raise TrajectoryError(
                f"ramp and hold: got {counts[0]} targets, {counts[1]} rates and {counts[2]} holds, "
                "expected the same number of each, at least 1"
            )
        pieces, at = [], self.start
        for target, rate, rest in zip(self.targets, self.rates, self.holds_s, strict=True):
            if target != at:
                pieces.append(ramp(at, target, abs(target - at) / rate))
            pieces.append(hold(target, rest))
            at = target
        return PiecewiseCubic(np.vstack(pieces))


class RampHoldDraw(TrajectorySettings):
    """Distribution of random ramp-and-hold commands; every draw is uniform.

    Attributes:
        moves: number of ramps, each followed by a hold.
        targets: least and greatest target [mm or bar].
        rates: least and greatest ramp speed [mm/s or bar/s].
        holds_s: shortest and longest hold [s].
        steps: least and greatest |target - previous target| [mm or bar]; targets outside are drawn again.

    Raises:
        TrajectoryError: if a range is empty or out of bounds.
    """

    moves: Count
    targets: Bounds
    rates: NotNegativeBounds
    holds_s: NotNegativeBounds
    steps: NotNegativeBounds | None = None

    def __call__(self, seed: int | np.random.Generator, start: float = 0.0) -> RampHold:
        """Draw one command; equal seeds give equal commands.

        Raises:
            TrajectoryError: if no target lies within the step window of the one before.
        """
        rng = np.random.default_rng(seed)
        targets, rates, holds = list[float](), list[float](), list[float]()
        for _ in range(self.moves):
            targets.append(self._target(rng, targets[-1] if targets else start))
            rates.append(float(rng.uniform(*self.rates)))
            holds.append(float(rng.uniform(*self.holds_s)))
        return RampHold(start=start, targets=tuple(targets), rates=tuple(rates), holds_s=tuple(holds))

    def _target(self, rng: np.random.Generator, last: float) -> float:
        for _ in range(_MOST_DRAWS):
            target = float(rng.uniform(*self.targets))
            if self.steps is None or self.steps[0] < abs(target - last) < self.steps[1]:
                return target
        raise TrajectoryError(
            f"no target in {self.targets[0]:g} to {self.targets[1]:g} is {self.steps} away from {last:.6g}, "
            "expected a wider step window"
        )


S1_AMPLITUDE_BAR = 1.5
S1_TRAIN_DECAY_PER_S = 0.15
# Not printed: 26 798 training samples in 8 groups, at the 250 Hz of the laser.
S1_GROUP_S = 13.4

S2_TRAVEL_MM = 6.0
S2_OFFSETS = {"0BL": (1.0, 0.0), "MidBL": (0.0, 1.0), "EndBL": (-1.0, 2.0)}
S2_POINT_TO_POINT = {
    "train": RampHoldDraw(
        moves=10, targets=(0.0, S2_TRAVEL_MM), rates=(0.5, 6.0), holds_s=(1.0, 5.0), steps=(0.5, 3.0)
    ),
    "test": RampHoldDraw(moves=10, targets=(0.0, S2_TRAVEL_MM), rates=(0.5, 6.0), holds_s=(1.0, 10.0)),
}

Offset = Literal["0BL", "MidBL", "EndBL"]
Split = Literal["train", "test"]


def _sine(amplitude: float, frequency_hz: float, decay_per_s: float, duration_s: float, **rest: float) -> DecayingSine:
    return DecayingSine(
        amplitude=amplitude, frequency_hz=frequency_hz, decay_per_s=decay_per_s, duration_s=duration_s, **rest
    )


def s1_zero_baseline(
    frequency_hz: float, decay_per_s: float = S1_TRAIN_DECAY_PER_S, duration_s: float = S1_GROUP_S
) -> DecayingSine:
    """Command of S1 with zero baseline: p1(t) = A e^(-tau t) (sin(2 pi f t - pi/2) + 1) [bar], A = 1.5. S1 eq. (5)."""
    return _sine(S1_AMPLITUDE_BAR, frequency_hz, decay_per_s, duration_s)


def s1_raised_baseline(
    frequency_hz: float, decay_per_s: float = S1_TRAIN_DECAY_PER_S, duration_s: float = S1_GROUP_S
) -> DecayingSine:
    """Command of S1 with raised baseline: p2(t) = A e^(-tau t) sin(2 pi f t - pi/2) + A [bar], A = 1.5. S1 eq. (6)."""
    return _sine(S1_AMPLITUDE_BAR, frequency_hz, decay_per_s, duration_s, lift=0.0, baseline=S1_AMPLITUDE_BAR)


def s2_sinusoid(frequency_hz: float, offset: Offset) -> DecayingSine:
    """Sinusoid of S2: u(t) = A e^(-tau t) ( sin(2 pi f t - pi/2) + a ) + A b [mm], A = 3. S2 eq. (9), (10).

    tau = (f / 6) ln 7 and T = 7 / f: seven periods, the amplitude is 1/7 after six. (a, b) is (1, 0) for `0BL`
    (minima at the pretension), (0, 1) for `MidBL`, (-1, 2) for `EndBL` (maxima at 6 mm). All start at u = 0.

    Raises:
        TrajectoryError: if the offset is unknown or the frequency is not positive.
    """
    if offset not in S2_OFFSETS:
        raise TrajectoryError(f"offset: got {offset!r}, {did_you_mean(str(offset), S2_OFFSETS)}")
    require_positive(frequency_hz=frequency_hz)
    a, b = S2_OFFSETS[offset]
    amplitude, decay = S2_TRAVEL_MM / 2, frequency_hz / 6 * math.log(7)
    return _sine(amplitude, frequency_hz, decay, 7 / frequency_hz, lift=a, baseline=amplitude * b)


def s2_point_to_point(seed: int | np.random.Generator, split: Split = "train") -> RampHold:
    """Point-to-point command of S2: ten constant-velocity moves and ten holds from u = 0 [mm]. S2 eq. (11).

    Targets U(0, 6) mm, speeds U(0.5, 6) mm/s. `train` (and validation): holds U(1, 5) s, 0.5 < |dx| < 3 mm;
    `test`: holds U(1, 10) s, |dx| free.

    Raises:
        TrajectoryError: if the split is unknown.
    """
    if split not in S2_POINT_TO_POINT:
        raise TrajectoryError(f"split: got {split!r}, {did_you_mean(str(split), S2_POINT_TO_POINT)}")
    return S2_POINT_TO_POINT[split](seed)


def s2_initialisation() -> DecayingSine:
    """Initialisation flexure of S2: one period of 0.1 Hz from 0 to 6 mm (90 deg) and back, to be discarded."""
    return _sine(S2_TRAVEL_MM / 2, 0.1, 0.0, 10.0)


WHOLE_S = 170.0
"""Time that all motions take together at full length, ways back to rest left out [s]."""

_INNER, _OUTER = 0.03, 0.97  # of the stroke


def identification_motions(
    stroke: float, rate: float, random: np.random.Generator, share: float = 1.0
) -> Iterator[tuple[str, Trajectory]]:
    """Return commands from 0 to `stroke` by name, which separate lag, delay, creep and hysteresis.

    Steps and ramps with holds, long holds, slow, shrinking and fast sines, and reversals at random. Each begins at 0
    and ends anywhere; a sine may ask for more than `rate`, so that the caller limits the commands.

    Args:
        stroke: greatest command [mm or bar].
        rate: greatest change of the command per second.
        random: random generator of targets, speeds and holds.
        share: of the full length, see `WHOLE_S`.

    Raises:
        TrajectoryError: if a number is not positive.
    """

    def drawn(moves: int, rates: tuple[float, float], holds_s: tuple[float, float], *steps: float) -> RampHold:
        """Ramps and holds with shares of the greatest rate and of the stroke."""
        low, high = (share * rate for share in rates)
        least, most = (share * stroke for share in steps)
        draw = RampHoldDraw(
            moves=moves,
            targets=(_INNER * stroke, _OUTER * stroke),
            rates=(low, high),
            holds_s=holds_s,
            steps=(least, most),
        )
        return draw(random)

    yield "steps", _cut(drawn(max(round(20 * share), 3), (0.1, 0.8), (1.0, 4.0), 0.1, 1.0), 38.0 * share)
    yield "long_holds", _cut(drawn(max(round(8 * share), 1), (0.05, 0.3), (6.0, 9.0), 0.2, 1.0), 33.0 * share)
    half = 0.5 * (_OUTER * stroke)
    yield "slow_sine", _sine(half, 0.1, 0.0, 28.0 * share)
    yield "shrinking_sine", _sine(half, 0.25, 0.06, 24.0 * share)
    yield "fast_sine", _sine(0.3 * stroke, 0.6, 0.0, 14.0 * share)
    yield "reversals", _cut(drawn(200, (0.05, 0.5), (0.0, 0.2), 0.05, 0.6), 33.0 * share)


@dataclass(frozen=True)
class _Cut:
    """Beginning of a trajectory."""

    whole: Trajectory
    duration_s: float

    def __call__(self, t: ArrayLike) -> Vec:
        return self.whole(np.minimum(np.asarray(t, dtype=np.float64), self.duration_s))


def _cut(whole: Trajectory, longest_s: float) -> Trajectory:
    return _Cut(whole, min(longest_s, whole.duration_s))


Pair = tuple[float, float]

PLANE_WHOLE_S = 150.0
"""Time that all motions of both axes at once take together at full length [s]."""

LEFT_OUT = "left_out"
"""Name of the motion of both axes that a check of the model uses and its identification does not."""

_MIDDLE, _REACH = 0.5, 0.46  # of the strokes: centre and radius of circles
_ROWS = 8  # of a raster at full length


def plane_identification_motions(
    strokes: Pair, rates: Pair, random: np.random.Generator, share: float = 1.0
) -> Iterator[tuple[str, PlaneMotion]]:
    """Return commands of both axes (..., 2) from 0 to `strokes` by name, which determine what joins two axes.

    Circles that grow; fast rows along x and slow ones along y; reversals of both at random, at speeds of their own; at
    last `left_out`, ramps and holds of both at random.

    Args:
        strokes: greatest command of x and of y [mm or bar].
        rates: greatest change of each command per second.
        random: random generator of targets, speeds and holds.
        share: of the full length, see `PLANE_WHOLE_S`.

    Raises:
        TrajectoryError: if a number is not positive.
    """
    for stroke, rate in zip(strokes, rates, strict=True):
        require_positive(stroke=stroke, rate=rate)
    speed = min(rate / stroke for rate, stroke in zip(rates, strokes, strict=True))  # strokes per second

    def sized(motion: PlaneMotion, longest_s: float, turned: bool = False) -> PlaneMotion:
        """Beginning of a motion in the unit square, as commands; with its axes exchanged where `turned`."""
        order = -1 if turned else 1
        return PlaneMotion(
            lambda t: np.asarray(strokes) * motion.function(t)[..., ::order], min(motion.duration_s, longest_s)
        )

    def drawn(rate_shares: Pair, holds_s: Pair, longest_s: float) -> PlaneMotion:
        """Ramps and holds of each axis, drawn apart."""
        x, y = (
            RampHoldDraw(
                moves=200,
                targets=(_INNER * stroke, _OUTER * stroke),
                rates=(rate_shares[0] * rate, rate_shares[1] * rate),
                holds_s=holds_s,
                steps=(0.05 * stroke, 0.6 * stroke),
            )(random)
            for stroke, rate in zip(strokes, rates, strict=True)
        )
        return PlaneMotion(lambda t: np.stack([x(t), y(t)], axis=-1), longest_s)

    centre, period_s = (_MIDDLE, _MIDDLE), 2 * math.pi * _REACH / (0.5 * speed)
    yield "circles", sized(spiral(centre, _REACH, period_s, max(round(30 * share / period_s), 2)), 30.0 * share)
    for name, share_of_rate, turned in (("rows_x", 0.6, False), ("rows_y", 0.25, True)):
        limits = MotionLimits(
            velocity_deg_s=share_of_rate * speed, acceleration_deg_s2=10 * speed, jerk_deg_s3=200 * speed
        )
        rows = raster((_INNER, _INNER), (_OUTER, _OUTER), max(round(_ROWS * share), 3), limits=limits)
        yield name, sized(rows, 25.0 * share, turned)
    yield "reversals_xy", drawn((0.05, 0.6), (0.0, 0.2), 40.0 * share)
    yield LEFT_OUT, drawn((0.1, 0.8), (0.0, 1.0), max(30.0 * share, 8.0))
