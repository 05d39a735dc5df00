"""Emission of LLVM instructions on vectors of float32: what the emitters of the kernels write with."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]

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
