"""Checks of single numbers, shared by every trajectory."""

from __future__ import annotations

import math

from hystmpc.trials.errors import TrajectoryError


def require_finite(**values: float) -> None:
    """Refuse what is not a finite number.

    Raises:
        TrajectoryError: at the first such value.
    """
    for name, value in values.items():
        if not math.isfinite(value):
            raise TrajectoryError(f"{name}: got {value}, expected a finite number")


def require_positive(**values: float) -> None:
    """Refuse what is not finite and above zero.

    Raises:
        TrajectoryError: at the first such value.
    """
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise TrajectoryError(f"{name}: got {value}, expected a finite number > 0")


def require_range(name: str, bounds: tuple[float, float], least: float = -math.inf) -> None:
    """Require `least` <= bounds[0] <= bounds[1], all finite.

    Raises:
        TrajectoryError: otherwise.
    """
    low, high = bounds
    if not (math.isfinite(low) and math.isfinite(high) and least <= low <= high):
        floor = "" if least == -math.inf else f"{least:g} <= "
        raise TrajectoryError(f"{name}: got {low} to {high}, expected finite {floor}lower <= upper")
