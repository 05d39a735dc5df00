"""Linear dynamics of an actuator, valve or sensor (lag, servo, delay, any other), and the rate limit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self, final

import casadi as ca
import numpy as np

from hystmpc.trials.errors import ModelError

from .operator import Number, Operator, Parameter, Symbol, maximum, minimum


@dataclass(frozen=True)
class Lag(Operator):
    """First-order lag, exact for an input in steps, or for one that runs straight between samples.

    tau y' + y = u  =>  y_k = u_k + exp(-dt / tau) (y_{k-1} - u_k)                                      hold 0
                        y_k = u_k - d_k + exp(-dt / tau) (y_{k-1} - u_{k-1} + d_k),
                              d_k = tau (u_k - u_{k-1}) / dt                                            hold 1

    Hold 0 applies the input of a sample from the previous sample on, half a sample early on average. That matters for
    distinguishing lag and delay at few samples a time constant.

    With a second constant tau is `tau_s` while the output rises (u_k >= y_{k-1}) and `tau_down_s` while it falls, as a
    valve fills and vents. At 1 us it is the identity, to the last bit from samples of 1 ms on.

    Attributes:
        tau_s: time constant, or that of a rise [s]; in files `tau_s`, with two of them `tau_up_s`.
        tau_down_s: time constant of a fall, if it differs [s].
        hold: order of the hold: 0 for an input in steps, 1 for one that runs straight between samples.

    Raises:
        ModelError: on more than one constant of a fall.

    Source: Franklin, Powell, Workman, Digital Control of Dynamic Systems (3rd ed., 1998), sections 4.3 and 6.3.
    """

    tau_s: float
    tau_down_s: tuple[float, ...] = ()
    hold: int = 0
    name: ClassVar[str] = "lag"
    shape: ClassVar[tuple[str, ...]] = ("ways", "hold")
    default_sizes: ClassVar[Mapping[str, int]] = {"ways": 1, "hold": 0}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"ways": (1, 2), "hold": (0, 1)}

    def check_sizes(self) -> None:
        if len(self.tau_down_s) > 1:
            raise ModelError(f"lag: {len(self.tau_down_s)} time constants of a fall, expected at most 1")

    @classmethod
    def template(cls, **structure: int) -> Self:
        return cls(1.0, (1.0,) * (structure.get("ways", 1) - 1), structure.get("hold", 0))

    @property
    def ways(self) -> int:
        """Number of time constants: one, or one for each direction."""
        return 1 + len(self.tau_down_s)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        if self.ways == 1:
            return (Parameter("tau_s", "s", 1e-6, 1e3, "time constant"),)
        ways = (("up", "rise"), ("down", "fall"))
        return tuple(Parameter(f"tau_{way}_s", "s", 1e-6, 1e3, f"time constant of a {motion}") for way, motion in ways)

    @property
    def states(self) -> tuple[str, ...]:
        return ("y", "u") if self.hold else ("y",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        tau = p[0] if self.ways == 1 else ca.if_else(u >= x[0], p[0], p[1])
        left = ca.exp(-dt / tau)
        if self.hold:
            behind = tau * (u - x[1]) / dt
            y = u - behind + left * (x[0] - x[1] + behind)
            return ca.vertcat(y, u), y
        y = u + left * (x[0] - u)
        return y, y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, u) if self.hold else u


@final
@dataclass(frozen=True)
class Servo(Operator):
    """Underdamped lag of second order, exact for an input in steps, or for one that runs straight between samples.

    y'' + 2 d w y' + w^2 y = w^2 u,  w = 2 d / tau

    with damping ratio d, so that it follows a ramp with delay tau as a lag of first order does. With the slope of the
    input a, which is 0 for steps (hold 0) and (u_k - u_{k-1}) / dt for straight lines (hold 1), the deviations e = y -
    (u_k - a dt - a tau) and g = v - a, and with s = d w, f = w sqrt(1 - d^2), c = cos(f dt), h = sin(f dt) / f,

        y_k = u_k - a tau + exp(-s dt) ((c + s h) e + h g),  v_k = a + exp(-s dt) (-w^2 h e + (c - s h) g)

    At 1 us it is the identity, except for a delay of 1 us.

    Attributes:
        hold: order of the hold, 0 for an input in steps.

    Source: Ogata, Modern Control Engineering (5th ed., 2010), section 5.3.
    """

    tau_s: Annotated[float, Number("s", 1e-6, 1e3, 1.0, "time by which it stays behind a ramp")]
    damping: Annotated[float, Number("1", 0.05, 0.999, 0.7, "ratio to the critical damping")]
    hold: int = 1
    name: ClassVar[str] = "servo"
    shape: ClassVar[tuple[str, ...]] = ("hold",)
    default_sizes: ClassVar[Mapping[str, int]] = {"hold": 1}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"hold": (0, 1)}
    state_names: ClassVar[tuple[str, ...]] = ("y", "v", "u")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        w = 2 * p[1] / p[0]
        s, f = p[1] * w, w * ca.sqrt(1 - p[1] * p[1])
        left, c, h = ca.exp(-s * dt), ca.cos(f * dt), ca.sin(f * dt) / f
        slope = (u - x[2]) / dt if self.hold else 0.0
        e, g = x[0] - (x[2] if self.hold else u) + slope * p[0], x[1] - slope
        y = u - slope * p[0] + left * ((c + s * h) * e + h * g)
        return ca.vertcat(y, slope + left * ((c - s * h) * g - w * w * h * e), u), y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u, 0, u)


@final
@dataclass(frozen=True)
class RateLimit(Operator):
    """Follower with a top speed; the identity for slower inputs, to the last bit.

    y_k = max(y_{k-1} - top_speed dt, min(y_{k-1} + top_speed dt, u_k))

    Source: Astrom and Murray, Feedback Systems (2nd ed., 2020), section 9.4, rate limiters.
    """

    top_speed: Annotated[float, Number("in/s", 0.0, 1e9, 1.0, "greatest change")]
    name: ClassVar[str] = "rate_limit"
    state_names: ClassVar[tuple[str, ...]] = ("y",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        y = maximum(x[0] - p[0] * dt, minimum(x[0] + p[0] * dt, u))
        return y, y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return u


@dataclass(frozen=True)
class Delay(Operator):
    """Transport delay of d seconds by linear interpolation between stored samples.

    y_k = sum_j h(d / dt - j) u_{k-j},  h(s) = max(0, 1 - |s|),  j = 0..n

    The output is differentiable by the delay, so that it can be identified.

    Attributes:
        delay_s: delay d [s], at most `samples` sample times.
        samples: length n of the store, fixed in a fit.

    Raises:
        ModelError: if the store is empty or the delay out of bounds.
    """

    delay_s: Annotated[float, Number("s", 0.0, 1e2, 0.0, "transport delay")]
    samples: int
    name: ClassVar[str] = "delay"
    shape: ClassVar[tuple[str, ...]] = ("samples",)

    def check_sizes(self) -> None:
        if self.samples < 1:
            raise ModelError(f"delay.samples is {self.samples}, expected at least 1")

    @classmethod
    def at_rate(cls, delay_s: float, dt: float) -> Self:
        """Delay with the shortest possible store at sample time `dt` [s]."""
        return cls(delay_s, max(1, math.ceil(delay_s / dt - 1e-9)))

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(f"u{j}" for j in range(1, self.samples + 1))

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        past: Symbol = ca.vertcat(u, x)
        steps = p[0] / dt
        y = sum(maximum(0.0, 1 - ca.fabs(steps - j)) * past[j] for j in range(self.samples + 1))
        return past[: self.samples], y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.repmat(u, self.samples, 1)

    def resampled(self, dt_s: float, was_s: float) -> Self:
        del was_s
        return self.at_rate(self.delay_s, dt_s)

    def holds(self, dt_s: float) -> bool:
        """Whether the store is long enough at sample time `dt_s` [s]: beyond it all weights vanish."""
        return self.samples >= self.at_rate(self.delay_s, dt_s).samples

    @property
    def settling_samples(self) -> int:
        return self.samples


@final
@dataclass(frozen=True)
class LinearDynamics(Operator):
    """Stable linear system of order n and static gain 1, given by its transfer function in z at one sample time.

    w_k = u_k - sum_i a_i w_{k-i},  y_k = sum_i b_i w_{k-i} + b_0 w_k,  i = 1..n

    y_k counts at the end of the sample in which u_k acts. Made from a system of python-control by `from_control`.

    Attributes:
        denominator: a_1..a_n of 1 + a_1 z^-1 + ...
        numerator: b_0..b_n; their sum is 1 + sum_i a_i.

    Raises:
        ModelError: on another number of coefficients, or another static gain; by `resampled`, where the system is none
            of an input in steps, as one with a pole at zero or on the negative axis.

    Source: Franklin, Powell, Workman, Digital Control of Dynamic Systems (3rd ed., 1998), section 4.2.
    """

    denominator: tuple[float, ...]
    numerator: tuple[float, ...]
    name: ClassVar[str] = "linear_dynamics"
    shape: ClassVar[tuple[str, ...]] = ("order",)
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"order": (1, 50)}

    def check_sizes(self) -> None:
        if len(self.numerator) != self.order + 1 or not self.order:
            raise ModelError(
                f"linear_dynamics: {len(self.numerator)} numbers of the numerator, {self.order} of the denominator, "
                "expected n + 1 and n, at least 1"
            )
        below, above = 1.0 + sum(self.denominator), sum(self.numerator)
        if not abs(above - below) <= _GAIN_ROUNDING * abs(below):
            raise ModelError(f"linear_dynamics: got a static gain of {above:.6g} / {below:.6g}, expected 1")

    @classmethod
    def template(cls, **structure: int) -> Self:
        order = structure["order"]
        return cls((0.0,) * order, (1.0,) + (0.0,) * order)

    @property
    def order(self) -> int:
        """Order n."""
        return len(self.denominator)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            *(Parameter(f"a{i}", "1", -1e6, 1e6, f"of z^-{i} below") for i in range(1, self.order + 1)),
            *(Parameter(f"b{i}", "1", -1e6, 1e6, f"of z^-{i} above") for i in range(self.order + 1)),
        )

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(f"w{i}" for i in range(1, self.order + 1))

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        n = self.order
        w = ca.vertcat(u - sum(p[i] * x[i] for i in range(n)), x)
        return w[:n], sum(p[n + i] * w[i] for i in range(n + 1))

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y
        return ca.repmat(u / (1 + sum(p[i] for i in range(self.order))), self.order, 1)

    def resampled(self, dt_s: float, was_s: float) -> LinearDynamics:
        """Operator converted from sample time `was_s` to `dt_s` [s], exact for an input in steps.

        Raises:
            ModelError: if a pole is zero or on the negative axis.
        """
        if dt_s == was_s:
            return self
        from scipy.linalg import expm, logm

        n = self.order
        step = np.zeros((n + 1, n + 1))  # of [w, u]
        step[0, :n], step[0, n], step[n, n] = -np.array(self.denominator), 1.0, 1.0
        step[1:n, : n - 1] = np.eye(n - 1)
        poles = np.linalg.eigvals(step[:n, :n])
        if np.any((np.abs(poles) < _NO_POLE) | ((np.abs(poles.imag) < _NO_POLE) & (poles.real < 0))):
            raise ModelError(
                f"linear_dynamics: got a pole at zero or on the negative axis, made for {was_s:.6g} s; at {dt_s:.6g} s "
                "no input in steps gives it"
            )
        b = np.array(self.numerator)
        behind = np.linalg.solve(step[:n, :n].T, b[1:] - b[0] * np.array(self.denominator))  # y by the next w
        rate: Any = logm(step)
        held = np.real(expm(rate * (dt_s / was_s)))
        a, by = held[:n, :n], held[:n, n]
        through, below = b[0] - behind @ step[:n, n] + behind @ by, np.poly(a)
        above = np.poly(a - np.outer(by, behind @ a)) + (through - 1.0) * below
        return LinearDynamics(tuple(below[1:].tolist()), tuple(above.tolist()))


_GAIN_ROUNDING, _NO_POLE = 1e-6, 1e-9


def stored(operators: Sequence[Operator], dt_s: float) -> tuple[Operator, ...]:
    """Operators whose delays have the shortest possible store at sample time `dt_s` [s]."""
    return tuple(operator.resampled(dt_s, dt_s) for operator in operators)
