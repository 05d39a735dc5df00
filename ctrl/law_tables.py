"""Weights, limits and blocks of moves of a predictive law, as the engine takes them."""

from __future__ import annotations

from dataclasses import dataclass
from threading import local
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from hystmpc.core.library import HoldsAddresses, engine
from hystmpc.models.inverse.inverses import Bounds
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat, Vec

from .command import CommandLimits
from .mpc_settings import WeightsSettings

_NO_BOUNDS = Bounds(0.0, 0.0, 0.0)


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

    def constant(self, weights: WeightsSettings) -> Mat:
        """Part of the program's Hessian that does not change (m, m): 2 (w_r (D M)'D M + w_e M'M)."""
        matrix = self.matrix
        moves = np.diff(matrix, axis=0, prepend=0.0)
        constant: Mat = 2.0 * (weights.rate * moves.T @ moves + weights.effort * matrix.T @ matrix)
        return constant


@final
class LawTables(HoldsAddresses):
    """Struct `hystmpc_law` of a law over a horizon, and room for its programs; see core/planning.h.

    Args:
        limits, dt: of commands and their rate, and the sample time [s]; left out where only costs are asked for.
        blocking: of the moves; None if every sample may move.
        more: numbers of room beside that of the program.

    Attributes:
        address: of the struct, which lives as long as this object.
        bounds: of commands and moves.
        moves: unknowns of the program, one a block or one a sample.
    """

    def __init__(
        self,
        weights: WeightsSettings,
        horizon: int,
        limits: CommandLimits | None = None,
        dt: float = 0.0,
        blocking: MoveBlocking | None = None,
        more: int = 0,
    ) -> None:
        soft = weights.limits_angle
        bounds = Bounds(limits.lower, limits.upper, limits.rate * dt) if limits else _NO_BOUNDS
        costs = [weights.rate, weights.effort, weights.soft_limit if soft else 0.0]
        parts: list[Any] = [[*bounds, *costs], weights.over(horizon)]
        starts = ends = np.arange(horizon)
        if blocking is not None:
            starts, ends = blocking.starts, blocking.ends
            parts += [blocking.matrix.ravel(), blocking.constant(weights).ravel()]
        self.horizon, self.bounds, self.soft, self.moves = horizon, bounds, soft, starts.size
        self._whole = np.array([horizon, self.moves, blocking is not None, soft, *starts, *ends], dtype=np.intc)
        self._numbers: Vec = np.concatenate(parts)
        self._struct = np.empty(engine().law_size(), dtype=np.uint8)
        engine().law_init(self._whole, self._numbers, self._struct)
        self.address = int(self._struct.ctypes.data)
        self._bytes = int(engine().law_bytes(self.address, more))
        self._per_thread = local()

    @property
    def room(self) -> int:
        """Address of this thread's room."""
        room: tuple[NDArray[np.uint8], int] | None = getattr(self._per_thread, "room", None)
        if room is None:
            memory = np.zeros(self._bytes, dtype=np.uint8)
            room = self._per_thread.room = memory, int(memory.ctypes.data)
        return room[1]

    def step_room(self) -> tuple[int, int]:
        """Numbers and whole numbers that one planning step needs, for an exported controller."""
        sizes = np.empty(2, dtype=np.intc)
        engine().step_room(self.address, sizes)
        return int(sizes[0]), int(sizes[1])
