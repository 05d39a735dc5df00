"""
Identify a device from its logs
===============================

``hystmpc.fit("auto", trials)`` finds what stands between the command and the angle: the delay or lag of the drive,
creep, and the simplest core of hysteresis. This page identifies a simulated catheter and checks the model on motions
that the fit has not seen.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# Record
# ------
# The device has four plays, a lag of 0.08 s, and a sensor with a noise of 0.15 deg. We record four motions of 20 s. A
# good set has slow and fast parts, large and small loops, and some holds.

simulator = hystmpc.load_model("builtin:tendon-catheter").simulator
device = hystmpc.SimulatedPlant(simulator, hystmpc.Effects(lag_s=0.08, noise_deg=0.15), seed=1)
time_s = np.arange(0.0, 20.0, device.dt)


def decaying(frequency_hz, rate_per_s):
    """A sine over the whole range that becomes smaller [mm]."""
    return 3.0 - 2.9 * np.cos(2.0 * np.pi * frequency_hz * time_s) * np.exp(-rate_per_s * time_s)


def steps(levels_mm):
    """Equally long holds, with ramps of 6 mm/s between them [mm]."""
    starts = np.linspace(0.0, time_s[-1], len(levels_mm) + 1)[:-1]
    wanted = np.asarray(levels_mm)[np.searchsorted(starts, time_s, side="right") - 1]
    command = [0.0]
    for level in wanted[1:]:
        command.append(command[-1] + np.clip(level - command[-1], -6.0 * device.dt, 6.0 * device.dt))
    return np.array(command)


def record(command_mm, name):
    """One trial: the device starts at rest, and each command holds for one sample."""
    device.reset()
    return hystmpc.Trial(time_s, command_mm, np.array([device.apply(u) for u in command_mm]), source=name)


trials = [
    record(decaying(0.2, 0.08), "decaying sine, 0.2 Hz"),
    record(decaying(0.5, 0.05), "decaying sine, 0.5 Hz"),
    record(steps([0.5, 4.0, 2.0, 5.5, 3.0, 1.0, 4.5, 2.5]), "steps"),
]
unseen = [record(decaying(0.35, 0.12), "another sine, 0.35 Hz"), record(steps([2, 5, 1, 4, 3, 6, 0.5]), "other steps")]

figure, axes = plt.subplots(3, 1, figsize=(7.0, 3.6), sharex=True)
for each, trial in zip(axes, trials, strict=True):
    each.plot(trial.t, trial.command, color="C2")
    each.set(ylabel="[mm]", title=trial.source)
axes[-1].set_xlabel("time [s]")
plt.show()

# %%
# Identify
# --------
# The report names the parts that were found, and the error on trials left out of the fit. The lag that was put in is
# 0.08 s. The plays of this device widen with speed: in motion that looks like a lag. The fit finds a little more, or
# one lag for each direction.

model = hystmpc.fit("auto", trials, limits=hystmpc.Limits(0.0, 6.0, 10.0))
print(model.identified.report)
found = dict(zip(model.simulator.chain.labels, model.simulator.chain.values, strict=True))
print({label: f"{value:.3f} s" for label, value in found.items() if label.startswith("lag.tau")})

# %%
# Check on motions left out
# -------------------------
# In a free run the model gets the command and nothing of the angle but its first value. The noise of the sensor alone
# is 0.15 deg. A model whose error comes close to that has found the device.

evaluation = hystmpc.evaluate(model, unseen)
figure, axes = plt.subplots(2, 1, figsize=(7.0, 3.8), sharex=True)
for each, run in zip(axes, evaluation, strict=True):
    each.plot(run.trial.t, run.trial.angle, color="C0", label="measured")
    each.plot(run.trial.t, run.theta, color="C1", linewidth=0.9, label="model, from the command alone")
    each.set(ylabel="tip angle [deg]", title=f"{run.trial.source}: RMSE {run.errors.rmse_deg:.2f} deg")
axes[-1].set_xlabel("time [s]")
axes[0].legend(loc="upper right", ncols=2)
plt.show()

# %%
# What the model leaves
# ---------------------
# What is left looks like the noise of the sensor. The first half second is the exception: the first angle does not tell
# the model where each play stands, and the first motion does. A residual that follows the motion all the time would be
# a sign of an effect that the model lacks.

figure, axes = plt.subplots(figsize=(7.0, 2.2))
for run in evaluation:
    axes.plot(run.trial.t, run.trial.angle - run.theta, linewidth=0.8, label=run.trial.source)
axes.set(xlabel="time [s]", ylabel="measured - model [deg]", title="Residuals on motions left out")
axes.legend(loc="upper right", ncols=2)
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert evaluation.mean.rmse_deg < 2 * 0.15
assert all(abs(tau - 0.08) < 0.04 for label, tau in found.items() if label.startswith("lag.tau"))
# sphinx_gallery_end_ignore
plt.show()
