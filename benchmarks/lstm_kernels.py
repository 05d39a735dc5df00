"""LSTM kernels against the machine's limit: the best float32 matrix product of the same process, one thread.

    python benchmarks/lstm_kernels.py [--hidden 64] [--layers 2]

Times are medians; a ratio of 1 is the time that the multiplications alone would take at the limit's speed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import scipy.linalg  # noqa: F401  its BLAS is the one that compiled code calls: loaded before threads are limited
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from hystmpc.models.kernels import lstm_kernels
from hystmpc.models.lstm.onnxruntime_ import RolloutSession
from hystmpc.models.lstm.weights import LstmLayer, LstmWeights

PLANS, HORIZON = 256, 20


def median_us(job: Callable[[], object], repeats: int) -> float:
    """Median time of a job [us], after two runs to warm up."""
    times = []
    for _ in range(repeats + 2):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times[2:]))


def matrix_product_gflops() -> float:
    """Best of twenty float32 products of 1024 x 1024 [GFLOP/s]."""
    a = np.random.default_rng(0).normal(size=(1024, 1024)).astype(np.float32)
    out, best = np.empty_like(a), np.inf
    for _ in range(20):
        start = time.perf_counter()
        np.dot(a, a, out=out)
        best = min(best, time.perf_counter() - start)
    return 2 * 1024**3 / best / 1e9


def example(hidden: int, layers: int) -> LstmWeights:
    """Random weights with gains of about one."""
    rng = np.random.default_rng(0)
    stack = []
    for k in range(layers):
        inputs = 1 if k == 0 else hidden
        shapes = ((4 * hidden, inputs), (4 * hidden, hidden), (4 * hidden,))
        stack.append(LstmLayer(*(rng.normal(size=shape) / np.sqrt(hidden) for shape in shapes)))
    return LstmWeights(tuple(stack), rng.normal(size=hidden) / np.sqrt(hidden), 0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hidden", type=int, default=64)
    parser.add_argument("--layers", type=int, default=2)
    given = parser.parse_args()
    threadpool_limits(1)
    weights = example(given.hidden, given.layers)
    packed, rng = lstm_kernels.pack_lstm(weights), np.random.default_rng(1)
    state = 0.3 * rng.normal(size=(2 * given.layers, given.hidden)).astype(np.float32)
    plans = rng.uniform(0, 6, (PLANS, HORIZON)).astype(np.float32)
    roll, one, angle = RolloutSession(weights), np.zeros(1, np.float32), np.empty(1, np.float32)
    step_flop = 2 * sum(layer.w_ih.size + layer.w_hh.size for layer in weights.layers)
    rows = [
        ("one step", median_us(lambda: lstm_kernels.advance(packed, state.copy(), one, angle), 5000), 1),
        (
            f"roll-out, {PLANS} plans of {HORIZON}",
            median_us(lambda: roll(state.ravel(), plans), 100),
            PLANS * HORIZON,
        ),
    ]
    for count in (10, 20, 50):
        plan, theta = rng.uniform(-1, 1, count).astype(np.float32), np.empty(count, np.float32)
        jacobian = np.zeros((count, count), np.float32)
        took = median_us(lambda p=plan, t=theta, j=jacobian: lstm_kernels.linearise(packed, state, p, t, j), 200)
        rows.append((f"Jacobian, horizon {count}", took, count + count * (count + 1) // 2))
    limit = matrix_product_gflops()
    table = Table(title=f"{given.layers} layers of {given.hidden}; limit {limit:.0f} GFLOP/s, one thread")
    for column in ("job", "us", "over the limit", "share of the limit"):
        table.add_column(column, justify="left" if column == "job" else "right")
    for name, took, steps in rows:
        ideal = step_flop * steps / limit / 1e3
        table.add_row(name, f"{took:.1f}", f"{took / ideal:.2f}", f"{ideal / took:.0%}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
