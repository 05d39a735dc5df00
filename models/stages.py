"""Operators as programs of the engine: the instructions of a CasADi expression in phases, and where its slopes are.

A step is y = f(x, u, p, dt), x' = g(x, u, p, dt). Its instructions are sorted by what they need, since most of them
need no loop over time:

    once     parameters and sample time alone
    ahead    the input: for all samples of a block together
    through  the state, and the next state needs them: one sample after the other
    behind   the state, but only the output needs them: all samples together
    slopes   derivatives by state and input, where they are not zero by structure: all samples together
    by parameters    derivatives by parameters, likewise: a controller needs none

`core/program.h` describes the numbers that a program consists of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from hystmpc.core.chain import ChainCode, PreparedChain, StageProgram

from .assignments import Assignments
from .operators.operator import Operator
from .program import BINARY, UNARY, dense
from .scheduled import Scheduled, inputs_of

CODES = {name: code for code, name in enumerate((*BINARY, *UNARY, "select"))}
"""Number of each operation; `core/program.c` has the same list."""

_STATE, _INPUT, _PARAMETER, _TIME = range(4)
"""Arguments of a step."""
_X, _U, _P = range(3)
"""What a slope is the derivative by."""
AHEAD, THROUGH, SLOPES = range(3)


@lru_cache(maxsize=1024)
def _in_series(stages: tuple[StageProgram, ...]) -> ChainCode:
    return ChainCode(stages)


@lru_cache(maxsize=256)
def _driven(stages: tuple[StageProgram, ...], reads: tuple[tuple[int, ...], ...], inputs: int) -> ChainCode:
    signals = [0, *range(1 + inputs, 1 + inputs + len(stages))]
    wires = [((signals[k], *more), (signals[k + 1],)) for k, more in enumerate(reads)]
    return ChainCode(stages, wires, [signals[-1]], scheduled=inputs)


def driven_code(operators: Sequence[Operator]) -> ChainCode:
    """The same with the measured inputs as signals behind the command, in the order of `inputs_of`.

    States and parameters are those of `chain_code`; the states of the inputs follow the signals.
    """
    names = [given.name for given in inputs_of(operators)]
    read = [tuple(i.name for i in o.inputs) if isinstance(o, Scheduled) else () for o in operators]
    stages = tuple(
        _of_structure(type(o), tuple(o.structure.items()), len(more)) for o, more in zip(operators, read, strict=True)
    )
    return _driven(stages, tuple(tuple(1 + names.index(name) for name in more) for more in read), len(names))


def chain_code(operators: Sequence[Operator]) -> ChainCode:
    """Operators in series for the engine, by their structure alone."""
    return _in_series(tuple(operator_program(operator) for operator in operators))


def prepared(operators: Sequence[Operator], dt_s: float) -> PreparedChain:
    """Operators in series with their parameters, at a sample time [s]."""
    values = [value for operator in operators for value in operator.values]
    return PreparedChain(chain_code(operators), np.array(values), dt_s)


def operator_program(operator: Operator) -> StageProgram:
    """Program of an operator's structure, made once."""
    return _of_structure(type(operator), tuple(operator.structure.items()))


@lru_cache(maxsize=1024)
def _of_structure(kind: type[Operator], structure: tuple[tuple[str, Any], ...], inputs: int = 0) -> StageProgram:
    operator = kind.template(**dict(structure))
    x, u = ca.SX.sym("x", len(operator.states)), ca.SX.sym("u", 1 + inputs)
    p, dt = ca.SX.sym("p", len(operator.parameters)), ca.SX.sym("dt")
    following, y = operator.equation(x, u, p, dt)
    seen = ca.SX.sym("seen")
    rest = None if inputs else (seen, operator.at_rest(u, seen, p))  # no input moves at rest
    return stage_program((x, u, p, dt), (y, following), rest)


@lru_cache(maxsize=256)
def _of_text(serialized: str) -> StageProgram:
    function = ca.Function.deserialize(serialized)
    arguments = [ca.SX.sym(f"a{k}", function.size_in(k)) for k in range(4)]
    y, following = function(*arguments)
    return stage_program(arguments, (y, following))


def function_program(function: Any) -> StageProgram:
    """Program of a CasADi SX function (x, u, p, dt) -> (y, x'), made once; it has no states at rest."""
    return _of_text(function.serialize())


def stage_program(arguments: Sequence[Any], step: Sequence[Any], rest: tuple[Any, Any] | None = None) -> StageProgram:
    """Make a program.

    Args:
        arguments: x (S, 1), u (N, 1), p (P, 1), dt: SX symbols.
        step: y (M, 1) and x' (S, 1) by them.
        rest: a symbol for the output that is seen, and the state at rest x (S, 1) by it, u and p; None without one.

    Raises:
        ModelError: if an operation is outside the closed list; names it.
    """
    x, u, p, dt = arguments
    y, following = (ca.densify(ca.SX(part)) for part in step)
    main = _phased([x, u, p, dt], y, following)
    resting = None
    if rest is not None:
        seen, at = rest
        resting = _phased([seen, u, p, dt], ca.densify(ca.SX(at)), ca.SX(0, 1))
    sizes = [x.numel(), u.numel(), p.numel(), y.numel()]
    table = main.table(sizes)
    at_rest = [] if resting is None else resting.table([1, u.numel(), p.numel(), x.numel()])
    return StageProgram(
        np.array(table, dtype=np.intc),
        np.array(at_rest, dtype=np.intc),
        np.array(main.constants, dtype=np.float64),
        np.array([] if resting is None else resting.constants, dtype=np.float64),
        states=sizes[0],
        inputs=sizes[1],
        parameters=sizes[2],
        outputs=sizes[3],
        kept=len(main.kept),
        registers=main.registers,
    )


@dataclass(frozen=True)
class _Term:
    """A slope: of next state `row` (or output `row`) by entry `j` of x, u or p; its value."""

    of_output: bool
    row: int
    by: int
    j: int
    value: int


def _phased(arguments: Sequence[Any], y: Any, following: Any) -> _Phases:
    x, u, p, _ = arguments
    places, values = [], []
    for of_output, expression in ((False, following), (True, y)):
        for by, symbols in ((_X, x), (_U, u), (_P, p)):
            jacobian = ca.jacobian(expression, symbols)
            for row, column in zip(*jacobian.sparsity().get_triplet(), strict=True):
                places.append((of_output, row, by, column))
                values.append(jacobian[row, column])
    stacked = ca.vertcat(*values) if values else ca.SX(0, 1)
    function = dense("step", list(arguments), ca.cse([y, following, stacked]))
    return _Phases(function, places)


@dataclass(frozen=True)
class _Single:
    """A step on registers: what the state alone decides, what the input decides, the rest of the next state.

    Attributes:
        code: instructions of the three.
        results: registers of the output's slope by the input (-1 for zero), of the outputs, of the next states.
        registers: their number: kept values, states, inputs, results.
    """

    code: tuple[list[list[int]], ...]
    results: list[int]
    registers: int


class _Phases:
    """Values of a step sorted by what they need."""

    def __init__(self, function: Any, places: Sequence[tuple[bool, int, int, int]]) -> None:
        self.values = Assignments(function)
        self.steps, self.read = self.values.steps, self.values.read
        self.outputs, self.following, slopes = self.values.results
        self.terms = [_Term(*place, value) for place, value in zip(places, slopes, strict=True)]
        self.known = self._known_states()
        by_state = self.values.needs(_STATE, unless=self.known)
        changes = zip(self.values.needs(_STATE), self.values.needs(_INPUT), strict=True)
        constant = [not a and not b for a, b in changes]
        plain = self.values.behind([*self.outputs, *self.following])
        wanted = self.values.behind([*self.outputs, *self.following, *slopes])
        next_state, count = self.values.behind(self.following), len(self.steps)
        inner = [v for v in range(count) if wanted[v] and self.steps[v].name not in ("input", "const")]
        self.once = [v for v in inner if constant[v]]
        self.ahead = self._in_order([v for v in inner if plain[v] and not constant[v] and not by_state[v]])
        self.through = [v for v in inner if plain[v] and by_state[v] and next_state[v]]
        self.behind = [v for v in inner if plain[v] and by_state[v] and not next_state[v]]
        by_signals = self.values.behind([t.value for t in self.terms if t.by != _P])
        self.slopes = [v for v in inner if not plain[v] and not constant[v] and by_signals[v]]
        self.by_parameters = [v for v in inner if not plain[v] and not constant[v] and not by_signals[v]]
        self.derived = [*self.slopes, *self.by_parameters]
        used = [a for v in (*self.ahead, *self.through, *self.behind, *self.derived) for a in self.read[v]]
        used += [*self.outputs, *self.following, *(t.value for t in self.terms)]
        self.kept = sorted({v for v in used if constant[v]})
        self.constants = [step.value for step in self.steps if step.name == "const"]

    def _known_states(self) -> list[int]:
        """States that are known ahead, since the next one needs the input and such states alone, as in a delay."""
        known: list[int] = []
        while True:
            needs = self.values.needs(_STATE, unless=known)
            more = [i for i, v in enumerate(self.following) if i not in known and not needs[v]]
            if not more:
                return known
            known += more

    def _in_order(self, ahead: Sequence[int]) -> list[int]:
        """Values of phase `ahead`, those first that known states need, so that a state is there before it is read."""
        order: list[int] = []
        for i in self.known:
            needed = self.values.behind([self.following[i]])
            order += [v for v in ahead if needed[v] and v not in order]
        return order + [v for v in ahead if v not in order]

    def table(self, sizes: Sequence[int]) -> list[int]:
        """The numbers of `core/program.h`; sizes: states, inputs, parameters, outputs."""
        rows = _Rows(self, sizes)
        once = self._once_code(sizes)
        phases = [rows.code(part) for part in (self.ahead, self.through, self.behind, self.slopes, self.by_parameters)]
        phases[0] = rows.with_early_moves(phases[0])
        phases[1] += rows.through_moves
        phases[2] += rows.late
        groups = self._groups(sizes[0])
        terms = sorted(self.terms, key=lambda t: (t.of_output, t.row, t.by, t.j))
        owner = [t.row + t.of_output * sizes[0] for t in terms]
        first = [sum(row < r for row in owner) for r in range(sizes[0] + sizes[3] + 1)]
        single = self._single(sizes)
        lists = [once, *phases, *single.code]
        head = [*sizes, len(self.kept), rows.count, len(terms), len(groups)]
        head += [self.registers, single.registers, *map(len, lists)]
        parts = [
            [self._register[v] for v in self.kept],
            [number for code in lists for one in code for number in one],
            [number for t in terms for number in (t.by, t.j, rows.of[t.value])],
            first,
            [number for group in groups for number in (len(group), *group)],
            single.results,
        ]
        return [len(head) + 1, *head, *(number for part in parts for number in part)]

    def _single(self, sizes: Sequence[int]) -> _Single:
        """The step for one command at a time, as an inverse needs it."""
        of = {v: k for k, v in enumerate(self.kept)}
        place = {_STATE: len(of), _INPUT: len(of) + sizes[0]}
        for v, step in enumerate(self.steps):
            if step.name == "input" and step.args[0] in place:
                of[v] = place[step.args[0]] + step.args[1]
        slope = next((t.value for t in self.terms if t.of_output and t.by == _U and t.row == 0), -1)
        shown = self.values.behind([*self.outputs, *([slope] if slope >= 0 else [])])
        all_needed, by_input = self.values.behind([*self.outputs, *self.following]), self.values.needs(_INPUT)
        by_state = self.values.needs(_STATE)
        moves = [
            v
            for v, step in enumerate(self.steps)
            if step.name not in ("input", "const") and (by_input[v] or by_state[v]) and (shown[v] or all_needed[v])
        ]
        fixed = [v for v in moves if shown[v] and not by_input[v]]
        moving = [v for v in moves if shown[v] and by_input[v]]
        rest = [v for v in moves if not shown[v]]
        count = len(self.kept) + sizes[0] + sizes[1]
        of |= {v: count + k for k, v in enumerate((*fixed, *moving, *rest))}
        code = tuple(
            [self._instruction(v, of[v], [of[a] for a in self.read[v]]) for v in part] for part in (fixed, moving, rest)
        )
        results = [of[v] for v in (*self.outputs, *self.following)]
        return _Single(code, [of[slope] if slope >= 0 else -1, *results], count + len(moves))

    def _once_code(self, sizes: Sequence[int]) -> list[list[int]]:
        """Instructions of phase `once` on registers: parameters, sample time, constants, then their results."""
        register: dict[int, int] = {}
        constants = 0
        for v, step in enumerate(self.steps):
            if step.name == "const":
                register[v] = sizes[2] + 1 + constants
                constants += 1
            elif step.name == "input" and step.args[0] in (_PARAMETER, _TIME):
                register[v] = step.args[1] if step.args[0] == _PARAMETER else sizes[2]
        free = sizes[2] + 1 + constants
        for k, v in enumerate(self.once):
            register[v] = free + k
        self.registers, self._register = free + len(self.once), register
        return [self._instruction(v, register[v], [register[a] for a in self.read[v]]) for v in self.once]

    def _instruction(self, v: int, out: int, read: Sequence[int]) -> list[int]:
        return [CODES[self.steps[v].name], out, *read, *[read[-1]] * (3 - len(read))]

    def _groups(self, size: int) -> list[list[int]]:
        """States in an order in which each group needs itself and earlier ones alone."""
        needs: dict[int, set[int]] = {i: set() for i in range(size)}
        for t in self.terms:
            if not t.of_output and t.by == _X and t.j < size:
                needs[t.row].add(t.j)
        return components(needs)


class _Rows:
    """Row of the block's table for every value: kept, states, next states, inputs, outputs, room that is reused."""

    def __init__(self, phases: _Phases, sizes: Sequence[int]) -> None:
        states, inputs, _, outputs = sizes
        kept = len(phases.kept)
        self.first_state = kept
        self.of: dict[int, int] = {v: k for k, v in enumerate(phases.kept)}
        self._phases = phases
        place = {_STATE: kept, _INPUT: kept + 2 * states}
        for v, step in enumerate(phases.steps):
            if step.name == "input" and step.args[0] in place:
                self.of[v] = place[step.args[0]] + step.args[1]
        following = [kept + states + i for i in range(len(phases.following))]
        shown = [kept + 2 * states + inputs + o for o in range(outputs)]
        self.early: dict[int, list[int]] = {}
        self.through_moves: list[list[int]] = []
        self.late: list[list[int]] = []
        through, ahead = set(phases.through), set(phases.ahead)
        for i, (v, row) in enumerate(zip(phases.following, following, strict=True)):
            move = [CODES["assign"], row, v, v, v]
            if v in self.of and i in phases.known:  # a copy of what has a row already
                self.early[i] = move
            elif v in self.of:
                self.through_moves.append(move)
            else:
                self.of[v] = row
        for v, row in zip(phases.outputs, shown, strict=True):
            if v in self.of:
                self.late.append([CODES["assign"], row, v, v, v])
            else:
                self.of[v] = row
        self.count = kept + 2 * states + inputs + outputs
        self._give_rooms(through, ahead)
        for move in (*self.early.values(), *self.through_moves, *self.late):
            move[2:] = [self.of[move[2]]] * 3

    def with_early_moves(self, code: list[list[int]]) -> list[list[int]]:
        """Phase `ahead` with copies into known states, each behind what it copies and before what reads the state."""
        p, result, done = self._phases, [], 0
        for i in p.known:
            needed = p.values.behind([p.following[i]])
            until = max((k + 1 for k, v in enumerate(p.ahead) if needed[v]), default=0)
            result += code[done:until]
            done = max(done, until)
            if i in self.early:
                result.append(self.early[i])
        return result + code[done:]

    def _give_rooms(self, through: set[int], ahead: set[int]) -> None:
        """Rooms for the other values, from the first instruction that writes to the last one that reads."""
        p = self._phases
        order = [*p.ahead, *p.through, *p.behind, *p.derived]
        last = self._last_reads(order, through, ahead)
        rooms: list[int] = []  # position after which each room is free
        for k, v in enumerate(order):
            if v in self.of:
                continue
            room = next((r for r, busy in enumerate(rooms) if busy < k), None)
            if room is None:
                rooms.append(0)
                room = len(rooms) - 1
            rooms[room] = last[v]
            self.of[v] = self.count + room
        self.count += len(rooms)

    def _last_reads(self, order: Sequence[int], through: set[int], ahead: set[int]) -> dict[int, int]:
        """Position after which nobody reads a value; what phase `through` reads, it reads again at the next sample."""
        p = self._phases
        ends = {AHEAD: len(p.ahead), THROUGH: len(p.ahead) + len(p.through), SLOPES: len(order)}
        last = {v: k for k, v in enumerate(order)}
        reads = [(a, k) for k, v in enumerate(order) for a in p.read[v]]
        reads += [(a, ends[THROUGH]) for v in through for a in p.read[v] if a in ahead]
        reads += [(move[2], ends[AHEAD]) for move in self.early.values()]
        reads += [(move[2], ends[THROUGH]) for move in self.through_moves]
        reads += [(move[2], ends[SLOPES]) for move in self.late] + [(t.value, ends[SLOPES]) for t in p.terms]
        for v, position in reads:
            if v in last:
                last[v] = max(last[v], position)
        return last

    def code(self, values: Sequence[int]) -> list[list[int]]:
        """Instructions that compute some values, by rows."""
        return [self._phases._instruction(v, self.of[v], [self.of[a] for a in self._phases.read[v]]) for v in values]


def components(needs: dict[int, set[int]]) -> list[list[int]]:
    """Strongly connected components of a graph, each behind those that it needs (Tarjan, SIAM J. Comput. 1 (1972))."""
    index: dict[int, int] = {}
    low: dict[int, int] = {}
    stack: list[int] = []
    result: list[list[int]] = []
    for start in needs:
        if start in index:
            continue
        work = [(start, iter(sorted(needs[start])))]
        index[start] = low[start] = len(index)
        stack.append(start)
        while work:
            node, rest = work[-1]
            for other in rest:
                if other not in index:
                    index[other] = low[other] = len(index)
                    stack.append(other)
                    work.append((other, iter(sorted(needs[other]))))
                    break
                if other in stack:
                    low[node] = min(low[node], index[other])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    at = stack.index(node)
                    result.append(sorted(stack[at:]))
                    del stack[at:]
    return result
