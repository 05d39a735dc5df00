"""
A controller that learns while it runs
======================================

A catheter changes: its friction grows when it is bent along its way. Its model was identified before that. By default
the predictive controllers learn what their model gets wrong, from the measurements of the run. This page compares a
controller that learns with one that does not.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# The device has changed
# ----------------------
# The widths of the plays are now twice those of the model. ``"adaptation": None`` turns the learning off. Both
# controllers still estimate an offset.

study = hystmpc.simulate(
    {
        "plant": {
            "simulator": "builtin:tendon-catheter",
            "lag_s": 0.08,
            "noise_deg": 0.15,
            "mismatch": {"prandtl_ishlinskii.alpha": 2.0},
        },
        "model": "builtin:auto",
        "motions": {
            "scan": {
                "kind": "scan_sinusoid",
                "start_deg": 29,
                "centre_deg": 56,
                "amplitude_deg": 16,
                "frequency_hz": 0.6,
                "cycles": 10,
            }
        },
        "controllers": {
            "without_learning": {"kind": "linearised_mpc", "adaptation": None},
            "with_learning": {"kind": "linearised_mpc"},
        },
        "seed": 1,
    }
)
rmse_deg = {result.controller: result.metrics.rmse_deg for result in study.results}

figure, axes = plt.subplots(figsize=(7.0, 2.8))
for result in study.results:
    label = f"{result.controller}: RMSE {result.metrics.rmse_deg:.2f} deg"
    axes.plot(result.run.log.time_s, result.run.error_deg, linewidth=0.9, label=label)
axes.set(xlabel="time [s]", ylabel="true angle - reference [deg]", title="Error along a scan at 0.6 Hz")
figure.legend(loc="outside lower center", ncols=2)
plt.show()

# %%
# Without learning each cycle is as bad as the one before. With it the way to the first cycle has already taught the
# controller a part, and the errors at the turns shrink further, cycle by cycle.
#
# Error cycle by cycle
# --------------------

CYCLE_S = 1.0 / 0.6
figure, axes = plt.subplots(figsize=(5.0, 2.6))
late_rmse_deg = {}
for result in study.results:
    time_s, error_deg = result.run.log.time_s, result.run.error_deg
    start_s = time_s[-1] - 10 * CYCLE_S
    cycle = np.floor((time_s - start_s) / CYCLE_S)
    each_deg = [np.sqrt(np.mean(error_deg[cycle == k] ** 2)) for k in range(10)]
    late_rmse_deg[result.controller] = float(np.mean(each_deg[5:]))
    axes.plot(np.arange(1, 11), each_deg, "o-", markersize=3, label=result.controller)
axes.set(xlabel="cycle of the scan [1]", ylabel="RMSE [deg]", ylim=(0, None), title="What the learning brings")
axes.legend()
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert late_rmse_deg["with_learning"] < 0.5 * late_rmse_deg["without_learning"]
# sphinx_gallery_end_ignore
plt.show()
