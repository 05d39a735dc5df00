"""Periodic disturbance: heartbeat and breathing, motion that does not depend on the command."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Operator, Parameter, Symbol, check_values


@final
@dataclass(frozen=True)
class PeriodicDisturbance(Operator):
    """A sum of harmonics on a clock of its own.

    c_k = frac(c_{k-1} + frequency_hz dt),  y = u + sum_h amplitude_h sin(2 pi h c + phase_h),  h = 1..n

    The clock c counts turns, is state and starts at zero. Amplitudes at 0 are the identity.

    Attributes:
        frequency_hz: of the first harmonic [Hz].
        amplitudes: of each harmonic [in].
        phases_rad: of each harmonic [rad].

    Raises:
        ModelError: if there is no harmonic, or another number of phases than of amplitudes.
    """

    frequency_hz: float
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    name: ClassVar[str] = "periodic_disturbance"
    shape: ClassVar[tuple[str, ...]] = ("harmonics",)
    default_sizes: ClassVar[Mapping[str, int]] = {"harmonics": 1}

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitudes", tuple(float(v) for v in self.amplitudes))
        object.__setattr__(self, "phases_rad", tuple(float(v) for v in self.phases_rad))
        if len(self.amplitudes) != len(self.phases_rad) or not self.amplitudes:
            raise ModelError(
                f"periodic_disturbance: {len(self.amplitudes)} amplitudes and {len(self.phases_rad)} phases, "
                "expected as many, at least 1"
            )
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        zeros = (0.0,) * structure.get("harmonics", 1)
        return cls(1.0, zeros, zeros)

    @property
    def harmonics(self) -> int:
        """Number n of harmonics."""
        return len(self.amplitudes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        marks = [""] if self.harmonics == 1 else [f"_{h}" for h in range(1, self.harmonics + 1)]
        return (
            Parameter("frequency_hz", "Hz", 1e-3, 1e2, "frequency of the first harmonic"),
            *(Parameter(f"amplitude{m}", "in", 0.0, 1e3, "amplitude") for m in marks),
            *(Parameter(f"phase{m}_rad", "rad", -10.0, 10.0, "phase at the start of the clock") for m in marks),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return ("c",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = self.harmonics
        turns = x[0] + p[0] * dt
        turns = turns - ca.floor(turns)
        waves = (p[1 + i] * ca.sin(2 * math.pi * (i + 1) * turns + p[1 + n + i]) for i in range(n))
        return turns, u + sum(waves)

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del u, y, p
        return ca.vertcat(0)
