"""
A public sampler on the simulated device
========================================

``HysteresisEnv`` is a simulated device as a gymnasium environment whose state can be saved and put back. This page lets
``pytorch-mppi`` plan on it. The planner thus knows the device exactly, hysteresis included. What it reaches is what
sampling can reach, not what a controller reaches that has only a model.

It needs two extras: ``pip install 'hystmpc[env,bench]'``.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch
from pytorch_mppi import MPPI

from hystmpc.sim import HysteresisEnv, SimulationConfig

plt.style.use("hystmpc.trials.report")

# %%
# The environment
# ---------------
# It is made from a study, as ``simulate`` takes it. The action is the command, scaled to -1 and 1. The reward is minus
# the squared error of the true angle. A snapshot holds the memory of the hysteresis and the noise to come.

STUDY = SimulationConfig.parse(
    {
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
)


env = HysteresisEnv.from_config(STUDY, rate_weight=0.1)
env.reset(seed=1)


def play(actions):
    """True angles [deg] under actions, from where the environment is."""
    return np.array([env.step(np.array([a], dtype=np.float32))[4]["true_angle_deg"] for a in actions])


play(np.linspace(-1.0, 0.3, 30))
state = env.get_state()
futures_deg = {}
for name, last in (("on", 1.0), ("hold", 0.3), ("back", -0.4)):
    env.set_state(state)
    futures_deg[name] = play(np.linspace(0.3, last, 20))
env.set_state(state)
again_deg = play(np.linspace(0.3, -0.4, 20)) - futures_deg["back"]

figure, axes = plt.subplots(figsize=(5.0, 2.6))
for name, angles_deg in futures_deg.items():
    axes.plot(0.04 * np.arange(1, 21), angles_deg, label=name)
axes.set(xlabel="time from the snapshot [s]", ylabel="tip angle [deg]", title="Three futures of one snapshot")
axes.legend()
plt.show()

# %%
# The environment was put back three times. Played again, a future is the same to the last bit.
#
# The planner's view
# ------------------
# ``pytorch-mppi`` asks for the dynamics of many states at once. Here a state is the number of a snapshot.


class Snapshots:
    """Dynamics and cost as pytorch-mppi wants them: a state is the number of a snapshot of the environment."""

    def __init__(self):
        self.env = HysteresisEnv.from_config(STUDY, rate_weight=0.1)
        self.held, self.costs = [], []

    def start(self, state):
        """Forget the last plan; the state's number is 0."""
        self.held, self.costs = [state], [0.0]
        return torch.zeros(1)

    def dynamics(self, states, actions):
        """Numbers (K, 1) of the snapshots one sample later."""
        following = []
        for number, action in zip(states[:, 0].tolist(), actions.numpy(), strict=True):
            self.env.set_state(self.held[int(number)])
            _, reward, _, _, _ = self.env.step(action)
            following.append(float(len(self.held)))
            self.held.append(self.env.get_state())
            self.costs.append(-reward)
        return torch.tensor(following)[:, None]

    def cost(self, states, actions):  # noqa: ARG002  # the reward says it all
        """Minus the reward of the sample that led to each state (K,)."""
        return torch.tensor([self.costs[int(number)] for number in states[:, 0].tolist()])


# %%
# Plan and track
# --------------
# Thirty-two plans of eight samples are tried at each sample. For comparison a second run keeps the command at rest.

torch.manual_seed(0)
snapshots = Snapshots()
bounds = {"u_min": -torch.ones(1), "u_max": torch.ones(1), "u_init": torch.zeros(1), "U_init": -torch.ones(8, 1)}
spread = torch.eye(1) * 0.02
planner = MPPI(snapshots.dynamics, snapshots.cost, 1, spread, num_samples=32, horizon=8, lambda_=0.5, **bounds)


def track(act, samples=75):
    """Reference and true angle (T, 2) [deg] of a run whose actions `act` chooses from the environment's state."""
    env = HysteresisEnv.from_config(STUDY, rate_weight=0.1)
    env.reset(seed=1)
    angles = []
    for _ in range(samples):
        _, _, _, _, info = env.step(act(env))
        angles.append((info["true_angle_deg"] - info["error_deg"], info["true_angle_deg"]))
    return np.array(angles)


def planned(env):
    """The first action of the plan from where the environment is."""
    with torch.inference_mode():
        return planner.command(snapshots.start(env.get_state())).numpy()


runs = {"planned by sampling": track(planned), "at rest": track(lambda env: np.array([-1.0], dtype=np.float32))}
rmse_deg = {name: float(np.sqrt(np.mean((run[:, 1] - run[:, 0]) ** 2))) for name, run in runs.items()}

figure, axes = plt.subplots(figsize=(7.0, 2.8))
time_s = 0.04 * np.arange(1, 76)
axes.plot(time_s, runs["at rest"][:, 0], color="C6", linewidth=2.4, alpha=0.45, label="reference")
for name, run in runs.items():
    axes.plot(time_s, run[:, 1], linewidth=0.9, label=f"{name}: RMSE {rmse_deg[name]:.2f} deg")
axes.set(xlabel="time [s]", ylabel="tip angle [deg]", title="MPPI that knows the device")
figure.legend(loc="outside lower center", ncols=3)
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert rmse_deg["planned by sampling"] < 0.5 * rmse_deg["at rest"]
assert np.ptp(again_deg) == 0
# sphinx_gallery_end_ignore
plt.show()
