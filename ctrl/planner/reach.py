"""Reachable angles: angles at which the model can be held within the command limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hystmpc.models.model import Predictor
from hystmpc.trials.brief import brief
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from ..command import CommandLimits

_SETTLING_S = 2.0  # at either end: many times the lag of any catheter drive

_MOST_SAMPLES = 4000  # of one ramp

_REACH_SLACK = 0.02  # of the reach: a reference may begin at the rest of a device that is a little off its model


@dataclass(frozen=True)
class Reach:
    """Reachability of an angle; its truth value is `reachable`.

    Attributes:
        low_deg, high_deg: least and greatest angle that can be reached now [deg].
        nearest_deg: reachable angle nearest to the requested one [deg]; NaN without a request.
    """

    reachable: bool
    low_deg: float
    high_deg: float
    reason: str
    nearest_deg: float
    __repr__ = brief

    def __bool__(self) -> bool:
        return self.reachable


@dataclass(frozen=True)
class Workspace:
    """Bounds of the reachable angles [deg]."""

    model: tuple[float, float]  # the model's angles at rest at both ends of the command
    soft: tuple[float, float]  # soft angle limits of the controller, infinite for none
    trained: tuple[float, float]  # angles that the model was identified on; beyond them it extrapolates

    def judge(self, theta_deg: float, disturbance_deg: float) -> Reach:
        """Return whether `theta_deg` can be reached with the output disturbance `disturbance_deg` [deg]."""
        ends = self.model[0] + disturbance_deg, self.model[1] + disturbance_deg
        low, high = max(ends[0], self.soft[0]), min(ends[1], self.soft[1])
        if not math.isfinite(theta_deg):
            return Reach(False, low, high, f"got {theta_deg} deg, expected a finite angle", math.nan)
        if low <= theta_deg <= high:
            inside = self.trained[0] <= theta_deg <= self.trained[1]
            range_text = f"{self.trained[0]:.4g} to {self.trained[1]:.4g} deg"
            reason = "within reach" if inside else f"within reach, beyond the {range_text} that the model has seen"
            return Reach(True, low, high, reason, theta_deg)
        below = theta_deg < low
        bound, end = (low, ends[0]) if below else (high, ends[1])
        cause = "the command limits" if bound == end else "the soft angle limits"
        side = "below the least" if below else "above the greatest"
        text = f"{theta_deg:.6g} deg is {side} angle within {cause}, {bound:.6g} deg, at which it is cut"
        return Reach(False, low, high, text, bound)


def beyond_reach(angles_deg: Vec, reach_deg: tuple[float, float]) -> str:
    """Return a text on the part of a reference beyond reach, to follow its name; empty if all angles are reachable."""
    low, high = float(np.min(angles_deg)), float(np.max(angles_deg))
    slack = _REACH_SLACK * (reach_deg[1] - reach_deg[0])
    if reach_deg[0] - slack <= low and high <= reach_deg[1] + slack:
        return ""
    return (
        f"asks for {low:.4g} to {high:.4g} deg, the model reaches {reach_deg[0]:.4g} to {reach_deg[1]:.4g} deg "
        "within the limits of the command"
    )


def angles_at_rest(predictor: Predictor, limits: CommandLimits, start_deg: float) -> tuple[float, float]:
    """Compute the model's angles at rest at both ends of the command, after one slow excursion over its range [deg].

    Args:
        start_deg: initial angle of the model.

    Raises:
        ControllerError: if the model does not answer with finite angles.
    """
    samples = math.ceil((limits.upper - limits.lower) / (limits.rate * predictor.dt))
    up = np.linspace(limits.lower, limits.upper, min(max(samples, 2), _MOST_SAMPLES))
    rest = max(1, round(_SETTLING_S / predictor.dt))
    top, bottom = np.full(rest, limits.upper), np.full(rest, limits.lower)
    commands = np.concatenate([bottom, up, top, up[::-1], bottom])
    angles = predictor.rollout(predictor.initial(start_deg, limits.lower), commands[None])[0]
    ends = float(angles[-1]), float(angles[2 * rest + up.size - 1])
    if not all(math.isfinite(x) for x in ends):
        raise ControllerError(f"model: answers {ends} deg at the ends of its command, expected finite angles")
    return min(ends), max(ends)
