"""Chains of operators in the engine: free runs, derivatives, states at rest, roll-outs, one-step inverse.

Arrays in, arrays out; `chain.h` says what each function computes.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from .library import engine

Array = NDArray[np.float64]
Whole = NDArray[np.intc]

_local = threading.local()

_REGISTERS = 9  # place of that number in a table
_OF_REST, _OF_STAGE = 32, 64
_FAULTS = (
    "parts within the block",
    "counts from zero, or one, to a million",
    "states, parameters, kept values and constants of all stages in turn",
    "signals that are written once, before they are read",
    "as many rows and registers as are used",
    "operations of the list",
    "rows and registers that are there",
    "results apart from arguments",
    "slopes by what is there",
    "every state in one group",
    "a state at rest of the same operator",
)
"""What a block has to have, in the order of the faults in `check.h`."""


@dataclass(frozen=True, eq=False)
class StageProgram:
    """A step y = f(x, u, p, dt), x' = g(x, u, p, dt) as numbers, see `program.h`.

    Attributes:
        table, rest: whole numbers of the step, and of the state at rest; `rest` is empty where there is none.
        constants, rest_constants: numbers of the two, lifted out.
        states, inputs, parameters, outputs, kept: sizes.
        registers: room of phase `once`.
    """

    table: Whole
    rest: Whole
    constants: Array
    rest_constants: Array
    states: int
    inputs: int
    parameters: int
    outputs: int
    kept: int
    registers: int


@final
class ChainCode:
    """Chain of stages for the engine.

    Args:
        stages: in the order of the signal.
        wires: signals that each stage reads and those that it writes; signal 0 and the next ones are the inputs. In
            series where left out.
        shown: signals that are outputs; the last stage's where left out.
        scheduled: how many inputs, the last ones, are measured and not commanded.

    With several inputs, commands or outputs an array has an axis for them, which comes first, or behind that of the
    rows N where rows come first. One alone has no such axis.

    Raises:
        ValueError: if the numbers of a stage would lead the engine out of its memory.
    """

    def __init__(
        self,
        stages: Sequence[StageProgram],
        wires: Sequence[tuple[Sequence[int], Sequence[int]]] | None = None,
        shown: Sequence[int] | None = None,
        scheduled: int = 0,
    ) -> None:
        wires = [((k,), (k + 1,)) for k in range(len(stages))] if wires is None else wires
        shown = [len(stages)] if shown is None else shown
        written = {signal for _, outs in wires for signal in outs}
        signals = max((s for ins, outs in wires for s in (*ins, *outs)), default=0) + 1
        self.inputs, self.outputs, self.scheduled = signals - len(written), len(shown), scheduled
        self.states, self.parameters, self.kept = (
            sum(getattr(stage, name) for stage in stages) for name in ("states", "parameters", "kept")
        )
        self.stages = tuple(stages)
        self.code, self.constants = _block(stages, wires, shown, signals, self)
        self.functions: Any = engine()
        _check(self.functions.chain_check(self.code, self.code.size, self.constants.size))
        self._registers = max((int(stage.table[_REGISTERS]) for stage in stages), default=0)
        self._single = int(self.functions.chain_single_bytes(self.code))
        self._rest_room = {
            k: int(self.functions.chain_rest_room(self.code, k)) for k, s in enumerate(stages) if s.rest.size
        }
        self._known_bytes: dict[tuple[int, ...], int] = {}

    def require_one_axis(self) -> None:
        """Refuse a chain of several inputs or outputs.

        Raises:
            ValueError: for such a chain.
        """
        if (self.inputs, self.outputs) != (1, 1):
            raise ValueError(f"chain: got {self.inputs} inputs and {self.outputs} outputs, expected one of each")

    def prepare(self, parameters: Array, dt_s: float) -> Array:
        """Values (K, N) that parameters (P, N) and sample time [s] alone decide.

        Raises:
            ValueError: if there are more parameters, or fewer.
        """
        if parameters.shape[0] != self.parameters:
            raise ValueError(f"chain: got {parameters.shape[0]} parameters, expected {self.parameters}")
        kept = np.empty((self.kept, parameters.shape[1]))
        room = np.empty(self._registers)
        self.functions.chain_prepare(self.code, self.constants, parameters, parameters.shape[1], dt_s, kept, room)
        return kept

    def simulate(self, kept: Array, states: Array, commands: Array) -> Array:
        """Outputs (T, N) of N rows under all inputs (T, N); states (S, N) are overwritten by the last ones.

        Raises:
            ValueError: if there are more inputs, or fewer.
        """
        samples, rows = commands.shape[-2:]
        _expect("inputs", commands, (*_axis(self.inputs), samples, rows))
        outputs = np.empty((*_axis(self.outputs), samples, rows))
        stride = _strides(samples * rows, rows, 1)
        self._run(kept, rows, samples, commands, stride, states, _strides(rows, 1), 1, outputs, stride)
        return outputs

    def simulate_rows(self, kept: Array, states: Array, commands: Array) -> Array:
        """The same with rows first: commands and outputs (N, T), states (N, S)."""
        rows, samples = commands.shape
        outputs = np.empty((rows, samples))
        stride = _strides(0, 1, samples)
        self._run(kept, rows, samples, commands, stride, states, _strides(1, self.states), 1, outputs, stride)
        return outputs

    def roll_out(self, kept: Array, state: Array, plans: Array, known: Array | None = None) -> Array:
        """Outputs (N, H) of plans (N, H), all from one state (S,) and with the same scheduled inputs (H,).

        Raises:
            ValueError: if there are other commands or scheduled inputs.
        """
        rows, samples = plans.shape[0], plans.shape[-1]
        self._expect_plan(plans, known, rows)
        outputs = np.empty((rows, *_axis(self.outputs), samples))
        self.functions.chain_roll_out(
            self.code, kept, state, rows, samples, plans, known, outputs, _memory(self._bytes(rows, 0))
        )
        return outputs

    def _expect_plan(self, plans: Array, known: Array | None, *rows: int) -> None:
        samples = plans.shape[-1]
        _expect("plans", plans, (*rows, *_axis(self.inputs - self.scheduled), samples))
        if self.scheduled or known is not None:
            _expect("scheduled inputs", np.empty(0) if known is None else known, (*_axis(self.scheduled), samples))

    def _bytes(self, rows: int, directions: int) -> int:
        """Memory of a call; that of one row, and of as many as run abreast."""
        key = (rows > 1, directions)
        if key not in self._known_bytes:
            self._known_bytes[key] = max(
                self.functions.chain_bytes(self.code, n, directions) for n in ((1,) if rows < 2 else range(2, 17))
            )
        return self._known_bytes[key]

    def _run(self, kept: Array, rows: int, samples: int, u: Array, us: Whole, x: Array, xs: Whole, moves: int,
             y: Array, ys: Whole) -> None:  # fmt: skip
        memory = _memory(self._bytes(rows, 0))
        self.functions.chain_simulate(
            self.code, kept, kept.shape[1], rows, samples, u, us, None, x, xs, moves, y, ys, memory
        )

    def differentiate(
        self, kept: Array, first: Whole, u: Array, du: Array | None, seeds: Array, states: Array, slopes: Array
    ) -> tuple[Array, Array]:
        """Outputs (T,) and derivatives (T, D) of runs laid end to end; several outputs: (outputs, T), (outputs, T, D).

        Args:
            first: first sample of each run, and T (N + 1,).
            u, du: input (T,) or inputs (inputs, T), and derivative (T, D) or (inputs, T, D); None for zero.
            seeds: derivative of the parameters (P, D).
            states, slopes: before the first samples (S, N), and their derivatives (S, N, D).
        """
        directions, rows = seeds.shape[1], first.size - 1
        samples = u.shape[-1]
        y, dy = np.empty((self.outputs, samples)), np.empty((self.outputs, samples, directions))
        memory = _memory(self._bytes(rows, directions))
        self.functions.chain_differentiate(
            self.code, kept, rows, first, u, du, directions, seeds, states, slopes, y, dy, memory
        )
        return (y, dy) if self.outputs > 1 else (y[0], dy[0])

    def rest(
        self, stage: int, u: Array, du: Array, seen: Array, by_seen: Array, parameters: Array, seeds: Array, x: Array,
        m: Array
    ) -> None:  # fmt: skip
        """Fill x (S, N) and m (S, N, D), states of one stage at rest at input u and output `seen`, and derivatives."""
        room = np.empty(self._rest_room[stage])
        self.functions.chain_rest(
            self.code, self.constants, stage, u.size, u, du, seen, by_seen, parameters, parameters.shape[1],
            seeds.shape[1], seeds, x, m, room
        )  # fmt: skip

    def settle(
        self, kept: Array, core: int, u: Array, y: Array, parameters: Array, seeds: Array
    ) -> tuple[Array, Array]:
        """States at rest (S, N) of the whole chain and their derivatives (S, N, D), at inputs u and outputs y (N,).

        Args:
            core: stage whose angle is sought; every other one rests at the output of the one before it.
            parameters, seeds: (P,), and their derivative in each direction (P, D).

        Raises:
            ValueError: for a chain of several inputs or outputs.
        """
        self.require_one_axis()
        rows, directions = u.size, seeds.shape[1]
        x, m = np.empty((self.states, rows)), np.empty((self.states, rows, directions))
        key = (rows, directions, self.states)
        if key not in self._known_bytes:
            self._known_bytes[key] = int(self.functions.chain_settle_bytes(self.code, rows, directions))
        self.functions.chain_settle(
            self.code, self.constants, kept, core, rows, u, y, parameters, directions, seeds, x, m,
            _memory(self._known_bytes[key]),
        )  # fmt: skip
        return x, m

    def linearise(self, kept: Array, state: Array, plan: Array, known: Array | None = None) -> tuple[Array, Array]:
        """Outputs (H,) along one plan (H,), with scheduled inputs (H,), and their derivatives (H, H) by its commands.

        Several: outputs (ny, H), plan (nu, H), scheduled inputs (ns, H), derivatives (ny, H, nu, H).

        Raises:
            ValueError: if there are other commands or scheduled inputs.
        """
        size = plan.shape[-1]
        self._expect_plan(plan, known)
        y = np.empty((*_axis(self.outputs), size))
        dy = np.empty((*y.shape, *plan.shape))
        key = (size,)
        if key not in self._known_bytes:
            self._known_bytes[key] = self.functions.chain_linearise_bytes(self.code, size)
        memory = _memory(self._known_bytes[key])
        self.functions.chain_linearise(self.code, kept, state, plan, known, size, y, dy, memory)
        return y, dy

    def step(self, kept: Array, state: Array, u: float) -> tuple[float, Array]:
        """Output of one sample, and the next state (S,)."""
        following = np.array(state, dtype=np.float64)
        return float(self.functions.chain_step(self.code, kept, following, u, _memory(self._single))), following

    def command_for(self, kept: Array, state: Array, wanted: float, low: float, high: float, last: float) -> float:
        """Command in [low, high] whose next output is `wanted`."""
        memory = _memory(self._single)
        return float(self.functions.chain_command_for(self.code, kept, state, wanted, low, high, last, memory))

    def lead(self, kept: Array, state: Array, wanted: Array, last: float, reach: float) -> tuple[Array, Array]:
        """Inputs (H,) whose outputs come closest to `wanted` (H,), and these outputs; see `follow.h`."""
        inputs, outputs = np.empty((2, wanted.size))
        memory = _memory(self.functions.lead_drive_bytes(self.code, wanted.size))
        self.functions.lead_drive(self.code, kept, state, wanted, wanted.size, last, reach, inputs, outputs, memory)
        return inputs, outputs


@final
class PreparedChain:
    """A chain with its parameters and sample time; one input and one output.

    Args:
        code: of the chain.
        parameters: (P,).
        dt_s: sample time [s].

    Raises:
        ValueError: for a chain of several inputs or outputs, or of other parameters; by each method, if a state is of
            another size: the engine does not look where memory ends.
    """

    def __init__(self, code: ChainCode, parameters: Array, dt_s: float) -> None:
        code.require_one_axis()
        self.code = code
        self.kept = code.prepare(np.array(parameters, dtype=np.float64).reshape(-1, 1), dt_s)

    def step(self, state: Array, u: float) -> tuple[float, Array]:
        """Output of one sample, and the next state (S,)."""
        return self.code.step(self.kept, self._checked(state), u)

    def run(self, states: Array, commands: Array) -> tuple[Array, Array]:
        """Outputs (N, T) of N rows under commands (N, T) from states (N, S), and the last states."""
        following = np.array(states, dtype=np.float64, order="C")
        if following.shape != (len(commands), self.code.states):
            raise ValueError(f"states: got shape {following.shape}, expected ({len(commands)}, {self.code.states})")
        return self.code.simulate_rows(self.kept, following, _doubles(commands)), following

    def roll_out(self, state: Array, plans: Array) -> Array:
        """Outputs (N, H) of plans (N, H), all from one state (S,)."""
        return self.code.roll_out(self.kept, self._checked(state), _doubles(plans))

    def linearise(self, state: Array, plan: Array) -> tuple[Array, Array]:
        """Outputs (H,) along one plan (H,) and their derivatives (H, H) by its commands."""
        return self.code.linearise(self.kept, self._checked(state), _doubles(plan))

    def command_for(self, state: Array, wanted: float, low: float, high: float, last: float) -> float:
        """Command in [low, high] whose next output is `wanted`."""
        return self.code.command_for(self.kept, self._checked(state), wanted, low, high, last)

    def lead(self, state: Array, wanted: Array, last: float, reach: float) -> tuple[Array, Array]:
        """Inputs (H,) that lead a drive along `wanted` (H,), see `ChainCode.lead`."""
        return self.code.lead(self.kept, self._checked(state), _doubles(wanted), last, reach)

    def _checked(self, state: Array) -> Array:
        """State (S,) as the engine reads it."""
        if state.shape != (self.code.states,):
            raise ValueError(f"state: got shape {state.shape}, expected ({self.code.states},)")
        return _doubles(state)


def _doubles(array: Array) -> Array:
    return np.ascontiguousarray(array, dtype=np.float64)


def _block(
    stages: Sequence[StageProgram],
    wires: Sequence[tuple[Sequence[int], Sequence[int]]],
    shown: Sequence[int],
    signals: int,
    sizes: Any,
) -> tuple[Whole, Array]:
    """Whole numbers and constants of a chain, see `chain.h`."""
    head = [len(stages), sizes.states, sizes.parameters, sizes.kept, signals, sizes.inputs, len(shown)]
    head += [sizes.scheduled, *shown]
    at = len(head) + 9 * len(stages)
    places: list[int] = []
    tail: list[Any] = []
    constants: list[Array] = [np.empty(0)]
    x = p = k = c = 0
    for stage, (ins, outs) in zip(stages, wires, strict=True):
        tables = [np.array([*ins, *outs], dtype=np.intc), stage.table, stage.rest]
        wires_at, table_at = at, at + tables[0].size
        rest_at = table_at + stage.table.size if stage.rest.size else -1
        places += [table_at, rest_at, x, p, k, c, stage.constants.size, stage.rest_constants.size, wires_at]
        tail += tables
        at += sum(table.size for table in tables)
        x, p, k = x + stage.states, p + stage.parameters, k + stage.kept
        constants += [stage.constants, stage.rest_constants]
        c += stage.constants.size + stage.rest_constants.size
    code = np.concatenate([np.array([*head, *places]), *tail]).astype(np.intc)
    return code, np.concatenate(constants)


def _check(fault: int) -> None:
    if fault:
        kind, place = fault % _OF_REST, "at rest" if fault % _OF_STAGE >= _OF_REST else "step"
        raise ValueError(f"chain: got a stage {fault // _OF_STAGE} ({place}) without {_FAULTS[kind - 1]}")


def _axis(count: int) -> tuple[int, ...]:
    """Axis of so many signals; one signal has none."""
    return (count,) if count > 1 else ()


def _expect(name: str, array: Array, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(f"{name}: got shape {array.shape}, expected {shape}")


def _strides(*numbers: int) -> Whole:
    return np.array(numbers, dtype=np.intc)


def _memory(size: int) -> NDArray[np.uint8]:
    """Room of this thread for a call."""
    memory: NDArray[np.uint8] | None = getattr(_local, "memory", None)
    if memory is None or memory.size < size:
        memory = _local.memory = np.empty(max(int(size), 1 << 20), dtype=np.uint8)
    return memory
