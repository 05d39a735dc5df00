"""The elementwise ONNX operators as CasADi expressions whose derivative is that of the active branch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import casadi as ca
import onnx

Expression = Any  # casadi.MX or casadi.DM, which have no types


def _maximum(a: Expression, b: Expression) -> Expression:
    # CasADi's fmax averages the derivatives at a tie; a play in contact rests exactly on one. The first operand counts.
    return ca.if_else(a >= b, a, b)


def _minimum(a: Expression, b: Expression) -> Expression:
    return ca.if_else(a <= b, a, b)


def _clip(x: Expression, lower: Expression = None, upper: Expression = None) -> Expression:
    x = x if lower is None else _maximum(x, lower)
    return x if upper is None else _minimum(x, upper)


def _sigmoid(x: Expression) -> Expression:
    # 1 / (1 + exp(-x)) has the derivative inf / inf far to the left.
    return 0.5 + 0.5 * ca.tanh(0.5 * x)


def _softplus(x: Expression) -> Expression:
    # log(1 + exp(x)) overflows; here fmax's average at the tie is exactly the derivative 1/2.
    return ca.fmax(x, 0) + ca.log1p(ca.exp(-ca.fabs(x)))


def _toward_zero(x: Expression) -> Expression:
    return ca.if_else(x >= 0, ca.floor(x), ca.ceil(x))


def cast(x: Expression, to: int) -> Expression:
    """Convert to ONNX element type `to`; numbers stay double, truth values are 0 and 1."""
    if to == onnx.TensorProto.BOOL:
        return x != 0
    return x if to in (onnx.TensorProto.FLOAT, onnx.TensorProto.DOUBLE) else _toward_zero(x)


ELEMENTWISE: Mapping[str, Callable[..., Expression]] = {
    "Abs": ca.fabs,
    "Add": lambda a, b: a + b,
    "And": ca.logic_and,
    "Ceil": ca.ceil,
    "Clip": _clip,
    "Cos": ca.cos,
    "Div": lambda a, b: a / b,
    "Equal": lambda a, b: a == b,
    "Erf": ca.erf,
    "Exp": ca.exp,
    "Floor": ca.floor,
    "Greater": lambda a, b: a > b,
    "GreaterOrEqual": lambda a, b: a >= b,
    "Identity": lambda a: a,
    "Less": lambda a, b: a < b,
    "LessOrEqual": lambda a, b: a <= b,
    "Log": ca.log,
    "Max": lambda *a: reduce(_maximum, a),
    "Min": lambda *a: reduce(_minimum, a),
    "Mul": lambda a, b: a * b,
    "Neg": lambda a: -a,
    "Not": ca.logic_not,
    "Or": ca.logic_or,
    "Pow": lambda a, b: a**b,
    "Reciprocal": lambda a: 1 / a,
    "Relu": lambda a: ca.if_else(a > 0, a, 0),
    "Sigmoid": _sigmoid,
    "Sign": ca.sign,
    "Sin": ca.sin,
    "Softplus": _softplus,
    "Sqrt": ca.sqrt,
    "Sub": lambda a, b: a - b,
    "Tanh": ca.tanh,
    "Where": ca.if_else,
}
