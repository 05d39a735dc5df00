"""Conversion of a step graph into a CasADi function with the exact derivatives of the active branch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np
import onnx
import onnx.numpy_helper
from numpy.typing import NDArray

from hystmpc.trials.errors import ModelError

Expression = Any  # casadi.MX or casadi.DM, which have no types


# Scalar expressions differentiate and evaluate faster than matrix ones while there are few of them: a graph whose
# matrix products take no more multiplications than this (any chain of operators) is expanded.
_EXPANDED_PRODUCTS = 4096


@dataclass(frozen=True)
class Tensor:
    """ONNX tensor: its entries in row-major order as one column, and its shape; the batch axis has length one."""

    entries: Expression
    shape: tuple[int, ...]

    @property
    def places(self) -> NDArray[np.int64]:
        """Entry numbers in the shape of the tensor."""
        return np.arange(int(np.prod(self.shape)), dtype=np.int64).reshape(self.shape)

    @property
    def known(self) -> NDArray[np.int64]:
        """Values of a constant integer tensor.

        Raises:
            ValueError: if the value depends on command or state.
        """
        if not isinstance(self.entries, ca.DM):
            raise ValueError("an axis, size or index depends on command or state, expected a constant")
        return np.array(self.entries).astype(np.int64).reshape(self.shape)

    def take(self, places: NDArray[np.int64]) -> Tensor:
        """Tensor of the entries with the numbers `places`."""
        numbers = places.ravel().tolist()
        moved = numbers != list(range(self.entries.shape[0]))
        return Tensor(self.entries[numbers, 0] if moved else self.entries, places.shape)


def to_casadi(graph: onnx.GraphProto, name: str = "model") -> ca.Function:
    """Convert a step graph into a CasADi function.

    Where a graph has branches (Where, Max, Min, Clip, Relu) the derivative is that of the active one, of the first
    operand at a tie; Relu has derivative zero at zero.

    Returns:
        `casadi.Function`: state (S, 1), u (nu, 1) -> theta (ny, 1), next_state (S, 1), in double.

    Raises:
        ModelError: on an operator that is not on the list, or a node that cannot be translated; names the node.
    """
    check_operators(graph, name)
    size = {value.name: value.type.tensor_type.shape.dim[1].dim_value for value in graph.input}
    state, u = (ca.MX.sym(key, size[key]) for key in ("state", "u"))
    tensors = {key: Tensor(given, (1, size[key])) for key, given in (("state", state), ("u", u))}
    tensors |= {weight.name: _constant(onnx.numpy_helper.to_array(weight)) for weight in graph.initializer}
    for index, node in enumerate(graph.node):
        try:
            results = _translate(node, [tensors[key] if key else None for key in node.input])
        except (ValueError, LookupError, TypeError, RuntimeError) as error:  # of NumPy and CasADi, on shapes
            text = next(iter(str(error).splitlines()), "")
            raise ModelError(f"{name}: node {node_name(node, index)} ({node.op_type}): {text}") from None
        tensors.update(zip(node.output, results, strict=True))
    outputs = [tensors["theta"].entries, tensors["next_state"].entries]
    function = ca.Function(name, [state, u], outputs, ["state", "u"], ["theta", "next_state"])
    return function.expand() if _products(graph) <= _EXPANDED_PRODUCTS else function


def _translate(node: onnx.NodeProto, operands: Sequence[Tensor | None]) -> list[Tensor]:
    given = {item.name: onnx.helper.get_attribute_value(item) for item in node.attribute}
    if node.op_type in REARRANGE:
        return _rearranged(node.op_type, operands, given)
    if node.op_type == "Constant":
        return [_literal(given)]
    if node.op_type == "Cast":
        return [Tensor(cast(_present(operands[0]).entries, given["to"]), _present(operands[0]).shape)]
    if node.op_type in ELEMENTWISE:
        return [_elementwise(ELEMENTWISE[node.op_type], operands)]
    return [_COMBINE[node.op_type](operands, given)]


def _elementwise(rule: Callable[..., Expression], operands: Sequence[Tensor | None]) -> Tensor:
    shape = np.broadcast_shapes(*(t.shape for t in operands if t is not None))
    # CasADi repeats scalars by itself, which keeps the expression small.
    spread = [t if t is None or t.entries.is_scalar() else t.take(np.broadcast_to(t.places, shape)) for t in operands]
    entries = rule(*(None if t is None else t.entries for t in spread))
    return Tensor(entries, shape)


def _rearranged(name: str, operands: Sequence[Tensor | None], given: Mapping[str, Any]) -> list[Tensor]:
    count = len(operands) if name == "Concat" else 1
    data = [_present(t) for t in operands[:count]]
    offsets = np.cumsum([0] + [t.entries.shape[0] for t in data])
    joined = Tensor(ca.vertcat(*(t.entries for t in data)) if count > 1 else data[0].entries, ())
    places = [t.places + offset for t, offset in zip(data, offsets, strict=False)]
    options = [None if t is None else t.known for t in operands[count:]]
    return [joined.take(result) for result in REARRANGE[name](places, options, given)]


def _product(operands: Sequence[Tensor | None], given: Mapping[str, Any]) -> Tensor:
    """Matrix product of ONNX; one of the operands has at most two axes."""
    del given
    a, b = _present(operands[0]), _present(operands[1])
    if len(b.shape) > 2 and int(np.prod(b.shape[:-2])) > 1:
        raise ValueError(f"second operand has shape {b.shape}, expected at most two axes longer than one")
    shape = np.matmul(np.zeros(a.shape), np.zeros(b.shape)).shape
    inner = a.shape[-1]
    rows, columns = a.entries.shape[0] // inner, b.entries.shape[0] // inner
    # Column-major CasADi reads a row-major matrix as its transpose: C' = B' A'.
    product = ca.mtimes(_sparse(ca.reshape(b.entries, columns, inner)), ca.reshape(a.entries, inner, rows))
    return Tensor(ca.vec(product), shape)


def _gemm(operands: Sequence[Tensor | None], given: Mapping[str, Any]) -> Tensor:
    """Matrix expression alpha A' B' + beta C, with the transpositions of the node's attributes."""
    a, b = (
        t.take(t.places.T) if given.get(key) else t
        for t, key in zip(map(_present, operands[:2]), ("transA", "transB"), strict=True)
    )
    scaled = Tensor(given.get("alpha", 1.0) * a.entries, a.shape)
    product = _product([scaled, b], {})
    if len(operands) < 3 or operands[2] is None:
        return product
    beta = given.get("beta", 1.0)
    return _elementwise(lambda p, c: p + beta * c, [product, operands[2]])


def _sum(operands: Sequence[Tensor | None], given: Mapping[str, Any]) -> Tensor:
    data = _present(operands[0])
    axes = tuple(_present(operands[1]).known.tolist()) if len(operands) > 1 else ()
    if not axes and given.get("noop_with_empty_axes", 0):
        return data
    axes = axes or tuple(range(len(data.shape)))
    kept = np.sum(data.places, axis=axes, keepdims=bool(given.get("keepdims", 1))).shape
    rows = int(np.prod(kept))
    summands = data.take(np.moveaxis(data.places, axes, range(-len(axes), 0)).reshape(rows, -1))
    return Tensor(ca.sum1(ca.reshape(summands.entries, summands.shape[1], rows)).T, kept)


def _shape(operands: Sequence[Tensor | None], given: Mapping[str, Any]) -> Tensor:
    shape = _present(operands[0]).shape
    return _constant(np.array(shape[given.get("start", 0) : given.get("end", len(shape))]))


_COMBINE: Mapping[str, Callable[[Sequence[Tensor | None], Mapping[str, Any]], Tensor]] = {
    "MatMul": _product,
    "Gemm": _gemm,
    "ReduceSum": _sum,
    "Shape": _shape,
}


def _present(operand: Tensor | None) -> Tensor:
    if operand is None:
        raise ValueError("an input is left out, expected a tensor")
    return operand


def _constant(values: NDArray[Any]) -> Tensor:
    return Tensor(ca.DM(np.asarray(values, dtype=np.float64).reshape(-1, 1)), np.shape(values))


def _literal(given: Mapping[str, Any]) -> Tensor:
    ((key, value),) = given.items()
    return _constant(onnx.numpy_helper.to_array(value) if key == "value" else np.array(value))


def _sparse(matrix: Expression) -> Expression:
    return ca.sparsify(matrix) if isinstance(matrix, ca.DM) else matrix


def _products(graph: onnx.GraphProto) -> int:
    """Number of multiplications in the matrix products with constant weights."""
    used = {key for node in graph.node if node.op_type in ("MatMul", "Gemm") for key in node.input}
    return sum(int(np.prod(weight.dims)) for weight in graph.initializer if weight.name in used)


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
Places = NDArray[np.int64]
Attributes = Mapping[str, Any]
Rule = Callable[[Sequence[Places], Sequence[Places | None], Attributes], Sequence[Places]]


# A rule takes the entry numbers of the tensors that it rearranges (all inputs of Concat, the first of the others), the
# values of its remaining inputs (axes, sizes, starts; None where left out) and the attributes.


def _split(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    axis = given.get("axis", 0)
    sizes = _option(options, 0)
    if sizes is not None:
        return np.split(data[0], np.cumsum(sizes)[:-1], axis)
    size = data[0].shape[axis]
    chunk = -(-size // given["num_outputs"])  # ONNX rounds up and lets the last part be smaller
    return np.split(data[0], range(chunk, size, chunk), axis)


def _slice(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    del given
    starts, ends, axes, steps = _needed(options, 0), _needed(options, 1), _option(options, 2), _option(options, 3)
    axes = np.arange(starts.size) if axes is None else axes
    steps = np.ones_like(starts) if steps is None else steps
    cuts = [slice(None)] * data[0].ndim
    for start, end, axis, step in np.stack([starts, ends, axes, steps], axis=1).tolist():
        # Counting down to the first entry, ONNX writes an end that Python would count from the back.
        past_front = step < 0 and end < -data[0].shape[axis]
        cuts[axis] = slice(start, None if past_front else end, step)
    return [data[0][tuple(cuts)]]


def _reshape(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    copy_zeros = not given.get("allowzero", 0)
    shape = [data[0].shape[k] if n == 0 and copy_zeros else n for k, n in enumerate(_needed(options).tolist())]
    return [data[0].reshape(shape)]


def _option(options: Sequence[Places | None], place: int) -> Places | None:
    return options[place] if place < len(options) else None


def _needed(options: Sequence[Places | None], place: int = 0) -> Places:
    value = _option(options, place)
    if value is None:
        raise ValueError(f"input {place + 1} is left out, expected whole numbers")
    return value


REARRANGE: Mapping[str, Rule] = {
    "Concat": lambda data, options, given: [np.concatenate(data, axis=given["axis"])],
    "Expand": lambda data, options, given: [
        np.broadcast_to(data[0], np.broadcast_shapes(data[0].shape, tuple(_needed(options).tolist())))
    ],
    "Gather": lambda data, options, given: [np.take(data[0], _needed(options), axis=given.get("axis", 0))],
    "Reshape": _reshape,
    "Slice": _slice,
    "Split": _split,
    "Squeeze": lambda data, options, given: [
        np.squeeze(data[0], None if _option(options, 0) is None else tuple(_needed(options).tolist()))
    ],
    "Transpose": lambda data, options, given: [np.transpose(data[0], given.get("perm"))],
    "Unsqueeze": lambda data, options, given: [np.expand_dims(data[0], tuple(_needed(options).tolist()))],
}

ALLOWED = frozenset((*ELEMENTWISE, *REARRANGE, *_COMBINE, "Cast", "Constant"))
"""Operators that a model file may use: those that can be translated."""


def check_operators(graph: onnx.GraphProto, where: str) -> None:
    """Check every node against the list of operators.

    Raises:
        ModelError: naming the first node that is not on it, its operator, and the list.
    """
    for index, node in enumerate(graph.node):
        domain = "" if node.domain == "ai.onnx" else node.domain
        if domain or node.op_type not in ALLOWED:
            operator = f"{domain}.{node.op_type}" if domain else node.op_type
            raise ModelError(
                f"{where}: node {node_name(node, index)} uses operator {operator!r}, which is not on the list, "
                f"available: {', '.join(sorted(ALLOWED))}"
            )


def node_name(node: onnx.NodeProto, index: int) -> str:
    """Name of a node in messages; without a name, its index and first output."""
    return repr(node.name) if node.name else f"{index} (output {node.output[0] if node.output else 'none'!r})"
