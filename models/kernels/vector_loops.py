"""Loops around the vector kernel. This file's text is compiled behind a header that chooses sizes, never imported.

The header gives LANES, ROWS and PARTS, the numbers a unit that are remembered, and `motions`, `first` and `tangents`:
functions as in `vector_emitter`. The rows of a table x (R, LANES + L U) are [.., v, h_1, ..., h_L], the scaled command
last in a vector of its own, the outputs of all layers behind it: what a layer reads, the new output of the layer below
and its own old one, stands side by side.
"""
# ruff: noqa: F821  (the header's names)
# mypy: ignore-errors
# pyright: reportUndefinedVariable=false

import numpy as np

from hystmpc.models.kernels.numba_ import njit

PLANS = 36  # at a time: with a panel of the weights their rows are in the first cache


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"})
def head_of(head, x, row):
    """Scaled angle of a row, the bias left out: the last layer's outputs stand at the end.

    In double: then the order of the sum, which is the compiler's, is not seen, and exported C has the same angle.
    """
    total = 0.0
    start = x.shape[1] - head.size
    for unit in range(head.size):
        total += np.float64(head[unit]) * np.float64(x[row, start + unit])
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def load(state, hidden, layers, x, c, row):
    """State (PARTS L H,) into one row of the tables."""
    units = c.shape[2]
    for layer in range(layers):
        for unit in range(hidden):
            x[row, LANES + layer * units + unit] = state[PARTS * layer * hidden + unit]
            c[layer, row, unit] = state[(PARTS * layer + PARTS - 1) * hidden + unit]


@njit(cache=True, error_model="numpy", nogil=True)
def show(h, rows, x, layer):
    """Outputs of a layer to where the next layer and the next sample read them."""
    units = h.shape[1]
    start = LANES + layer * units
    for row in range(rows):
        for unit in range(units):
            x[row, start + unit] = h[row, unit]


@njit(cache=True, error_model="numpy", nogil=True)
def move(weights, rows, x, c, h):
    """One sample of `rows` motions through all layers."""
    layers, panels, units = weights.shape[0], weights.shape[1], h.shape[1]
    for layer in range(layers):
        column = LANES - 1 if layer == 0 else LANES + (layer - 1) * units
        inputs = 1 + units if layer == 0 else 2 * units
        for panel in range(panels):
            for row in range(0, rows, ROWS):
                count = min(ROWS, rows - row)
                motions(count, weights[layer], panel, inputs, x, row, column, c[layer], h, h)
        show(h, rows, x, layer)


@njit(cache=True, error_model="numpy", nogil=True)
def differentiate(weights, rows, x, c, h, factors):
    """One sample of a motion, row 0, and of derivatives along it; blocks of rows as even as can be."""
    layers, panels, units = weights.shape[0], weights.shape[1], h.shape[1]
    blocks = (rows + ROWS - 1) // ROWS
    for layer in range(layers):
        column = LANES - 1 if layer == 0 else LANES + (layer - 1) * units
        inputs = 1 + units if layer == 0 else 2 * units
        for panel in range(panels):
            row = (rows + blocks - 1) // blocks
            first(row, weights[layer], panel, inputs, x, 0, column, c[layer], h, factors)
            for block in range(1, blocks):
                count = (rows - row + blocks - block - 1) // (blocks - block)
                tangents(count, weights[layer], panel, inputs, x, row, column, c[layer], h, factors)
                row += count
        show(h, rows, x, layer)


@njit(cache=True, error_model="numpy", nogil=True)
def unload(following, hidden, layers, x, c, row):
    """State (PARTS L H,) from one row of the tables."""
    units = c.shape[2]
    for layer in range(layers):
        for unit in range(hidden):
            following[PARTS * layer * hidden + unit] = x[row, LANES + layer * units + unit]
            following[(PARTS * layer + PARTS - 1) * hidden + unit] = c[layer, row, unit]


@njit(cache=True, error_model="numpy", nogil=True)
def rollout(packed, state, plans, begin, end, angles, following):
    """Angles (N, K) [deg] of the plans `begin` to `end` of (N, K) from one state (S,), and states behind them.

    `following` (M, S) takes the states behind the first M plans; M = 0 where nobody asks for them.
    """
    weights, head, scaling, hidden = packed.weights, packed.head, packed.scaling, packed.hidden
    layers, units = weights.shape[0], head.size
    blocks = (end - begin + ROWS - 1) // ROWS
    chunks = max(1, (blocks * ROWS + PLANS - 1) // PLANS)
    most = min(end - begin, ROWS * ((blocks + chunks - 1) // chunks))
    x = np.empty((most, LANES + layers * units), np.float32)
    c = np.empty((layers, most, units), np.float32)
    h = np.empty((most, units), np.float32)
    for start in range(begin, end, most):
        rows = min(most, end - start)
        x[:] = 0.0
        c[:] = 0.0
        for row in range(rows):
            load(state, hidden, layers, x, c, row)
        for k in range(plans.shape[1]):
            for row in range(rows):
                x[row, LANES - 1] = (plans[start + row, k] - scaling[0]) / scaling[1]
            move(weights, rows, x, c, h)
            for row in range(rows):
                angles[start + row, k] = scaling[2] + scaling[3] * (head_of(head, x, row) + packed.head_bias)
        for row in range(min(rows, len(following) - start)):
            unload(following[start + row], hidden, layers, x, c, row)


@njit(cache=True, error_model="numpy", nogil=True)
def linearise(packed, state, plan, angles, jacobian):
    """Angles (K,) [deg] along one plan (K,) and their derivatives (K, K), whose upper part is left alone.

    Row 0 is the motion, row j the derivative by command j - 1; it joins at that command's own sample.
    """
    weights, head, scaling, hidden = packed.weights, packed.head, packed.scaling, packed.hidden
    layers, units, count = weights.shape[0], head.size, plan.size
    x = np.zeros((1 + count, LANES + layers * units), np.float32)
    c = np.zeros((layers, 1 + count, units), np.float32)
    h = np.empty((1 + count, units), np.float32)
    factors = np.empty((6, units), np.float32)
    load(state, hidden, layers, x, c, 0)
    gain = scaling[3] / scaling[1]
    for k in range(count):
        x[k, LANES - 1] = 0.0  # the last command's share has come in
        x[1 + k, LANES - 1] = 1.0
        x[0, LANES - 1] = (plan[k] - scaling[0]) / scaling[1]
        differentiate(weights, 2 + k, x, c, h, factors)
        angles[k] = scaling[2] + scaling[3] * (head_of(head, x, 0) + packed.head_bias)
        for j in range(k + 1):
            jacobian[k, j] = gain * head_of(head, x, 1 + j)


@njit(cache=True, error_model="numpy", nogil=True)
def sample(packed, states, rows, v, theta):
    """One sample of the first `rows` states (2, S) under commands v (2,), in place; theta (2,) takes the angles."""
    head, scaling, layers = packed.head, packed.scaling, packed.weights.shape[0]
    x = np.zeros((rows, LANES + layers * head.size), np.float32)
    c = np.zeros((layers, rows, head.size), np.float32)
    h = np.empty((rows, head.size), np.float32)
    for row in range(rows):
        load(states[row], packed.hidden, layers, x, c, row)
        x[row, LANES - 1] = (v[row] - scaling[0]) / scaling[1]
    move(packed.weights, rows, x, c, h)
    for row in range(rows):
        theta[row] = scaling[2] + scaling[3] * (head_of(head, x, row) + packed.head_bias)
        unload(states[row], packed.hidden, layers, x, c, row)
