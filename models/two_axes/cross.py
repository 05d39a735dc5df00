"""Identification of the friction that both axes share, from what their models leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.types import Vec

from .model import AXES, CrossFriction

SHARES = (0.005, 0.01, 0.02, 0.035, 0.06, 0.1, 0.16)
"""Radii that are offered, as shares of the greatest range of a travel."""
LAGS_S = (0.0, 0.05, 0.1, 0.2)
"""Time constants of the drives in front that are compared [s]."""

_RIDGE = 1e-4
_PARTS = 6  # parts that are left out one after another


def shared_friction(travels: Sequence[Vec], left: Sequence[Vec], dt_s: float) -> CrossFriction | None:
    """Friction of least error on what the models of both axes leave; None where parts left out do not need it.

        min_k sum_t |e_i - o - sum_j k_ij z_ji|^2 + ridge |k|^2,    z_j = b_j - p_j,    o of each trial

    It is kept where the mean square error on parts left out falls by more than its standard error.

    Args:
        travels: w (T, 2) of every trial.
        left: e = y - f(w) (T, 2) of every trial [deg].
        dt_s: sample time [s].
    """
    span = max(float(np.ptp(w, axis=0).max()) for w in travels)
    radii = tuple(share * span for share in SHARES)
    target = np.vstack([e - e.mean(0) for e in left])
    before, best = _squares(target, None), None
    for lag_s in LAGS_S:
        columns = _columns(travels, radii, lag_s, dt_s)
        squares = _squares(target, columns)
        if best is None or squares.mean() < best[0].mean():
            best = squares, lag_s, columns
    assert best is not None
    gain = before - best[0]
    if not gain.mean() > gain.std() / np.sqrt(_PARTS):
        return None
    weights = [_solved(best[2][:, i], target[:, i]) for i in range(AXES)]
    return CrossFriction(lag_s=best[1], radii=radii, weights=(tuple(weights[0]), tuple(weights[1])))


def _columns(travels: Sequence[Vec], radii: Sequence[float], lag_s: float, dt_s: float) -> Vec:
    """z (T, 2, J) of all trials, each without its mean."""
    made = []
    for w in travels:
        one = [CrossFriction(lag_s=lag_s, radii=(r,), weights=((1.0,), (1.0,))).run(w, dt_s) for r in radii]
        z = np.stack(one, axis=2)
        made.append(z - z.mean(0))
    return np.concatenate(made)


def _squares(target: Vec, columns: Vec | None) -> Vec:
    """Mean square errors on parts left out (parts,); without columns those of nothing."""
    squares = np.empty(_PARTS)
    for k, part in enumerate(np.array_split(np.arange(len(target)), _PARTS)):
        seen = np.ones(len(target), dtype=bool)
        seen[part] = False
        error = target[part].copy()
        for i in range(AXES if columns is not None else 0):
            assert columns is not None
            error[:, i] -= columns[part, i] @ _solved(columns[seen, i], target[seen, i])
        squares[k] = float(np.mean(error**2))
    return squares


def _solved(columns: Vec, target: Vec) -> Vec:
    square = columns.T @ columns
    square += _RIDGE * np.trace(square) / len(square) * np.eye(len(square))
    return np.asarray(np.linalg.solve(square, columns.T @ target))
