"""Guarded controller: a control law inside an observer, a chain of fallback levels and hard limits, as one call."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from threading import local
from time import perf_counter
from types import MappingProxyType
from typing import Any, cast, final

import numpy as np

from hystmpc.core.library import HoldsAddresses, engine
from hystmpc.core.outside import faults, forget_faults, raised_last
from hystmpc.core.structs import Struct, constants, layout
from hystmpc.trials.brief import brief, in_brief
from hystmpc.trials.errors import ControllerError, HystmpcError, did_you_mean, shown
from hystmpc.trials.types import Index, Vec

from .answers import NO_SOLUTION, SOURCES, status_words
from .command import Command, CommandLimits, Timing, number_of, numbers_of
from .estimation.observer import ANGLE_BOUND_DEG, Bytes, Estimate, Observer, Places, read_estimate, usable_angle
from .law import Law, LawPart
from .linearised.program import IterativeSolution

_ROUNDING = 1e-6  # of a sample
_HEAD, _KNOWN, _COMMAND = layout("hystmpc_head"), layout("hystmpc_known"), layout("hystmpc_command")
_BEHIND_HEAD = -(-ctypes.sizeof(_HEAD) // 8) * 8
_NOT_AT_REST = constants()["HYSTMPC_NOT_AT_REST"]
_BEYOND = f"reference: not finite or beyond {ANGLE_BOUND_DEG:.0f} deg"
_DOUBLE = np.dtype(np.float64)
_STOPPED = "after repeated failures"
NO_INPUTS: Mapping[str, tuple[int, ...]] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class GuardedState:
    """Complete state of a controller, which serves as its snapshot.

    Attributes:
        memory: bytes of the engine without addresses (B,), never changed: see core/controller.h.
        places: of the estimate in them.
        law: memory of a law that is written in Python.
        cause: why the stop is latched.
        refusal: why the next step has no time for a plan; empty if it has.
    """

    memory: Bytes
    places: Places
    law: Any = None
    cause: str = _STOPPED
    refusal: str = ""
    __repr__ = brief

    @cached_property
    def head(self) -> Any:
        """Struct `hystmpc_head` of the memory, to be read."""
        return _HEAD.from_address(self.memory.ctypes.data)

    @cached_property
    def known(self) -> Any:
        """Struct `hystmpc_known` of the memory, to be read."""
        return _KNOWN.from_address(self.memory.ctypes.data + _BEHIND_HEAD)

    @property
    def stopped(self) -> bool:
        """Whether the stop is latched; only a new `init` releases it."""
        return bool(self.head.stopped)

    @property
    def due(self) -> float:
        """Reference angle at the present instant [deg]."""
        return float(self.head.due)

    @cached_property
    def estimate(self) -> Estimate:
        """What is known of the device."""
        return read_estimate(self.memory[_BEHIND_HEAD:], self.places)

    def __getstate__(self) -> Mapping[str, Any]:
        names = ("memory", "places", "law", "cause", "refusal")
        return {name: getattr(self, name) for name in names}  # a copy has addresses of its own


@final
class GuardedController(HoldsAddresses):
    """Controller around a control law: its step never raises, and its commands never leave the limits.

    Order of one step: correct the estimate with the measurement, check the reference, let the law propose, take the
    proposal or a fallback, limit from the command really sent, advance the model with the result. All of it is one
    call of the engine, see core/controller.h, which an exported controller and the control loop in C make too.

    Args:
        problem: struct `hystmpc_problem`, see `ctrl.problem`.
        limits: of every command.
        observer: of the problem.
        rest: state of the predictor (S,) at rest at an angle [deg] and a command; None without a model.
        law: of the problem, if it is written in Python.
        solution: of quadratic programs in Python, by OSQP.
        inputs: entries of the predictor's state that hold each measured input, by name.
    """

    def __init__(
        self,
        problem: Struct,
        limits: CommandLimits,
        observer: Observer,
        rest: Callable[[float, float], Vec] | None,
        law: LawPart | None = None,
        solution: IterativeSolution | None = None,
        inputs: Mapping[str, tuple[int, ...]] = NO_INPUTS,
    ) -> None:
        self.problem, self._limits, self._observer, self._rest = problem, limits, observer, rest
        self._outside, self._solution, self._inputs = law, solution, dict(inputs)
        self._address = problem.address
        self._engine = core = engine()
        self._bytes, self._room_bytes = int(core.memory_bytes(self._address)), int(core.room_bytes(self._address))
        self._horizon = int(core.reference_samples(self._address))
        self._planned = self._horizon - observer.delay_samples
        self._numbers = self._planned + max(self._planned, observer.delay_samples + 1)
        self._step = core.controller_step
        self._places = observer.places
        model = problem.fields.get("model")
        self._sent = 0 if model is None else self._places.angles
        self._states = 0 if model is None else int(core.model_states(model.address))
        self._unusable = np.full(self._horizon, np.nan)
        self._local = local()

    def __repr__(self) -> str:
        return in_brief(self, f"{self._limits}, every {self.dt:.4g} s")

    @property
    def limits(self) -> CommandLimits:
        """Hard limits of every command."""
        return self._limits

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the measured inputs on which the model depends."""
        return tuple(self._inputs)

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return float(self.problem.fields["dt_s"])

    @property
    def horizon(self) -> int:
        """Number of reference samples that `step` uses: those of the law and those that pass before a command acts."""
        return self._horizon

    def with_law(self, law: Law[Any]) -> GuardedController:
        """Return a controller with the same observer, fallbacks and limits around a law written in Python."""
        from .problem import outside_law

        part = LawPart(law, self._states)
        problem = Struct("hystmpc_problem", **{**self.problem.fields, "law": outside_law(part)})
        return GuardedController(problem, self._limits, self._observer, self._rest, part, inputs=self._inputs)

    def init(self, y: float, u: float) -> GuardedState:
        """Return the state at rest.

        Raises:
            ControllerError: if `y` or `u` is not finite, `u` is beyond the limits, or the model fails at rest.
        """
        low, high = self._limits.lower, self._limits.upper
        angle, held = usable_angle(y), number_of(u)
        if not (math.isfinite(angle) and held is not None and low <= held <= high):
            raise ControllerError(
                f"controller: got a start at {shown(y, 50)} deg with command {shown(u, 50)}, expected a finite angle "
                f"within {ANGLE_BOUND_DEG:.0f} deg and a command within {low} to {high}"
            )
        try:
            return self._begun(angle, held)
        except HystmpcError:
            raise
        except Exception as error:
            raise ControllerError(
                f"controller: the model fails at rest ({angle} deg, command {held}): {error}"
            ) from error

    def _begun(self, angle: float, held: float) -> GuardedState:
        memory = np.zeros(self._bytes, dtype=np.uint8)
        x = None if self._rest is None else np.ascontiguousarray(self._rest(angle, held), dtype=np.float64)
        forget_faults()
        answer = self._engine.controller_init(self._address, memory, x, angle, held, self._room)
        if error := raised_last():
            raise error
        if answer == _NOT_AT_REST:
            raise self._observer.not_at_rest(x, angle, held)
        law = None if self._outside is None else self._outside.law.init(angle, held)
        return GuardedState(memory, self._places, law)

    def replay(self, commands: Vec, angles: Vec) -> GuardedState:
        """Return the state after a recording, as if the controller itself had sent its commands.

        Args:
            commands: sent last (T,) [mm or bar], the newest at the end.
            angles: measured when each was sent (T,) [deg]; not-a-number where there was none. The device is assumed to
                rest at the first usable one, under the command sent before it, or then where it is the first.

        Raises:
            ControllerError: as `usable_in`, or if the model fails.
        """
        first = int(self.usable_in(commands, angles)[0])
        state = self.init(float(angles[first]), float(commands[max(first - 1, 0)]))
        memory, room = self._copied(state), self._room
        forget_faults()
        for y, u in zip(angles[first:].tolist(), commands[first:].tolist(), strict=True):
            if self._engine.controller_look_on(self._address, memory, y, u, room):
                raise ControllerError(f"replay: the model fails at command {u}: {' '.join(faults()) or 'not finite'}")
        law = None if self._outside is None else self._outside.law.init(state.due, float(commands[-1]))
        return replace(state, memory=memory, law=law)

    def usable_in(self, commands: Vec, angles: Vec) -> Index:
        """Return the samples of a recording whose angle is usable, at least one.

        Raises:
            ControllerError: if no angle is usable, the lengths differ, or a command is beyond the limits.
        """
        usable = np.flatnonzero([math.isfinite(usable_angle(y)) for y in angles])
        low, high = self._limits.lower, self._limits.upper
        if commands.shape != angles.shape or not usable.size or not np.all((commands >= low) & (commands <= high)):
            raise ControllerError(
                f"replay: got {commands.size} commands and {angles.size} angles, {usable.size} of them usable, "
                f"expected as many commands within {low} to {high} as angles, at least one of them usable"
            )
        return usable

    def to_control(self, name: str = "controller") -> Any:
        """System of python-control of a PID, with the engine's own step: limits, dead zone and anti-windup included.

        Inputs `reference_deg` at the end of the sample and `angle_deg`, output `command`; states `integral`, `speed`,
        `angle_deg`, `command`. At rest they are (command - lower limit, 0, angle, command). `angle_deg` is joined with
        the output of `LoadedModel.to_control` by its name in `control.interconnect`.

        Args:
            name: of the system.

        Raises:
            ControllerError: for any other law: it has no fixed form in so few numbers. `hystmpc analyse` has the linear
                law of a predictive controller around a resting plan.
        """
        from .linear.laws import engine_pid

        if self.problem.fields["law"].fields["kind"] != constants()["HYSTMPC_PID"]:
            raise ControllerError("to_control: got a law with a model or a plan, expected a pid, which is a fixed law")

        def step(x: Vec, u: Vec) -> tuple[float, Vec]:
            state = self.init(float(x[2]), self._limits.clip(float(x[3]), float(x[3]), self.dt))
            head = state.head
            head.integral, head.speed, head.age = float(x[0]), float(x[1]), 0.0
            command, after = self.step(state, float(u[1]), np.full(self._horizon, float(u[0])))
            return command.u, np.array([after.head.integral, after.head.speed, after.head.angle, command.u])

        return engine_pid(step, self.dt, name)

    def sigma_deg(self, state: GuardedState) -> float:
        """Standard deviation of the error of the estimated angle [deg]; not-a-number where it is not known."""
        return self._observer.sigma_deg(state.estimate)

    def sigma_ahead_deg(self, state: GuardedState, commands: Vec) -> Vec:
        """Standard deviation of the error of the angles predicted under the coming commands (H,) [deg]."""
        estimate = state.estimate
        travels = np.concatenate([estimate.moves[1:], np.abs(np.diff(commands, prepend=estimate.command))])
        return self._observer.sigma_ahead_deg(estimate, travels[: commands.size])

    def model_state(self, state: GuardedState) -> Vec:
        """State from which the predictor predicts, after every command sent so far."""
        x, numbers = np.empty(self._states), np.empty(16)
        self._engine.controller_look(self._address, self._copied(state), numbers, x, None, None, None, None)
        return x

    def measure(self, state: GuardedState, y: float, age: float) -> GuardedState:
        """Measurement update with `y` [deg], taken `age` samples before the next step.

        Raises:
            ControllerError: if the observer accepts no late measurements, or none of that age; or the model fails.
        """
        age = 0.0 if -_ROUNDING < age < 0.0 else age
        memory = self._copied(state)
        forget_faults()
        if not self._engine.controller_measure(self._address, memory, usable_angle(y), age):
            raise ControllerError("; ".join(faults()) or self._observer.refused(y, age))
        return replace(state, memory=memory)

    def with_inputs(self, state: GuardedState, inputs: Mapping[str, float]) -> GuardedState:
        """Return the state with the present values of measured inputs, which hold over the preview until the next ones.

        One that is not finite changes nothing.

        Raises:
            ControllerError: if the model does not depend on an input of that name.
        """
        memory = self._copied(state)
        for name, value in inputs.items():
            if name not in self._inputs:
                raise ControllerError(
                    f"controller: no input {shown(name, 40)}, {did_you_mean(str(name), self._inputs)}"
                )
            for entry in self._inputs[name]:
                self._engine.controller_input(self._address, memory, entry, value)
        return replace(state, memory=memory)

    def stop(self, state: GuardedState, cause: str) -> GuardedState:
        """Return the state with the stop latched: steps go to the safe command or hold, until a new `init`."""
        memory = self._copied(state)
        self._engine.controller_stop(self._address, memory)
        return replace(state, memory=memory, cause=cause)

    def holding(self, state: GuardedState, command: float) -> GuardedState:
        """Return the state in which the device holds `command` in place of the one sent last."""
        memory = self._copied(state)
        self._engine.controller_held(self._address, memory, command)
        return replace(state, memory=memory)

    def step(self, state: GuardedState, y: float, reference: Vec) -> tuple[Command, GuardedState]:
        """Compute the command of one sample, for any `y` and any `reference`; see `Controller.step`."""
        began = perf_counter()
        wanted, fault = usable_reference(reference, self._horizon, self._unusable)
        memory, numbers, answer = self._copied(state), np.empty(self._numbers), _COMMAND()
        if state.refusal:
            self._engine.controller_hurry(self._address, memory)
        forget_faults()
        if self._outside is not None:
            self._outside.begin(state.law)
        address, angle = ctypes.addressof(answer), number_of(y)
        unusual = self._step(
            self._address, memory, math.nan if angle is None else angle, wanted, address, numbers, self._room
        )
        after = GuardedState(memory, self._places, self._law_after(state, answer), state.cause)
        planned, begin, sent = answer.planned, self._planned, self._sent
        command = Command(
            u=answer.u,
            source=SOURCES[answer.source],
            status=self.status(state, after, answer, fault) if unusual else self._note,
            plan=numbers[:planned],
            predicted=numbers[begin : begin + (planned or sent if sent else 0)],
            disturbance=answer.departure_deg,
            timing=Timing({"step": perf_counter() - began}),
        )
        return command, after

    def _law_after(self, state: GuardedState, answer: Any) -> Any:
        """Next memory of a law written in Python; the old one where it failed."""
        if self._outside is None:
            return None
        proposal = self._outside.answer
        return state.law if proposal is None or answer.status else proposal.memory

    @property
    def _note(self) -> str:
        """What a law written in Python says of a sample in which nothing was unusual."""
        answer = None if self._outside is None else self._outside.answer
        return "ok" if answer is None else answer.status or "ok"

    @property
    def places(self) -> Places:
        """Places of the estimate in a state's memory."""
        return self._places

    def status(self, state: GuardedState, after: GuardedState, answer: Any, fault: str) -> str:
        """Status line of an answer of the engine, with the states before and after; `fault`: of the reference."""
        known, head = after.known, after.head
        level = head.level if answer.source == 1 else 0
        more = {
            "cause": state.cause,
            "reference": fault,
            "stalled": state.known.stalled,
            "refusal": state.refusal,
            "unfinished": "" if self._solution is None else f"{self._solution.words}, its best step used",
        }
        if self._solution is not None and answer.status == NO_SOLUTION:
            more["planner"] = self._solution.words
        return status_words(answer, level, known.forecast_error, known.stalled, faults(), more)

    def check_state(self, state: GuardedState) -> None:
        """Check the size of a state's memory: the engine does not look where memory ends.

        Raises:
            ControllerError: if it is of another controller, or cut off.
        """
        check_memory(state.memory, self._bytes)

    def _copied(self, state: GuardedState) -> Bytes:
        self.check_state(state)
        return state.memory.copy()

    @property
    def _room(self) -> Bytes:
        """Memory of this thread for one call."""
        room: Bytes | None = getattr(self._local, "room", None)
        if room is None:
            room = self._local.room = np.empty(self._room_bytes, dtype=np.uint8)
        return room


def usable_reference(reference: object, horizon: int, unusable: Vec) -> tuple[Vec, str]:
    """Return reference angles [deg] for the engine, `unusable` for too few; and what may be wrong with them."""
    plain = type(reference) is np.ndarray and reference.dtype is _DOUBLE
    wanted = cast(Vec, reference) if plain else numbers_of(reference)
    if wanted.ndim != 1 or wanted.shape[0] < horizon:
        return unusable, f"reference: got shape {wanted.shape}, expected ({horizon},)"
    return np.ascontiguousarray(wanted), _BEYOND


def check_memory(memory: Bytes, size: int) -> None:
    """Check the size of a state's memory in bytes: the engine does not look where memory ends.

    Raises:
        ControllerError: if it is of another controller, or cut off.
    """
    if memory.dtype != np.uint8 or memory.shape != (size,):
        raise ControllerError(
            f"state: got a memory of {memory.nbytes} bytes, expected {size}: it is cut off, or of another controller"
        )
