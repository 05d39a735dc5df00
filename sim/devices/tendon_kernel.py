"""Compiled recursion of the tendon catheter; equations and meaning in `tendon.TendonCatheter`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hystmpc.models.kernels.numba_ import njit

DRIVE, ROUGHNESS, VISCOUS, CREEP, REACHED = range(5)  # of the state, after the elements
EXTRA_STATES = 5


class TendonNumbers(NamedTuple):
    """Parameters as the recursion reads them; see `tendon.TendonParameters`."""

    drive_share: float  # 1 - exp(-dt / drive_lag)
    middle_slope: float
    middle_deg: float
    half_gap_slope: float
    half_gap_deg: float
    end_deg: float
    end_mm: float
    viscous_s_per_mm: float
    roughness: float
    roughness_mm: float
    viscoelastic: float
    viscoelastic_share: float
    creep: float
    creep_share: float
    set_deg: float
    set_mm: float
    offset_deg: float
    pretension_n: float
    stiffness_n_per_mm: float
    friction_tension: float


@njit(cache=True, error_model="numpy")
def advance(
    state: Any, widths: Any, commands: Any, bumps: Any, p: Any, dt: float, angle: Any, drive: Any, tension: Any
) -> None:
    """Move `state` (N + 5,) on through commands (T,); `widths` (N,), `bumps` (T,) standard normal; outputs (T,)."""
    count = widths.size
    x, rough, viscous, creep, reached = state[count:]
    for k in range(commands.size):
        step = p.drive_share * (commands[k] - x)
        x += step
        travel = abs(step)
        keep = math.exp(-travel / p.roughness_mm)
        rough = keep * rough + p.roughness * math.sqrt(max(1 - keep * keep, 0.0)) * bumps[k]
        middle = p.middle_deg + p.middle_slope * x + p.end_deg * math.exp(-x / p.end_mm)
        half = (p.half_gap_deg + p.half_gap_slope * x) * (1 + p.viscous_s_per_mm * travel / dt) * max(1 + rough, 0.0)
        total = 0.0
        for i in range(count):
            # The friction of one element holds it until the wall reaches it.
            state[i] = max(middle - widths[i] * half, min(middle + widths[i] * half, state[i]))
            total += state[i]
        bend = total / count
        viscous += p.viscoelastic_share * (bend - viscous)
        creep += p.creep_share * (bend - creep)
        reached = max(reached, x)
        set_left = p.set_deg * max(1 - reached / p.set_mm, 0.0)
        angle[k] = bend + p.viscoelastic * (viscous - bend) + p.creep * (creep - bend) + p.offset_deg - set_left
        drive[k] = x
        stick = (middle - bend) / half if half > 0 else 0.0  # 1 on the loading line, -1 on the unloading line
        tension[k] = (p.pretension_n + p.stiffness_n_per_mm * x) * (1 + p.friction_tension * (stick - 1))
    state[count:] = np.array([x, rough, viscous, creep, reached])
