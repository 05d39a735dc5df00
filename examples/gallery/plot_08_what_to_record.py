"""
What to record next
===================

Some motions hardly tell two effects apart. A slow motion looks nearly the same behind a lag and behind a delay. The
diagnosis says how sure it is, and it designs the motion that would decide. This page records that motion and diagnoses
again.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# Slow trials of a device with a lag
# ----------------------------------
# The device has a lag of 0.12 s that the simulator lacks. All trials are slow sines.

LIBRARY = ("lag", "delay")
simulator = hystmpc.load_model("builtin:pi").simulator
device = hystmpc.SimulatedPlant(simulator, hystmpc.Effects(lag_s=0.12, noise_deg=0.2), seed=2)


def record(command_mm, name):
    """One trial, from the device at rest."""
    device.reset()
    time_s = device.dt * np.arange(len(command_mm))
    return hystmpc.Trial(time_s, command_mm, [device.apply(u) for u in command_mm], source=name)


time_s = np.arange(0.0, 12.0, device.dt)


def slow(frequency_hz, rate_per_s):
    """A sine over the range that becomes smaller."""
    return 3.0 - 2.8 * np.cos(2.0 * np.pi * frequency_hz * time_s) * np.exp(-rate_per_s * time_s)


trials = [
    record(slow(f, r), f"sine of {f} Hz, {r}/s") for f, r in ((0.15, 0.03), (0.25, 0.1), (0.15, 0.1), (0.25, 0.03))
]
scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name) / "first"
first = hystmpc.diagnose(trials, simulator, only=LIBRARY, out=folder)
print(first.reason)
print(first.next_motion)

figure, (motion, chance) = plt.subplots(1, 2, figsize=(7.0, 2.4), width_ratios=(3, 2))
for trial in trials:
    motion.plot(trial.t, trial.angle, linewidth=0.9)
motion.set(xlabel="time [s]", ylabel="tip angle [deg]", title="Four slow trials")
chance.barh([name for name, _ in first.ranking], [p for _, p in first.ranking], color="C1")
chance.set(xlim=(0, 1), xlabel="probability [1]", title="They hardly decide")
plt.show()

# %%
# The motion that decides
# -----------------------
# The diagnosis writes the motion as a file. It keeps the limits of command and rate. It is long enough, and quick
# enough, that a lag and a delay of the sizes found here would give different angles.

planned = np.genfromtxt(folder / first.next_motion.file, delimiter=",", names=True)
command_mm = planned["command"]

figure, axes = plt.subplots(figsize=(7.0, 2.2))
axes.step(device.dt * np.arange(command_mm.size), command_mm, where="pre", color="C2")
axes.set(xlabel="time [s]", ylabel="command [mm]", title=f"To record next: {first.next_motion.duration_s:.0f} s")
plt.show()

# %%
# Record it and diagnose again
# ----------------------------
# One more trial settles the question. At the device, ``hystmpc investigate`` does these rounds by itself.

second = hystmpc.diagnose([*trials, record(command_mm, "decisive motion")], simulator, only=LIBRARY)
print(second.reason)
for effect in second.effects:
    print(effect.name, effect.parameters, effect.units)

figure, axes = plt.subplots(figsize=(5.0, 2.4))
for shift, (label, diagnosis) in zip((-0.2, 0.2), (("before", first), ("after", second)), strict=True):
    chances = dict(diagnosis.ranking)
    axes.barh(np.arange(2) + shift, [chances[name] for name in LIBRARY], height=0.35, label=label)
axes.set_yticks(np.arange(2), LIBRARY)
axes.set(xlim=(0, 1), xlabel="probability [1]", title="The device has a lag of 0.12 s")
axes.legend(loc="lower right")
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert set(first.next_motion.separates) == {"lag", "delay"}
assert dict(first.ranking)["lag"] == dict(first.ranking)["delay"] < 0.5 < dict(second.ranking)["lag"]
assert [effect.name for effect in second.effects] == ["lag"]
# sphinx_gallery_end_ignore
plt.show()
