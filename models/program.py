"""From one CasADi expression to Python source: scalar code, and array code for NumPy and torch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from hystmpc.trials.errors import ModelError, did_you_mean

_NAMES: dict[int, str] = {
    value: key.removeprefix("OP_").lower() for key, value in vars(ca).items() if key.startswith("OP_")
}
# What an operator's equation may use. The list is closed so that every backend can be held to all of it.
BINARY = ("add", "sub", "mul", "div", "lt", "le", "eq", "ne", "and", "or", "if_else_zero", "fmin", "fmax", "pow")
UNARY = (
    *("neg", "fabs", "sign", "sqrt", "sq", "twice", "inv", "not", "exp", "log", "tanh", "sin", "cos", "floor"),
    "assign",
)


@dataclass(frozen=True)
class Instruction:
    """One scalar operation of a straight-line program on numbered work registers.

    Attributes:
        name: `input`, `output`, `const`, or one of BINARY and UNARY.
        out: register written; for `output` the pair (output, element).
        args: registers read; for `input` the pair (input, element).
        value: the number of a `const`.
    """

    name: str
    out: tuple[int, ...]
    args: tuple[int, ...]
    value: float = 0.0


def instructions(function: Any) -> Iterator[Instruction]:
    """Yield the program of a dense SX function.

    Raises:
        ModelError: if the function uses an operation outside the closed list; names it.
    """
    for k in range(function.n_instructions()):
        name = _NAMES[function.instruction_id(k)]
        out, args = tuple(function.instruction_output(k)), tuple(function.instruction_input(k))
        if name == "const":
            yield Instruction(name, out, (), float(function.instruction_constant(k)))
        elif name in ("input", "output"):
            yield Instruction(name, out, args)
        elif name in BINARY:
            yield Instruction(name, out, args[:2])
        elif name in UNARY or name == "constpow":
            yield Instruction("pow" if name == "constpow" else name, out, args[:2] if name == "constpow" else args[:1])
        else:
            raise ModelError(
                f"{function.name()}: operation {name!r} at instruction {k} is outside the list that all backends "
                f"share, {did_you_mean(name, BINARY + UNARY)}"
            )


def dense(name: str, inputs: list[Any], outputs: list[Any]) -> Any:
    """Return a CasADi function whose outputs are dense column-major, as the backends expect."""
    return ca.Function(name, inputs, [ca.densify(ca.SX(o)) for o in outputs])


# Conditions are numbers, 1.0 or 0.0, as in CasADi, so that they can be added and multiplied.
_SHARED = {
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
    "sq": "{0} * {0}",
    "twice": "{0} + {0}",
    "inv": "1.0 / {0}",
    "not": "1.0 - {0}",
    "and": "{0} * {1}",
    "assign": "{0}",
    "pow": "{0} ** {1}",
}
SCALAR: Mapping[str, str] = (
    _SHARED
    | {
        "lt": "1.0 if {0} < {1} else 0.0",
        "le": "1.0 if {0} <= {1} else 0.0",
        "eq": "1.0 if {0} == {1} else 0.0",
        "ne": "1.0 if {0} != {1} else 0.0",
        "or": "1.0 if {0} + {1} > 0.0 else 0.0",
        "if_else_zero": "{1} if {0} != 0.0 else 0.0",
        "fmin": "{0} if {0} <= {1} else {1}",
        "fmax": "{0} if {0} >= {1} else {1}",
        "fabs": "abs({0})",
        "sign": "(1.0 if {0} > 0.0 else (-1.0 if {0} < 0.0 else 0.0))",
    }
    | {name: f"math.{name}({{0}})" for name in ("sqrt", "exp", "log", "tanh", "sin", "cos", "floor")}
)


def array_table(module: str, cast: str) -> Mapping[str, str]:
    """Templates for a module with NumPy's names; `cast` turns a truth array {c} into numbers."""

    def number(condition: str) -> str:
        return cast.replace("{c}", condition)

    table = _SHARED | {
        "lt": number("{0} < {1}"),
        "le": number("{0} <= {1}"),
        "eq": number("{0} == {1}"),
        "ne": number("{0} != {1}"),
        "or": number("({0} + {1}) > 0"),
        "if_else_zero": module + ".where({0} != 0, {1}, 0.0 * {0})",
        "fmin": module + ".where({0} <= {1}, {0}, {1})",
        "fmax": module + ".where({0} >= {1}, {0}, {1})",
        "fabs": module + ".abs({0})",
    }
    return table | {n: f"{module}.{n}({{0}})" for n in ("sign", "sqrt", "exp", "log", "tanh", "sin", "cos", "floor")}


NUMPY = array_table("np", "np.asarray({c}, dtype=float)")
TORCH = array_table("torch", "({c}).to(torch.get_default_dtype())")


@dataclass(frozen=True)
class Program:
    """Source of one function, with its numbers lifted out.

    Attributes:
        source: text of the function, whose last argument `k` receives `constants`.
        constants: the numbers of the expression. Kept outside so that models that differ in numbers only share
            one source.
    """

    source: str
    constants: tuple[float, ...]


def scalar_program(function: Any, name: str, table: Mapping[str, str] = SCALAR) -> Program:
    """Return source `name(i0, i1, ..., o0, o1, ..., k)` reading and writing flat float arrays."""
    lines, constants = _body(function, table, "o{0}[{1}] = {2}")
    inputs = [f"i{j}" for j in range(function.n_in())]
    outputs = [f"o{j}" for j in range(function.n_out())]
    header = f"def {name}({', '.join([*inputs, *outputs, 'k'])}):"
    return Program("\n".join([header, *lines]) + "\n", constants)


def array_program(function: Any, name: str, table: Mapping[str, str]) -> Program:
    """Return source `name(i0, i1, ..., k) -> list of lists`: element e of input j is the array i{j}[e].

    Elements broadcast against one another, so a batch is a leading axis of every element.
    """
    lines, constants = _body(function, table, "out[{0}][{1}] = {2}")
    allocation = f"    out = [[None] * n for n in {[function.numel_out(j) for j in range(function.n_out())]}]"
    header = f"def {name}({', '.join([*(f'i{j}' for j in range(function.n_in())), 'k'])}):"
    return Program("\n".join([header, allocation, *lines, "    return out"]) + "\n", constants)


def _body(function: Any, table: Mapping[str, str], write: str) -> tuple[list[str], tuple[float, ...]]:
    """Indented statements and the constants they read."""
    constants: list[float] = []
    lines = ["    " + _statement(step, table, write, constants) for step in instructions(function)]
    return lines, tuple(constants)


def _statement(step: Instruction, table: Mapping[str, str], write: str, constants: list[float]) -> str:
    """One line of source; a new constant is appended to `constants`."""
    if step.name == "input":
        return f"w{step.out[0]} = i{step.args[0]}[{step.args[1]}]"
    if step.name == "output":
        return write.format(*step.out, f"w{step.args[0]}")
    if step.name == "const":
        constants.append(step.value)
        return f"w{step.out[0]} = k[{len(constants) - 1}]"
    return f"w{step.out[0]} = {table[step.name].format(*(f'w{a}' for a in step.args))}"
