"""The input that leads a drive along a path. This file's text is compiled behind a header that imports, never imported.

The header gives `linearise` of the drive (`chain_loops`), and `first_acting` and `bounded_moves` of `inverse.drive`.
"""
# ruff: noqa: F821  (the header's names)
# mypy: ignore-errors
# pyright: reportUndefinedVariable=false

import numpy as np

from hystmpc.models.kernels.numba_ import njit


@njit(cache=True, error_model="numpy", nogil=True)
def fit(state, p, dt, k, wanted, u_last, reach, numbers, inputs, outputs):
    """`Drive.fit`: inputs (H,) and outputs (H,) in place; answers the first sample that the inputs change.

    numbers: weight of the moves, linearisations, share of the outputs' change that the linearisation may miss.
    """
    size = wanted.size
    response, moves, found = np.empty((size, size)), np.zeros(size), np.empty(size)
    before, promised = np.empty(size), np.empty(size)
    inputs[:] = u_last
    linearise(state, inputs, p, dt, k, outputs, response)
    first = first_acting(response)
    for _ in range(int(numbers[1])):
        for i in range(size):  # by command -> by move
            for j in range(i - 1, -1, -1):
                response[i, j] += response[i, j + 1]
        found[:] = moves
        bounded_moves(response, wanted - outputs, found, reach, numbers[0])
        change, total = 0.0, 0.0
        for i in range(size):
            promised[i] = outputs[i]
            for j in range(i + 1):
                promised[i] += response[i, j] * (found[j] - moves[j])
        for i in range(size):
            total += found[i]
            moves[i], inputs[i], before[i] = found[i], u_last + total, outputs[i]
        linearise(state, inputs, p, dt, k, outputs, response)
        missed = 0.0
        for i in range(size):
            missed, change = max(missed, abs(outputs[i] - promised[i])), max(change, abs(outputs[i] - before[i]))
        if missed <= numbers[2] * max(1.0, change):
            break
    return first
