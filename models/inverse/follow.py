"""The inverse followed along a horizon: where the commands should be, and where the rate limit lets them be."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import lru_cache
from importlib import resources
from typing import Any, NamedTuple, final

import numpy as np

from hystmpc.trials.types import Vec

from ..kernels.numba_ import generated_module, njit
from ..model import Inverse, Predictor
from ..prediction.compiled import CompiledPredictor
from ..prediction.recurrent import RoutedPredictor
from .drive import DrivenInverse
from .one_step import CompanionInverse, CompiledInverse

_GRAIN = 1e-7  # of commands, as a share of the greatest move


class Bounds(NamedTuple):
    """Least and greatest command, and greatest change per sample [mm or bar]."""

    low: float
    high: float
    reach: float


@njit(cache=True, error_model="numpy", nogil=True)
def clip_plans(plans: Any, lower: float, upper: float, reach: float, last: float) -> None:
    """Nearest admissible plans (N, H) sample by sample, in place; not-a-number stays what it is.

    Commands are rounded to 1e-7 of the greatest move: a play at its edge, or at rest, has another slope on either side,
    which must not hang on the last digit.
    """
    grain, half = _GRAIN * reach, 0.5 * _GRAIN * reach
    last = min(max(last, lower), upper)
    for n in range(plans.shape[0]):
        before = last
        for k in range(plans.shape[1]):
            u = plans[n, k]
            if u == u:
                u = np.rint(u / grain) * grain
                u = lower if u <= lower + half else (upper if u >= upper - half else u)
                u = min(max(u, before - reach), before + reach)
                if abs(u - before) <= half and lower < u < upper:
                    u = before
            plans[n, k] = u
            before = u


class Follower(ABC):
    """Inverse along a horizon, sample by sample from the state after the commands before."""

    @abstractmethod
    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        """Commands (2, H) along the angles `wanted` (H,) [deg]: within the box alone, and within the rate limit too."""


@final
class StepwiseFollower(Follower):
    """Inverse along a horizon by one call of model and inverse a sample, for any model."""

    def __init__(self, predictor: Predictor, inverse: Inverse) -> None:
        self._predictor, self._inverse = predictor, inverse

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        free = self._followed(state, wanted, u_last, bounds._replace(reach=np.inf))
        moves = np.abs(np.diff(free, prepend=u_last))
        return np.stack(
            [free, free if np.max(moves) <= bounds.reach else self._followed(state, wanted, u_last, bounds)]
        )

    def _followed(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        plan = np.empty(wanted.size)
        for k, theta in enumerate(wanted.tolist()):
            u = self._inverse.command(state, theta, u_last)
            u = min(max(u if np.isfinite(u) else u_last, bounds.low), bounds.high)
            u_last = min(max(u, u_last - bounds.reach), u_last + bounds.reach)
            _, state = self._predictor.advance(state, u_last)
            plan[k] = u_last
        return plan


@final
class CompiledFollower(Follower):
    """Inverse along a horizon in one compiled call, for chains, and for networks with a chain at their side.

    Args:
        inverse: of the chain.
        chain: what is inverted.
        network: what the chain stands in for; None for itself.
        size: entries of the network's state.
    """

    def __init__(
        self,
        inverse: CompiledInverse,
        chain: CompiledPredictor,
        network: RoutedPredictor | None = None,
        size: int = 0,
    ) -> None:
        route = None if network is None else network.route
        self._packed: Any = 0 if route is None else route.packed
        kernels = chain.kernels
        self._kernel = _compiled_follow(
            kernels.command_for.__module__, None if route is None else route.sample.__module__
        )
        self._chain = (chain.parameters, chain.sample_s, kernels.step_constants, kernels.slope_constants)
        self._inverted = np.array([inverse.low, inverse.high])
        self._size = size

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        plans = np.empty((2, wanted.size))
        if not np.isfinite(state).all():  # a clamp of the gates would turn what is no number into one
            plans[:] = u_last
            return plans
        ends = np.array(bounds), self._inverted
        self._kernel(self._packed, self._size, state, *self._chain, wanted, u_last, *ends, plans)
        return plans


@final
class DrivenFollower(Follower):
    """The inverse behind and before dynamics: first where the travel should be, then the commands that bring it there.

    The dynamics behind are undone along the preview, the inverse follows what is left from the instant on at which a
    command acts, and the drive is led along its answer within the rate limit (`Drive.fit`). Both plans are the same:
    without a rate limit there is none.
    """

    def __init__(self, inverse: DrivenInverse) -> None:
        self._inverse = inverse
        self._inner = follower_for(inverse.predictor, inverse.inner)

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Bounds) -> Vec:
        plans = np.full((2, wanted.size), u_last)
        if not np.isfinite(state).all():
            return plans
        front, back, inner = self._inverse.front, self._inverse.back, self._inverse.predictor
        middle, ahead, behind = self._inverse.parts(state)
        if back is not None:
            wanted = back.fit(behind, wanted, float(wanted[0]), np.inf).inputs
        travel, first, last = wanted, 0, u_last
        if front is not None:
            travel, first = front.held(ahead, u_last, wanted.size)[1:]
            for v in travel[:first].tolist():
                _, middle = inner.advance(middle, v)
                last = v
        if first < wanted.size:
            free = self._inner.follow(middle, wanted[first:], last, Bounds(bounds.low, bounds.high, np.inf))[0]
            if front is not None:
                travel[first:] = free
                free = front.fit(ahead, travel, u_last, bounds.reach).inputs
            plans[:] = np.minimum(np.maximum(free, bounds.low), bounds.high)  # `np.clip` takes three times as long
        return plans


def follower_for(predictor: Predictor, inverse: Inverse) -> Follower:
    """The fastest way to follow an inverse with the memory of its predictor."""
    if isinstance(inverse, DrivenInverse):
        return DrivenFollower(inverse)
    if isinstance(inverse, CompiledInverse) and isinstance(inverse.predictor, CompiledPredictor):
        return CompiledFollower(inverse, inverse.predictor)
    if isinstance(inverse, CompanionInverse) and isinstance(inverse.inverse, CompiledInverse):
        network, chain = inverse.predictor.predictor, inverse.inverse.predictor
        if isinstance(network, RoutedPredictor) and isinstance(chain, CompiledPredictor):
            return CompiledFollower(inverse.inverse, chain, network, inverse.predictor.size)
    return StepwiseFollower(predictor, inverse)


_NO_NETWORK = '''@njit(cache=True)
def sample(packed, states, rows, v, theta):
    """No network."""
'''


@lru_cache(maxsize=64)
def _compiled_follow(chain: str, network: str | None) -> Callable[..., Any]:
    """`follow_loops.follow` for the modules of a chain's kernels and of a network's `sample`; None for no network."""
    header = f"from {chain} import command_for, step\n"
    header += _NO_NETWORK if network is None else f"from {network} import sample\n"
    loops = resources.files("hystmpc.models.kernels").joinpath("follow_loops.py").read_text(encoding="utf-8")
    follow: Callable[..., Any] = generated_module(f"{header}\n\n{loops}").follow
    return follow
