"""The peer of the linearised controller: single shooting in CasADi, the same model, cost and limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import casadi as ca
import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.mpc import PlanningProblem
from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.trials.types import Vec

# Primal and dual tolerance; a dual residual of 1e-3 deg^2/mm is below 1e-5 mm of command at 10 deg/mm.
_PRIMAL, _DUAL = 1e-6, 1e-3
_IPOPT = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": _DUAL,
    "ipopt.warm_start_init_point": "yes",
    "ipopt.mu_init": 1e-4,
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_bound_frac": 1e-6,
    "ipopt.warm_start_slack_bound_push": 1e-6,
    "ipopt.warm_start_slack_bound_frac": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
}
_QUIET: Mapping[str, dict[str, Any]] = {
    "osqp": {"osqp": {"verbose": False, "eps_abs": _PRIMAL, "eps_rel": _PRIMAL}},
    "qrqp": {"print_iter": False, "print_header": False},
}


@dataclass(frozen=True)
class Method:
    """Solver settings of the peer.

    Attributes:
        solver: CasADi plugin, `sqpmethod` or `ipopt`.
        gauss_newton: Hessian from the Jacobian of the angles, otherwise the solver's limited-memory one.
        iterations: bound; one makes the peer a real-time iteration like ours.
    """

    name: str
    solver: str
    gauss_newton: bool
    iterations: int


SQP = Method("CasADi SQP, Gauss-Newton", "sqpmethod", True, 50)
SQP_ONCE = Method("CasADi SQP, Gauss-Newton, one iteration", "sqpmethod", True, 1)
IPOPT = Method("CasADi IPOPT, Gauss-Newton", "ipopt", True, 100)
IPOPT_LBFGS = Method("CasADi IPOPT, L-BFGS", "ipopt", False, 100)
METHODS = (SQP, SQP_ONCE, IPOPT, IPOPT_LBFGS)


@dataclass(frozen=True, eq=False)
class Answer:
    """Solution of the peer: plan (H,), iterations, and whether it reports convergence."""

    plan: Vec
    iterations: int
    converged: bool


@final
class SingleShooting:
    """min J(u) of `PlanCost` without effort and angle limits, subject to box and rate limits, over u (H,).

    Built once; every solve starts from the last solution shifted by one sample, with its multipliers.

    Args:
        function: step (state, u) -> (theta, next state).
        horizon: H.
        dt: sample time [s].
    """

    def __init__(
        self, function: Any, limits: CommandLimits, weights: WeightsSettings, horizon: int, dt: float, method: Method
    ) -> None:
        self._limits, self._reach = limits, limits.rate * dt
        self._size = function.numel_in(0)
        self._solver = _build(function, weights, horizon, method)
        self._plan: Vec | None = None
        self._multipliers: dict[str, Any] = {}

    def solve(self, problem: PlanningProblem) -> Answer:
        """Solve one problem, whose state begins with the model's own."""
        start = np.full(problem.reference.size, problem.u_last)
        if self._plan is not None:
            start[:-1], start[-1] = self._plan[1:], self._plan[-1]
        solution = self._solver(
            x0=start,
            p=np.concatenate([problem.state[: self._size], [problem.u_last], problem.reference]),
            lbx=self._limits.lower,
            ubx=self._limits.upper,
            lbg=-self._reach,
            ubg=self._reach,
            **self._multipliers,
        )
        self._plan = np.asarray(solution["x"]).ravel()
        self._multipliers = {"lam_x0": solution["lam_x"], "lam_g0": solution["lam_g"]}
        stats = self._solver.stats()
        return Answer(self._plan, int(stats["iter_count"]), bool(stats["success"]))


def quadratic_solver() -> str:
    """The plugin that solves the peer's quadratic programs: the fastest of those that this CasADi has."""
    return next(name for name in ("daqp", "osqp", "qrqp") if ca.has_conic(name))


def _build(function: Any, weights: WeightsSettings, horizon: int, method: Method) -> Any:
    """The nonlinear program with parameters p = [state, u_last, reference]."""
    # scalar expressions for operator chains, which are a few dozen operations long; matrix ones for networks
    sym: Callable[..., Any] = ca.SX.sym if function.is_a("SXFunction") else ca.MX.sym
    size = function.numel_in(0)
    u, p = sym("u", horizon), sym("p", size + 1 + horizon)
    x, angles = p[:size], []
    for k in range(horizon):
        theta, x = function(x, u[k])
        angles.append(theta)
    error = ca.vertcat(*angles) - p[size + 1 :]
    tracking, difference = weights.over(horizon), np.eye(horizon) - np.eye(horizon, k=-1)
    moves = u - ca.vertcat(p[size], u[:-1])
    cost = ca.dot(tracking * error, error) + weights.rate * ca.dot(moves, moves)
    options = _options(method)
    if method.gauss_newton:
        jacobian = ca.jacobian(error, u)
        constant = ca.DM(weights.rate * difference.T @ difference)
        options["hess_lag"] = _hessian(method, u, p, jacobian.T @ ca.diag(ca.DM(tracking)) @ jacobian + constant, sym)
    return ca.nlpsol("peer", method.solver, {"x": u, "p": p, "f": cost, "g": moves}, options)


def _hessian(method: Method, u: Any, p: Any, half: Any, sym: Callable[..., Any]) -> Any:
    """The Lagrangian's Gauss-Newton Hessian in the form that the solver wants; the constraints are linear."""
    factor, multipliers = sym("lam_f"), sym("lam_g", u.numel())
    hessian, name = 2.0 * factor * ca.densify(half), "hess_gamma_x_x"
    if method.solver == "ipopt":
        hessian, name = ca.triu(hessian), "triu_hess_gamma_x_x"
    return ca.Function("nlp_hess_l", [u, p, factor, multipliers], [hessian], ["x", "p", "lam_f", "lam_g"], [name])


def _options(method: Method) -> dict[str, Any]:
    if method.solver == "ipopt":
        options: dict[str, Any] = {**_IPOPT, "ipopt.max_iter": method.iterations}
        return options if method.gauss_newton else {**options, "ipopt.hessian_approximation": "limited-memory"}
    quadratic = quadratic_solver()
    return {
        "qpsol": quadratic,
        "qpsol_options": {"print_time": False, "error_on_fail": False, **_QUIET.get(quadratic, {})},
        "max_iter": method.iterations,
        "tol_pr": _PRIMAL,
        "tol_du": _DUAL,
        "error_on_fail": False,
        **dict.fromkeys(("print_header", "print_iteration", "print_status", "print_time"), False),
    }
