"""A public sampler on the simulated device: pytorch-mppi plans on the gymnasium environment itself.

    pip install 'hystmpc[env,bench]'
    python examples/environment_mppi.py

pytorch-mppi asks for the dynamics of many states at once. Here a state is the number of a snapshot: `set_state` puts it
back, `step` goes on from it, `get_state` keeps what came of it. The planner thus knows the device exactly, hysteresis
included; what it reaches is what sampling can, not what a controller will reach that has only a model.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import torch
from pytorch_mppi import MPPI

from hystmpc.sim import EnvironmentState, HysteresisEnv, SimulationConfig

STUDY: dict[str, Any] = {
    "plant": {"simulator": "builtin:tendon-catheter", "lag_s": 0.08, "noise_deg": 0.15},
    "model": "builtin:pi",
    "motions": {
        "scan": {
            "kind": "scan_sinusoid",
            "start_deg": 29,
            "centre_deg": 45,
            "amplitude_deg": 10,
            "frequency_hz": 0.5,
            "cycles": 2,
        }
    },
    "controllers": {"inverse": {"kind": "inverse"}},
}


class Snapshots:
    """Dynamics and cost as pytorch-mppi wants them, over snapshots of one environment.

    Args:
        env: to plan on.
    """

    def __init__(self, env: HysteresisEnv) -> None:
        self._env = env
        self._held: list[EnvironmentState] = []
        self._costs: list[float] = []

    def start(self, state: EnvironmentState) -> torch.Tensor:
        """Forget the last plan; the state's number is 0."""
        self._held, self._costs = [state], [0.0]
        return torch.zeros(1)

    def dynamics(self, states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Numbers (K, 1) of the snapshots one sample after those numbered `states` (K, 1) under `actions` (K, 1)."""
        following = []
        for number, action in zip(states[:, 0].tolist(), actions.numpy(), strict=True):
            self._env.set_state(self._held[int(number)])
            _, reward, _, _, _ = self._env.step(action)
            following.append(float(len(self._held)))
            self._held.append(self._env.get_state())
            self._costs.append(-reward)
        return torch.tensor(following)[:, None]

    def cost(self, states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Minus the reward of the sample that led to each state (K,)."""
        del actions
        return torch.tensor([self._costs[int(number)] for number in states[:, 0].tolist()])


def track(steps: int, samples: int, horizon: int) -> float:
    """Root mean square error of the true angle over the first samples of the motion [deg]."""
    env = HysteresisEnv.from_config(SimulationConfig.parse(STUDY), rate_weight=0.1)
    snapshots = Snapshots(HysteresisEnv.from_config(SimulationConfig.parse(STUDY), rate_weight=0.1))
    torch.manual_seed(0)
    low = torch.full((1,), -1.0)
    planner = MPPI(
        snapshots.dynamics,
        snapshots.cost,
        1,
        torch.eye(1) * 0.02,
        num_samples=samples,
        horizon=horizon,
        lambda_=0.5,
        u_min=low,
        u_max=-low,
        u_init=low,
        U_init=low.repeat(horizon, 1),
    )
    env.reset(seed=1)
    errors = []
    for _ in range(steps):
        with torch.inference_mode():
            action = planner.command(snapshots.start(env.get_state()))
        _, _, _, truncated, info = env.step(action.numpy())
        errors.append(info["error_deg"])
        if truncated:
            break
    return float(np.sqrt(np.mean(np.square(errors))))


def main() -> None:
    """Track and print the error."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100, help="samples to track")
    parser.add_argument("--samples", type=int, default=64, help="plans a step")
    parser.add_argument("--horizon", type=int, default=8, help="samples a plan")
    arguments = parser.parse_args()
    error = track(arguments.steps, arguments.samples, arguments.horizon)
    print(f"MPPI with {arguments.samples} plans over {arguments.horizon} samples: RMSE {error:.2f} deg")


if __name__ == "__main__":
    main()
