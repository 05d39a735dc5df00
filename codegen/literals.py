"""Numbers and tables of numbers as C text, exact in double precision."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from hystmpc.models.stages import CODES

EXACT = ("fabs", "sqrt", "rint", "ceil", "floor", "fmaf")
"""Functions of <math.h> whose results are exact or rounded correctly wherever floating point is IEC 60559."""
INEXACT = ("exp", "log", "log1p", "tanh", "sin", "cos", "pow")
"""Functions of <math.h> whose last digits differ from one C library to the next."""

_CHAIN_HEAD, _STAGE = 8, 9  # numbers of a chain before its outputs, and of a stage; see `core/chain.h`
_HEAD, _PHASES, _WORDS, _KEPT = 20, 9, 5, 5  # of a table, see `core/program.h`; place of the number of kept values


def number(value: float) -> str:
    """C text of a number of the engine, `R(0.5)`; infinity and not-a-number by the macros of <math.h>."""
    if math.isnan(value):
        return "((real)NAN)"
    sign = math.copysign(1.0, value) < 0
    text = "((real)INFINITY)" if math.isinf(value) else f"R({abs(float(value))!r})"
    return f"(-{text})" if sign else text


def table(name: str, kind: str, values: Iterable[str]) -> str:
    """C text of a constant array, a line of at most 120 characters; with one zero where there are no values."""
    lines, line = [f"static const {kind} {name}[] = {{"], "   "
    for value in list(values) or ["0"]:
        if len(line) + len(value) + 2 > 120:
            lines, line = [*lines, line], "   "
        line += f" {value},"
    return "\n".join([*lines, line, "};", ""])


def literal(value: float, single: bool) -> str:
    """C literal that gives exactly this number, or in single precision the nearest one."""
    with np.errstate(over="ignore"):
        rounded = float(np.float32(value)) if single else float(value)
    if math.isnan(rounded):
        return "(real)NAN"
    if math.isinf(rounded):
        return "(real)INFINITY" if rounded > 0 else "-(real)INFINITY"
    return f"{np.format_float_scientific(np.float32(rounded), trim='0')}F" if single else repr(rounded)


def functions_called(chain: Iterable[int], at_rest: bool = False) -> tuple[str, ...]:
    """Functions of <math.h> that a chain's step calls, sample by sample.

    Args:
        chain: block of whole numbers, see `core/chain.h`.
        at_rest: whether states at rest are computed too.
    """
    words, used = list(chain), set[int]()
    for stage in range(words[0]):
        place = _CHAIN_HEAD + words[6] + _STAGE * stage
        for at in words[place : place + 1 + at_rest]:
            used.update(_operations(words[at:]) if at >= 0 else ())
    return tuple(name for name in (*EXACT, *INEXACT) if CODES.get(name) in used)


def _operations(words: Sequence[int]) -> Iterator[int]:
    """Operations of a table that are done in every sample, or for a state at rest."""
    lengths, at = words[_HEAD - _PHASES : _HEAD], _HEAD + words[_KEPT]
    for phase, length in enumerate(lengths):
        if phase:
            yield from words[at : at + _WORDS * length : _WORDS]
        at += _WORDS * length
