"""Compiled recursion of the muscle-driven catheter; equations and meaning in `muscle.MuscleCatheter`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from hystmpc.models.kernels.numba_ import njit

PRESSURE, BLADDER, FRICTION, LATE, BEND = range(5)
STATES = 5


class MuscleNumbers(NamedTuple):
    """Parameters as the recursion reads them; see `muscle.MuscleParameters`."""

    supply_bar: float
    valve_s: float
    fill_s: float
    vent_s: float
    slack_bar: float
    slack_width_bar: float
    friction: float
    presliding_bar: float
    greatest_deg: float
    half_bar: float
    late: float
    late_share: float
    bend_share: float


@njit(cache=True, error_model="numpy")
def slack(pressure: float, at: float, width: float) -> float:
    """Pressure that reaches the braid: a smooth max(p - at, 0) that is 0 at p = 0."""
    return width * (math.log1p(math.exp((pressure - at) / width)) - math.log1p(math.exp(-at / width)))


@njit(cache=True, error_model="numpy")
def advance(state: Any, commands: Any, p: Any, dt: float, parts: int, angle: Any, drive: Any) -> None:
    """Move `state` (5,) on through commands (T,), each in `parts` steps of dt / parts; outputs (T,)."""
    pressure, before, friction, late, bend = state
    h = dt / parts
    for k in range(commands.size):
        for _ in range(parts):
            flow = (commands[k] - pressure) / p.valve_s
            flow = min(max(flow, -pressure / p.vent_s), (p.supply_bar - pressure) / p.fill_s)
            pressure = max(pressure + h * flow, 0.0)
            bladder = slack(pressure, p.slack_bar, p.slack_width_bar)
            step = bladder - before
            before = bladder
            side = 1.0 if step > 0 else -1.0
            friction = side + (friction - side) * math.exp(-abs(step) / p.presliding_bar)
            pull = max(bladder * (1 - p.friction * friction), 0.0)
            still = p.greatest_deg * pull / (pull + p.half_bar)
            late += p.late_share * (still - late)
            bend += p.bend_share * (still + p.late * (late - still) - bend)
        angle[k] = bend
        drive[k] = pressure
    state[0], state[1], state[2], state[3], state[4] = pressure, before, friction, late, bend
