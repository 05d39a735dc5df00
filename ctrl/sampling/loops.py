"""Compiled parts of the sampling planners: drawing plans, fitting a slope to their angles, weighing them."""

from __future__ import annotations

from typing import Any

import numpy as np

from hystmpc.models.inverse.follow import clip_plans
from hystmpc.models.kernels.numba_ import njit

_SMALL = 1e-12  # squared distance of a sample from the start below which it says nothing
_RIDGE = 1e-6  # of the fit, as a share of its normal matrix's trace
_TINY = float(np.finfo(np.float64).tiny)


@njit(cache=True, error_model="numpy", nogil=True)
def draw_plans(
    normals: Any,
    shape: Any,
    mean: Any,
    deviations: Any,
    low: float,
    high: float,
    reach: float,
    u_last: float,
    plans: Any,
) -> None:
    """Admissible plans (N, H) = mean + deviations * (w shape), in place; w (N, m) are `normals` made orthogonal.

    shape (m, H); mean (H,); deviations (N, 1) or (1, H).
    """
    make_orthogonal(normals)
    plans[:] = 0.0
    for n in range(normals.shape[0]):
        for j in range(normals.shape[1]):
            add(plans[n], normals[n, j], shape[j])
    plans[:] = mean + deviations * plans
    clip_plans(plans, low, high, reach, u_last)


@njit(cache=True, error_model="numpy", nogil=True)
def make_orthogonal(normals: Any) -> None:
    """The first m rows of (N, m), the next m and so on made orthogonal in place; every row keeps its length."""
    count, size = normals.shape
    squares = np.empty(count)
    for n in range(count):
        row = normals[n]
        squares[n] = product(row, row)
        for other in range(n - n % size, n):
            add(row, -product(normals[other], row) / squares[other], normals[other])
        row *= np.sqrt(squares[n] / product(row, row))


@njit(cache=True, error_model="numpy", nogil=True)
def fit_columns(
    plans: Any, angles: Any, commands: Any, start_angles: Any, ends: Any, whitening: Any, columns: Any
) -> None:
    """S F^-1 (H, m) in place: the fit in `SampledGaussNewton` to plans (N, H) and angles (N, H) around a start plan.

    ends (m,): last samples of the blocks; whitening (m, m): F^-1, transposed.
    """
    size, horizon = ends.size, commands.size
    normal, products = np.zeros((size, size)), np.zeros((size, horizon))
    z, column = np.empty(size), np.empty(horizon)
    for n in range(plans.shape[0]):
        z[:] = 0.0
        for j in range(size):
            add(z, plans[n, ends[j]] - commands[ends[j]], whitening[j])
        change = angles[n] - start_angles
        near = 1.0 / max(product(z, z), _SMALL) ** 2
        for j in range(size):
            add(normal[j, j:], near * z[j], z[j:])
            add(products[j], near * z[j], change)
    # no sample may have moved at all: then the slope is zero
    ridge = _RIDGE * np.trace(normal) + _TINY
    for j in range(size):
        normal[j, j] += ridge
    solve(normal, products)
    for i in range(size):
        column[:] = 0.0
        for j in range(size):
            add(column, whitening[i, j], products[j])
        columns[:, i] = column


@njit(cache=True, error_model="numpy", nogil=True)
def solve(matrix: Any, right: Any) -> None:
    """`right` (m, H) becomes X of matrix X = right, by matrix = R'R; only its upper triangle is read, and becomes R."""
    size = matrix.shape[0]
    for j in range(size):
        for i in range(j):
            factor = -matrix[i, j]
            add(matrix[j, j:], factor, matrix[i, j:])
            add(right[j], factor, right[i])
        root = np.sqrt(matrix[j, j])
        matrix[j, j:] /= root
        right[j] /= root
    for j in range(size - 1, -1, -1):
        for i in range(j + 1, size):
            add(right[j], -matrix[j, i], right[i])
        right[j] /= matrix[j, j]


@njit(cache=True, error_model="numpy", nogil=True)
def product(a: Any, b: Any) -> Any:
    """Inner product of two vectors."""
    total = 0.0
    for k in range(a.size):
        total += a[k] * b[k]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def add(target: Any, factor: float, row: Any) -> None:
    """target += factor * row, in place."""
    for k in range(target.size):
        target[k] += factor * row[k]


@njit(cache=True, error_model="numpy", nogil=True)
def weighted_mean(plans: Any, costs: Any, temperature: float) -> Any:
    """Mean (H,) of plans (N, H) with finite costs (N,), by exp(-(J - J_min) / lambda); see `SamplingMpcSettings`."""
    lowest = costs.min()
    scale = max(temperature * (np.median(costs) - lowest), _TINY)
    total, mean = 0.0, np.zeros(plans.shape[1])
    for n in range(plans.shape[0]):
        weight = np.exp((lowest - costs[n]) / scale)
        total += weight
        add(mean, weight, plans[n])
    return mean / total
