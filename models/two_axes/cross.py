"""Identification of the friction that both axes share and of their static coupling, from what their models leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.trials.types import Mask, Vec

from .model import AXES, COUPLED, Coupled, CrossFriction

SHARES = (0.005, 0.01, 0.02, 0.035, 0.06, 0.1, 0.16)
"""Radii that are offered, as shares of the greatest range of a travel."""
LAGS_S = (0.0, 0.05, 0.1, 0.2)
"""Time constants of the drives in front that are compared [s]."""
DELAYS_S = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2)
"""Delays in front of these that are compared [s]."""

_RIDGE = 1e-4
_PARTS = 6  # parts that are left out one after another


def shared_friction(
    travels: Sequence[Vec], left: Sequence[Vec], dt_s: float, seen: Mask | None = None
) -> CrossFriction | None:
    """Friction and coupling of least error on what the models of both axes leave; None if parts left out need neither.

        min_k sum_t |e_i - o - sum_j k_ij z_ji|^2 + ridge sum_j s_j^2 k_ij^2,    o of each trial, s_j the size of z_j

    z are the plays b_j - p_j, and in a second search the products of the travels too, see `CrossFriction`. Either is
    kept where the mean square error on parts left out falls by more than its standard error.

    Args:
        travels: w (T, 2) of every trial.
        left: e = y - f(w) (T, 2) of every trial [deg].
        dt_s: sample time [s].
        seen: samples of all trials, one behind the other, that count (T,); all where left out.
    """
    counted = slice(None) if seen is None else seen
    target = np.vstack([e - e.mean(0) for e in left])[counted]
    kept: _SharedFit | None = None
    for coupled in (False, True):
        best = min(
            (_SharedFit.of(travels, target, dt_s, drive, coupled, counted) for drive in _drives(dt_s)),
            key=lambda one: float(one.squares.mean()),
        )
        gain = (_squares(target, None) if kept is None else kept.squares) - best.squares
        if gain.mean() > gain.std() / np.sqrt(_PARTS):
            kept = best
    return None if kept is None else kept.friction(target)


def _drives(dt_s: float) -> list[tuple[float, float]]:
    """Delays and time constants [s], each delay in whole samples."""
    delays = sorted({round(delay / dt_s) * dt_s for delay in DELAYS_S})
    return [(delay, lag) for delay in delays for lag in LAGS_S]


@dataclass(frozen=True, eq=False)
class _SharedFit:
    """Columns (T, 2, K) behind a drive, and mean square errors on parts left out (parts,)."""

    radii: tuple[float, ...]
    drive: tuple[float, float]
    columns: Vec
    squares: Vec

    @classmethod
    def of(
        cls,
        travels: Sequence[Vec],
        target: Vec,
        dt_s: float,
        drive: tuple[float, float],
        coupled: bool,
        counted: Mask | slice,
    ) -> _SharedFit:
        """With the products of the travels where `coupled`, of the samples that are counted."""
        span = max(float(np.ptp(w, axis=0).max()) for w in travels)
        radii, blocks = tuple(share * span for share in SHARES), []
        parts = [CrossFriction(lag_s=0.0, radii=(r,), weights=((1.0,), (1.0,))) for r in radii]
        if coupled:
            units = [_coupled(row) for row in np.eye(COUPLED).tolist()]
            parts += [CrossFriction(lag_s=0.0, radii=(), weights=((), ()), coupling=(one, one)) for one in units]
        parts = [part.model_copy(update={"delay_s": drive[0], "lag_s": drive[1]}) for part in parts]
        for w in travels:
            z = np.stack([part.run(w, dt_s) for part in parts], axis=2)
            blocks.append(z - z.mean(0))
        columns = np.concatenate(blocks)[counted]
        return cls(radii, drive, columns, _squares(target, columns))

    def friction(self, target: Vec) -> CrossFriction:
        """Of all parts."""
        x, y = (_solved(self.columns[:, i], target[:, i]).tolist() for i in range(AXES))
        count = len(self.radii)
        return CrossFriction(
            delay_s=self.drive[0],
            lag_s=self.drive[1],
            radii=self.radii,
            weights=(tuple(x[:count]), tuple(y[:count])),
            coupling=(_coupled(x[count:]), _coupled(y[count:])) if len(x) > count else None,
        )


def _coupled(weights: Sequence[float]) -> Coupled:
    a, b, c, d, e = weights
    return a, b, c, d, e


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
    sizes = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), np.finfo(np.float64).tiny)
    scaled = columns / sizes
    square = scaled.T @ scaled
    square += _RIDGE * len(target) * np.eye(len(square))
    return np.asarray(np.linalg.solve(square, scaled.T @ target) / sizes)
