"""Dynamics with memory from force to displacement: a mass on a hysteretic spring, and a neural state space."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self, final

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Number, Operator, Parameter, Symbol


@final
@dataclass(frozen=True)
class Oscillator(Operator):
    """Mass, damper and spring with a hysteretic force z behind them (Bouc-Wen, exponent 1).

    m y'' + c y' + k y + z = u,   z' = alpha y' - gamma |y'| z - delta y' |z|

    `gamma` and `delta` are beta gamma and beta delta of the literature: beta alone is not identifiable. With |delta| <=
    gamma, z is dissipative.

    Integrated by Runge-Kutta of fourth order in `steps` equal steps a sample. The input between two samples is the
    polynomial of order `hold` through the last `hold` + 1 of them: straight lines (1) take sinc^2(f dt) of a sine of
    frequency f, which at a twentieth of the sample rate is 0.8 %; a cubic (3) takes far less of a signal without steps.
    For a command in steps, as a controller sends it, 1 is the better choice.

    Attributes:
        hold: order of the interpolation of the input, 1 to 3.
        steps: steps of the integration a sample. At w dt / steps = 0.15, w the resonance, the error a sample is 1e-6.

    Source: Wen, J. Eng. Mech. Div. ASCE 102 (1976); Noel and Schoukens, Hysteretic benchmark with a dynamic
    nonlinearity (2016), eq. (1)-(2).
    """

    mass: Annotated[float, Number("cmd s^2/deg", 1e-12, 1e6, 1.0, "inertia")]
    damping: Annotated[float, Number("cmd s/deg", 0.0, 1e6, 0.0, "viscous damping")]
    stiffness: Annotated[float, Number("cmd/deg", 0.0, 1e6, 1.0, "stiffness of the spring without memory")]
    alpha: Annotated[float, Number("cmd/deg", 0.0, 1e6, 0.0, "stiffness of the hysteretic force at a reversal")]
    gamma: Annotated[float, Number("1/deg", -1e6, 1e6, 0.0, "relaxation of the hysteretic force along the path")]
    delta: Annotated[float, Number("1/deg", -1e6, 1e6, 0.0, "the same, less while the force is given back")]
    hold: int = 3
    steps: int = 2
    name: ClassVar[str] = "oscillator"
    shape: ClassVar[tuple[str, ...]] = ("hold", "steps")
    default_sizes: ClassVar[Mapping[str, int]] = {"hold": 3, "steps": 2}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"hold": (1, 3), "steps": (1, 16)}

    @property
    def states(self) -> tuple[str, ...]:
        return ("y", "v", "z", *(f"u{j}" for j in range(1, self.hold + 1)))

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        mass, damping, stiffness, alpha, gamma, delta = (p[k] for k in range(6))

        def rate(y: Symbol, force: Symbol) -> Symbol:
            v, z = y[1], y[2]
            push = force - damping * v - stiffness * y[0] - z
            return ca.vertcat(v, push / mass, alpha * v - gamma * ca.fabs(v) * z - delta * v * ca.fabs(z))

        differences = _backward_differences(u, x[3:], self.hold)
        y, h = x[:3], dt / self.steps
        for j in range(self.steps):
            first, middle, last = (_between(differences, (j + part) / self.steps - 1) for part in (0.0, 0.5, 1.0))
            k1 = rate(y, first)
            k2 = rate(y + h / 2 * k1, middle)
            k3 = rate(y + h / 2 * k2, middle)
            k4 = rate(y + h * k3, last)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return ca.vertcat(y, u, x[3 : 2 + self.hold]), y[0]

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        """State on the path from no load, z = alpha y, u = (k + alpha) y; the input at rest is unknown in files."""
        del u
        return ca.vertcat(y, 0, p[3] * y, ca.repmat((p[2] + p[3]) * y, self.hold, 1))


def _backward_differences(u: Symbol, past: Symbol, order: int) -> list[Symbol]:
    row, delayed = [u, *(past[j] for j in range(order))], [u]
    for _ in range(order):
        row = [a - b for a, b in itertools.pairwise(row)]
        delayed.append(row[0])
    return delayed


def _between(differences: list[Symbol], s: float) -> Symbol:
    """Polynomial through the last samples at s samples after the newest, -1 <= s <= 0."""
    value, weight = differences[0], 1.0
    for j, difference in enumerate(differences[1:]):
        weight *= (s + j) / (j + 1)
        value = value + weight * difference
    return value


@final
@dataclass(frozen=True)
class StateNetwork(Operator):
    """Neural state space: a linear system of n states with a nonlinear layer of H neurons.

    x_k = A x_{k-1} + B (u_k, u_{k-1}) + W tanh(V (x_{k-1}, u_k, u_{k-1}) + c),   y_k = first entry of x_k

    It has no model of masses or hysteresis: a black-box model of a device with resonances.

    Attributes:
        a, b: A (n, n) and B (n, 2), row by row.
        w: W (n, H), row by row.
        vx, vu: V of the states (H, n) and of the inputs (H, 2), row by row.
        c: biases (H,).
        order, hidden: n and H.

    Raises:
        ModelError: if the numbers of a matrix do not fit the sizes.

    Source: Suykens et al., Artificial Neural Networks for Modelling and Control of Non-Linear Systems (1996), ch. 2;
    Schoukens, Improved initialization of state-space artificial neural networks, ECC 2021.
    """

    a: tuple[float, ...]
    b: tuple[float, ...]
    w: tuple[float, ...]
    vx: tuple[float, ...]
    vu: tuple[float, ...]
    c: tuple[float, ...]
    order: int
    hidden: int
    name: ClassVar[str] = "state_network"
    shape: ClassVar[tuple[str, ...]] = ("order", "hidden")
    default_sizes: ClassVar[Mapping[str, int]] = {}
    size_limits: ClassVar[Mapping[str, tuple[int, int]]] = {"order": (1, 16), "hidden": (1, 100)}

    def check_sizes(self) -> None:
        for field, count in self._counts(self.order, self.hidden).items():
            if len(getattr(self, field)) != count:
                raise ModelError(f"state_network.{field}: {len(getattr(self, field))} numbers, expected {count}")

    @staticmethod
    def _counts(order: int, hidden: int) -> dict[str, int]:
        sizes = {"a": order * order, "b": 2 * order, "w": order * hidden}
        return sizes | {"vx": hidden * order, "vu": 2 * hidden, "c": hidden}

    @classmethod
    def template(cls, **structure: int) -> Self:
        order, hidden = structure["order"], structure["hidden"]
        zeros = {field: (0.0,) * count for field, count in cls._counts(order, hidden).items()}
        return cls(**zeros, order=order, hidden=hidden)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        meanings = {
            "a": ("1", "step of the linear system"),
            "b": ("deg/cmd", "its input"),
            "w": ("deg", "output of the neurons"),
            "vx": ("1/deg", "what a neuron sees of the states"),
            "vu": ("1/cmd", "what a neuron sees of the inputs"),
            "c": ("1", "bias of a neuron"),
        }
        return tuple(
            Parameter(f"{field}{k + 1}", meanings[field][0], -1e6, 1e6, meanings[field][1])
            for field, count in self._counts(self.order, self.hidden).items()
            for k in range(count)
        )

    @property
    def states(self) -> tuple[str, ...]:
        return (*(f"x{j + 1}" for j in range(self.order)), "u")

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del dt
        n, hidden = self.order, self.hidden
        ends, start = {}, 0
        for field, count in self._counts(n, hidden).items():
            ends[field], start = p[start : start + count], start + count
        rows = {"a": n, "b": n, "w": n, "vx": hidden, "vu": hidden}
        a, b, w, vx, vu = (ca.reshape(ends[f], ends[f].numel() // count, count).T for f, count in rows.items())
        state, inputs = x[:n], ca.vertcat(u, x[n])
        neurons = ca.tanh(ca.mtimes(vx, state) + ca.mtimes(vu, inputs) + ends["c"])
        following = ca.mtimes(a, state) + ca.mtimes(b, inputs) + ca.mtimes(w, neurons)
        return ca.vertcat(following, u), following[0]

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del p
        return ca.vertcat(y, ca.repmat(0 * u, self.order - 1, 1), u)

    @property
    def settling_samples(self) -> int:
        """Number of samples of constant command at the start: the state at rest has no closed form."""
        return _SETTLING

    @property
    def rest_samples(self) -> int:
        """Samples of constant input until rest, as many as `settling_samples`."""
        return _SETTLING


_SETTLING = 500
