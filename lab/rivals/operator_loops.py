"""Loops around a generated operator; this text is compiled after the generated functions, never imported.

The generated functions, on flat float64 arrays (state x, input u (1,), parameters p, numbers k):

    forward_step(x, u, p, y (1,), following (S,), k)
    partials(x, u, p, A (S*S,), B (S,), C (S,), D (1,), E (S*P,), F (P,), k): derivatives of following by x, u and of y
        by x, u, then of both by p; matrices column-major
"""
# ruff: noqa: F821  (forward_step and partials are generated)
# mypy: ignore-errors
# pyright: reportUndefinedVariable=false

import numpy as np

from hystmpc.models.kernels.numba_ import njit


@njit(cache=True, error_model="numpy", nogil=True)
def run(states, u, p, y, k):
    """Compute N rows of T samples: fill states (N, T + 1, S), whose first sample is given, and y (N, T).

    u (N, T), p (N, T, P).
    """
    for n in range(u.shape[0]):
        for t in range(u.shape[1]):
            forward_step(states[n, t], u[n, t : t + 1], p[n, t], y[n, t : t + 1], states[n, t + 1], k)


@njit(cache=True, error_model="numpy", nogil=True)
def pull_back(states, u, p, by_y, by_state, by_u, by_p, k):
    """Reverse sensitivity from the loss by y (N, T) and by the last state (N, S).

    Fills the derivatives by u (N, T), by p (N, T, P) and, in place of the last state's, by the first state.
    """
    size, count = states.shape[2], p.shape[2]
    a, b, c, d = np.empty(size * size), np.empty(size), np.empty(size), np.empty(1)
    e, f = np.empty(size * count), np.empty(count)
    moved = np.empty(size)
    for n in range(u.shape[0]):
        for t in range(u.shape[1] - 1, -1, -1):
            partials(states[n, t], u[n, t : t + 1], p[n, t], a, b, c, d, e, f, k)
            g = by_y[n, t]
            by_u[n, t] = g * d[0]
            for i in range(size):
                by_u[n, t] += by_state[n, i] * b[i]
            for j in range(count):
                by_p[n, t, j] = g * f[j]
                for i in range(size):
                    by_p[n, t, j] += by_state[n, i] * e[i + size * j]
            for j in range(size):
                moved[j] = g * c[j]
                for i in range(size):
                    moved[j] += by_state[n, i] * a[i + size * j]
            by_state[n, :] = moved
