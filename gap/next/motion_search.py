"""Search for the motion that is worth most: expected information per second of device time over a family."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from scipy.optimize import differential_evolution

from hystmpc.trials.types import Vec

from .motion_design import Noise, OpenHypothesis, Option, option_on
from .motion_family import SIZE, MotionFamily
from .motion_menu import MenuMotion

_DRAWN, _GENERATIONS = 12, 8  # members beside the menu's; 24 in all, so that a search looks at about 200 motions
_LEAST_S = 6.0  # a shorter motion is not worth a run of its own


@dataclass(frozen=True)
class SearchSettings:
    """What counts, and how long is searched.

    Attributes:
        seed: of what is drawn.
        overhead_s: device time that a run takes beside its motion [s].
        least_s: duration below which a motion is left out [s].
        generations: of the search.
        allowed: whether a motion may be played, judged by the angles that the explanations expect.
    """

    seed: int | Sequence[int] = 0
    overhead_s: float = 0.0
    least_s: float = _LEAST_S
    generations: int = _GENERATIONS
    allowed: Callable[[Option], bool] = lambda option: True


@dataclass(frozen=True, eq=False)
class SearchedMotion:
    """The motion that was found, and what it was compared with.

    Attributes:
        chosen: the best motion with its expected result.
        numbers: of it in the family (22,).
        bits: expected information of it.
        seconds: device time of it, the run around it included [s].
        menu: the best motion of the menu by the same measure; None where none can be simulated.
        menu_bits, menu_seconds: of that.
        looked_at: motions that were simulated.
    """

    chosen: Option
    numbers: Vec = field(repr=False)
    bits: float
    seconds: float
    menu: Option | None = field(repr=False)
    menu_bits: float
    menu_seconds: float
    looked_at: int

    @property
    def gain(self) -> float:
        """Information per second over that of the menu's best; infinite where that tells nothing."""
        own, other = self.bits / self.seconds, self.menu_bits / self.menu_seconds if self.menu else 0.0
        return own / other if other > 0 else math.inf


def information_bits(probability: float, count: int) -> float:
    """Expected information on which of `count` equally likely explanations holds: log2(count p), 0 by chance."""
    return max(math.log2(max(count * probability, 1.0)), 0.0)


def search_motion(
    open_ones: Sequence[OpenHypothesis],
    family: MotionFamily,
    noise: Noise,
    settings: SearchSettings = SearchSettings(),
    menu: Sequence[MenuMotion] = (),
) -> SearchedMotion | None:
    """The motion with the most expected information per second that tells open explanations apart.

    Maximises log2(K p(x)) / (T(x) + T_run) over the numbers x of the family, p the expected probability of the right
    one of K explanations after retuning each (`propose`). Differential evolution (Storn, Price, J. Global Optimization
    11, 1997) starts from the menu's entries and motions drawn at random.

    Args:
        open_ones: two explanations or more.
        family: motions that are allowed.
        noise: of the device, and form error of the explanations.
        menu: motions to compare with, as `motion_menu.menu` makes them, of any duration.

    Returns:
        The motion; None where no motion can be simulated that is allowed.
    """
    count = len(open_ones)
    best: list[tuple[float, Option, Vec]] = []
    looked = [0]

    def value_of(motion: MenuMotion) -> tuple[float, Option | None]:
        looked[0] += 1
        option = option_on(open_ones, motion, noise)
        if option is None or not settings.allowed(option):
            return -1.0, None
        short = max(settings.least_s / motion.duration_s, 1.0)
        return _rate(option, count, settings) / short**2, option

    def cost(x: Vec) -> float:
        value, option = value_of(family.motion(x, "designed"))
        if option is not None and (not best or value > best[0][0]):
            best[:] = [(value, option, x.copy())]
        return -value

    _evolve(cost, family, settings)
    if not best:
        return None
    options = [option for motion in menu if (option := option_on(open_ones, motion, noise))]
    compared = max(options, key=lambda option: _rate(option, count, settings), default=None)
    chosen = best[0][1]
    return SearchedMotion(
        chosen=chosen,
        numbers=best[0][2],
        bits=information_bits(chosen.probability, count),
        seconds=chosen.motion.duration_s + settings.overhead_s,
        menu=compared,
        menu_bits=information_bits(compared.probability, count) if compared else 0.0,
        menu_seconds=compared.motion.duration_s + settings.overhead_s if compared else math.nan,
        looked_at=looked[0],
    )


def _rate(option: Option, count: int, settings: SearchSettings) -> float:
    """Expected information per second of device time."""
    return information_bits(option.probability, count) / (option.motion.duration_s + settings.overhead_s)


def _evolve(cost: Callable[[Vec], float], family: MotionFamily, settings: SearchSettings) -> None:
    drawn = np.random.default_rng(settings.seed).uniform(0, 1, (_DRAWN, SIZE))
    first = np.vstack([*family.starts.values(), drawn])
    cast(Any, differential_evolution)(  # its types take no array for `init`
        cost,
        [(0.0, 1.0)] * SIZE,
        init=first,
        maxiter=settings.generations,
        rng=np.random.default_rng(settings.seed),
        mutation=(0.4, 0.9),
        recombination=0.5,
        polish=False,
        tol=0.0,
    )
