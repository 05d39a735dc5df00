"""Operators as C: one step of a chain and its tangent, from the same symbolic equations as every other backend."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from hystmpc.models.kernels.program import Instruction, dense, instructions
from hystmpc.trials.types import Vec

# Conditions are numbers, 1.0 or 0.0, as in CasADi, so that they can be added and multiplied.
_TEMPLATES = MappingProxyType(
    {
        "add": "{0} + {1}",
        "sub": "{0} - {1}",
        "mul": "{0} * {1}",
        "div": "{0} / {1}",
        "neg": "-{0}",
        "sq": "{0} * {0}",
        "twice": "{0} + {0}",
        "inv": "R(1.0) / {0}",
        "not": "R(1.0) - {0}",
        "and": "{0} * {1}",
        "assign": "{0}",
        "lt": "{0} < {1} ? R(1.0) : R(0.0)",
        "le": "{0} <= {1} ? R(1.0) : R(0.0)",
        "eq": "{0} == {1} ? R(1.0) : R(0.0)",
        "ne": "{0} != {1} ? R(1.0) : R(0.0)",
        "or": "{0} + {1} > R(0.0) ? R(1.0) : R(0.0)",
        "if_else_zero": "{0} != R(0.0) ? {1} : R(0.0)",
        "fmin": "{0} <= {1} ? {0} : {1}",
        "fmax": "{0} >= {1} ? {0} : {1}",
        "fabs": "{0} < R(0.0) ? -{0} : {0}",
        "sign": "{0} > R(0.0) ? R(1.0) : {0} < R(0.0) ? R(-1.0) : R(0.0)",
    }
)
EXACT = ("sqrt", "floor")
"""Functions of <math.h> whose results are exact or rounded correctly wherever floating point is IEC 60559."""
INEXACT = ("exp", "log", "tanh", "sin", "cos", "pow")
"""Functions of <math.h> whose last digits differ from one C library to the next."""


def number(value: float) -> str:
    """A number of the scalar type in C, exact in double."""
    if np.isinf(value):
        return "INFINITE" if value > 0 else "(-INFINITE)"
    text = repr(float(value))
    return f"R({text})" if value >= 0 else f"(-R({text[1:]}))"


def functions_used(steps: Sequence[Any]) -> tuple[str, ...]:
    """Functions of <math.h> that symbolic steps (x, u) -> (theta, next) and their derivatives call, by name."""
    names = {step.name for function in steps for part in _pair(function) for step in instructions(part)}
    return tuple(name for name in (*EXACT, *INEXACT) if name in names)


def model_source(name: str, step: Any) -> str:
    """C of the model `hystmpc_<name>`: a symbolic step (x, u) -> (theta, next), and its tangent."""
    plain, tangent = _pair(step)
    outputs = ("*theta", "next"), ("*theta", "next", "a", "b", "c", "*d")
    arguments = ", ".join(f"real *{out.lstrip('*')}" for out in outputs[0])
    more = ", ".join(f"real *{out.lstrip('*')}" for out in outputs[1])
    return "\n".join(
        [
            f"static void step_{name}(const real *x, real u, {arguments}) {{",
            *_body(plain, outputs[0]),
            "}\n",
            f"static void tangent_{name}(const real *x, real u, {more}) {{",
            *_body(tangent, outputs[1]),
            "}\n",
            f"const model hystmpc_{name} = {{{step.numel_in(0)}, step_{name}, tangent_{name}}};\n",
        ]
    )


def rest_source(offset: Vec, by_angle: Vec, by_command: Vec, warmup: int) -> str:
    """C of the state at rest: offset + by_angle y + by_command u, then so many samples of the command held."""
    lines = [
        f"    x[{i}] = {number(float(offset[i]))} + {number(float(by_angle[i]))} * y"
        f" + {number(float(by_command[i]))} * u;"
        for i in range(offset.size)
    ]
    return "\n".join(
        [
            "void hystmpc_rest(real y, real u, real *x) {",
            "    real theta, next[HYSTMPC_STATES];",
            *lines,
            f"    for (int k = 0; k < {warmup}; k++) {{",
            "        step_whole(x, u, &theta, next);",
            "        copy(next, x, S);",
            "    }",
            "}\n",
        ]
    )


def _pair(step: Any) -> tuple[Any, Any]:
    """The step, and the step with d next / d x, d next / d u, d theta / d x, d theta / d u."""
    x, u = ca.SX.sym("x", step.numel_in(0)), ca.SX.sym("u")
    theta, following = step(x, u)
    by = ca.jacobian
    slopes = [by(following, x), by(following, u), by(theta, x), by(theta, u)]
    return dense("step", [x, u], [theta, following]), dense("tangent", [x, u], [theta, following, *slopes])


def _body(function: Any, outputs: Sequence[str]) -> list[str]:
    """Statements with single assignments; an argument that is not read is said to be so."""
    where: dict[int, str] = {}
    lines = list(_statements(function, outputs, where))
    text = "\n".join(lines)
    unread = [name for name in ("x", "u") if (f" {name}[" if name == "x" else " = u;") not in text]
    return [*(f"    (void){name};" for name in unread), *lines]


def _statements(function: Any, outputs: Sequence[str], where: dict[int, str]) -> Iterator[str]:
    for count, step in enumerate(instructions(function)):
        if step.name == "output":
            out = outputs[step.out[0]]
            target = out if out.startswith("*") else f"{out}[{step.out[1]}]"
            yield f"    {target} = {where[step.args[0]]};"
            continue
        name = f"w{count}"
        yield f"    const real {name} = {_expression(step, where)};"
        where[step.out[0]] = name


def _expression(step: Instruction, where: Mapping[int, str]) -> str:
    if step.name == "input":
        return f"x[{step.args[1]}]" if step.args[0] == 0 else "u"
    if step.name == "const":
        return number(step.value)
    arguments = [where[a] for a in step.args]
    if step.name in _TEMPLATES:
        return _TEMPLATES[step.name].format(*arguments)
    return f"MATH({step.name})({', '.join(arguments)})"
