"""Creep: part of the answer to a held input relaxes away, or comes late."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Operator, Parameter, Symbol, check_values


@final
@dataclass(frozen=True)
class Creep(Operator):
    """Linear viscoelastic relaxation with one or more exponentials, exact for an input that is constant over a sample.

    tau_i l_i' + l_i = u  =>  l_i,k = u_k + exp(-dt / tau_i) (l_i,k-1 - u_k),  y = u - sum_i share_i l_i

    A step shows 1 at once and settles to 1 - sum_i share_i. A share below zero creeps on in the direction of the step
    instead. Share 0 is the identity.

    Attributes:
        shares: part of a step that relaxes away with each time constant.
        taus_s: time constants [s].

    Raises:
        ModelError: if there is no exponential, or another number of shares than of time constants.

    Source: generalised Maxwell body, e.g. Findley, Lai and Onaran, Creep and Relaxation of Nonlinear Viscoelastic
    Materials (1976), ch. 5.
    """

    shares: tuple[float, ...]
    taus_s: tuple[float, ...]
    name: ClassVar[str] = "creep"
    shape: ClassVar[tuple[str, ...]] = ("terms",)
    default_sizes: ClassVar[Mapping[str, int]] = {"terms": 1}

    def __post_init__(self) -> None:
        object.__setattr__(self, "shares", tuple(float(v) for v in self.shares))
        object.__setattr__(self, "taus_s", tuple(float(v) for v in self.taus_s))
        if len(self.shares) != len(self.taus_s) or not self.shares:
            raise ModelError(
                f"creep: {len(self.shares)} shares and {len(self.taus_s)} time constants, expected as many, at least 1"
            )
        check_values(self)

    @classmethod
    def template(cls, **structure: int) -> Self:
        terms = structure.get("terms", 1)
        return cls((0.0,) * terms, tuple(min(5.0 * 8.0**i, 1e4) for i in range(terms)))

    @property
    def terms(self) -> int:
        """Number of exponentials."""
        return len(self.shares)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        marks = [""] if self.terms == 1 else [f"_{i}" for i in range(1, self.terms + 1)]
        return (
            *(Parameter(f"share{m}", "1", -3.0, 0.95, "part that relaxes away; below zero: creeps on") for m in marks),
            *(Parameter(f"tau{m}_s", "s", 1e-2, 1e5, "time constant of the relaxation") for m in marks),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(f"l{i}" for i in range(1, self.terms + 1))

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        n = self.terms
        late = [u + ca.exp(-dt / p[n + i]) * (x[i] - u) for i in range(n)]
        return ca.vertcat(*late), u - sum(p[i] * late[i] for i in range(n))

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(*([u] * self.terms))
