"""Plans worth looking at before any optimisation: they cross dead bands where a gradient is zero."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.model import Inverse, Predictor

from .limits import CommandLimits

Vec = NDArray[np.float64]

HOLD, INVERSE = 0, 1  # rows of the candidates that callers refer to
# Shares of the greatest step. Inside what a network has for a dead band its slope may have the wrong sign: the little
# step that ends an error in a hold is found by trying it, not by a gradient.
_STEPS = (0.125, 0.1875, 0.25, 0.375, 0.5, 0.625, 0.75)


@final
class Candidates:
    """Admissible plans (N, H), the same N at every step:

    hold; inverse, as fast as the rate limit allows once the reference asks for it; inverse ahead of time, so that
    a dead band is crossed before the reference turns; inverse half ahead, so that the crossing has its middle at
    the turn; the last plan, shifted; steps and reversals: a share of a sample, or m samples, at the greatest rate in
    either direction and then rest.

    Args:
        predictor: the model, with the sample time.
        inverse: its inverse.
        limits: hard limits.
        horizon: H.
    """

    def __init__(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits, horizon: int) -> None:
        self._predictor, self._inverse, self._limits = predictor, inverse, limits
        self._horizon = horizon
        self._dt = predictor.dt
        self._reach = limits.rate * predictor.dt
        self._ramps = self._reversal_ramps()

    def build(self, state: Vec, u_last: float, reference: Vec, remaining: Vec) -> Vec:
        """The plans that may follow `u_last` for the model angles `reference` (H,) [deg].

        Args:
            state: predictor state (S,).
            u_last: the command really sent last.
            reference: wanted angles without disturbance [deg], shape (H,).
            remaining: what is left of the last plan, shape (0..H,).
        """
        targets = self._inverse_targets(state, u_last, reference)
        moves = np.diff(targets, prepend=u_last)
        greedy = targets if np.max(np.abs(moves)) <= self._reach else self.inverse_plan(state, u_last, reference)
        plans = np.empty((5 + len(self._ramps), self._horizon))
        plans[HOLD] = u_last
        plans[INVERSE] = greedy
        plans[2] = self._ahead(targets)
        plans[3] = self._ahead(self._half_postponed(targets, moves))
        plans[4] = greedy if not remaining.size else remaining[-1]
        plans[4, : remaining.size] = remaining
        plans[5:] = u_last + self._ramps
        return self._limits.clip_plans(plans, u_last, self._dt)

    def inverse_plan(self, state: Vec, u_last: float, reference: Vec) -> Vec:
        """The inverse followed sample by sample within all limits, shape (H,)."""
        plan = np.empty(self._horizon)
        for k in range(self._horizon):
            wanted = self._inverse.command(state, float(reference[k]), u_last)
            u_last = self._limits.clip(wanted, u_last, self._dt)
            _, state = self._predictor.advance(state, u_last)
            plan[k] = u_last
        return plan

    def _inverse_targets(self, state: Vec, u_last: float, reference: Vec) -> Vec:
        """The inverse followed within the box alone: where the commands should be, were there no rate limit."""
        low, high = self._limits.lower, self._limits.upper
        targets = np.empty(self._horizon)
        for k in range(self._horizon):
            u_last = min(max(self._inverse.command(state, float(reference[k]), u_last), low), high)
            _, state = self._predictor.advance(state, u_last)
            targets[k] = u_last
        return targets

    def _ahead(self, targets: Vec) -> Vec:
        """The targets, limited in rate backwards in time: every move starts early enough to arrive in time."""
        plan = targets.copy()
        for k in range(self._horizon - 2, -1, -1):
            plan[k] = min(max(plan[k], plan[k + 1] - self._reach), plan[k + 1] + self._reach)
        return plan

    def _half_postponed(self, targets: Vec, moves: Vec) -> Vec:
        """The targets with their first jump later by half of the samples that it takes at the greatest rate."""
        jumps = np.flatnonzero(np.abs(moves) > self._reach)
        if not jumps.size:
            return targets
        first = int(jumps[0])
        half = math.ceil(abs(moves[first]) / self._reach) // 2
        postponed = targets.copy()
        postponed[first : first + half] = targets[first] - moves[first]
        return postponed

    def _reversal_ramps(self) -> Vec:
        """Offsets (M, H) from the last command: a step, or m = 2, 4, ... samples at the greatest rate, up and down."""
        samples = np.arange(1, self._horizon + 1)
        lengths = [2**i for i in range(self._horizon.bit_length()) if 2**i <= max(self._horizon // 2, 1)]
        ramps = [self._reach * np.minimum(samples, length) for length in lengths]
        steps = [np.full(self._horizon, share * self._reach) for share in _STEPS]
        offsets = np.array([*steps, *ramps])
        return np.concatenate([offsets, -offsets])
