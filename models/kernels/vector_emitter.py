"""The vector kernel: LLVM code for a few rows of the product with one panel of a cell's weights, gates at once.

Numba compiles Python to LLVM's instructions, and lets a function write its own (`intrinsic`). This one does, since no
loop in Python says which numbers have to stay in registers:

    for every input k:  sums[row, gate] += x[row, k] weights[k, gate]      (a vector of units each)

A panel holds the weights of as many units as a vector has lanes, four gates side by side, so that the four sums of a
row meet in registers when the loop ends and become cell and output there: the sums are never stored. A panel is small
enough for the first cache, where it stays while all rows pass."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from llvmlite import binding, ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

INDEX = ir.IntType(64)
FLOAT = ir.FloatType()
FLOATS = FLOAT.as_pointer()


class VectorCode:
    """Instructions at the end of a function under construction; every value is a vector of `lanes` numbers.

    Args:
        builder: llvmlite's writer of instructions.
        lanes: numbers in a vector.
    """

    def __init__(self, builder: ir.IRBuilder, lanes: int) -> None:
        self.builder, self.lanes = builder, lanes
        self.type = ir.VectorType(FLOAT, lanes)
        name = f"llvm.fma.v{lanes}f32"
        known = builder.module.globals.get(name)
        self._fma = known or ir.Function(builder.module, ir.FunctionType(self.type, [self.type] * 3), name)

    def constant(self, value: float) -> Any:
        """The same number in every lane."""
        return ir.Constant(self.type, [ir.Constant(FLOAT, value)] * self.lanes)

    def load(self, base: Any, index: Any) -> Any:
        """Numbers base[index], base[index + 1], ...; without a claim of alignment, which costs nothing if there is."""
        return self.builder.load(self._place(base, index), align=4)

    def store(self, vector: Any, base: Any, index: Any) -> None:
        """Write from base[index] on."""
        self.builder.store(vector, self._place(base, index), align=4)

    def repeated(self, base: Any, index: Any) -> Any:
        """base[index] in every lane."""
        number = self.builder.load(self.builder.gep(base, [index]))
        first = self.builder.insert_element(ir.Constant(self.type, ir.Undefined), number, ir.IntType(32)(0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), [ir.IntType(32)(0)] * self.lanes)
        return self.builder.shuffle_vector(first, ir.Constant(self.type, ir.Undefined), mask)

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """a b + c, rounded once."""
        return self.builder.call(self._fma, [a, b, c])

    def add(self, a: Any, b: Any) -> Any:
        """a + b."""
        return self.builder.fadd(a, b)

    def sub(self, a: Any, b: Any) -> Any:
        """a - b."""
        return self.builder.fsub(a, b)

    def mul(self, a: Any, b: Any) -> Any:
        """a b."""
        return self.builder.fmul(a, b)

    def div(self, a: Any, b: Any) -> Any:
        """a / b."""
        return self.builder.fdiv(a, b)

    def one_less_square(self, a: Any) -> Any:
        """1 - a^2."""
        return self.fma(self.builder.fneg(a), a, self.constant(1.0))

    def polynomial(self, x: Any, coefficients: tuple[float, ...]) -> Any:
        """Sum of coefficients[k] x^k, by Horner's rule."""
        value = self.constant(coefficients[-1])
        for coefficient in coefficients[-2::-1]:
            value = self.fma(value, x, self.constant(coefficient))
        return value

    def clamp(self, x: Any, limit: float) -> Any:
        """x within [-limit, limit]; not-a-number stays what it is, since no comparison holds for it."""
        for bound, relation in ((limit, ">"), (-limit, "<")):
            edge = self.constant(bound)
            x = self.builder.select(self.builder.fcmp_ordered(relation, x, edge), edge, x)
        return x

    def _place(self, base: Any, index: Any) -> Any:
        return self.builder.bitcast(self.builder.gep(base, [index]), self.type.as_pointer())


# Odd polynomial of degree 11 over even one of degree 8, fitted here: the fraction is off by at most 6e-8 on the whole
# line, in float32 by 2.2e-7; the coefficients are the float32 numbers of a search for the least error after rounding.
LIMIT = 8.50072098
ODD = (1.7296555, 0.234707922, 0.00645443471, 4.38413517e-05, 4.25241105e-08, -1.40259228e-11)
EVEN = (1.72965527, 0.811259866, 0.0462537706, 0.000640153361, 1.91435902e-06)


class Factors(NamedTuple):
    """Derivatives of a row's cell and output: dc' = cell dc + i dz_i + f dz_f + g dz_g, dh' = o dz_o + shown dc'."""

    cell: Any
    i: Any
    f: Any
    g: Any
    o: Any
    shown: Any


def row(code: VectorCode, z: Sequence[Any], c: Any) -> tuple[Any, Any]:
    """c' = f c + i g and h' = o tanh(c') from the sums z of the four gates, with two divisions."""
    (pi, qi), (pf, qf), (pg, qg), (po, qo) = (_fraction(code, value) for value in z)
    half, mul, add = code.constant(0.5), code.mul, code.add
    beside = mul(qi, qg)
    kept = mul(mul(add(qf, pf), c), beside)
    total = code.fma(mul(add(qi, pi), pg), qf, kept)
    c = code.div(mul(half, total), mul(beside, qf))
    pc, qc = _fraction(code, c)
    return c, code.div(mul(mul(half, add(qo, po)), pc), mul(qo, qc))


def differentiated_row(code: VectorCode, z: Sequence[Any], c: Any) -> tuple[Any, Any, Factors]:
    """As `row`, and what `tangent_row` multiplies with."""
    i, f, g, o = (_tanh(code, value) for value in z)
    half, mul = code.constant(0.5), code.mul
    gain, forget, out = (code.fma(half, gate, half) for gate in (i, f, o))
    c_new = code.fma(forget, c, mul(gain, g))
    shown = _tanh(code, c_new)
    slopes = [mul(half, code.one_less_square(gate)) for gate in (i, f, o)]
    factors = Factors(
        cell=forget,
        i=mul(slopes[0], g),
        f=mul(slopes[1], c),
        g=mul(gain, code.one_less_square(g)),
        o=mul(slopes[2], shown),
        shown=mul(out, code.one_less_square(shown)),
    )
    return c_new, mul(out, shown), factors


def tangent_row(code: VectorCode, z: Sequence[Any], c: Any, by: Factors) -> tuple[Any, Any]:
    """dc' and dh' from the derivatives z of the sums of the four gates and c of the cell."""
    i, f, g, o = z
    c = code.fma(by.g, g, code.fma(by.f, f, code.fma(by.i, i, code.mul(by.cell, c))))
    return c, code.fma(by.shown, c, code.mul(by.o, o))


class GruFactors(NamedTuple):
    """Derivatives of a row's output: dh' = keep dh + r dz_r + z dz_z + n dz_n + own dz_own."""

    keep: Any
    r: Any
    z: Any
    n: Any
    own: Any


def gru_row(code: VectorCode, z: Sequence[Any], h: Any) -> tuple[Any, Any]:
    """h' = (1 - z) n + z h, n = tanh(z_n + r z_own), from the sums of r, z and both parts of n, with two divisions."""
    half, mul = code.constant(0.5), code.mul
    opened = code.fma(half, _tanh(code, z[0]), half)
    (pz, qz), (pn, qn) = _fraction(code, z[1]), _fraction(code, code.fma(opened, z[3], z[2]))
    total = code.fma(code.sub(qz, pz), pn, mul(mul(code.add(qz, pz), h), qn))
    h = code.div(mul(half, total), mul(qz, qn))
    return h, h


def gru_differentiated_row(code: VectorCode, z: Sequence[Any], h: Any) -> tuple[Any, Any, GruFactors]:
    """As `gru_row`, and what `gru_tangent_row` multiplies with."""
    half, mul = code.constant(0.5), code.mul
    r, k = (_tanh(code, value) for value in z[:2])
    opened, keep, take = code.fma(half, r, half), code.fma(half, k, half), code.fma(code.constant(-0.5), k, half)
    new = _tanh(code, code.fma(opened, z[3], z[2]))
    fresh, gap = mul(take, code.one_less_square(new)), code.sub(h, new)
    factors = GruFactors(
        keep=keep,
        r=mul(mul(fresh, z[3]), mul(half, code.one_less_square(r))),
        z=mul(gap, mul(half, code.one_less_square(k))),
        n=fresh,
        own=mul(fresh, opened),
    )
    h = code.fma(keep, gap, new)
    return h, h, factors


def gru_tangent_row(code: VectorCode, z: Sequence[Any], h: Any, by: GruFactors) -> tuple[Any, Any]:
    """dh' from the derivatives z of the four sums and h of the output."""
    h = code.fma(by.r, z[0], code.mul(by.keep, h))
    h = code.fma(by.own, z[3], code.fma(by.n, z[2], code.fma(by.z, z[1], h)))
    return h, h


def _fraction(code: VectorCode, x: Any) -> tuple[Any, Any]:
    """P and Q of tanh(x) = P / Q, 1 < Q < 600: products of three stay far from the ends of float32."""
    x = code.clamp(x, LIMIT)
    s = code.mul(x, x)
    return code.mul(x, code.polynomial(s, ODD)), code.polynomial(s, EVEN)


def _tanh(code: VectorCode, x: Any) -> Any:
    return code.div(*_fraction(code, x))


@dataclass(frozen=True)
class Cell:
    """What the four sums of a unit become.

    Attributes:
        name: in names of functions.
        halves: factor on the weights of each sum, 1/2 where it is the argument of a sigmoid.
        parts: numbers a unit that are remembered: cell and output, or the output alone, which then is its own cell.
        row, differentiated, tangent: the code of a motion, of one with its factors, and of a derivative.
        factors: what `differentiated` gives and `tangent` takes.
    """

    name: str
    halves: tuple[float, float, float, float]
    parts: int
    row: Callable[..., Any]
    differentiated: Callable[..., Any]
    tangent: Callable[..., Any]
    factors: Any


CELLS = {
    "lstm": Cell("lstm", (0.5, 0.5, 1.0, 0.5), 2, row, differentiated_row, tangent_row, Factors),
    "gru": Cell("gru", (0.5, 0.5, 1.0, 1.0), 1, gru_row, gru_differentiated_row, gru_tangent_row, GruFactors),
}


@dataclass(frozen=True)
class VectorShape:
    """Sizes of the vector kernel.

    One row takes four registers, one a gate; beside the rows there must be room for the weights of four gates and the
    row's input: 4 rows + 5 registers of the 32 that AVX-512 has and of the 16 that AVX2 has. One row more, and the
    sums are spilled to memory in every turn of the inner loop.

    Attributes:
        lanes: float32 numbers in a vector.
        rows: rows of the batch whose sums are in registers.
    """

    lanes: int
    rows: int


AVX512 = VectorShape(lanes=16, rows=6)
AVX2 = VectorShape(lanes=8, rows=2)
SHAPES = {"avx512": AVX512, "avx2": AVX2}


def host_shape() -> VectorShape | None:
    """Sizes for this processor; None where it has no long vectors, or numba is told to compile for another."""
    if os.environ.get("NUMBA_CPU_NAME") or os.environ.get("NUMBA_CPU_FEATURES"):
        return None
    return shape_for(binding.get_host_cpu_features())


def shape_for(features: Mapping[str, bool]) -> VectorShape | None:
    """Sizes for a processor with these features, as LLVM calls them; None without AVX-512 and AVX2."""
    if features.get("avx512f"):
        return AVX512
    return AVX2 if features.get("avx2") and features.get("fma") else None


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


def block_intrinsic(kind: Rows, shape: VectorShape, cell: Cell) -> Any:
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
            _call(builder, kind, shape, cell, arrays, *(arguments[k] for k in (0, 2, 3, 5, 6)))
            return context.get_dummy_value()

        return signature, generate

    return block


def _call(
    b: ir.IRBuilder,
    kind: Rows,
    shape: VectorShape,
    cell: Cell,
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
        b.call(_block(b.module, kind, shape, cell, count), [*places, inputs, width["x"], width["c"]])
        b.branch(done)
    b.position_at_end(done)


def _block(module: ir.Module, kind: Rows, shape: VectorShape, cell: Cell, rows: int) -> ir.Function:
    """Function (weights, x, c, h, factors, inputs, stride of x, stride of c, h and factors) for `rows` rows."""
    name = f"hystmpc_{cell.name}_{kind}_{shape.lanes}x{rows}"
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
    _finish(code, kind, cell, sums, c, h, factors, width)
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


def _finish(
    code: VectorCode, kind: Rows, unit: Cell, sums: list[list[Any]], c: Any, h: Any, factors: Any, width: Any
) -> None:
    """From sums to cells and outputs of all rows."""
    b = code.builder
    by = None
    if kind is Rows.TANGENTS:
        by = unit.factors(*(code.load(factors, b.mul(width, INDEX(k))) for k in range(len(unit.factors._fields))))
    for r, z in enumerate(sums):
        at = b.mul(width, INDEX(r))
        cell = code.load(c, at)
        if kind is Rows.MOTIONS:
            cell, out = unit.row(code, z, cell)
        elif by is None:
            cell, out, by = unit.differentiated(code, z, cell)
            for k, factor in enumerate(by):
                code.store(factor, factors, b.mul(width, INDEX(k)))
        else:
            cell, out = unit.tangent(code, z, cell, by)
        code.store(cell, c, at)
        code.store(out, h, at)
