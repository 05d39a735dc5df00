"""Plans worth looking at before any optimisation: they cross dead bands where a gradient is zero."""

from __future__ import annotations

from typing import final

import numpy as np

from hystmpc.models.inverse.follow import Bounds, Follower, follower_for
from hystmpc.models.model import Inverse, Predictor
from hystmpc.trials.types import Vec

from .adaptive.follow import LearnedFollower
from .adaptive.predictor import LearnedInverse
from .limits import CommandLimits
from .plan_kernels import clip_plans, fill_candidates

HOLD, INVERSE = 0, 1  # rows of the candidates that callers refer to
FOLLOWING = 5  # rows before those that only search
# Shares of the greatest step. Inside what a network has for a dead band its slope may have the wrong sign: the little
# step that ends an error in a hold is found by trying it, not by a gradient.
_STEPS = (0.125, 0.1875, 0.25, 0.375, 0.5, 0.625, 0.75, 1.0)


@final
class Candidates:
    """Admissible plans (N, H):

    hold; inverse, as fast as the rate limit allows once the reference asks for it; inverse ahead of time, so that
    a dead band is crossed before the reference turns; inverse half ahead, so that the crossing has its middle at
    the turn; the last plan, shifted; reversals: m = 2, 4, ... samples at the greatest rate in either direction and
    then rest; and where the reference rests, small steps: a share of a sample at the greatest rate, either way.

    Args:
        predictor: the model, with the sample time.
        inverse: its inverse.
        limits: hard limits.
        horizon: H.
    """

    def __init__(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits, horizon: int) -> None:
        self._horizon = horizon
        reach = limits.rate * predictor.dt
        self._bounds = Bounds(limits.lower, limits.upper, reach)
        if isinstance(inverse, LearnedInverse):
            self._follower: Follower = LearnedFollower(inverse)
        else:
            self._follower = follower_for(predictor, inverse)
        self._reversals = _reversals(reach, horizon)
        steps = np.repeat(reach * np.array(_STEPS)[:, None], horizon, axis=1)
        self._all = np.concatenate([self._reversals, steps, -steps])

    def build(self, state: Vec, u_last: float, reference: Vec, remaining: Vec, resting: bool = True) -> Vec:
        """The plans that may follow `u_last` for the model angles `reference` (H,) [deg].

        Args:
            state: predictor state (S,).
            u_last: the command really sent last.
            reference: wanted angles without disturbance [deg], shape (H,).
            remaining: what is left of the last plan, shape (0..H,).
            resting: whether small steps are among them.
        """
        low, high, reach = self._bounds
        ramps = self._all if resting else self._reversals
        plans = np.empty((FOLLOWING + len(ramps), self._horizon))
        targets = self._follower.follow(state, reference, u_last, self._bounds)
        fill_candidates(plans, targets, remaining, ramps, u_last, reach)
        clip_plans(plans, low, high, reach, u_last)
        return plans

    def inverse_plan(self, state: Vec, u_last: float, reference: Vec) -> Vec:
        """The inverse followed sample by sample within all limits, shape (H,)."""
        return self._follower.follow(state, reference, u_last, self._bounds)[1]


def _reversals(reach: float, horizon: int) -> Vec:
    """Offsets (M, H) from the last command: m = 2, 4, ... samples at the greatest rate, up and down."""
    lengths = [2**i for i in range(1, horizon.bit_length()) if 2**i <= max(horizon // 2, 2)]
    ramps = reach * np.minimum(np.arange(1, horizon + 1), np.array(lengths)[:, None])
    return np.concatenate([ramps, -ramps])
