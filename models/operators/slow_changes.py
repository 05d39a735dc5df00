"""Slow change and history: creep, drift, first flexure, and differences between trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Number, Operator, Parameter, Symbol, maximum, play


@final
@dataclass(frozen=True)
class Creep(Operator):
    """Linear viscoelastic relaxation with one or more exponentials, exact for an input that is constant over a sample.

    tau_i l_i' + l_i = u  =>  l_i,k = u_k + exp(-dt / tau_i) (l_i,k-1 - u_k),  y = u - sum_i share_i l_i

    The step response is 1 at once and settles to 1 - sum_i share_i; with a share below zero it rises further. Share 0
    is the identity.

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

    def check_sizes(self) -> None:
        if len(self.shares) != len(self.taus_s) or not self.shares:
            raise ModelError(
                f"creep: {len(self.shares)} shares and {len(self.taus_s)} time constants, expected as many, at least 1"
            )

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


@final
@dataclass(frozen=True)
class Drift(Operator):
    """Offset and gain that change linearly with a clock, and an offset that grows with the travel.

    t_k = t_{k-1} + dt,  s_k = s_{k-1} + |u_k - u_{k-1}|
    y   = u + (offset_per_min + gain_per_min u) t / 60 + offset_per_travel s

    Clock and travel are state and start at zero. All rates at 0 are the identity.
    """

    offset_per_min: Annotated[float, Number("in/min", -1e3, 1e3, 0.0, "change of the offset with time")]
    gain_per_min: Annotated[float, Number("1/min", -10.0, 10.0, 0.0, "change of the gain with time")]
    offset_per_travel: Annotated[float, Number("1", -0.1, 0.1, 0.0, "change of the offset with travel")]
    name: ClassVar[str] = "drift"
    state_names: ClassVar[tuple[str, ...]] = ("t", "s", "u")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        t, travel = x[0] + dt, x[1] + ca.fabs(u - x[2])
        return ca.vertcat(t, travel, u), u + (p[0] + p[1] * u) * (t / 60) + p[2] * travel

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(0, 0, u)


_AT_ONCE = 1e-6  # [s], settles within a sample


@final
@dataclass(frozen=True)
class FirstFlexure(Operator):
    """Permanent set in proportion to the excess of the largest bend so far over a threshold.

    m_k = max(m_{k-1}, u_k),  s_k = set max(m_k - threshold, 0)
    l_k = exp(-dt / tau) (l_{k-1} + s_k - s_{k-1}),  y = u + s - l

    With tau 0 it is immediate, else delayed by l, as material flows or a tendon beds in. A first loading beyond the
    threshold therefore has the slope 1 + set, and motions below the largest bend are only shifted. A set below zero
    loses angle. Set 0 is the identity.
    """

    set: Annotated[float, Number("1", -0.95, 3.0, 0.0, "set by bend beyond the threshold")]
    threshold: Annotated[float, Number("in", -1e4, 1e4, 0.0, "bend that leaves no set yet")]
    tau_s: Annotated[float, Number("s", 0.0, 1e4, 0.0, "time constant of taking it")] = 0.0
    name: ClassVar[str] = "first_flexure"
    state_names: ClassVar[tuple[str, ...]] = ("m", "l")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        largest = maximum(u, x[0])
        before, now = (p[0] * maximum(m - p[1], 0) for m in (x[0], largest))
        late = ca.exp(-dt / maximum(p[2], _AT_ONCE)) * (x[1] + now - before)
        return ca.vertcat(largest, late), u + now - late

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """State of a device that was never bent further than now, after a long rest."""
        del y, p
        return ca.vertcat(u, 0)


@final
@dataclass(frozen=True)
class TrialShift(Operator):
    """Offset, gain and extra play of one trial, due to re-mounting, a bend of the sheath or another pretension.

    v = gain u + offset,  z_k = max(v_k - width, min(v_k + width, z_{k-1})),  y = z

    Offset 0, gain 1 and width 0 are the identity.
    """

    offset: Annotated[float, Number("in", -1e4, 1e4, 0.0, "offset of this trial")]
    gain: Annotated[float, Number("1", 0.05, 20.0, 1.0, "gain of this trial")]
    width: Annotated[float, Number("in", 0.0, 1e3, 0.0, "half-width of the extra play of this trial")]
    name: ClassVar[str] = "trial_shift"
    state_names: ClassVar[tuple[str, ...]] = ("z",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        z = play(p[1] * u + p[0], x[0], p[2])
        return z, z

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        return play(p[1] * u + p[0], y, p[2])
