"""What a model is: one sample in, one sample out, all memory in the state that the caller holds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Model(Protocol):
    """A tip-angle model with explicit state (architecture, section 3).

    The state `x` has `nx` entries and is batched over a leading axis: `x` (N, nx), `u` (N, 1), `y` (N, 1).
    """

    @property
    def nx(self) -> int:
        """Entries of the state."""
        ...

    @property
    def nu(self) -> int:
        """Commands: one."""
        ...

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        ...

    def initial(self, y: Array) -> Array:
        """State of a device that rests at the measured angle `y` (N, 1) [deg]."""
        ...

    def step(self, x: Array, u: Array) -> Array:
        """State one sample later under command `u` (N, 1) [mm or bar]."""
        ...

    def output(self, x: Array) -> Array:
        """Tip angle (N, 1) [deg] of state `x`."""
        ...


class StepFunction(ABC):
    """One stateful step in the layout of the ONNX contract: the reference that an exported graph is held against."""

    state_size: int

    @abstractmethod
    def advance(self, state: Array, u: Array) -> tuple[Array, Array]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1)."""

    @abstractmethod
    def jacobian(self, state: Array, u: float) -> Array:
        """Exact active-branch derivative of (theta, next state) by (state, u) at one point, shape (1 + S, S + 1)."""


class Predictor(ABC):
    """Fast roll-outs of one model from one state: what a predictive controller asks for.

    The state is a flat vector (S,) in the model's own layout; only this object reads it. Plans are commands
    [mm or bar], predictions tip angles [deg]; `theta[k]` is the angle after `plan[k]` has acted for one sample.
    """

    dt: float
    command_range: tuple[float, float]  # the range the model was identified on

    @abstractmethod
    def initial(self, y: float, u: float) -> Array:
        """State (S,) of a device that shows angle `y` [deg] and has been held at command `u`."""

    @abstractmethod
    def advance(self, state: Array, u: float) -> tuple[float, Array]:
        """Angle [deg] and state one sample later; the given state is left as it is."""

    @abstractmethod
    def rollout(self, state: Array, plans: Array) -> Array:
        """Angles (N, H) [deg] of the plans (N, H) from `state`."""

    @abstractmethod
    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        """Angles (H,) along `plan` (H,) and their exact active-branch Jacobian (H, H), lower triangular.

        Entry [i, j] is d theta_i / d u_j [deg per command unit].
        """


class Inverse(ABC):
    """The inverse of a model from its present memory: angle in, command out."""

    @abstractmethod
    def command(self, state: Array, theta: float, u_last: float) -> float:
        """Command [mm or bar] that brings the predictor state `state` to angle `theta` [deg].

        Where a whole interval of commands does (the dead band of a play), the one nearest to `u_last`; where none
        does, the one that comes closest.
        """


FitProgress = Callable[[int, float], None]
"""What an identification calls as it goes on: steps done, and the least error so far in the unit of the output."""
