"""The vector kernel: LLVM code for a few rows of the product with one panel of an LSTM's weights, gates at once.

Numba compiles Python to LLVM's instructions, and lets a function write its own (`intrinsic`). This one does, since no
loop in Python says which numbers have to stay in registers:

    for every input k:  sums[row, gate] += x[row, k] weights[k, gate]      (a vector of units each)

A panel holds the weights of as many units as a vector has lanes, four gates side by side, so that the four sums of a
row meet in registers when the loop ends and become cell and output there: the sums are never stored. A panel is small
enough for the first cache, where it stays while all rows pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .vector_code import FLOATS, INDEX, VectorCode
from .vector_gates import Factors, differentiated_row, row, tangent_row
from .vector_shape import VectorShape

GATES = 4
_TABLE = types.Array(types.float32, 2, "C")


class Rows(StrEnum):
    """What the rows of a block are."""

    MOTIONS = "motions"  # plans of a roll-out
    FIRST = "first"  # a motion, whose factors are kept, and derivatives along it
    TANGENTS = "tangents"  # more derivatives along the same motion

    def counts(self, most: int) -> range:
        """Rows that a block can have if `most` fit: derivatives are dealt out evenly, in blocks at least half full."""
        least = {Rows.MOTIONS: 1, Rows.FIRST: 2, Rows.TANGENTS: (most + 1) // 2}
        return range(least[self], most + 1)


def block_intrinsic(kind: Rows, shape: VectorShape) -> Any:
    """Function for compiled code: one block of rows, one panel, one sample.

    block(rows, weights, panel, inputs, x, first, column, c, h, factors) with

        weights (panels, (1 + I) 4 lanes): bias, then inputs, each four gates of as many units as there are lanes
        x (R, X): a row's inputs stand from `column` on, `inputs` of them
        c, h (R, U): cells, moved on in place, and outputs, of rows `first` to `first + rows`
        factors (6, U): written by `FIRST`, read by `TANGENTS`
    """

    @intrinsic
    def block(
        typing: Any,
        rows: Any,
        weights: Any,
        panel: Any,
        inputs: Any,
        x: Any,
        first: Any,
        column: Any,
        c: Any,
        h: Any,
        factors: Any,
    ) -> Any:
        del typing, rows, weights, panel, inputs, x, first, column, c, h, factors  # numba counts the arguments by name
        number, table = types.intp, _TABLE
        signature = types.void(number, table, number, number, table, number, number, table, table, table)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            del signature
            views = dict(
                zip(("weights", "x", "c", "h", "factors"), (arguments[k] for k in (1, 4, 7, 8, 9)), strict=True)
            )
            arrays = {name: context.make_array(_TABLE)(context, builder, view) for name, view in views.items()}
            _call(builder, kind, shape, arrays, *(arguments[k] for k in (0, 2, 3, 5, 6)))
            return context.get_dummy_value()

        return signature, generate

    return block


def _call(
    b: ir.IRBuilder,
    kind: Rows,
    shape: VectorShape,
    arrays: dict[str, Any],
    rows: Any,
    panel: Any,
    inputs: Any,
    first: Any,
    column: Any,
) -> None:
    """Jump to the function for this number of rows, with places instead of indices."""
    width = {name: cgutils.unpack_tuple(b, array.shape)[1] for name, array in arrays.items()}
    unit = b.mul(panel, INDEX(shape.lanes))
    from_row = b.add(b.mul(first, width["c"]), unit)
    starts = {
        "weights": b.mul(panel, width["weights"]),
        "x": b.add(b.mul(first, width["x"]), column),
        "c": from_row,
        "h": from_row,
        "factors": unit,
    }
    places = [b.gep(arrays[name].data, [start]) for name, start in starts.items()]
    done = b.append_basic_block("done")
    choice = b.switch(rows, done)
    for count in kind.counts(shape.rows):
        choice.add_case(INDEX(count), b.append_basic_block(f"rows{count}"))
        b.position_at_end(b.function.blocks[-1])
        b.call(_block(b.module, kind, shape, count), [*places, inputs, width["x"], width["c"]])
        b.branch(done)
    b.position_at_end(done)


def _block(module: ir.Module, kind: Rows, shape: VectorShape, rows: int) -> ir.Function:
    """Function (weights, x, c, h, factors, inputs, stride of x, stride of c, h and factors) for `rows` rows."""
    name = f"hystmpc_{kind}_{shape.lanes}x{rows}"
    known = module.globals.get(name)
    if known is not None:
        return known
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), [FLOATS] * 5 + [INDEX] * 3), name)
    function.linkage = "internal"
    function.attributes.add("noinline")  # its registers are its own
    weights, x, c, h, factors, inputs, stride, width = function.args
    b = ir.IRBuilder(function.append_basic_block("entry"))
    code = VectorCode(b, shape.lanes)
    bias = [code.load(weights, INDEX(gate * shape.lanes)) for gate in range(GATES)]
    nothing = [code.constant(0.0)] * GATES
    starts = [bias if kind is Rows.MOTIONS or (kind is Rows.FIRST and r == 0) else nothing for r in range(rows)]
    sums = _product(code, weights, x, inputs, stride, starts)
    _finish(code, kind, sums, c, h, factors, width)
    b.ret_void()
    return function


def _product(
    code: VectorCode, weights: Any, x: Any, inputs: Any, stride: Any, starts: Sequence[Sequence[Any]]
) -> list[list[Any]]:
    """Sums (rows, gates) over all inputs, in registers."""
    b, before = code.builder, code.builder.block
    places = [b.gep(x, [b.mul(stride, INDEX(r))]) for r in range(len(starts))]
    loop, done = b.append_basic_block("inputs"), b.append_basic_block("gates")
    b.branch(loop)
    b.position_at_end(loop)
    k = b.phi(INDEX)
    k.add_incoming(INDEX(0), before)
    sums = [[b.phi(code.type) for _ in start] for start in starts]
    following = b.add(k, INDEX(1))
    panel = b.mul(following, INDEX(GATES * code.lanes))  # behind the bias
    columns = [code.load(weights, b.add(panel, INDEX(gate * code.lanes))) for gate in range(GATES)]
    added = []
    for place, row_sums, start in zip(places, sums, starts, strict=True):
        value = code.repeated(place, k)
        added.append([code.fma(value, column, total) for column, total in zip(columns, row_sums, strict=True)])
        for total, initial, final in zip(row_sums, start, added[-1], strict=True):
            total.add_incoming(initial, before)
            total.add_incoming(final, loop)
    k.add_incoming(following, loop)
    b.cbranch(b.icmp_signed("<", following, inputs), loop, done)
    b.position_at_end(done)
    return added


def _finish(code: VectorCode, kind: Rows, sums: list[list[Any]], c: Any, h: Any, factors: Any, width: Any) -> None:
    """From sums to cells and outputs of all rows."""
    b = code.builder
    by = None
    if kind is Rows.TANGENTS:
        by = Factors(*(code.load(factors, b.mul(width, INDEX(k))) for k in range(len(Factors._fields))))
    for r, z in enumerate(sums):
        at = b.mul(width, INDEX(r))
        cell = code.load(c, at)
        if kind is Rows.MOTIONS:
            cell, out = row(code, z, cell)
        elif by is None:
            cell, out, by = differentiated_row(code, z, cell)
            for k, factor in enumerate(by):
                code.store(factor, factors, b.mul(width, INDEX(k)))
        else:
            cell, out = tangent_row(code, z, cell, by)
        code.store(cell, c, at)
        code.store(out, h, at)
