"""Random numbers as an equation: a generator small enough to run in every backend, in single precision too."""

from __future__ import annotations

import casadi as ca

from .operator import Symbol

Triple = tuple[Symbol, Symbol, Symbol]
_FACTORS = (171, 172, 170)
_MODULI = (30269, 30307, 30323)
_MASK = 2**64 - 1


def draw(state: Triple) -> tuple[Triple, Symbol]:
    """Next state and a number that is uniform on (0, 1).

    s_i <- a_i s_i mod m_i,  number = frac(s_1 / m_1 + s_2 / m_2 + s_3 / m_3)

    Products stay below 2^24, hence states are whole numbers exactly in single and double precision, and a remainder is
    one floor. The period is 6.95e12 draws.

    Source: Wichmann and Hill, Applied Statistics 31 (1982), algorithm AS 183, 188-190.
    """
    following = []
    total: Symbol = 0
    for s, factor, modulus in zip(state, _FACTORS, _MODULI, strict=True):
        product = factor * s
        s_next = product - modulus * ca.floor(product / modulus)
        following.append(s_next)
        total = total + s_next / modulus
    return (following[0], following[1], following[2]), total - ca.floor(total)


def start_of_seed(seed: int) -> tuple[float, float, float]:
    """Start state of a seed: three whole numbers from 1 to m_i - 1, well mixed so that near seeds are unrelated.

    Source of the mixing: splitmix64, Steele, Lea and Flood, OOPSLA 2014.
    """
    parts = []
    state = seed & _MASK
    for modulus in _MODULI:
        state = (state + 0x9E3779B97F4A7C15) & _MASK
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
        parts.append(1.0 + float((z ^ (z >> 31)) % (modulus - 1)))
    return parts[0], parts[1], parts[2]
