"""Weights, limits and blocks of moves of a predictive law, as the engine takes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.core.structs import Struct, struct
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat

from .command import CommandLimits
from .mpc_settings import WeightsSettings


@dataclass(frozen=True)
class MoveBlocking:
    """Move blocking (Cagienard et al., 2007): deviations v = M w (H,) from a plan, with one w for each block.

        v_k = w_{b-1} + (k - s_b + 1) / L_b (w_b - w_{b-1})   in block b of length L_b from sample s_b on,  w_{-1} = 0
        v_k = w_{m-1}                                         after the last block

    That is offset blocking of the moves: within a block the deviation's move is constant, after the last one zero. A
    block of held commands would have to make its whole move in one sample, whose rate is limited; here a block of L
    samples moves by up to L times as much. The plan itself, the best candidate, is not blocked.

    Raises:
        ControllerError: if there is no block, one is shorter than a sample, or they are longer than the horizon.
    """

    lengths: tuple[int, ...]  # L, samples in each block, the first one first
    horizon: int  # H

    def __post_init__(self) -> None:
        if not self.lengths or min(self.lengths) < 1 or sum(self.lengths) > self.horizon:
            raise ControllerError(
                f"move_blocking: got blocks of {list(self.lengths)} samples, {sum(self.lengths)} together, expected at "
                f"least one, each of at least 1 sample, together at most the horizon of {self.horizon}"
            )

    @property
    def starts(self) -> NDArray[np.intp]:
        """First sample s (m,) of each block."""
        return np.cumsum((0, *self.lengths[:-1]))

    @property
    def ends(self) -> NDArray[np.intp]:
        """Last sample of each block (m,), at which v equals w."""
        return np.cumsum(self.lengths) - 1

    @property
    def matrix(self) -> Mat:
        """Blocking matrix M (H, m)."""
        count = len(self.lengths)
        matrix = np.zeros((self.horizon, count))
        for b, (start, length) in enumerate(zip(self.starts.tolist(), self.lengths, strict=True)):
            along = np.arange(1, length + 1) / length
            matrix[start : start + length, b] = along
            if b:
                matrix[start : start + length, b - 1] = 1.0 - along
        matrix[sum(self.lengths) :, count - 1] = 1.0
        return matrix


def law_over(
    weights: WeightsSettings,
    horizon: int,
    limits: CommandLimits,
    dt: float,
    blocks: tuple[int, ...] | None = None,
    following: Struct | None = None,
) -> Struct:
    """Return the `hystmpc_law` of weights over a horizon.

    Args:
        blocks: samples of each block of moves, see `MoveBlocking`; None if every sample may move.
        following: law of the next axes, of the same horizon, and with blocks where this one has them.

    Raises:
        ControllerError: if the blocks do not fit the horizon, or the angle limits cross.
    """
    starts = ends = np.arange(horizon)
    tables: dict[str, Any] = {}
    if blocks is not None:
        blocking = MoveBlocking(blocks, horizon)
        starts, ends = blocking.starts, blocking.ends
        tables = {"blocking": blocking.matrix}
    soft = weights.limits_angle
    return struct(
        "hystmpc_law",
        horizon=horizon,
        moves=starts.size,
        blocked=blocks is not None,
        soft=soft,
        lower=limits.lower,
        upper=limits.upper,
        reach=limits.rate * dt,
        effort_weight=weights.effort,
        soft_weight=weights.soft_limit if soft else 0.0,
        tracking=weights.over(horizon),
        starts=starts,
        ends=ends,
        next=following,
        **tables,
    )
