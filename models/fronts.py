"""Predictors, inverses and followers whose arithmetic is the engine's: arrays in, arrays out, see core/model.h."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.core.outside import raised_last
from hystmpc.core.rooms import in_room
from hystmpc.core.structs import Struct, constants, struct
from hystmpc.trials.types import Vec

from .model import Inverse, Predictor, kind_of

if TYPE_CHECKING:
    from .scheduled import MeasuredInput


@final
class Front:
    """Functions of a model of the engine on arrays.

    What a part that is written in Python raises is raised here.

    Args:
        whole: `hystmpc_model`.

    Raises:
        ValueError: by each method, if the state is of another size.
    """

    def __init__(self, whole: Struct) -> None:
        self.whole, self.size = whole, int(engine().model_states(whole.address))
        self._sizes: dict[tuple[int, int], int] = {}

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        """Angle [deg] and state one sample later."""
        following, theta = np.array(self._checked(state)), np.empty(1)
        self._call(engine().model_advance, 1, 1, following, u, theta)
        return float(theta[0]), following

    def run(self, state: Vec, plans: Vec) -> Vec:
        """Angles (N, H) [deg] of plans (N, H)."""
        angles = np.empty(plans.shape)
        self._call(engine().model_run, *plans.shape, self._checked(state), *plans.shape, _doubles(plans), angles)
        return angles

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        """Angles (H,) [deg] along a plan (H,) and their derivatives (H, H)."""
        size = plan.size
        angles, slopes = np.empty(size), np.empty((size, size))
        self._call(engine().model_linearise, 1, size, self._checked(state), size, _doubles(plan), angles, slopes)
        return angles, slopes

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        """Command whose next angle is `theta` [deg]."""
        u = np.empty(1)
        self._call(engine().model_command, 1, 1, self._checked(state), theta, u_last, u)
        return float(u[0])

    def follow(self, state: Vec, wanted: Vec, u_last: float, bounds: Vec) -> Vec:
        """Commands (2, H) along the angles `wanted` (H,) [deg]."""
        plans, given = np.empty((2, wanted.size)), _doubles(wanted)
        state = self._checked(state)
        self._call(engine().model_follow, 1, wanted.size, state, given, wanted.size, u_last, bounds, plans)
        return plans

    def _call(self, function: Any, rows: int, samples: int, *given: Any) -> None:
        size = self._sizes.get((rows, samples))
        if size is None:
            size = self._sizes[rows, samples] = engine().model_bytes(self.whole.address, rows, samples)
        if in_room(size, function, self.whole.address, *given):
            raise raised_last() or RuntimeError("the engine's model fails without an exception of Python")

    def _checked(self, state: Vec) -> Vec:
        """The engine does not look where memory ends."""
        if state.shape != (self.size,):
            raise ValueError(f"state: got shape {state.shape}, expected ({self.size},)")
        return _doubles(state)


def _doubles(array: Vec) -> Vec:
    return np.ascontiguousarray(array, dtype=np.float64)


class EnginePredictor(Predictor):
    """Base of predictors whose functions are the engine's, by their `part`."""

    @cached_property
    def _front(self) -> Front:
        return Front(self.whole)

    @property
    def whole(self) -> Struct:
        """`hystmpc_model` of this predictor."""
        return struct("hystmpc_model", predictor=self.part)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        return self._front.advance(state, u)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._front.run(state, plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        return self._front.linearise(state, plan)


def pair_part(kind: str, first: Predictor, second: Predictor, size: int) -> Struct:
    """Two predictors as one `hystmpc_predictor`, with so many entries of its state."""
    return struct("hystmpc_predictor", kind=kind_of(kind), states=size, first=first.part, second=second.part)


def pair_inputs(
    first: Predictor, second: Predictor, between: int = 0
) -> tuple[tuple[MeasuredInput, ...], dict[str, tuple[int, ...]]]:
    """Inputs of two predictors, and their entries in [state of the first, `between` numbers, state of the second]."""
    places = {name: list(entries) for name, entries in first.input_states.items()}
    for name, entries in second.input_states.items():
        places.setdefault(name, []).extend(first.state_size + between + k for k in entries)
    known = {given.name: given for given in (*second.inputs, *first.inputs)}
    return tuple(known.values()), {name: tuple(entries) for name, entries in places.items()}


def pair_rest(first: Predictor, second: Predictor) -> Struct:
    """States at rest of two predictors as one `hystmpc_rest_rule`."""
    rests = {"first": first.rest_part, "second": second.rest_part}
    return struct("hystmpc_rest_rule", kind=constants()["HYSTMPC_RESTS"], **rests)


class EngineInverse(Inverse):
    """Base of inverses whose function is the engine's, by their `part`.

    Attributes:
        predictor: what the inverse reads beside the state.
    """

    predictor: Predictor

    @property
    @abstractmethod
    def state_size(self) -> int:
        """Number S of entries of the state."""

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        size, u = self.state_size, np.empty(1)
        if state.shape != (size,):
            raise ValueError(f"state: got shape {state.shape}, expected ({size},)")
        given = self.part.address, _doubles(state), size, theta, u_last, u
        if in_room(self._room, engine().inverse_command, *given):
            raise raised_last() or RuntimeError("the engine's inverse fails without an exception of Python")
        return float(u[0])

    @cached_property
    def _room(self) -> int:
        return int(engine().inverse_bytes(self.part.address, self.predictor.part.address, 1))
