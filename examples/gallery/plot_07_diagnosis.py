"""
Your first diagnosis
====================

A simulator was made for a catheter. Since then the tendon has become slack: the first part of a command moves nothing.
``hystmpc.diagnose`` compares the simulator with trials of the device and says which effect causes the difference.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# The device and its simulator
# ----------------------------
# The simulator is ``builtin:pi``. The device is the same, with 0.7 mm of slack and a sensor noise of 0.1 deg. A
# diagnosis wants several trials, since it keeps some of them for the end and chooses nothing on them.

simulator = hystmpc.load_model("builtin:pi").simulator
slack = {"effect": "slack", "parameters": {"slack": 0.7}}
device = hystmpc.SimulatedPlant(simulator, hystmpc.Effects(noise_deg=0.1, effects=[slack]), seed=1)
time_s = np.arange(0.0, 16.0, device.dt)


def record(k):
    """Trial number k: a decaying sine of its own frequency, then a hold."""
    swing = np.cos(2.0 * np.pi * (0.15, 0.3, 0.45)[k % 3] * time_s) * np.exp(-(0.04, 0.1)[k % 2] * time_s)
    command_mm = 2.8 - 2.8 * swing
    command_mm[-60:] = command_mm[-60]
    device.reset()
    return hystmpc.Trial(time_s, command_mm, [device.apply(u) for u in command_mm], source=f"trial {k}")


trials = [record(k) for k in range(6)]
before = hystmpc.evaluate(simulator, trials)

figure, axes = plt.subplots(figsize=(7.0, 2.6))
axes.plot(trials[0].t, trials[0].angle, color="C0", label="device")
axes.plot(trials[0].t, before[0].theta, color="C1", label="simulator")
axes.set(xlabel="time [s]", ylabel="tip angle [deg]", title=f"The gap: RMSE {before.mean.rmse_deg:.1f} deg")
axes.legend(loc="upper right", ncols=2)
plt.show()

# %%
# Diagnose
# --------
# The library of effects is cut to five here, which keeps this page quick. Without ``only`` all effects are tried, and
# the motion is judged in more ways.

LIBRARY = ("slack", "lag", "creep", "nonlinear_gain", "asymmetry")
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name) / "diagnosis"
diagnosis = hystmpc.diagnose(trials, simulator, only=LIBRARY, out=folder)
print(diagnosis.verdict)
print(diagnosis.reason)
for effect in diagnosis.effects:
    print(effect.name, effect.parameters, effect.units)

gap = diagnosis.gap
sizes = {
    "as given": gap.nominal_rmse_deg,
    "retuned": gap.retuned_rmse_deg,
    "with the effect": gap.with_effects_rmse_deg,
    "floor: noise": gap.floor_rmse_deg,
}
figure, (chance, error) = plt.subplots(1, 2, figsize=(7.0, 2.4))
chance.barh([name for name, _ in diagnosis.ranking], [p for _, p in diagnosis.ranking], color="C1")
chance.set(xlim=(0, 1), xlabel="probability [1]", title="Which effect it is")
chance.invert_yaxis()
error.barh(list(sizes), list(sizes.values()), color="C6")
error.set(xlabel="RMSE on trials kept for the end [deg]", title="How far the gap closes")
error.invert_yaxis()
plt.show()

# %%
# Retuning gain, offset and widths of the simulator closes a part of the gap. The effect closes the rest, down to what
# the noise leaves. A number that is wrong and an effect that is missing are thus two different findings.
#
# Use the corrected simulator
# ---------------------------
# The folder of a diagnosis holds a report of all that was tried, and the corrected simulator. We run it over a motion
# that no part of the diagnosis has seen.

corrected = hystmpc.load_model(folder / "sim.fixed.yaml").simulator
random = np.random.default_rng(7)
fresh_mm = np.interp(time_s, np.arange(0.0, 17.0, 1.0), [0.0, *random.uniform(0.0, 6.0, 16)])
device.reset()
fresh = hystmpc.Trial(time_s, fresh_mm, [device.apply(u) for u in fresh_mm], source="fresh motion")
after = {name: hystmpc.evaluate(model, fresh)[0] for name, model in (("given", simulator), ("corrected", corrected))}
fresh_rmse_deg = {name: run.errors.rmse_deg for name, run in after.items()}

figure, axes = plt.subplots(figsize=(7.0, 2.6))
for name, run in after.items():
    label = f"simulator as {name}: RMSE {run.errors.rmse_deg:.2f} deg"
    axes.plot(fresh.t, fresh.angle - run.theta, linewidth=0.9, label=label)
axes.set(xlabel="time [s]", ylabel="device - simulator [deg]", title="A motion that the diagnosis has not seen")
figure.legend(loc="outside lower center", ncols=2)
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert diagnosis.verdict == "named"
assert [effect.name for effect in diagnosis.effects] == ["slack"]
assert abs(diagnosis.effects[0].parameters["slack"] - 0.7) < 0.07
assert fresh_rmse_deg["corrected"] < 0.1 * fresh_rmse_deg["given"]
# sphinx_gallery_end_ignore
plt.show()
