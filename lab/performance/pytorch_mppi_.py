"""The peer of the sampling controller: pytorch-mppi over torch's own LSTM, where both are installed."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, final

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.mpc import PlanningProblem
from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.models.networks.lstm import LstmWeights
from hystmpc.trials.types import Vec

if TYPE_CHECKING:
    from hystmpc.models.networks.recurrent_ import LstmNet

_LAMBDA = 0.1  # with a sigma of the greatest move of a sample, near the least mean cost of its plans on a grid


def installed() -> bool:
    """Whether pytorch-mppi and torch are there; neither is imported."""
    return find_spec("pytorch_mppi") is not None and find_spec("torch") is not None


def net_of(weights: LstmWeights) -> LstmNet:
    """A network with these weights, for further training."""
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
    """MPPI with N samples over H steps, the same model, cost and limits.

    pytorch-mppi knows states and actions only, so that angle, command and its last change ride along in the state:
    [LSTM state, theta, u, du]. Its own limits are those of a box; the rate limit is kept by the dynamics.

    Args:
        samples: N.
        horizon: H.
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
        """Threads of torch from here on."""
        self._torch.set_num_threads(count)

    def solve(self, problem: PlanningProblem) -> Vec:
        """The next plan (H,), from the last one shifted by one sample; its rate limited as in the dynamics."""
        self._reference = problem.reference.tolist()
        with self._torch.inference_mode():
            self._mppi.command(self._start(problem.state, problem.u_last))
        plan: Any = self._mppi.U
        return self._limits.clip_plans(plan[:, 0].numpy(), problem.u_last, self._dt)

    def angles(self, state: Vec, u_last: float, plan: Vec) -> Vec:
        """Angles (H,) [deg] of one plan (H,) as the peer's dynamics see it, its rate limited."""
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
