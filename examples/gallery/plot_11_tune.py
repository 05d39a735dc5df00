"""
Tune a controller
=================

``hystmpc.tune`` searches the settings of a controller on a set of simulated devices that differ in lag, noise and
friction. It judges the result on devices that the search has not seen. This page tunes a PID with
twelve trials on three devices. Sixty trials on ten devices are the default.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# The study and what differs between devices
# ------------------------------------------
# ``base`` is a study as ``simulate`` takes it. ``draw`` says what differs from device to device. The first trial of the
# search has the settings as given, so the result is never worse than they are on the devices of the search.

scan = {"kind": "scan_sinusoid", "start_deg": 29, "centre_deg": 56, "amplitude_deg": 14, "frequency_hz": 0.4}
scratch = tempfile.TemporaryDirectory()
tuning = hystmpc.tune(
    {
        "base": {
            "plant": {"simulator": "builtin:tendon-catheter"},
            "model": "builtin:pi",
            "motions": {"scan": {**scan, "cycles": 2}},
            "controllers": {"pid": {"kind": "pid", "gains": {"kp_per_deg": 0.05, "ki_per_deg_s": 1.0}}},
        },
        "draw": {
            "plant.lag_s": {"uniform": [0.03, 0.15]},
            "plant.noise_deg": {"uniform": [0.05, 0.3]},
            'plant.mismatch."prandtl_ishlinskii.alpha"': {"uniform": [0.8, 1.3]},
        },
        "plants": {"count": 3, "seed": 1},
        "held_out": {"count": 8, "seed": 2},
        "trials": 12,
        "seed": 0,
    },
    Path(scratch.name) / "tuning",
)
print(tuning.best.values)

objective = [trial.value for trial in tuning.trials]
figure, axes = plt.subplots(figsize=(7.0, 2.6))
axes.plot(objective, "o", color="C6", markersize=3, label="trial")
axes.step(np.arange(len(objective)), np.minimum.accumulate(objective), where="post", color="C1", label="best so far")
axes.set_yscale("log")
axes.set(xlabel="trial [1]", ylabel="objective [deg]", title="The search")
axes.legend()
plt.show()

# %%
# On devices that the search has not seen
# ---------------------------------------
# Each point is a device. Below the line the tuned settings track better than the given ones.

given_deg, tuned_deg = tuning.check.errors("given"), tuning.check.errors("tuned")
reach_deg = 1.05 * max(given_deg.max(), tuned_deg.max())
figure, axes = plt.subplots(figsize=(3.6, 3.4))
axes.plot((0, reach_deg), (0, reach_deg), color="C6", linewidth=0.8)
axes.plot(given_deg, tuned_deg, "o", color="C0", markersize=4)
axes.set(xlim=(0, reach_deg), ylim=(0, reach_deg), aspect="equal")
axes.set(xlabel="RMSE, given settings [deg]", ylabel="RMSE, tuned settings [deg]", title="Eight new devices")
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert all(tuned_deg < given_deg)
assert tuning.best.value == min(objective)
# sphinx_gallery_end_ignore
plt.show()
