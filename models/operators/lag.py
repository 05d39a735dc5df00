"""First-order lag of an actuator, valve or sensor, with one time constant or with one for each direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import casadi as ca

from hystmpc.trials.errors import ModelError

from .operator import Operator, Parameter, Symbol, check_values


@dataclass(frozen=True)
class Lag(Operator):
    """First-order lag, exact for an input in steps, or for one that runs straight between samples.

    tau y' + y = u  =>  y_k = u_k + exp(-dt / tau) (y_{k-1} - u_k)                                      hold 0
                        y_k = u_k - d_k + exp(-dt / tau) (y_{k-1} - u_{k-1} + d_k),
                              d_k = tau (u_k - u_{k-1}) / dt                                            hold 1

    The first takes the input of a sample to be there from the sample before on, half a sample early on average: a
    little delay undoes that, which matters where lag and delay are to be told apart at few samples a time constant.

    With a second constant tau is `tau_s` while the output rises (u_k >= y_{k-1}) and `tau_down_s` while it falls, as
    a valve fills and vents. At 1 us it is the identity, to the last bit from samples of 1 ms on.

    Attributes:
        tau_s: time constant, or that of a rise [s]; in files `tau_s`, with two of them `tau_up_s`.
        tau_down_s: time constant of a fall, if it has its own [s].
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "tau_down_s", tuple(float(v) for v in self.tau_down_s))
        if len(self.tau_down_s) > 1:
            raise ModelError(f"lag: {len(self.tau_down_s)} time constants of a fall, expected at most 1")
        check_values(self)

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
