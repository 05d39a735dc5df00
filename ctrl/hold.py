"""Holds that hold: when a constant reference counts as reached, and how gently what is left over is corrected."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

_LEAVE_SIGMAS = 5.0  # two independent estimates of one disturbance differ by more than this once in 10^4 samples


@dataclass(frozen=True)
class Hold:
    """Whether the command is held on purpose, at which reference, and for how many samples that has been constant."""

    holding: bool = False
    constant: int = 0
    target: float = math.nan


@dataclass(frozen=True)
class HoldRule:
    """When a constant reference counts as reached, and how an error that is left over is worked off.

    A reference is constant while it and what the preview shows of the next `lead` samples stay within `tolerance_deg`
    of the angle at which they came to rest. Reached it is where the held command keeps the angle close: within
    `tolerance_deg` at first; and with every `patience` that passes one standard deviation of the disturbance estimate
    more, up to five, since noise may never let it come closer and a command has to come to rest; once held, five.

    A longer lead would let the command cross the dead band before the reference turns. On a dead band as flat as the
    model's that is free; on a device that answers there, it moves the tip in a hold.

    Attributes:
        tolerance_deg: closeness that is always good enough [deg].
        patience: samples of constant reference for which one more standard deviation is allowed for.
        lead: samples of preview that are looked at, at least 1.
        settle_after: samples of constant reference after which corrections are gentle.
        settle: samples over which a gentle correction works off an error at the model's mean slope; 0 for none.

    Raises:
        ControllerError: if a value is out of bounds.
    """

    tolerance_deg: float = 0.03
    patience: int = 10
    lead: int = 1
    settle_after: int = 10
    settle: int = 3

    def __post_init__(self) -> None:
        counts = self.patience, self.settle_after, self.settle
        if not (self.tolerance_deg >= 0 and min(counts) >= 0 and self.lead >= 1):
            raise ControllerError(f"hold: got {self}, expected values >= 0 and a lead of at least 1")

    def judge(self, before: Hold, reference: Vec, held: Vec, sigma: float) -> Hold:
        """Whether to hold now.

        Args:
            before: the last answer.
            reference: preview (H,) [deg].
            held: angles (H,) that the held command is expected to lead to [deg].
            sigma: standard deviation of the disturbance estimate's error [deg].
        """
        now = float(reference[0])
        if not abs(now - before.target) <= self.tolerance_deg:  # not-a-number: none yet
            return Hold(target=now)
        if self.lead > 1 and self.error(before, reference[: self.lead]) > self.tolerance_deg:
            return Hold(target=now)
        constant = before.constant + 1
        waited = min(float(constant // max(self.patience, 1)), _LEAVE_SIGMAS)
        sigmas = _LEAVE_SIGMAS if before.holding else waited
        return Hold(self.error(before, held) <= self.tolerance_deg + sigmas * sigma, constant, before.target)

    @staticmethod
    def error(hold: Hold, held: Vec) -> float:
        """Greatest distance of angles (H,) from the angle to be held [deg]."""
        return float(np.max(np.abs(held - hold.target)))

    def gentle(self, hold: Hold, plan: Vec, u_last: float, error: float, slope: float) -> Vec:
        """The plan (H,), in a hold within u_last -+ k error / (slope settle), k = 1, 2, ... samples.

        Inside what a model has for a dead band and a device does not, a plan takes a whole dead band for free, and the
        plan after it takes it back: a limit cycle. A correction as small as the error asks for outside dead bands meets
        the measurement before it is too far, and a true dead band is crossed all the same, within some samples more.

        Args:
            hold: the present answer of `judge`.
            plan: commands.
            u_last: the command really sent last.
            error: greatest error of the held command [deg].
            slope: mean slope of the model [deg per command unit].
        """
        if not (self.settle > 0 and hold.constant > self.settle_after and slope > 0):
            return plan
        most = error / (slope * self.settle) * np.arange(1, plan.size + 1)
        return np.clip(plan, u_last - most, u_last + most)
