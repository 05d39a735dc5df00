"""
Inverse, PID and predictive control
===================================

There are three ways to make the tip follow a wish: invert the model, feed the error back, or plan ahead with the model
and correct it by the measurement. This page compares them on one catheter with plays and lag. Then it shows what the
predictive controller loses when its model forgets the state of the plays.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# One device, three controllers
# -----------------------------
# ``builtin:auto`` was identified from simulated trials of this catheter. Since then its friction has grown: the plays
# are 1.2 times as wide. The gains of the PID come from a search on the device as it was. ``simulate`` runs each
# controller on the same device with the same noise.

ALPHA = "prandtl_ishlinskii.alpha"  # spacing of the widths of the plays
study = hystmpc.simulate(
    {
        "plant": {"simulator": "builtin:tendon-catheter", "lag_s": 0.08, "noise_deg": 0.15, "mismatch": {ALPHA: 1.2}},
        "model": "builtin:auto",
        "motions": {
            "scan": {
                "kind": "scan_triangle",
                "start_deg": 29,
                "centre_deg": 56,
                "amplitude_deg": 16,
                "frequency_hz": 0.2,
                "cycles": 2.5,
            }
        },
        "controllers": {
            "inverse": {"kind": "inverse"},
            "pid": {
                "kind": "pid",
                "gains": {"kp_per_deg": 0.3877, "ki_per_deg_s": 2.732, "kd_s_per_deg": 0.0, "dead_zone_deg": 0.1732},
            },
            "linearised_mpc": {"kind": "linearised_mpc"},
        },
        "seed": 1,
    }
)
rmse_deg = {result.controller: result.metrics.rmse_deg for result in study.results}

figure, axes = plt.subplots(figsize=(7.0, 2.8))
for result in study.results:
    label = f"{result.controller}: RMSE {result.metrics.rmse_deg:.2f} deg"
    axes.plot(result.run.log.time_s, result.run.error_deg, linewidth=0.9, label=label)
axes.set(xlabel="time [s]", ylabel="true angle - reference [deg]", title="Error along a scan")
figure.legend(loc="outside lower center", ncols=3)
plt.show()

# %%
# The inverse crosses the plays of its model, which are too narrow now. It never sees that, so it stays behind in both
# directions. The PID sees it. But it has nothing except the error to act on, and needs high gains. The predictive
# controller knows the plays and also corrects what it measures.
#
# What the device has to do
# -------------------------
# High gains pass the noise of the sensor on to the command. The figure shows the commands around one turn, and the
# travel of each command over the whole scan.

turn_s = study.results[0].run.log.time_s[np.argmax(study.results[0].run.log.reference_deg)]
travel_mm = {result.controller: result.metrics.command_travel for result in study.results}
figure, axes = plt.subplots(figsize=(7.0, 2.8))
for result in study.results:
    label = f"{result.controller}: {travel_mm[result.controller]:.0f} mm"
    axes.step(result.run.log.time_s, result.run.log.command, where="pre", linewidth=0.9, label=label)
axes.axvline(turn_s, color="C6", linewidth=0.8)
axes.set(xlim=(turn_s - 1.2, turn_s + 0.8), ylim=(3.2, 5.2))
axes.set(xlabel="time [s]", ylabel="command [mm]", title="Commands around a turn of the reference (line)")
figure.legend(loc="outside lower center", ncols=3)
plt.show()

# %%
# A model without memory
# ----------------------
# Now the model loses its plays: all their weight goes to the straight term. It keeps the lag and the mean slope, and it
# has no state that says which way the device turned last. Both controllers estimate an offset from the measurement.
# Neither learns the error of its model here (``"adaptation": None``), so that the difference is the model's alone.

simulator = hystmpc.load_model("builtin:auto").simulator
values = dict(zip(simulator.chain.labels, simulator.chain.values, strict=True))
plays = [label for label in values if label.startswith("prandtl_ishlinskii.a") and label[-1] in "123456"]
values["prandtl_ishlinskii.a0"] += sum(values[label] for label in plays)
values.update(dict.fromkeys(plays, 0.0))
memoryless = replace(simulator, chain=simulator.chain.with_values(list(values.values())))

effects = hystmpc.Effects(lag_s=0.08, noise_deg=0.15, mismatch={ALPHA: 1.2})
device = hystmpc.SimulatedPlant(hystmpc.load_model("builtin:tendon-catheter").simulator, effects, seed=1)
scan = hystmpc.TriangleScan(start_deg=29, centre_deg=56, amplitude_deg=16, frequency_hz=0.2, cycles=2.5)
figure, axes = plt.subplots(figsize=(7.0, 2.8))
memory_rmse_deg = {}
for label, model in (("with the state of the plays", simulator), ("without", memoryless)):
    controller = hystmpc.build_controller({"kind": "linearised_mpc", "adaptation": None}, model)
    run = hystmpc.run_closed_loop(controller, device, scan)
    memory_rmse_deg[label] = float(np.sqrt(np.mean(run.error_deg**2)))
    text = f"{label}: RMSE {memory_rmse_deg[label]:.2f} deg"
    axes.plot(run.log.time_s, run.error_deg, linewidth=0.9, label=text)
axes.set(xlabel="time [s]", ylabel="true angle - reference [deg]", title="The same controller with two models")
figure.legend(loc="outside lower center", ncols=2)
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert rmse_deg["linearised_mpc"] < rmse_deg["pid"] < rmse_deg["inverse"]
assert travel_mm["linearised_mpc"] < travel_mm["pid"]
assert memory_rmse_deg["with the state of the plays"] < 0.5 * memory_rmse_deg["without"]
# sphinx_gallery_end_ignore
plt.show()
