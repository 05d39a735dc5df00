"""Numbers and tables of numbers as C text, exact in double precision."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hystmpc.core.chain import ChainCode
from hystmpc.models.stages import CODES

EXACT = ("fabs", "sqrt", "rint", "floor", "fmaf")
"""Functions of <math.h> whose results are exact or rounded correctly wherever floating point is IEC 60559."""
INEXACT = ("exp", "log", "tanh", "sin", "cos", "pow")
"""Functions of <math.h> whose last digits differ from one C library to the next."""

_HEAD, _PHASES, _WORDS, _KEPT = (
    19,
    8,
    5,
    5,
)  # of a table, see `core/program.h`; _KEPT: place of the number of kept values
_STEP = range(5, 8)  # phases of one sample at a time


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


def functions_called(code: ChainCode) -> tuple[str, ...]:
    """Functions of <math.h> that a chain's step calls, sample by sample."""
    used = {operation for stage in code.stages for operation in _operations(stage.table.tolist())}
    return tuple(name for name in (*EXACT, *INEXACT) if CODES.get(name) in used)


def _operations(words: list[int]) -> Iterable[int]:
    lengths, at = words[_HEAD - _PHASES : _HEAD], _HEAD + words[_KEPT]
    for phase, length in enumerate(lengths):
        if phase in _STEP:
            yield from words[at : at + _WORDS * length : _WORDS]
        at += _WORDS * length
