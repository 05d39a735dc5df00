"""What comes in from outside, made safe: a measurement may be missing, a reference may be nonsense."""

from __future__ import annotations

import math

import numpy as np

from hystmpc.trials.types import Vec

ANGLE_BOUND_DEG = 1e4  # far beyond any joint; keeps squares and sums of angles finite


class UnusableReferenceError(ValueError):
    """A reference that cannot be followed; never leaves the step."""


def usable_angle(y: object) -> float:
    """The measured angle [deg], or not-a-number where it is missing, not a number or absurdly large."""
    try:
        angle = float(y)  # type: ignore[arg-type]  # anything may come from a device; what is no number is caught
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return angle if abs(angle) <= ANGLE_BOUND_DEG else math.nan


def usable_reference(reference: object, horizon: int) -> Vec:
    """The first `horizon` wanted angles [deg].

    Raises:
        UnusableReferenceError: if it is not a vector of numbers, is too short, or holds a NaN or an absurd angle.
    """
    try:
        wanted = np.asarray(reference, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise UnusableReferenceError(f"reference: got {type(reference).__name__}, expected numbers") from None
    if wanted.ndim != 1 or wanted.shape[0] < horizon:
        raise UnusableReferenceError(f"reference: got shape {wanted.shape}, expected ({horizon},)")
    wanted = wanted[:horizon]
    if not bool(np.all(np.abs(wanted) <= ANGLE_BOUND_DEG)):
        raise UnusableReferenceError(f"reference: not finite or beyond {ANGLE_BOUND_DEG:.0f} deg")
    return wanted
