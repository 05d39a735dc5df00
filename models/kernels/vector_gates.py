"""What becomes of the sums of an LSTM's four gates: cell and output of a row, or of a row's derivative.

All four gates are hyperbolic tangents, sigmoid(z) = 1/2 + 1/2 tanh(z/2), with the inner half already in the weights:
the sums arrive as z_i / 2, z_f / 2, z_g, z_o / 2. A hyperbolic tangent is a fraction P / Q of two polynomials, and
divisions are slow: a row of a roll-out brings its gates to a common denominator and divides twice, not five times.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from .vector_code import VectorCode

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


def _fraction(code: VectorCode, x: Any) -> tuple[Any, Any]:
    """P and Q of tanh(x) = P / Q, 1 < Q < 600: products of three stay far from the ends of float32."""
    x = code.clamp(x, LIMIT)
    s = code.mul(x, x)
    return code.mul(x, code.polynomial(s, ODD)), code.polynomial(s, EVEN)


def _tanh(code: VectorCode, x: Any) -> Any:
    return code.div(*_fraction(code, x))
