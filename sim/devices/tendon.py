"""Tendon catheter of S2, with distributed friction between its loading and unloading lines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .device import DeviceMotion, Quantities, quantity

EXTRA_STATES = 5  # drive, roughness, viscoelastic angle, creep and greatest drive, after the elements


class TendonNumbers(NamedTuple):
    """Parameters of the recursion in core/tendon.c, in its order; see `TendonParameters`."""

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


@dataclass(frozen=True)
class TendonParameters(Quantities):
    """Parameters of the tendon catheter; docs/reference/devices.md says how friction, widths and noise were set.

    Raises:
        ConfigError: if a number is out of its bounds, or the lines cross within the travel.
    """

    travel_mm: float = quantity(6.0, "mm", 0.1, 100.0, "greatest tendon displacement (S2)")
    loading_slope: float = quantity(10.70, "deg/mm", 0.1, 100.0, "slope of the loading line (S2's code)")
    loading_deg: float = quantity(21.43, "deg", -90.0, 180.0, "loading line at 0 mm (S2's code)")
    unloading_slope: float = quantity(10.27, "deg/mm", 0.1, 100.0, "slope of the unloading line (S2's code)")
    unloading_deg: float = quantity(28.98, "deg", -90.0, 180.0, "unloading line at 0 mm (S2's code)")
    friction: float = quantity(0.85, "1", 0.0, 3.0, "mean half gap of the elements over that of the two lines")
    core_share: float = quantity(0.6, "1", 0.01, 0.99, "share of the elements in the narrow band of widths")
    core_from: float = quantity(0.45, "1", 0.0, 1.0, "least width over the mean width")
    core_to: float = quantity(0.60, "1", 0.0, 1.0, "width at which the tail of widths begins, over the mean width")
    end_deg: float = quantity(1.0, "deg", 0.0, 20.0, "rise of both lines at 0 mm, where the tube's own set takes over")
    end_mm: float = quantity(0.4, "mm", 0.01, 10.0, "travel over which that rise fades")
    viscous_s_per_mm: float = quantity(0.01, "s/mm", 0.0, 1.0, "growth of the friction with tendon speed")
    roughness: float = quantity(0.15, "1", 0.0, 1.0, "standard deviation of the friction along the travel")
    roughness_mm: float = quantity(2.0, "mm", 0.01, 100.0, "travel over which the friction forgets")
    viscoelastic: float = quantity(0.04, "1", 0.0, 1.0, "share of the angle that follows late")
    viscoelastic_s: float = quantity(0.3, "s", 1e-3, 100.0, "time constant of that share")
    creep: float = quantity(0.0, "1", 0.0, 1.0, "share of the angle that creeps (S2 shows none)")
    creep_s: float = quantity(10.0, "s", 1e-2, 1e4, "time constant of the creep")
    drive_lag_s: float = quantity(0.02, "s", 0.0, 10.0, "first-order lag of the servo drive")
    set_deg: float = quantity(3.0, "deg", 0.0, 90.0, "what the first flexure adds for good")
    offset_deg: float = quantity(0.0, "deg", -20.0, 20.0, "shift of all angles, for variation between trials")
    pretension_n: float = quantity(4.92, "N", 0.0, 100.0, "tendon tension of the virgin catheter at 0 mm (S2)")
    stiffness_n_per_mm: float = quantity(3.3, "N/mm", 0.0, 100.0, "rise of the tension while loading")
    friction_tension: float = quantity(0.2, "1", 0.0, 0.5, "friction over tension, each way")
    elements: int = quantity(40, "1", 2, 1000, "friction elements")

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.gap(0.0), self.gap(self.travel_mm)) <= 0:
            raise ConfigError("TendonParameters: the lines cross within the travel, expected unloading above loading")
        if not self.core_from <= self.core_to:
            raise ConfigError(f"core_from: got {self.core_from}, expected at most core_to = {self.core_to}")

    def gap(self, x_mm: float) -> float:
        """Unloading line minus loading line at `x_mm` [deg]."""
        return self.unloading_deg - self.loading_deg + (self.unloading_slope - self.loading_slope) * x_mm

    @property
    def widths(self) -> Vec:
        """Widths of the elements relative to their mean (N,): a narrow band, then a tail that makes the mean 1."""
        core = min(max(round(self.core_share * self.elements), 1), self.elements - 1)
        band = np.linspace(self.core_from, self.core_to, core)
        rest = self.elements - core
        tail_mean = (self.elements - band.sum()) / rest
        return np.concatenate([band, self.core_to + 2 * (tail_mean - self.core_to) * (np.arange(rest) + 0.5) / rest])


@final
class TendonCatheter:
    """Device with input tendon displacement [mm] and output tip angle [deg], of N friction elements between two lines.

    With x the drive's displacement, x' = (u - x) / drive_lag, and its speed v = x':

        M(x) = (loading(x) + unloading(x)) / 2 + end_deg exp(-x / end_mm)          middle of the loop
        h    = friction (unloading(x) - loading(x)) / 2 (1 + viscous |v|) (1 + r)     mean half gap
        z_i  = max(M - w_i h, min(M + w_i h, z_i)),  mean of w_i = 1                element i, i = 1..N
        dr   = -r |dx| / roughness_mm + roughness sqrt(2 / roughness_mm) dW(|dx|)        friction along the travel
        theta = mean(z_i), less the late shares (viscoelastic, creep), less the set that the first flexure leaves

    Elements of equal width would be the 4-parameter backlash; spread widths (a Preisach density of generalised plays)
    make a reversal first flat, then smooth. The friction r is random along the travel and stands still in a hold,
    so a hold holds. A virgin catheter lies on the loading line at 0 mm and below it by `set_deg`; after a flexure it
    comes back to the unloading line: 20 deg once, about 30 deg ever after (S2 sec. III).

    State (N + 5,): z, drive x [mm], r, viscoelastic and creep angle [deg], greatest x so far [mm].
    """

    command_unit = "mm"

    def __init__(self, parameters: TendonParameters | None = None) -> None:
        self.parameters = parameters or TendonParameters()
        self._widths = self.parameters.widths
        self._packed = (0.0, np.empty(0))  # the last sample time, and the numbers for it

    @property
    def commands(self) -> tuple[float, float]:
        """Least and greatest command [mm]."""
        return 0.0, self.parameters.travel_mm

    def virgin(self) -> Vec:
        """Return the state (N + 5,) at the pretension, before any flexure."""
        p = self._numbers(1.0)
        elements = p.middle_deg + p.end_deg - self._widths * p.half_gap_deg
        bend = float(elements.mean())
        return np.concatenate([elements, [0.0, 0.0, bend, bend, 0.0]])

    def advance(self, state: Vec, commands: Vec, dt_s: float, random: np.random.Generator) -> DeviceMotion:
        """Run commands (T,) [mm], each held for `dt_s` [s]; see `Device.advance`."""
        after = np.array(state, dtype=np.float64)
        clipped = np.clip(np.asarray(commands, dtype=np.float64), *self.commands)
        angle, drive, tension = (np.empty(clipped.size) for _ in range(3))
        bumps = random.standard_normal(clipped.size)
        if self._packed[0] != dt_s:
            self._packed = dt_s, np.array(self._numbers(dt_s), dtype=np.float64)
        signals = clipped, bumps, clipped.size, self._packed[1], dt_s, angle, drive, tension
        engine().tendon(after, self._widths, self._widths.size, *signals)
        return DeviceMotion(angle, drive, tension, after)

    @property
    def state_size(self) -> int:
        """Number of entries of the state, S = N + 5."""
        return self._widths.size + EXTRA_STATES

    def _numbers(self, dt_s: float) -> TendonNumbers:
        p = self.parameters
        computed = {
            "drive_share": _share(dt_s, p.drive_lag_s),
            "middle_slope": (p.loading_slope + p.unloading_slope) / 2,
            "middle_deg": (p.loading_deg + p.unloading_deg) / 2,
            "half_gap_slope": p.friction * (p.unloading_slope - p.loading_slope) / 2,
            "half_gap_deg": p.friction * (p.unloading_deg - p.loading_deg) / 2,
            "viscoelastic_share": _share(dt_s, p.viscoelastic_s),
            "creep_share": _share(dt_s, p.creep_s),
            "set_mm": p.travel_mm,
        }
        return TendonNumbers._make((vars(p) | computed)[name] for name in TendonNumbers._fields)


def _share(dt_s: float, lag_s: float) -> float:
    """Step response of a first-order lag after one sample, exact for a held input."""
    return 1 - math.exp(-dt_s / lag_s) if lag_s > 0 else 1.0
