"""C source of operators: one step of a chain and its tangent, from the symbolic equations of all backends."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from hystmpc.models.program import SCALAR, Instruction, dense, instructions
from hystmpc.trials.types import Vec

# Conditions are numbers, 1.0 or 0.0, as in CasADi, so that they can be added and multiplied.
_TEMPLATES = MappingProxyType(
    {name: SCALAR[name] for name in ("add", "sub", "mul", "div", "neg", "sq", "twice", "and", "assign")}
    | {
        "inv": "R(1.0) / {0}",
        "not": "R(1.0) - {0}",
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
# Operations on numbers that are known here, as kernels compute them.
_FOLDED: Mapping[str, Callable[..., float]] = MappingProxyType(
    {name: eval(f"lambda a, b=0.0: {text.format('a', 'b')}", {"math": math}) for name, text in SCALAR.items()}
)
EXACT = ("fabs", "sqrt", "rint", "floor", "fmaf")
"""Functions of <math.h> whose results are exact or rounded correctly wherever floating point is IEC 60559."""
INEXACT = ("exp", "log", "tanh", "sin", "cos", "pow")
"""Functions of <math.h> whose last digits differ from one C library to the next."""


def number(value: float) -> str:
    """C literal of a number of the scalar type, exact in double."""
    if np.isinf(value):
        return "INFINITE" if value > 0 else "(-INFINITE)"
    text = repr(float(value))
    return f"R({text})" if value >= 0 else f"(-R({text[1:]}))"


@dataclass(frozen=True, eq=False)
class Step:
    """Step of a chain (x, u, p, dt) -> (theta, next), its parameters p (P,) and its sample time dt [s]."""

    function: Any
    parameters: Vec
    sample_s: float

    @property
    def size(self) -> int:
        """Number of entries of the state."""
        return int(self.function.numel_in(0))


def functions_used(source: str) -> tuple[str, ...]:
    """Return the functions of <math.h> that a C source of the package calls."""
    names = {name or "fmaf" for name in re.findall(r"MATH\((\w+)\)\(|\bfmaf\(", source)}
    return tuple(name for name in (*EXACT, *INEXACT) if name in names)


def model_source(name: str, step: Step) -> str:
    """Return the C source of the model `hystmpc_<name>`: step of a chain, and its tangent.

    Constant values are computed here by the operations of the engine, so that both agree to the last bit.
    """
    known = _known(step)
    outputs = "*theta", "next", "a", "b", "c", "*d"
    arguments = ", ".join(f"real *{out.lstrip('*')}" for out in outputs)
    return "\n".join(
        [
            step_source(name, step),
            f"static void tangent_{name}(const real *x, real u, {arguments}) {{",
            *_body(_tangent(step.function), outputs, known),
            "}\n",
            f"HYSTMPC_SHARED const model hystmpc_{name} = {{{step.size}, step_{name}, tangent_{name}}};\n",
        ]
    )


def inverted_source(name: str, step: Step) -> str:
    """Return the C source of the inverse of a step, sample by sample, and of its slope d theta / d u."""
    return "\n".join(
        [
            step_source(name, step, "HYSTMPC_LOCAL"),
            f"HYSTMPC_LOCAL void slope_{name}(const real *x, real u, real *theta, real *d) {{",
            *_body(_tangent(step.function), ("*theta", *[None] * 4, "*d"), _known(step)),
            "}\n",
        ]
    )


def step_source(name: str, step: Step, linkage: str = "static") -> str:
    """Return the C source of a chain's step alone, `step_<name>(x, u, theta, next)`; numbers as in `model_source`."""
    return "\n".join(
        [
            f"{linkage} void step_{name}(const real *x, real u, real *theta, real *next) {{",
            *_body(step.function, ("*theta", "next"), _known(step)),
            "}\n",
        ]
    )


_ROUNDS, _CLOSE, _FLAT, _WITHIN = 8, 1e-9, 1e-3, 1e-6  # as in `models.rest`
_NUDGE, _COARSE = 1e-6, 1e-2  # of the angle, for a slope: in double and in single precision


def chain_rest_source(offset: Vec, by_angle: Vec, by_command: Vec, held: int) -> str:
    """Return the C source of a chain's state at rest: offset + by_angle a + by_command u, a such that the output is y.

    Newton's method of `models.rest.ChainRest`, with a difference quotient for the slope; then `held` samples follow.
    """
    return "\n".join(
        [
            "static real rest_at(real y, real u, real *x) {",
            *_affine(offset, by_angle, by_command),
            "    real theta, next[HYSTMPC_STATES];",
            "    step_whole(x, u, &theta, next);",
            "    return theta;",
            "}\n",
            "HYSTMPC_LOCAL void hystmpc_rest(real y, real u, real *x) {",
            f"    const real nudge = HYSTMPC_SINGLE ? {number(_COARSE)} : {number(_NUDGE)};",
            "    real a = y, given = y, edge = R(0.0), left = y - rest_at(a, u, x);",
            f"    for (int k = 0; k < {_ROUNDS} && !(absolute(left) < {number(_CLOSE)}); k++) {{",
            "        real slope = (rest_at(a + nudge, u, x) - (y - left)) / nudge;",
            f"        if (absolute(slope) < {number(_FLAT)}) {{ /* beyond what the core can hold: a little within */",
            "            const real side = left > R(0.0) ? R(1.0) : R(-1.0), last = edge;",
            "            if (edge > R(-0.5) && edge < R(0.5)) given = a;",
            f"            a = y - left + side * (HYSTMPC_SINGLE ? {number(_COARSE)} : {number(_WITHIN)});",
            "            edge = side;",
            "            left = y - rest_at(a, u, x);",
            "            slope = (rest_at(a + side * nudge, u, x) - (y - left)) / (side * nudge);",
            f"            if (last * side > R(0.5) || absolute(slope) < {number(_FLAT)}) {{",
            "                a = given;",
            "                break;",
            "            }",
            "        }",
            "        a += left / slope;",
            "        left = y - rest_at(a, u, x);",
            "    }",
            "    real theta = rest_at(a, u, x), next[HYSTMPC_STATES];",
            f"    for (int k = 0; k < {held}; k++) {{",
            "        step_whole(x, u, &theta, next);",
            "        copy(next, x, S);",
            "    }",
            "}\n",
        ]
    )


def network_rest_source(offset: Vec, by_angle: Vec, by_command: Vec, held: int, companion_held: int) -> str:
    """Return the C source of a network's state at rest: offset + by_angle y + by_command u, then a held command.

    Args:
        held: samples of the network.
        companion_held: samples of the operators next to it, whose output is the measured angle too.
    """
    return "\n".join(
        [
            "HYSTMPC_LOCAL void hystmpc_rest(real y, real u, real *x) {",
            *_affine(offset, by_angle, by_command),
            "    real theta, next[HYSTMPC_CHAIN];",
            "    real *network = x + HYSTMPC_FRONT, *chain = network + HYSTMPC_NETWORK + 1;",
            f"    for (int k = 0; k < {held}; k++) network_step(network, u);",
            f"    for (int k = 0; k < {companion_held}; k++) {{",
            "        step_middle(chain, u, &theta, next);",
            "        copy(next, chain, HYSTMPC_BESIDE);",
            "    }",
            "}\n",
        ]
    )


def _affine(offset: Vec, by_angle: Vec, by_command: Vec) -> list[str]:
    """C statements of x = offset + by_angle y + by_command u."""
    return [
        f"    x[{i}] = {number(float(offset[i]))} + {number(float(by_angle[i]))} * y"
        f" + {number(float(by_command[i]))} * u;"
        for i in range(offset.size)
    ]


def _known(step: Step) -> Mapping[int, Vec]:
    """Constant arguments of the step's function, by number."""
    return {2: step.parameters, 3: np.array([step.sample_s])}


def _tangent(function: Any) -> Any:
    """Function with d next / d x, d next / d u, d theta / d x, d theta / d u, in the form that kernels compile."""
    x, u = ca.SX.sym("x", function.numel_in(0)), ca.SX.sym("u")
    arguments = [x, u, ca.SX.sym("p", function.numel_in(2)), ca.SX.sym("dt")]
    theta, following = function(*arguments)
    by = ca.jacobian
    slopes = [by(following, x), by(following, u), by(theta, x), by(theta, u)]
    return dense("tangent", arguments, [theta, following, *slopes])


def _body(function: Any, outputs: Sequence[str | None], known: Mapping[int, Vec]) -> list[str]:
    """C statements with single assignments; unused arguments are marked, and an output None is left out."""
    lines = _used(list(_statements(function, outputs, known)))
    text = "\n".join(lines)
    unread = [name for name in ("x", "u") if (f" {name}[" if name == "x" else " = u;") not in text]
    return [*(f"    (void){name};" for name in unread), *lines]


def _used(lines: Sequence[str]) -> list[str]:
    """C statements whose value is used."""
    kept: list[str] = []
    read: set[str] = set()
    for line in reversed(lines):
        target, _, value = line.partition(" = ")
        name = target.rpartition(" ")[2]
        if not re.fullmatch(r"w\d+", name) or name in read:
            kept.append(line)
            read |= set(re.findall(r"\bw\d+\b", value))
    return kept[::-1]


def _statements(function: Any, outputs: Sequence[str | None], known: Mapping[int, Vec]) -> Iterator[str]:
    where: dict[int, str | float] = {}
    for count, step in enumerate(instructions(function)):
        if step.name == "output":
            out = outputs[step.out[0]]
            if out is None:
                continue
            yield f"    {out if out.startswith('*') else f'{out}[{step.out[1]}]'} = {_text(where[step.args[0]])};"
            continue
        value = _value(step, where, known)
        if isinstance(value, str):
            yield f"    const real w{count} = {value};"
            value = f"w{count}"
        where[step.out[0]] = value


def _value(step: Instruction, where: Mapping[int, str | float], known: Mapping[int, Vec]) -> str | float:
    """Result of one instruction: a number if its arguments are known, else a C expression."""
    if step.name == "const":
        return step.value
    if step.name == "input":
        argument, element = step.args
        return float(known[argument][element]) if argument in known else ("u" if argument else f"x[{element}]")
    arguments = [where[a] for a in step.args]
    numbers = [a for a in arguments if isinstance(a, float)]
    if len(numbers) == len(arguments):
        return float(_FOLDED[step.name](*numbers))
    texts = [_text(a) for a in arguments]
    template = _TEMPLATES.get(step.name)
    return f"MATH({step.name})({', '.join(texts)})" if template is None else template.format(*texts)


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else number(value)
