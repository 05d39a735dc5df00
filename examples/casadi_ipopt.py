"""The model file of a controller in your own CasADi problem: single shooting with IPOPT beside the linearised MPC.

    python examples/casadi_ipopt.py [--model builtin:lstm] [--horizon 8] [--steps 25]

`load_model(file).casadi_function()` is one sample of the model, (state, u) -> (theta, next state), with exact
derivatives; what is built from it here takes a few lines and can be changed at will:

    min  sum_k (theta_k + d - r_k)^2 + w (u_k - u_{k-1})^2   over u,  u within its limits, moves within the rate limit

Both controllers see the same measurements, state, disturbance d and reference; the linearised one drives the device.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import hystmpc
from hystmpc.sim import SimulatedPlant

Vec = NDArray[np.float64]

TERMINAL, RATE = 2.0, 3.0  # factor on the last error; weight of a move [1/mm^2]


@dataclass(frozen=True)
class Comparison:
    """One sample: both commands [mm] and what they cost [s]."""

    mpc: float
    ipopt: float
    mpc_s: float
    ipopt_s: float


def optimal_control_problem(step: ca.Function, horizon: int, limits: hystmpc.Limits, dt: float) -> Any:
    """A function (state, last command, disturbance, reference (H,), first guess (H,)) -> commands (H,)."""
    opti = ca.Opti()
    u = opti.variable(horizon)
    state, last, disturbance = opti.parameter(step.numel_in(0)), opti.parameter(), opti.parameter()
    reference = opti.parameter(horizon)
    x, errors = state, []
    for k in range(horizon):
        theta, x = step(x, u[k])
        errors.append(theta + disturbance - reference[k])
    errors[-1] *= np.sqrt(TERMINAL)
    moves = u - ca.vertcat(last, u[:-1])
    opti.minimize(ca.sumsqr(ca.vertcat(*errors)) + RATE * ca.sumsqr(moves))
    opti.subject_to(opti.bounded(limits.lower, u, limits.upper))
    opti.subject_to(opti.bounded(-limits.rate * dt, moves, limits.rate * dt))
    quiet = {"print_level": 0, "sb": "yes", "hessian_approximation": "limited-memory", "tol": 1e-6}
    opti.solver("ipopt", {"print_time": False}, quiet)
    return opti.to_function("plan", [state, last, disturbance, reference, u], [u])


def run(model_text: str, horizon: int, steps: int) -> list[Comparison]:
    """Follow a scan with the linearised MPC and ask IPOPT at every sample for its own answer."""
    model = hystmpc.load_model(model_text, start="conditioned")
    settings = {
        "kind": "linearised_mpc",
        "horizon": horizon,
        "iterations": 4,  # linearised anew four times a sample, so that it converges too
        "weights": {"terminal": TERMINAL, "rate": RATE, "effort": 0.0},
        "adaptation": None,  # IPOPT's model learns nothing
    }
    tip = hystmpc.TipController.from_config({"model": model_text, "controller": settings})
    box = model.metadata.command_limits
    limits = hystmpc.Limits(box.lower, box.upper, model.metadata.command_rate)
    step = model.casadi_function()
    problem = optimal_control_problem(step, horizon, limits, tip.dt)
    device = SimulatedPlant(hystmpc.load_simulator("builtin:tendon-catheter"), seed=1)
    y, last = device.reset(), device.rest_command
    state, guess, compared = at_rest(model, step, y, last), np.full(horizon, last), []
    rest = y
    tip.set_reference(lambda t: rest + 15.0 * (1.0 - np.cos(2.0 * np.pi * 0.5 * t)))
    with threadpool_limits(limits=1):
        for _ in range(steps):
            started = perf_counter()
            command = tip.step(y)
            between = perf_counter()
            plan = tip.plan()
            guess = np.asarray(problem(state, last, command.disturbance, plan.reference_deg, guess)).ravel()
            compared.append(Comparison(command.u, float(guess[0]), between - started, perf_counter() - between))
            y, last = device.apply(command.u), command.u
            state = np.asarray(step(state, last)[1]).ravel()
            guess = np.append(guess[1:], guess[-1])
    return compared


def at_rest(model: Any, step: ca.Function, y: float, u: float) -> Vec:
    """The model's state after resting at angle `y` [deg] and command `u`, as the controller's estimator starts."""
    state = model.initial(np.array([[y]]))[0, :-1]  # the last entry of a model's x is the angle
    for _ in range(model.metadata.warmup_samples + 1):
        state = np.asarray(step(state, u)[1]).ravel()
    return state


def main() -> None:
    """Print one row a sample."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--model", default="builtin:lstm", help="model file or builtin:NAME")
    parser.add_argument("--horizon", type=int, default=8, help="samples looked ahead")
    parser.add_argument("--steps", type=int, default=25, help="samples to run")
    arguments = parser.parse_args()
    compared = run(arguments.model, arguments.horizon, arguments.steps)
    table = Table("linearised MPC [mm]", "IPOPT [mm]", "difference [mm]", "MPC [ms]", "IPOPT [ms]")
    for c in compared:
        cells = c.mpc, c.ipopt, c.mpc - c.ipopt, 1e3 * c.mpc_s, 1e3 * c.ipopt_s
        table.add_row(*(f"{value:.{digits}f}" for value, digits in zip(cells, (4, 4, 5, 2, 1), strict=True)))
    Console().print(table)


if __name__ == "__main__":
    main()
