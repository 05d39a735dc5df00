"""Numbers of the rod device."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from hystmpc.trials.errors import ConfigError

from .device import Quantities, quantity
from .rod_equations import RodNumbers, StepNumbers

_SINKING = 0.5  # greatest weight moment over stiffness: beyond, a rod buckles under its own weight


@dataclass(frozen=True)
class RodParameters(Quantities):
    """Numbers of the rod device; the defaults were identified, see docs/devices.md. Altered by `dataclasses.replace`.

    Raises:
        ConfigError: if a number is out of its bounds, the branches' shares leave no stiffness at rest, or the weight
            is too much for the stiffness.
    """

    travel_mm: float = quantity(6.0, "mm", 0.1, 100.0, "greatest tendon displacement (S2)")
    rest_deg: float = quantity(-8.529, "deg", -90.0, 120.0, "bend of the rod without tendon and history")
    length_mm: float = quantity(60.0, "mm", 1.0, 1000.0, "length of the rod (steerable part of the recorded device)")
    offset_mm: float = quantity(1.7926, "mm", 0.1, 20.0, "distance of the lumen from the rod's axis")
    stiffness_nmm: float = quantity(6.8951, "N mm/rad", 1e-2, 1e5, "bending stiffness of the whole rod at rest, EI / l")
    shaft_n_per_mm: float = quantity(6.1229, "N/mm", 1e-2, 1e5, "stiffness of tendon against shaft, EA / free length")
    rod_n_per_mm: float = quantity(1.2711, "N/mm", 1e-2, 1e5, "stiffness of the tendon within the rod")
    pretension_mm: float = quantity(3.6194, "mm", -20.0, 20.0, "pull that tensions the virgin tendon; below 0 is slack")
    friction: float = quantity(0.05, "1", 0.0, 0.6, "coefficient of friction of tendon and lumen")
    shaft_bend_deg: float = quantity(30.0, "deg", 0.0, 720.0, "wrap angle of the passive shaft")
    shaft_drag_n: float = quantity(1.6638, "N", 0.0, 1000.0, "drag in the shaft that does not come from tension")
    rod_drag_n: float = quantity(1.5684, "N", 0.0, 1000.0, "the same in the rod")
    fast_share: float = quantity(1.0, "1", 0.0, 10.0, "stiffness of the first Maxwell branch over that at rest")
    fast_s: float = quantity(0.04784, "s", 1e-3, 1e4, "its relaxation time")
    slow_share: float = quantity(0.07096, "1", 0.0, 10.0, "stiffness of the second Maxwell branch over that at rest")
    slow_s: float = quantity(1.9418, "s", 1e-3, 1e4, "its relaxation time")
    set_share: float = quantity(0.11839, "1", 0.0, 0.9, "share of the greatest bend so far that stays: first flexure")
    weight_n: float = quantity(0.0, "N", 0.0, 100.0, "weight of the rod, evenly along it")
    down_deg: float = quantity(0.0, "deg", -360.0, 360.0, "from the rod's base axis to the pull of gravity")
    drive_lag_s: float = quantity(0.02, "s", 0.0, 10.0, "first-order lag of the servo drive")
    mount_deg: float = quantity(0.0, "deg", -60.0, 60.0, "shift of all angles by how the rod is mounted")
    longest_step_s: float = quantity(0.05, "s", 1e-4, 10.0, "longer samples are solved in equal parts")
    shaft_contacts: int = quantity(5, "1", 1, 50, "contacts of tendon and shaft")
    segments: int = quantity(10, "1", 1, 50, "segments of the rod, with a contact each")

    def __post_init__(self) -> None:
        super().__post_init__()
        for f in fields(self):
            if f.type == "float":  # the kernel is compiled for floats: a 2 is a 2.0
                object.__setattr__(self, f.name, float(getattr(self, f.name)))
        if self.weight_n * self.length_mm > _SINKING * self.stiffness_nmm:
            raise ConfigError(
                f"RodParameters.weight_n: got {self.weight_n} N, expected at most "
                f"{_SINKING * self.stiffness_nmm / self.length_mm:.3g} N on a rod of this stiffness and length"
            )

    @property
    def contacts(self) -> int:
        """m, contacts of the tendon in shaft and rod."""
        return self.shaft_contacts + self.segments

    def numbers(self) -> RodNumbers:
        """The parameters as the equations read them."""
        p, n = self.shaft_contacts, self.segments
        stiffness = self.stiffness_nmm * n
        shaft, rod = (p + 1) * self.shaft_n_per_mm, n * self.rod_n_per_mm
        return RodNumbers(
            shaft_contacts=p,
            segments=n,
            compliance=np.repeat([1 / shaft, 1 / rod], [p + 1, n]),
            wrap=np.repeat([0.0, math.radians(self.shaft_bend_deg) / p, 0.0], [1, p, n]),
            drag=np.repeat([0.0, self.shaft_drag_n / p, self.rod_drag_n / n], [1, p, n]),
            mu=self.friction,
            offset=self.offset_mm,
            rest=math.radians(self.rest_deg) / n,
            stiffness=stiffness,
            branch_stiffness=(self.fast_share * stiffness, self.slow_share * stiffness),
            set_share=self.set_share,
            pretension=self.pretension_mm,
            weight=self.weight_n / n,
            length=self.length_mm / n,
            down=math.radians(self.down_deg),
        )

    def step_numbers(self, dt_s: float) -> StepNumbers:
        """Constants of a step; exact for bends that change evenly within it."""
        times = (self.fast_s, self.slow_s)
        keep = tuple(math.exp(-dt_s / tau) for tau in times)
        mean = tuple(-math.expm1(-dt_s / tau) * tau / dt_s for tau in times)
        return StepNumbers(
            keep=(keep[0], keep[1]),
            old=(mean[0] - keep[0], mean[1] - keep[1]),
            new=(1 - mean[0], 1 - mean[1]),
            drive_share=-math.expm1(-dt_s / self.drive_lag_s) if self.drive_lag_s > 0 else 1.0,
        )


@dataclass(frozen=True)
class RodVariation(Quantities):
    """Variation of the device between trials: standard deviations of normal draws."""

    mount_deg: float = quantity(0.3, "deg", 0.0, 10.0, "shift of all angles")
    pretension_mm: float = quantity(0.02, "mm", 0.0, 1.0, "change of the pretension")
    friction: float = quantity(0.04, "1", 0.0, 0.3, "relative change of friction and drags")

    def __call__(self, parameters: RodParameters, random: np.random.Generator) -> RodParameters:
        """The device of one trial."""
        mount, pretension, friction = random.standard_normal(3)
        scale = 1 + self.friction * friction
        return replace(
            parameters,
            mount_deg=parameters.mount_deg + self.mount_deg * mount,
            pretension_mm=parameters.pretension_mm + self.pretension_mm * pretension,
            friction=parameters.friction * scale,
            shaft_drag_n=parameters.shaft_drag_n * scale,
            rod_drag_n=parameters.rod_drag_n * scale,
        )
