"""Two ways to write an operator's equation once, measured on the play operator.

A: the equation takes the module of its array operations as an argument (`play(u, z, r, np)`).
B: the equation is a CasADi expression, its instruction list is translated
   (`models/kernels/program.py`); this is what we use.

Run: python lab/benchmarks/operator_backends.py
"""

from __future__ import annotations

import timeit
from typing import Any

import casadi as ca
import numpy as np
from rich.console import Console
from rich.table import Table

from hystmpc.models.chain import Chain
from hystmpc.models.kernels.chain_kernels import compile_step
from hystmpc.models.kernels.program import NUMPY, array_program
from hystmpc.models.operators.hysteresis import Play

SAMPLES, BATCH = 1000, 256


def play_of(xp: Any, u: Any, z: Any, r: Any) -> Any:
    """Way A: z = max(u - r, min(u + r, z))."""
    return xp.maximum(u - r, xp.minimum(u + r, z))


def seconds(run: Any, number: int) -> float:
    """Best of five, per call [s]."""
    return min(timeit.repeat(run, number=number, repeat=5)) / number


def main() -> None:
    """Print time per sample and what each way gives without further work."""
    chain, dt = Chain(Play(0.4)), np.array([0.04])
    kernels, p = compile_step(chain.transition), chain.values
    scope: dict[str, Any] = {"np": np}
    program = array_program(chain.transition, "step", NUMPY)
    exec(program.source, scope)
    one, many = np.array([[1.0]]), np.ones((1, BATCH))
    u, theta, state = np.ones((1, SAMPLES)), np.empty((1, SAMPLES)), np.zeros((1, 1))
    jacobian, angles = np.empty((20, 20)), np.empty(20)
    plan = np.linspace(0, 2, 20)
    rows = [
        ("A, NumPy, one sample", seconds(lambda: play_of(np, 1.0, 0.5, 0.4), 2000), 1),
        ("A, NumPy, batch of 256", seconds(lambda: play_of(np, many, many, 0.4), 2000), BATCH),
        ("B, NumPy source, one sample", seconds(lambda: scope["step"](one, one, p, dt, program.constants), 2000), 1),
        (
            "B, NumPy source, batch of 256",
            seconds(lambda: scope["step"](many, many, p, dt, program.constants), 2000),
            BATCH,
        ),
        ("B, CasADi evaluation, one sample", seconds(lambda: chain.transition(0.5, 1.0, ca.DM(p), 0.04), 2000), 1),
        (
            "B, compiled, 1000 samples",
            seconds(lambda: kernels.simulate(state, u, p, dt, kernels.step_constants, theta), 200),
            SAMPLES,
        ),
        (
            "B, compiled, Jacobian over 20 samples",
            seconds(
                lambda: kernels.linearise(state[0], plan, p, dt, kernels.tangent_constants, angles, jacobian), 2000
            ),
            20,
        ),
    ]
    table = Table("way", "time a sample [ns]", title="The play operator, two ways")
    for name, time, count in rows:
        table.add_row(name, f"{1e9 * time / count:.1f}")
    Console().print(table)
    Console().print(
        "A gives values where a module of array operations exists; Jacobians, ONNX nodes and compiled code would each "
        "be written again. B gives all of them, parameter sensitivities included, from the one expression."
    )


if __name__ == "__main__":
    main()
