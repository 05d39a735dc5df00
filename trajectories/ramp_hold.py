"""Constant-velocity ramps and holds: the point-to-point commands of the papers, drawn from a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import TrajectoryError
from hystmpc.trials.types import Vec

from .checks import require_finite, require_positive, require_range
from .piecewise import PiecewiseCubic, hold, ramp

# Draws of one target before a step window counts as impossible; a window of 1 % of the range still passes.
_MOST_DRAWS = 10_000


@dataclass(frozen=True)
class RampHold:
    """Alternating ramps and holds; a ramp from x to y at rate v takes |y - x| / v.

    Attributes:
        start: command at time 0 [mm or bar].
        targets: commands to reach, in order [mm or bar].
        rates: speed of each ramp [mm/s or bar/s].
        holds_s: time at each target [s].

    Raises:
        TrajectoryError: if the counts differ, a number is out of bounds, or nothing moves or holds at all.
    """

    start: float
    targets: Sequence[float]
    rates: Sequence[float]
    holds_s: Sequence[float]
    _path: PiecewiseCubic = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("targets", "rates", "holds_s"):
            object.__setattr__(self, name, tuple(float(x) for x in getattr(self, name)))
        counts = (len(self.targets), len(self.rates), len(self.holds_s))
        if len(set(counts)) != 1 or not counts[0]:
            raise TrajectoryError(
                f"ramp and hold: got {counts[0]} targets, {counts[1]} rates and {counts[2]} holds, "
                "expected the same number of each, at least 1"
            )
        require_finite(start=self.start)
        pieces, at = [], self.start
        for k, (target, rate, rest) in enumerate(zip(self.targets, self.rates, self.holds_s, strict=True)):
            require_finite(**{f"targets[{k}]": target})
            require_positive(**{f"rates[{k}]": rate})
            require_range(f"holds_s[{k}]", (rest, rest), least=0.0)
            if target != at:
                pieces.append(ramp(at, target, abs(target - at) / rate))
            pieces.append(hold(target, rest))
            at = target
        object.__setattr__(self, "_path", PiecewiseCubic(np.vstack(pieces)))

    @property
    def duration_s(self) -> float:
        """Time of all ramps and holds [s]."""
        return self._path.duration_s

    def __call__(self, t: ArrayLike) -> Vec:
        """Command [mm or bar] at `t` [s]."""
        return self._path(t)


@dataclass(frozen=True)
class RampHoldDraw:
    """How a random ramp-and-hold command is drawn; every draw is uniform.

    Attributes:
        moves: number of ramps, each followed by a hold.
        targets: least and greatest target [mm or bar].
        rates: least and greatest ramp speed [mm/s or bar/s].
        holds_s: shortest and longest hold [s].
        steps: least and greatest |target - previous target| [mm or bar]; targets outside are drawn again.

    Raises:
        TrajectoryError: if a range is empty or out of bounds.
    """

    moves: int
    targets: tuple[float, float]
    rates: tuple[float, float]
    holds_s: tuple[float, float]
    steps: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.moves < 1:
            raise TrajectoryError(f"moves: got {self.moves}, expected at least 1")
        require_range("targets", self.targets)
        require_range("rates", self.rates, least=0.0)
        require_range("holds_s", self.holds_s, least=0.0)
        if self.steps is not None:
            require_range("steps", self.steps, least=0.0)

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
        return RampHold(start, targets, rates, holds)

    def _target(self, rng: np.random.Generator, last: float) -> float:
        for _ in range(_MOST_DRAWS):
            target = float(rng.uniform(*self.targets))
            if self.steps is None or self.steps[0] < abs(target - last) < self.steps[1]:
                return target
        raise TrajectoryError(
            f"no target in {self.targets[0]:g} to {self.targets[1]:g} is {self.steps} away from {last:.6g}, "
            "expected a wider step window"
        )
