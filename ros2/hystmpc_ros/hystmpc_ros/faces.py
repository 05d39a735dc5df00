"""Messages and services of the node for a controller of one axis, and of two."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hystmpc_msgs.msg import PlaneTipState, TipState
from hystmpc_msgs.srv import SetPlaneReference, SetPlaneTarget, SetReference, SetTarget
from std_msgs.msg import Float64, Float64MultiArray

from hystmpc.rig.axes import each, from_array, spread, together
from hystmpc.trials.errors import ControllerError


@dataclass(frozen=True)
class Face:
    """What the node offers to others, and how its numbers are put into messages.

    Attributes:
        state, target: messages of the topics `~/state` and `~/target`.
        set_target, set_reference: services.
        numbers: of a message: a number, or of two axes a list of both.
        reference: what `set_reference` of the controller takes, of a request.
        answer: puts into a response how far a target can be reached.
    """

    state: Any
    target: Any
    set_target: Any
    set_reference: Any
    numbers: Callable[[Any], Any]
    reference: Callable[[Any], Any]
    answer: Callable[[Any, Any], None]


def face(axes: int) -> Face:
    """What the node offers for so many axes."""
    if axes == 1:
        return Face(TipState, Float64, SetTarget, SetReference, float, lambda asked: list(asked.angles_deg), _ends)
    return Face(PlaneTipState, Float64MultiArray, SetPlaneTarget, SetPlaneReference, _pair, _points, _nearest)


def seen(newest: Any, before: Any) -> Any:
    """The newest measurement, and where it is no number, of each axis, the one before."""
    known = each(from_array(before))
    pairs = zip(spread(from_array(newest), len(known)), known, strict=True)
    return together(one if math.isfinite(one) else other for one, other in pairs)


def less(one: Any, other: Any) -> Any:
    """Difference of two numbers, or of two pairs."""
    return together(a - b for a, b in zip(each(from_array(one)), each(from_array(other)), strict=True))


def _pair(value: Any) -> list[float]:
    return list(map(float, each(from_array(value))))


def _points(asked: Any) -> list[tuple[float, float]]:
    x, y = list(asked.x_deg), list(asked.y_deg)
    if len(x) != len(y):
        raise ControllerError(f"set_reference: got {len(x)} angles of x and {len(y)} of y, expected as many of each")
    return list(zip(x, y, strict=True))


def _ends(response: Any, reach: Any) -> None:
    response.low_deg, response.high_deg = reach.low_deg, reach.high_deg


def _nearest(response: Any, reach: Any) -> None:
    response.nearest_deg = _pair(reach.nearest_deg)
