"""Move blocking: few decisions over a long horizon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat


@dataclass(frozen=True)
class MoveBlocking:
    """Which deviations v (H,) from a plan the program may choose: v = M w, one w a block (Cagienard et al., 2007).

        v_k = w_{b-1} + (k - s_b + 1) / L_b (w_b - w_{b-1})   in block b of length L_b from sample s_b on,  w_{-1} = 0
        v_k = w_{m-1}                                         after the last block

    That is offset blocking of the moves: within a block the deviation's move is constant, after the last one zero. A
    block of held commands would have to make its whole move in one sample, whose rate is limited; here a block of L
    samples moves by up to L times as much. The plan itself, the best candidate, may do what it likes in every sample.

    Attributes:
        lengths: L, samples in each block, the first one first.
        horizon: H.

    Raises:
        ControllerError: if there is no block, one is shorter than a sample, or they are longer than the horizon.
    """

    lengths: tuple[int, ...]
    horizon: int

    def __post_init__(self) -> None:
        if not self.lengths or min(self.lengths) < 1 or sum(self.lengths) > self.horizon:
            raise ControllerError(
                f"move_blocking: got blocks of {list(self.lengths)} samples, {sum(self.lengths)} together, expected at "
                f"least one, each of at least 1 sample, together at most the horizon of {self.horizon}"
            )

    @property
    def starts(self) -> NDArray[np.intp]:
        """s (m,): the first sample of each block."""
        return np.cumsum((0, *self.lengths[:-1]))

    @property
    def ends(self) -> NDArray[np.intp]:
        """Last sample of each block (m,): where v is w itself."""
        return np.cumsum(self.lengths) - 1

    @property
    def matrix(self) -> Mat:
        """M (H, m)."""
        count = len(self.lengths)
        found = np.zeros((self.horizon, count))
        for b, (start, length) in enumerate(zip(self.starts.tolist(), self.lengths, strict=True)):
            along = np.arange(1, length + 1) / length
            found[start : start + length, b] = along
            if b:
                found[start : start + length, b - 1] = 1.0 - along
        found[sum(self.lengths) :, count - 1] = 1.0
        return found
