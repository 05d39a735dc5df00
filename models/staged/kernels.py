"""Compiled kernels of one operator over whole trials, shared by all operators of the same structure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, final

import numpy as np

from hystmpc.trials.types import Vec

from ..kernels.numba_ import generated_module
from ..operators.operator import Operator
from .source import stage_source


@final
@dataclass(frozen=True, eq=False)
class StageKernels:
    """What is compiled for an operator with S states and P parameters, for N rows of T samples, time first.

    Attributes:
        prepare: (p (P, N), dt, k, c) fills c, everything that does not change from sample to sample, for `simulate`.
        simulate: (x (S, N), u (T, N), c, y (T, N)) runs all rows; x goes on.
        prepare_slopes, differentiate: the same for one row with tangents, (x (S,), m (S, Q), u (T,), du (T, Q), c,
            own, count, y (T,), dy (T, Q)): of the Q directions the first `count` are in use, the operator's own
            parameters from `own` on.
        rest: (u, seen, p (P,), k, x (S,), slope (S, P), by_u (S,), by_seen (S,)) the state at rest at input u and
            output seen, and its derivatives.
        constants: arguments k of `prepare`, `prepare_slopes` and `rest`.
        kept: rows of c for `simulate` and `differentiate`.
    """

    prepare: Callable[..., None]
    simulate: Callable[..., None]
    prepare_slopes: Callable[..., None]
    differentiate: Callable[..., None]
    rest: Callable[..., None]
    constants: tuple[Vec, Vec, Vec]
    kept: tuple[int, int]


def stage_kernels(operator: Operator) -> StageKernels:
    """Kernels of an operator's structure; compiled at their first call, kept on disk."""
    return _compile(type(operator), tuple(operator.structure.items()))


@lru_cache(maxsize=256)
def _compile(kind: type[Operator], structure: tuple[tuple[str, Any], ...]) -> StageKernels:
    source = stage_source(kind.template(**dict(structure)))
    module = generated_module("import math\n\n\n" + source.text)
    plain, exact, rest = (np.array(k, dtype=np.float64) for k in source.constants)
    return StageKernels(
        module.prepare,
        module.simulate,
        module.prepare_slopes,
        module.differentiate,
        module.rest,
        (plain, exact, rest),
        source.kept,
    )
