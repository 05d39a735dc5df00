"""Compiled kernels of chains: one step with its tangent for a controller, free runs with sensitivities for a fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from typing import Any, final

import casadi as ca
import numpy as np

from hystmpc.trials.types import Vec

from ..operators.operator import Operator
from .numba_ import generated_module
from .program import SCALAR, Instruction, dense, instructions, scalar_program

_INLINED = '@njit(cache=True, error_model="numpy", inline="never")\n'


@dataclass(frozen=True)
class ChainKernels:
    """Compiled functions of one step (x, u, p, dt) -> (theta, following); see `chain_loops` for their arguments.

    Attributes:
        constants: numbers of the expressions, for the last arguments.
    """

    simulate: Callable[..., None]
    rollout: Callable[..., None]
    linearise: Callable[..., None]
    command_for: Callable[..., float]
    state_size: int
    step_constants: Vec
    tangent_constants: Vec
    slope_constants: Vec


def compile_step(function: Any) -> ChainKernels:
    """Compile a dense CasADi function (state, u, p, dt) -> (theta, next state).

    Kernels are cached by the expression's structure: models that differ in numbers only share them.
    """
    return _compile(function.serialize())


@lru_cache(maxsize=64)
def _compile(serialized: str) -> ChainKernels:
    function = ca.Function.deserialize(serialized)
    size, count = function.numel_in(0), function.numel_in(2)
    x, u = ca.SX.sym("x", size), ca.SX.sym("u")
    p, dt = ca.SX.sym("p", count), ca.SX.sym("dt")
    theta, following = function(x, u, p, dt)
    by = ca.jacobian
    arguments = [x, u, p, dt]
    step = scalar_program(dense("step", arguments, [theta, following]), "step", _TEMPLATES)
    tangent = scalar_program(
        dense("tangent", arguments, [theta, following, by(following, x), by(following, u), by(theta, x), by(theta, u)]),
        "tangent",
        _TEMPLATES,
    )
    slope = scalar_program(dense("slope", arguments, [theta, by(theta, u)]), "slope", _TEMPLATES)
    generated = "".join(_INLINED + program.source + "\n\n" for program in (step, tangent, slope))
    loops = resources.files("hystmpc.models.kernels").joinpath("chain_loops.py").read_text(encoding="utf-8")
    module = generated_module(_HEADER + "\n\n" + generated + loops)
    return ChainKernels(
        module.simulate,
        module.rollout,
        module.linearise,
        module.command_for,
        size,
        np.array(step.constants),
        np.array(tangent.constants),
        np.array(slope.constants),
    )


DIRECTIONS = 264
"""Greatest number of directions of one call; no power of two, so that rows of that length share no place in a cache."""

_STATE, _INPUT = 0, 1  # arguments of an operator's function that change from sample to sample
_ARGUMENTS = ("x", "u", "p", "dt")
_NOGIL = '@njit(cache=True, error_model="numpy", nogil=True)'

# Choices as calls, which LLVM inlines: numba's compile time grows with the square of a function's branches.
_CHOICES = {
    "lt": "1.0 if a < b else 0.0",
    "le": "1.0 if a <= b else 0.0",
    "eq": "1.0 if a == b else 0.0",
    "ne": "1.0 if a != b else 0.0",
    "or": "1.0 if a + b > 0.0 else 0.0",
    "if_else_zero": "b if a != 0.0 else 0.0",
    "fmin": "a if a <= b else b",
    "fmax": "a if a >= b else b",
    "sign": "(1.0 if a > b else 0.0) - (1.0 if a < b else 0.0)",
}
_TEMPLATES = {**SCALAR, **{name: f"choose_{name}({{0}}, {{1}})" for name in _CHOICES}, "sign": "choose_sign({0}, 0.0)"}
_HEADER = "import math\n" + "".join(
    f"\n\n{_INLINED}\ndef choose_{name}(a, b):\n    return {value}\n" for name, value in _CHOICES.items()
)


@final
@dataclass(frozen=True, eq=False)
class StageKernels:
    """What is compiled for an operator with S states and P parameters, for N rows of T samples, time first.

    Attributes:
        prepare: (p (P, N), dt, k, c) fills c, everything that does not change from sample to sample, for `simulate`.
        simulate: (x (S, N), u (T, N), c, y (T, N)) runs all rows; x is updated.
        prepare_slopes, differentiate: the same for runs laid end to end, with derivatives in D <= `DIRECTIONS`
            directions: (x (S, N), m (S, N, D), y (T,), dy (T, D), s (P, D), c, first (N + 1,), w). Run n has samples
            first[n] to first[n + 1]; y and dy hold the input and receive the output; s is the derivative of the
            operator's own parameters; w is room for (S + P) `DIRECTIONS` numbers.
        rest: (u (N,), du (N, D), seen (N,), dseen (N, D), p (P, N) or (P, 1), k, s (P, D), x (S, N), m (S, N, D))
            fills x and m, the states at rest at input u and output seen, and their derivatives.
        constants: arguments k of `prepare`, `prepare_slopes` and `rest`.
        kept: rows of c for `simulate` and `differentiate`.
    """

    prepare: Callable[..., None]
    simulate: Callable[..., None]
    prepare_slopes: Callable[..., None]
    differentiate: Callable[..., None]
    rest: Callable[..., None]
    constants: tuple[Vec, Vec, Vec]
    kept: tuple[int, int]


def stage_kernels(operator: Operator) -> StageKernels:
    """Kernels of an operator's structure; compiled at their first call, kept on disk."""
    return _compile_stages(type(operator), tuple(operator.structure.items()))


@lru_cache(maxsize=256)
def _compile_stages(kind: type[Operator], structure: tuple[tuple[str, Any], ...]) -> StageKernels:
    operator = kind.template(**dict(structure))
    x, u = ca.SX.sym("x", len(operator.states)), ca.SX.sym("u")
    p, dt = ca.SX.sym("p", len(operator.parameters)), ca.SX.sym("dt")
    following, y = (ca.densify(ca.SX(part)) for part in operator.equation(x, u, p, dt))
    plain = _split(dense("step", [x, u, p, dt], [y, following]))
    slopes = _Slopes.of(following, y, x, u, p)
    exact = _split(dense("slopes", [x, u, p, dt], ca.cse([y, following, slopes.values])))
    seen = ca.SX.sym("seen")
    rest = ca.densify(ca.SX(operator.at_rest(u, seen, p)))
    rest_slopes = _Slopes.of(rest, ca.SX(0, 1), seen, u, p)
    at_rest = _split(dense("rest", [seen, u, p, dt], [seen, rest, rest_slopes.values]))
    functions = (
        _HEADER,
        _prepare("prepare", plain),
        _prepare("prepare_slopes", exact),
        _simulate(plain, x.numel()),
        _differentiate(exact, slopes, x.numel()),
        _rest(at_rest, rest_slopes, x.numel()),
    )
    module = generated_module("\n\n".join(functions))
    plain_k, exact_k, rest_k = (np.array(s.constants, dtype=np.float64) for s in (plain, exact, at_rest))
    return StageKernels(
        module.prepare,
        module.simulate,
        module.prepare_slopes,
        module.differentiate,
        module.rest,
        (plain_k, exact_k, rest_k),
        (len(plain.kept), len(exact.kept)),
    )


@dataclass
class _Split:
    """A straight-line program cut in two.

    Attributes:
        once: statements that need parameters and sample time alone.
        always: statements of every sample.
        constants: numbers of the expression, lifted out so that models that differ in numbers share a kernel.
        kept: values of `once` that `always` reads, by name.
        parameters: those that are read.
        outputs: name of the value of each (output, element).
    """

    once: list[str] = field(default_factory=list)
    always: list[str] = field(default_factory=list)
    constants: list[float] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    parameters: list[int] = field(default_factory=list)
    outputs: dict[tuple[int, int], str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Slopes:
    """Where the derivatives of one step are not zero by structure.

    Attributes:
        values: their expressions, stacked.
        state: (state, what, position in `values`) with what = ("x", j), ("u", 0) or ("p", j).
        output: (what, position) of the output's.
    """

    values: Any
    state: tuple[tuple[int, tuple[str, int], int], ...]
    output: tuple[tuple[tuple[str, int], int], ...]

    @classmethod
    def of(cls, following: Any, y: Any, x: Any, u: Any, p: Any) -> _Slopes:
        values: list[Any] = []
        state: list[tuple[int, tuple[str, int], int]] = []
        output: list[tuple[tuple[str, int], int]] = []
        for name, by in (("x", x), ("u", u), ("p", p)):
            for row, column, value in _nonzeros(ca.jacobian(following, by)):
                state.append((row, (name, column), len(values)))
                values.append(value)
            for _, column, value in _nonzeros(ca.jacobian(y, by)):
                output.append(((name, column), len(values)))
                values.append(value)
        return cls(ca.vertcat(*values) if values else ca.SX(0, 1), tuple(state), tuple(output))

    @property
    def own(self) -> list[int]:
        """Parameters by which anything has a derivative."""
        terms = [*self.output, *((what, k) for _, what, k in self.state)]
        return sorted({j for (what, j), _ in terms if what == "p"})

    def of_state(self, i: int) -> list[tuple[tuple[str, int], int]]:
        """(what, position) of one state's."""
        return [(what, k) for row, what, k in self.state if row == i]


def _nonzeros(matrix: Any) -> list[tuple[int, int, Any]]:
    rows, columns = matrix.sparsity().get_triplet()
    return [(r, c, matrix[r, c]) for r, c in zip(rows, columns, strict=True)]


def _split(function: Any) -> _Split:
    """Cut a function (x, u, p, dt) in two; work registers become single assignments."""
    split, where, varying = _Split(), dict[int, str](), set[str]()
    for count, step in enumerate(instructions(function)):
        if step.name == "output":
            split.outputs[(step.out[0], step.out[1])] = where[step.args[0]]
            continue
        name = f"v{count}"
        if step.name not in ("input", "const"):
            changes = any(where[a] in varying for a in step.args)
        else:
            changes = step.name == "input" and step.args[0] in (_STATE, _INPUT)
        statement = f"{name} = {_expression(step, where, split)}"
        if changes:
            varying.add(name)
            _keep(split, [where[a] for a in step.args] if step.name != "input" else [], varying)
            split.always.append(statement)
        else:
            split.once.append(statement)
        where[step.out[0]] = name
    _keep(split, list(split.outputs.values()), varying)
    return split


def _keep(split: _Split, names: Sequence[str], varying: set[str]) -> None:
    for name in names:
        if name not in varying and name not in split.kept:
            split.kept.append(name)


def _expression(step: Instruction, where: dict[int, str], split: _Split) -> str:
    if step.name == "input":
        if _ARGUMENTS[step.args[0]] == "p":
            split.parameters.append(step.args[1])
        return f"{_ARGUMENTS[step.args[0]]}{step.args[1]}"
    if step.name == "const":
        split.constants.append(step.value)
        return f"k[{len(split.constants) - 1}]"
    return _TEMPLATES[step.name].format(*(where[a] for a in step.args))


def _prepare(name: str, split: _Split) -> str:
    """`prepare(p, dt, k, c)`: rows of c (C, N) from p (P, N)."""
    reads = ["dt0 = dt", *(f"p{j} = p[{j}, n]" for j in sorted(set(split.parameters)))]
    writes = [f"c[{i}, n] = {value}" for i, value in enumerate(split.kept)]
    return _function(f"{name}(p, dt, k, c)", ["for n in range(p.shape[1]):", *_deeper(reads + split.once + writes)])


def _simulate(split: _Split, size: int) -> str:
    """`simulate(x, u, c, y)`: x (S, N) is updated, u (T, N), y (T, N)."""
    reads = [f"x{i} = x[{i}, n]" for i in range(size)] + ["u0 = u[t, n]"]
    reads += [f"{value} = c[{i}, n]" for i, value in enumerate(split.kept)]
    writes = [f"y[t, n] = {split.outputs[0, 0]}"] + [f"x[{i}, n] = {split.outputs[1, i]}" for i in range(size)]
    loop = ["for t in range(u.shape[0]):", *_deeper(["for n in range(u.shape[1]):"])]
    return _function("simulate(x, u, c, y)", [*loop, *_deeper(_deeper(reads + split.always + writes))])


def _differentiate(split: _Split, slopes: _Slopes, size: int) -> str:
    """`differentiate(x, m, y, dy, s, c, first, w)`: runs laid end to end, see `StageKernels`.

    What is read and written in all directions stands in rows of w, whose distance is a number that the compiler knows:
    of arrays it could not tell whether they overlap, and would take one direction after the other.
    """
    own = slopes.own
    row = {f"m{i}": i for i in range(size)} | {f"s{j}": size + k for k, j in enumerate(own)}
    held = {name: f"w[{DIRECTIONS * k} + q]" for name, k in row.items()}
    kept = [f"{value} = c[{i}, 0]" for i, value in enumerate(split.kept)]
    taken = [f"{held[f'm{i}']} = m[{i}, n, q]" for i in range(size)] + [f"{held[f's{j}']} = s[{j}, q]" for j in own]
    moving = ["d = dy[t, q]", *(f"{name} = {place}" for name, place in held.items())]
    moving.append(f"dy[t, q] = {_product(split, slopes.output)}")
    moving += [f"{held[f'm{i}']} = {_product(split, slopes.of_state(i))}" for i in range(size)]
    goes_on = [f"x{i} = {split.outputs[1, i]}" for i in range(size)]
    body = ["u0 = y[t]", *split.always, f"y[t] = {split.outputs[0, 0]}", *_each_direction("dy", moving), *goes_on]
    run = [f"x{i} = x[{i}, n]" for i in range(size)] + (_each_direction("dy", taken) if taken else [])
    run += ["for t in range(first[n], first[n + 1]):", *_deeper(body)]
    return _function(
        "differentiate(x, m, y, dy, s, c, first, w)", [*kept, "for n in range(first.size - 1):", *_deeper(run)]
    )


def _rest(split: _Split, slopes: _Slopes, size: int) -> str:
    """`rest(u, du, seen, dseen, p, k, s, x, m)`: states (S, N) of all rows and their derivatives (S, N, D)."""
    reads = ["r = n if p.shape[1] > 1 else 0", "x0 = seen[n]", "u0 = u[n]"]
    reads += [f"p{j} = p[{j}, r]" for j in sorted(set(split.parameters))]
    writes = [f"x[{i}, n] = {split.outputs[1, i]}" for i in range(size)]
    moving = ["d = du[n, q]", "m0 = dseen[n, q]", *(f"s{j} = s[{j}, q]" for j in slopes.own)]
    moving += [f"m[{i}, n, q] = {_product(split, slopes.of_state(i))}" for i in range(size)]
    body = [*reads, *split.once, *split.always, *writes, *_each_direction("du", moving)]
    return _function("rest(u, du, seen, dseen, p, k, s, x, m)", ["for n in range(u.size):", *_deeper(body)])


def _product(split: _Split, terms: Sequence[tuple[tuple[str, int], int]]) -> str:
    """Derivatives times what they are derivatives by: sum of v m{j}, v d and v s{j}."""
    factor = {"x": "m{0}", "u": "d", "p": "s{0}"}
    return " + ".join(f"{split.outputs[2, k]} * {factor[what].format(j)}" for (what, j), k in terms) or "0.0"


def _each_direction(array: str, lines: Sequence[str]) -> list[str]:
    return [f"for q in range({array}.shape[1]):", *_deeper(lines)]


def _function(header: str, lines: Sequence[str]) -> str:
    return "\n".join([_NOGIL, f"def {header}:", *_deeper(lines or ["pass"])]) + "\n"


def _deeper(lines: Sequence[str]) -> list[str]:
    return ["    " + line for line in lines]
