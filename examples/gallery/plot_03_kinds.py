"""
Which kind of model?
====================

``hystmpc.fit`` knows many kinds of models. This page fits five of them to the same trials and compares them on motions
left out. The device is a rod catheter from the equations of mechanics: an elastic tendon rubs in its lumen and bends a
rod. None of the models has these equations, so the comparison is fair.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

import hystmpc
from hystmpc.sim import RodParameters, simulate_rod

plt.style.use("hystmpc.trials.report")

# %%
# The device and its trials
# -------------------------
# Each trial starts with a new rod, which keeps a small set after its first bend. ``skip_first_flexure`` therefore
# counts each trial only from the first turn of the command on.

DT_S = 0.04
time_s = np.arange(0.0, 20.0, DT_S)


def record(seed, frequency_hz, rate_per_s):
    """A trial of 20 s: a full bend, then a decaying sine with a hold of 3 s at its end."""
    decay = np.exp(-rate_per_s * time_s)
    command_mm = 3.0 - 3.0 * np.cos(2.0 * np.pi * frequency_hz * time_s) * decay
    command_mm[-75:] = command_mm[-75]
    _, measured_deg = simulate_rod(RodParameters(), command_mm, DT_S, seed)
    return hystmpc.Trial(time_s, command_mm, measured_deg, source=f"{frequency_hz} Hz")


trials = [record(1, 0.2, 0.1), record(2, 0.45, 0.02), record(3, 0.3, 0.05)]
unseen = [record(4, 0.25, 0.08), record(5, 0.38, 0.03)]

figure, axes = plt.subplots(figsize=(4.2, 3.0))
axes.plot(trials[0].command, trials[0].angle, color="C0")
axes.set(xlabel="command [mm]", ylabel="tip angle [deg]", title="The rod's first loop differs from the later ones")
plt.show()

# %%
# Fit and compare
# ---------------
# ``backlash`` is one play between two lines. ``pi`` is a sum of plays. ``bouc_wen`` is a differential equation.
# ``play_kernel`` sums curves of plays. ``auto`` looks for the parts of the device itself. Networks are not on this
# page: they need more data and minutes of training.

kinds = ("backlash", "pi", "bouc_wen", "play_kernel", "auto")
evaluations, seconds = {}, {}
for kind in kinds:
    started = time.process_time()
    model = hystmpc.fit(kind, trials, skip_first_flexure=True)
    seconds[kind] = time.process_time() - started
    evaluations[kind] = hystmpc.evaluate(model, unseen, skip_first_flexure=True)

rmse_deg = {kind: evaluation.mean.rmse_deg for kind, evaluation in evaluations.items()}
figure, (error, duration) = plt.subplots(1, 2, figsize=(7.0, 2.4), sharey=True)
error.barh(kinds, [rmse_deg[kind] for kind in kinds], color="C1")
error.set(xlabel="RMSE on motions left out [deg]", title="Free run")
error.invert_yaxis()
duration.barh(kinds, [seconds[kind] for kind in kinds], color="C6")
duration.set(xlabel="processor time to fit [s]", title="Cost")
plt.show()

# %%
# Where they differ
# -----------------
# The error of the backlash follows the motion: a real loop has round corners, and one play has sharp ones. Start with
# ``auto``. Take another kind if its free run on your own trials is better.

figure, axes = plt.subplots(figsize=(7.0, 2.8))
for kind in ("backlash", "pi", "auto"):
    run = evaluations[kind][0]
    counted = slice(run.start, None)
    axes.plot(run.trial.t[counted], (run.trial.angle - run.theta)[counted], linewidth=0.9, label=kind)
axes.set(xlabel="time [s]", ylabel="measured - model [deg]", title="Error on the first motion left out")
figure.legend(loc="outside lower center", ncols=3)
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert all(rmse_deg[kind] < rmse_deg["backlash"] for kind in kinds if kind != "backlash")
# sphinx_gallery_end_ignore
plt.show()
