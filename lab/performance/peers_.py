"""Peers of the controllers: single shooting in CasADi, and pytorch-mppi over torch's LSTM where it is installed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, final

import casadi as ca
import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.models.networks.lstm import LstmWeights
from hystmpc.trials.types import Vec

from .subjects import PlanningProblem

if TYPE_CHECKING:
    from hystmpc.models.networks.recurrent_ import LstmNet

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
    """Peer by single shooting: min J(u) of `PlanningProblem`, over u (H,).

    Box and rate limits are constraints. It is built once; every solve starts from the last solution shifted by one
    sample, with its multipliers.

    Args:
        function: step (state, u) -> (theta, next state).
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
        """Solve one problem, whose state begins with the state of the model."""
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
    """Plugin for the peer's quadratic programs: the fastest one available in this CasADi."""
    return next(name for name in ("daqp", "osqp", "qrqp") if ca.has_conic(name))


def _build(function: Any, weights: WeightsSettings, horizon: int, method: Method) -> Any:
    """Nonlinear program with parameters p = [state, u_last, reference]."""
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
    """Gauss-Newton Hessian of the Lagrangian in the form required by the solver; the constraints are linear."""
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


_LAMBDA = 0.1  # with a sigma of the greatest move of a sample, near the least mean cost of its plans on a grid


def pytorch_mppi_installed() -> bool:
    """Whether pytorch-mppi and torch are installed; neither is imported."""
    return find_spec("pytorch_mppi") is not None and find_spec("torch") is not None


def net_of(weights: LstmWeights) -> LstmNet:
    """Network with these weights, for further training."""
    import torch

    from hystmpc.models.networks.recurrent_ import LstmNet

    net = LstmNet(weights.hidden, len(weights.layers))
    values = {"head.weight": weights.head_weight[None], "head.bias": [weights.head_bias]}
    for k, layer in enumerate(weights.layers):
        values |= {f"lstm.weight_ih_l{k}": layer.w_ih, f"lstm.weight_hh_l{k}": layer.w_hh}
        values |= {f"lstm.bias_ih_l{k}": layer.bias, f"lstm.bias_hh_l{k}": np.zeros_like(layer.bias)}
    net.load_state_dict({name: torch.tensor(np.asarray(v), dtype=torch.float32) for name, v in values.items()})
    return net


@final
class TorchMppi:
    """MPPI with N samples over H steps, and the same model, cost and limits.

    pytorch-mppi has only states and actions, so that angle, command and its last change are part of the state:
    [LSTM state, theta, u, du]. It has only box limits; the rate limit is applied in the dynamics.

    Args:
        dt: sample time [s].
        sigma: standard deviation of the perturbations [command unit].
    """

    def __init__(
        self,
        network: LstmWeights,
        limits: CommandLimits,
        weights: WeightsSettings,
        samples: int,
        horizon: int,
        dt: float,
        sigma: float,
    ) -> None:
        import torch
        from pytorch_mppi import MPPI

        self._torch = torch
        self._net = net_of(network).requires_grad_(False)
        self._size = network.state_size
        self._limits, self._dt = limits, dt
        self._scaling, self._reach, self._rate = network.scaling, limits.rate * dt, weights.rate
        self._tracking = [float(q) for q in weights.over(horizon)]
        self._reference = [0.0] * horizon
        middle = torch.full((1,), 0.5 * (limits.lower + limits.upper))
        torch.manual_seed(0)
        self._mppi = MPPI(
            self._step,
            self._cost,
            network.state_size + 3,
            torch.eye(1) * sigma**2,
            num_samples=samples,
            horizon=horizon,
            lambda_=_LAMBDA,
            u_min=torch.tensor([limits.lower]),
            u_max=torch.tensor([limits.upper]),
            u_init=middle,
            U_init=middle.repeat(horizon, 1),
            step_dependent_dynamics=True,
        )

    def use_threads(self, count: int) -> None:
        """Set the number of threads of torch."""
        self._torch.set_num_threads(count)

    def solve(self, problem: PlanningProblem) -> Vec:
        """Next plan (H,), from the last one shifted by one sample; its rate limited as in the dynamics."""
        self._reference = problem.reference.tolist()
        with self._torch.inference_mode():
            self._mppi.command(self._start(problem.state, problem.u_last))
        plan: Any = self._mppi.U
        return self._limits.clip_plans(plan[:, 0].numpy(), problem.u_last, self._dt)

    def angles(self, state: Vec, u_last: float, plan: Vec) -> Vec:
        """Angles (H,) [deg] of one plan (H,) by the peer's dynamics, with rate limit."""
        angles = []
        with self._torch.inference_mode():
            rows = self._start(state, u_last)[None]
            for u in plan.tolist():
                rows = self._step(rows, self._torch.full((1, 1), u), 0)
                angles.append(float(rows[0, -3]))
        return np.array(angles)

    def _start(self, state: Vec, u_last: float) -> Any:
        return self._torch.tensor(np.concatenate([state[: self._size], [0.0, u_last, 0.0]]), dtype=self._torch.float32)

    def _step(self, state: Any, action: Any, _: int) -> Any:
        torch = self._torch
        last = state[:, -2:-1]
        command = torch.minimum(torch.maximum(action, last - self._reach), last + self._reach)
        scaled = (command - self._scaling.u_offset) / self._scaling.u_scale
        y, following = self._net(scaled, state[:, :-3])
        theta = self._scaling.theta_offset + self._scaling.theta_scale * y
        return torch.cat([following, theta, command, command - last], dim=1)

    def _cost(self, state: Any, action: Any, step: int) -> Any:
        del action
        error, move = state[:, -3] - self._reference[step], state[:, -1]
        return self._tracking[step] * error * error + self._rate * move * move
