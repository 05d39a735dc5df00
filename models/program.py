"""Instructions of a CasADi expression: the closed list of operations that every backend has."""

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
