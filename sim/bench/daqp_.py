"""The peer of the quadratic solver: DAQP, dense and exact, where it is installed."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from hystmpc.ctrl.linearised.problem import QpData, QpPattern

Vec = NDArray[np.float64]


def installed() -> bool:
    """Whether daqp is there; it is not imported."""
    return find_spec("daqp") is not None


def dense(pattern: QpPattern, data: QpData) -> tuple[Vec, Vec, Vec, Vec, Vec]:
    """Hessian, gradient, constraint rows behind the simple bounds, upper and lower bounds, as `solve` takes them."""
    triangle = pattern.hessian.copy()
    triangle.data = data.hessian_data
    upper = triangle.toarray()
    hessian = upper + np.triu(upper, 1).T
    rows = pattern.constraints.toarray()[len(hessian) :]  # the first H rows are the identity
    return hessian, data.gradient, np.ascontiguousarray(rows), data.upper, data.lower


def solve(hessian: Vec, gradient: Vec, rows: Vec, upper: Vec, lower: Vec) -> Vec:
    """Solution z (n,) of  min 1/2 z'Pz + q'z  subject to bounds on z and on `rows` z, from a cold start."""
    import daqp

    solution, _, _, _ = daqp.solve(hessian, gradient, rows, upper, lower)
    return np.asarray(solution)
