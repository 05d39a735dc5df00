"""Loops around a generated step. This file's text is compiled behind the generated functions, never imported.

The generated functions, on flat float64 arrays (state x, command u (1,), parameters p, sample time dt (1,), constants
k...):

    step(x, u, p, dt, theta (1,), following (S,), k)
    tangent(x, u, p, dt, theta, following, A (S*S,), B (S,), C (S,), D (1,), k): also d following / d x and d u,
        d theta / d x and d u, matrices column-major
    slope(x, u, p, dt, theta, D (1,), k): theta and d theta / d u alone
"""
# ruff: noqa: F821  (step, tangent and slope are generated)
# mypy: ignore-errors
# pyright: reportUndefinedVariable=false

import numpy as np

from hystmpc.models.kernels.numba_ import njit


@njit(cache=True, error_model="numpy", nogil=True)
def simulate(state, commands, p, dt, k, theta):
    """Free run of N rows: state (N, S) is overwritten by the last state, theta (N, T) is filled."""
    rows, samples = commands.shape
    size = state.shape[1]
    following = np.empty(size)
    x = np.empty(size)
    for n in range(rows):
        x[:] = state[n]
        for t in range(samples):
            step(x, commands[n, t : t + 1], p, dt, theta[n, t : t + 1], following, k)
            x[:] = following
        state[n] = x


@njit(cache=True, error_model="numpy", nogil=True)
def rollout(state, plans, p, dt, k, theta):
    """N plans (N, H) from one state (S,); theta (N, H) is filled, the state kept."""
    rows, samples = plans.shape
    following = np.empty(state.size)
    x = np.empty(state.size)
    for n in range(rows):
        x[:] = state
        for t in range(samples):
            step(x, plans[n, t : t + 1], p, dt, theta[n, t : t + 1], following, k)
            x[:] = following


@njit(cache=True, error_model="numpy", nogil=True)
def linearise(state, plan, p, dt, k, theta, jacobian):
    """Angles (H,) and their Jacobian (H, H) along one plan by forward sensitivity."""
    size, samples = state.size, plan.size
    x, following = state.copy(), np.empty(size)
    a, b, c, d = np.empty(size * size), np.empty(size), np.empty(size), np.empty(1)
    moving, moved = np.zeros((size, samples)), np.zeros((size, samples))
    for t in range(samples):
        tangent(x, plan[t : t + 1], p, dt, theta[t : t + 1], following, a, b, c, d, k)
        x[:] = following
        for j in range(t):  # only commands already given have a tangent
            value = 0.0
            for i in range(size):
                value += c[i] * moving[i, j]
            jacobian[t, j] = value
            for i in range(size):
                value = 0.0
                for m in range(size):
                    value += a[i + m * size] * moving[m, j]
                moved[i, j] = value
        jacobian[t, t] = d[0]
        jacobian[t, t + 1 :] = 0.0
        moved[:, t] = b
        moving, moved = moved, moving


@njit(cache=True, error_model="numpy", nogil=True)
def command_for(state, wanted, low, high, last, p, dt, k):
    """Command in [low, high] that brings the next angle to `wanted`: bracketed Newton on the exact derivative.

    The step is taken to be non-decreasing in the command. On a flat branch that already shows `wanted` the command
    nearest to `last` is kept.
    """
    theta, d = np.empty(1), np.empty(1)
    u = np.array([min(max(last, low), high)])
    tolerance = 1e-11 * max(1.0, abs(wanted))
    for _ in range(200):
        slope(state, u, p, dt, theta, d, k)
        miss = wanted - theta[0]
        if abs(miss) <= tolerance:
            break
        if miss > 0.0:
            low = u[0]
        else:
            high = u[0]
        if high - low <= 1e-13 * max(1.0, abs(high)):
            break
        newton = u[0] + miss / d[0] if d[0] > 0.0 else high + 1.0
        inside = low < newton < high
        # At an end of the range that is the answer, Newton points outside: try the end itself before halving.
        u[0] = newton if inside else 0.5 * (low + high)
    return u[0]
