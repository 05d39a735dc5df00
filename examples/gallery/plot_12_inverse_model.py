"""
An inverse model: the command from the angle
============================================

With ``inverse=True``, ``hystmpc.fit`` identifies the map from angle to command. The inverse of a hysteresis has memory
too: which command gives an angle depends on the last turns. This page identifies such a map and uses it as a
feedforward, beside a straight line without memory.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# Identify
# --------
# Trials are recorded as always. The fit swaps command and angle by itself. The inverse of a sum of plays (``pi``) is
# a sum of plays again.

simulator = hystmpc.load_model("builtin:tendon-catheter").simulator
device = hystmpc.SimulatedPlant(simulator, hystmpc.Effects(noise_deg=0.05), seed=1)
time_s = np.arange(0.0, 20.0, device.dt)


def record(frequency_hz, rate_per_s):
    """A decaying sine over the whole range."""
    command_mm = 3.0 - 2.95 * np.cos(2.0 * np.pi * frequency_hz * time_s) * np.exp(-rate_per_s * time_s)
    device.reset()
    return hystmpc.Trial(time_s, command_mm, [device.apply(u) for u in command_mm], source=f"{frequency_hz} Hz")


trials = [record(0.1, 0.0), record(0.2, 0.08), record(0.3, 0.12)]
unseen = record(0.25, 0.06)
inverse = hystmpc.fit("pi", trials, inverse=True)
run = hystmpc.evaluate(inverse, unseen)[0]  # the trial is swapped: its input is the angle
error_mm = run.errors.rmse_deg  # in the unit of what the map gives, which is the command

figure, (loop, over_time) = plt.subplots(1, 2, figsize=(7.0, 3.0), width_ratios=(2, 3))
loop.plot(run.trial.command, run.trial.angle, color="C0", label="recorded")
loop.plot(run.trial.command, run.theta, color="C1", linewidth=0.8, label="inverse model")
loop.set(xlabel="tip angle [deg]", ylabel="command [mm]", title="The inverse is a loop, too")
loop.legend()
over_time.plot(run.trial.t, run.theta - run.trial.angle, color="C1", linewidth=0.8)
over_time.set(xlabel="time [s]", ylabel="error of the command [mm]", title=f"Motion left out: RMSE {error_mm:.3f} mm")
plt.show()

# %%
# Use it as a feedforward
# -----------------------
# We ask for a motion of the tip and send what the inverse model answers. Nothing is fed back. The straight line is the
# best one through the same trials. Where it turns, it ignores the plays.

wanted_deg = 56.0 - 18.0 * np.cos(2.0 * np.pi * 0.2 * time_s) * np.exp(-0.05 * time_s)
slope, offset = np.polyfit(
    np.concatenate([trial.angle for trial in trials]), np.concatenate([trial.command for trial in trials]), 1
)


def from_inverse_model(angles_deg, command_mm):
    """Commands of the inverse model along wanted angles, from the command that the device holds."""
    model = inverse.model
    x, commands = model.initial(np.array([[command_mm]])), []
    for angle in angles_deg:
        x = model.step(x, np.array([[angle]]))
        commands.append(float(model.output(x)[0, 0]))
    return np.clip(commands, 0.0, 6.0)


plans_mm = {
    "straight line": slope * wanted_deg + offset,
    "inverse model": from_inverse_model(wanted_deg, device.rest_command),
}
figure, (angle, error) = plt.subplots(2, 1, figsize=(7.0, 4.0), sharex=True, height_ratios=(3, 2))
angle.plot(time_s, wanted_deg, color="C6", linewidth=2.4, alpha=0.45, label="wanted")
rmse_deg = {}
for colour, (name, commands_mm) in zip(("C0", "C1"), plans_mm.items(), strict=True):
    device.reset()
    true_deg = []
    for u in commands_mm:
        device.apply(u)
        true_deg.append(device.true_angle)
    error_deg = np.array(true_deg) - wanted_deg
    rmse_deg[name] = float(np.sqrt(np.mean(error_deg[50:] ** 2)))  # after the way to the start
    angle.plot(time_s, true_deg, color=colour, linewidth=0.9, label=f"{name}: RMSE {rmse_deg[name]:.2f} deg")
    error.plot(time_s, error_deg, color=colour, linewidth=0.9)
angle.set(ylabel="tip angle [deg]", title="Feedforward alone")
error.set(xlabel="time [s]", ylabel="error [deg]", ylim=(-6, 6))
figure.legend(loc="outside lower center", ncols=3)
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert rmse_deg["inverse model"] < 0.2 * rmse_deg["straight line"]
# sphinx_gallery_end_ignore
plt.show()
