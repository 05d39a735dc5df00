r"""
A star in two planes
====================

A catheter with two pairs of tendons bends in two planes. Its tendons are not aligned with the planes, and a motion in
one plane changes the friction in the other one. This page identifies both axes from logs and draws a star with the tip:
with a PID of each axis, with the inverse model, and with the predictive controller.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystmpc
from hystmpc import models, trajectories

plt.style.use("hystmpc.trials.report")

# %%
# The device
# ----------
# It is simulated, of the operators that are identified below: two catheters of one axis, tendons that are 9 and 14 deg
# off, and a friction that both share. Each command goes from 0 to 6 mm and rests at 3 mm.

axis = hystmpc.load_model("builtin:pi").simulator
shared = models.CrossFriction(lag_s=0.0, radii=(0.3,), weights=((4.0,), (4.0,)))
device = models.TwoAxisModel(
    axes=(axis, axis),
    mix=((1.0, 0.25), (-0.16, 1.0)),
    frame=((1.0, 0.0), (0.0, 1.0)),
    command_limits=(axis.command_limits,) * 2,
    command_rates_per_s=(6.0, 6.0),
    rest_commands=(3.0, 2.5),
    comparison={},
    cross_friction=shared,
)
dt, random = device.dt_s, np.random.default_rng(1)
REST_DEG = np.array([60.0, 52.0])


def recorded(samples):
    """A trial in which both commands move and rest at random."""
    commands, at, to = np.empty((samples, 2)), np.array(device.rest_commands), np.array(device.rest_commands)
    for k in range(samples):
        moves = random.random(2) < 0.03
        to = np.where(moves, random.uniform(0.5, 5.5, 2), to)
        at = at + np.clip(to - at, -0.12, 0.12)
        commands[k] = at
    angles = device.run(commands, REST_DEG)
    return hystmpc.Trial(dt * np.arange(samples), commands, angles + 0.1 * random.standard_normal(angles.shape))


trials = [recorded(900) for _ in range(4)]
figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 3.0))
left.plot(*trials[0].commands.T, linewidth=0.8)
left.set(xlabel="command x [mm]", ylabel="command y [mm]")
right.plot(*trials[0].angles.T, linewidth=0.8)
right.set(xlabel="angle x [deg]", ylabel="angle y [deg]")
plt.show()

# %%
# Both axes, and what joins them
# ------------------------------
# ``fit`` sees two axes. It compares four answers to the question what joins them on parts of the logs that it left out.

fit = hystmpc.fit("pi", trials)
print(fit.report)
print(np.round(fit.model.matrix, 3))
path = fit.save(Path(tempfile.mkdtemp()) / "both.yaml")

# %%
# The star
# --------
# The calls are those of one axis, with arrays. All have the same limits. The gains of the PID are set by hand,
# and the model turns its axes too, so that it has the decoupling of the others.

limits = trajectories.MotionLimits(velocity_deg_s=15.0, acceleration_deg_s2=60.0, jerk_deg_s3=600.0)
motion = trajectories.star(tuple(REST_DEG), 11.0, hold_s=0.6, limits=limits)
BEFORE = 60  # samples on the way to the first tip of the star
KINDS = {
    "PID": {"kind": "pid", "gains": {"kp_per_deg": 0.05, "ki_per_deg_s": 1.0}},
    "inverse": {"kind": "inverse"},
    "MPC": {"kind": "linearised_mpc"},
}


def drawn(controller):
    """True angles (T, 2) while a controller follows the star."""
    tip = hystmpc.TipController.from_config({"model": str(path), "controller": controller})
    sent, angles = [], [REST_DEG]
    tip.set_target(motion(0.0))
    for k in range(BEFORE + round(motion.duration_s / dt)):
        if k == BEFORE:
            tip.set_reference(motion)
        measured = angles[-1] + 0.1 * random.standard_normal(2)
        sent.append(tip.step(measured).u)
        angles.append(device.run(np.array(sent), REST_DEG)[-1])
    return np.array(angles[BEFORE:])


wanted = motion(dt * np.arange(round(motion.duration_s / dt) + 1))
errors, tips = {}, {name: drawn(kind) for name, kind in KINDS.items()}
figure, axes = plt.subplots(1, 3, figsize=(7.0, 2.9), sharex=True, sharey=True)
for panel, (name, angles) in zip(axes, tips.items(), strict=True):
    errors[name] = float(np.sqrt(np.mean((angles - wanted) ** 2)))
    panel.plot(*wanted.T, color="C6", linewidth=2.4, alpha=0.45)
    panel.plot(*angles.T, color="C0")
    panel.set(title=f"{name}: {errors[name]:.2f} deg", xlabel="angle x [deg]", aspect="equal")
axes[0].set_ylabel("angle y [deg]")
plt.show()

# sphinx_gallery_start_ignore
assert fit.identified.joint == "tendons"
assert errors["MPC"] < 0.6 * errors["PID"]
assert errors["MPC"] < 0.4
# sphinx_gallery_end_ignore
