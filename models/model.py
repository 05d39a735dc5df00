"""Interfaces of models with explicit state, of predictors and of inverses."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hystmpc.core.structs import Struct, constants, struct
from hystmpc.trials.brief import in_brief
from hystmpc.trials.types import Vec

from .contract.metadata import ModelMetadata, NoiseModel, Start
from .python_methods import PythonMethods
from .rest import RestRule

if TYPE_CHECKING:
    from .operators.operator import Operator
    from .scheduled import MeasuredInput

NO_INPUTS: Mapping[str, Vec] = MappingProxyType({})
NO_VALUES: Mapping[str, float] = MappingProxyType({})
_SETTLING_S = 2.0  # [s], many times the lag of any catheter drive


class Model(Protocol):
    """Interface of a tip-angle model with explicit state.

    The state `x` has `nx` entries and is batched over a leading axis: `x` (N, nx), `u` (N, 1), `y` (N, 1).
    """

    @property
    def nx(self) -> int:
        """Number of entries of the state."""
        ...

    @property
    def nu(self) -> int:
        """Number of commands: one."""
        ...

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        ...

    def initial(self, y: Vec) -> Vec:
        """State of a device at rest at the measured angle `y` (N, 1) [deg]."""
        ...

    def step(self, x: Vec, u: Vec) -> Vec:
        """State one sample later under command `u` (N, 1) [mm or bar]."""
        ...

    def output(self, x: Vec) -> Vec:
        """Tip angle (N, 1) [deg] of state `x`."""
        ...


class StepFunction(ABC):
    """Reference of an exported graph: one step with explicit state, in the layout of the ONNX contract."""

    state_size: int

    @abstractmethod
    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1)."""

    @abstractmethod
    def jacobian(self, state: Vec, u: float) -> Vec:
        """Exact active-branch derivative of (theta, next state) by (state, u) at one point, shape (1 + S, S + 1)."""


class LoadedModel(ABC):
    """Model ready to run behind the `Model` protocol, with the state x = [state, last theta] (N, S + 1)."""

    def __init__(self, metadata: ModelMetadata, start: Start) -> None:
        self.metadata: ModelMetadata = metadata
        self.state_size: int = metadata.state_size
        self._rule = metadata.rule(start)
        self._rest = RestRule(metadata, start)

    def __repr__(self) -> str:
        facts = self.metadata
        command, angle = facts.command_limits, facts.trained_angle
        ends = f"{command.lower:.4g} to {command.upper:.4g} {facts.command_unit}"
        seen = f"{angle.lower:.4g} to {angle.upper:.4g} {facts.angle_unit}"
        return in_brief(self, f"{facts.kind}: {ends}, {seen}, every {facts.dt_s:.4g} s")

    @property
    def nx(self) -> int:
        """Number of entries of x: state and last angle."""
        return self.state_size + 1

    @property
    def nu(self) -> int:
        """Number of commands: one."""
        return 1

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self.metadata.dt_s

    def initial(self, y: Vec) -> Vec:
        """State x (N, S + 1) of a device at rest at `y` (N, 1) [deg], by the file's rule, before the warm-up."""
        y = np.asarray(y, dtype=np.float64).reshape(-1, 1)
        return np.hstack([self._rule.state(y), y])

    @property
    def inputs(self) -> tuple[MeasuredInput, ...]:
        """Measured inputs on which the model depends; see `models.scheduled`."""
        chain = self._rest.chain if self.metadata.by_inputs else None
        return () if chain is None else chain.inputs

    @property
    def input_states(self) -> Mapping[str, tuple[int, ...]]:
        """Entries of the state that hold the present value of each input; writing it there is measuring it."""
        chain = self._rest.chain if self.metadata.by_inputs else None
        return {} if chain is None else chain.input_states

    def resting(self, commands: Vec, angles: Vec, inputs: Mapping[str, float] = NO_VALUES) -> Vec:
        """States (N, S) after constant commands (N,) with output angles (N,) [deg] and the warm-up; see `RestRule`.

        Args:
            inputs: constant values of the measured inputs; their references where left out.
        """
        commands, angles = (np.asarray(given, dtype=np.float64) for given in (commands, angles))
        states = self._rest.at_inputs(inputs).states(commands, angles)
        held = self._rest.hold_samples
        return self.run_on(states, np.tile(commands[:, None], held))[1] if held else states

    def at_rest(self, theta_deg: float, command: float, inputs: Mapping[str, float] = NO_VALUES) -> Vec:
        """State (S,) of a device at rest at an angle [deg] under a command; see `resting`."""
        return self.resting(np.array([command]), np.array([theta_deg]), inputs)[0]

    def run_on(self, states: Vec, commands: Vec, inputs: Mapping[str, Vec] = NO_INPUTS) -> tuple[Vec, Vec]:
        """Angles (N, T) [deg] over commands (N, T) from states (N, S), and the states after them.

        Args:
            inputs: measured inputs (T,); one that is left out keeps its value in the states.
        """
        theta, states = np.empty(commands.shape), np.array(states, dtype=np.float64)
        places = [(list(self.input_states[name]), np.asarray(z, dtype=np.float64)) for name, z in inputs.items()]
        for k in range(commands.shape[1]):
            for at, z in places:
                states[:, at] = z[k]
            angle, states = self.advance(states, commands[:, k : k + 1])
            theta[:, k] = angle[:, 0]
        return theta, np.asarray(states, dtype=np.float64)

    def to_control(self, name: str = "device") -> Any:
        """System of python-control in discrete time, with the exact step of this model.

            [x, theta]_{k+1} = [g(x_k, u_k), f(x_k, u_k)],   y_k = theta_k

        Input `command_UNIT`, output `angle_UNIT`; the states are those of `resting_x`. A chain with linear drives is an
        `InterconnectedSystem`: each linear operator is a `StateSpace` block of it, see its `syslist`.

        A play at its edge has one slope where the command goes on and another where it turns. `control.linearize` has
        to be given `params={"branch": 1}` where the command rises from the operating point, -1 where it falls; with
        the default 0 a numeric linearisation at an edge mixes both. Do not simulate with another value than 0: it moves
        the command by 1e-4 of its range.

        Args:
            name: of the system.
        """
        from .linear.systems import control_system

        return control_system(self, name, self.operators)

    @property
    def operators(self) -> tuple[Operator, ...]:
        """Operators in series that are the whole model; none of a network."""
        return ()

    def resting_x(self, theta_deg: float, command: float) -> Vec:
        """State x (S + 1,) of `to_control` of a device at rest at an angle [deg] under a command."""
        state = self.at_rest(theta_deg, command)
        return np.append(state, self.advance(state[None], np.array([[command]]))[0])

    def step(self, x: Vec, u: Vec) -> Vec:
        """State x (N, S + 1) one sample later under commands `u` (N, 1) [command unit]."""
        theta, state = self.advance(np.asarray(x)[:, :-1], u)
        return np.hstack([state, theta])

    def output(self, x: Vec) -> Vec:
        """Tip angles (N, 1) [deg]."""
        return np.asarray(x)[:, -1:]

    @abstractmethod
    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        """Angles (N, 1) [deg] and next states (N, S) from states (N, S) and commands (N, 1)."""

    @abstractmethod
    def casadi_function(self) -> Any:
        """The step as `casadi.Function`: state (S, 1), u (1, 1) -> theta (1, 1), next_state (S, 1)."""


class WithPart:
    """Base of what the engine knows by structs, which are made anew where it is copied."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("part", "_front")}


class Predictor(WithPart, ABC):
    """Fast roll-outs of one model from one state, for predictive control.

    The state is a flat vector (S,) in the model's layout, used by this object alone. Plans are commands [mm or bar],
    predictions tip angles [deg]; `theta[k]` is the angle one sample after the start of `plan[k]`.
    """

    dt: float
    command_range: tuple[float, float]  # trained range
    inputs: tuple[MeasuredInput, ...] = ()  # measured inputs on which it depends
    input_states: Mapping[str, tuple[int, ...]] = MappingProxyType({})  # entries of the state that hold each
    noise: NoiseModel | None = None  # None where the file has none
    model_sigma_deg: float = math.nan  # error without a sensor [deg]; not-a-number where unknown

    def _as(self, other: Predictor) -> None:
        """Copy sample time, range, noise and inputs from another predictor, whose state comes first."""
        self.dt, self.command_range = other.dt, other.command_range
        self.noise, self.model_sigma_deg = other.noise, other.model_sigma_deg
        self.inputs, self.input_states = other.inputs, other.input_states

    @property
    def state_size(self) -> int:
        """Number S of entries of the state."""
        return self.initial(0.0, self.command_range[0]).size

    @cached_property
    def part(self) -> Struct:
        """The predictor as the engine reads it, `hystmpc_predictor`; it calls the methods of one written in Python."""
        size = self.state_size
        outside = PythonMethods(self, size).predictor()
        return struct("hystmpc_predictor", kind=kind_of("WRITTEN"), states=size, outside=outside)

    @property
    def rest_part(self) -> Struct | None:
        """What `initial` does as the engine reads it, `hystmpc_rest_rule`; None of a predictor written in Python."""
        return None

    @abstractmethod
    def initial(self, y: float, u: float) -> Vec:
        """State (S,) of a device at angle `y` [deg] after a constant command `u`."""

    @abstractmethod
    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        """Angle [deg] and state one sample later; the given state is not changed."""

    @abstractmethod
    def rollout(self, state: Vec, plans: Vec) -> Vec:
        """Angles (N, H) [deg] of the plans (N, H) from `state`."""

    @abstractmethod
    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        """Angles (H,) along `plan` (H,) and their exact active-branch Jacobian (H, H), lower triangular.

        Entry [i, j] is d theta_i / d u_j [deg per command unit].
        """


class ModelPredictor(Predictor):
    """Predictor of one model file; the state is the model's."""

    def __init__(self, metadata: ModelMetadata, start: Start = "conditioned") -> None:
        self.dt = metadata.dt_s
        self.command_range = (metadata.trained_command.lower, metadata.trained_command.upper)
        self.noise, self.model_sigma_deg = metadata.noise, metadata.model_sigma_deg
        self._rest = RestRule(metadata, start)
        if metadata.by_inputs and (chain := self._rest.chain) is not None:
            self.inputs, self.input_states = chain.inputs, chain.input_states

    @property
    def rest_part(self) -> Struct | None:
        return self._rest.part

    def initial(self, y: float, u: float) -> Vec:
        state = self._rest.states(np.array([u]), np.array([y]))[0]
        for _ in range(self._rest.hold_samples):
            _, state = self.advance(state, u)
        return state


class InvertiblePredictor(ModelPredictor):
    """Predictor of a model whose angle does not fall with the command, with a fast search for the command."""

    @abstractmethod
    def command_for(self, state: Vec, theta: float, low: float, high: float, last: float) -> float:
        """Command in [low, high] whose next angle is `theta` [deg], exact to 1e-11; see `CompiledInverse`."""


class Inverse(WithPart, ABC):
    """Inverse of a model from its present memory: angle to command."""

    @cached_property
    def part(self) -> Struct:
        """The inverse as the engine reads it, `hystmpc_inverse`; it calls `command` of one written in Python."""
        return struct("hystmpc_inverse", kind=kind_of("ANSWERED"), outside=PythonMethods(self).inverse())

    @abstractmethod
    def command(self, state: Vec, theta: float, u_last: float) -> float:
        """Command [mm or bar] whose angle is nearest to `theta` [deg]; in a dead band the one nearest to `u_last`."""


def kind_of(name: str) -> int:
    """Number of a kind of predictor or inverse, as core/predictor.h has them."""
    return constants()[f"HYSTMPC_{name}"]


FitProgress = Callable[[int, float], None]
"""What an identification calls as it goes on: steps done, and the least error so far in the unit of the output."""


def static_gain(model: Predictor) -> float:
    """Static gain without dead bands and lags: difference of the angles at rest over the command range [deg/cmd]."""
    low, high = model.command_range
    samples = max(round(_SETTLING_S / model.dt), 1)
    plans = np.array([np.full(samples, low), np.full(samples, high)])
    ends = model.rollout(model.initial(0.0, low), plans)[:, -1]
    return abs(float(ends[1] - ends[0])) / (high - low)
