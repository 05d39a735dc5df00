r"""
A scan and a ring of targets
============================

``TipController`` is the controller behind the calls of a planner. It keeps the clock and the reference, so that a
planner only says where to go. This page follows a scan. Then it visits a ring of targets with a pause at each, as an
ablation around a pulmonary vein does.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

SETTINGS = {
    "model": "builtin:pi",
    "actuator_lag_s": 0.08,  # a lag of the drive that the model does not contain
    "controller": {"kind": "linearised_mpc", "ladder": {"safe_command": 0.0}},  # where `stop` goes
    "motion": {"velocity_deg_s": 30, "acceleration_deg_s2": 200, "jerk_deg_s3": 3000},  # of `set_target`
    "tolerance_deg": 0.5,  # settled is closer than this
}


class Bench:
    """A simulated catheter and its controller; it remembers what happened.

    Args:
        friction: factor on the widths of the plays. The model does not know it.
    """

    def __init__(self, friction):
        effects = hystmpc.Effects(lag_s=0.08, noise_deg=0.15, mismatch={"prandtl_ishlinskii.alpha": friction})
        self.device = hystmpc.SimulatedPlant(hystmpc.load_model("builtin:tendon-catheter").simulator, effects, seed=1)
        self.tip = hystmpc.TipController.from_config(SETTINGS)
        self.measured_deg, self.log = self.device.reset(), []

    def step(self):
        """One sample of 0.04 s."""
        self.measured_deg = self.device.apply(self.tip.step(self.measured_deg).u)
        state = self.tip.state()
        self.log.append((state.time_s, state.reference_deg, self.device.true_angle, state.command))


# %%
# A scan
# ------
# The controller first goes to the middle of the scan. Then the planner hands over its own function of time.

CENTRE_DEG, AMPLITUDE_DEG, FREQUENCY_HZ = 58.0, 15.0, 0.25
bench = Bench(friction=1.0)
bench.tip.set_target(CENTRE_DEG)
while not bench.tip.state().settled:
    bench.step()
arrived = len(bench.log)
bench.tip.set_reference(lambda t: CENTRE_DEG + AMPLITUDE_DEG * np.sin(2.0 * np.pi * FREQUENCY_HZ * t))
for _ in range(round(2.0 / FREQUENCY_HZ / bench.tip.dt)):
    bench.step()

time_s, reference_deg, true_deg, command_mm = np.array(bench.log).T
scan_error_deg = (true_deg - reference_deg)[arrived:]
scan_rmse_deg = float(np.sqrt(np.mean(scan_error_deg**2)))
figure, (angle, error) = plt.subplots(2, 1, figsize=(7.0, 3.8), sharex=True, height_ratios=(3, 2))
angle.plot(time_s, reference_deg, color="C6", linewidth=2.4, alpha=0.45, label="reference")
angle.plot(time_s, true_deg, color="C0", label="tip")
angle.set(ylabel="tip angle [deg]", title=f"A scan at {FREQUENCY_HZ} Hz: RMSE {scan_rmse_deg:.2f} deg")
angle.legend(loc="upper left")
error.plot(time_s[arrived:], scan_error_deg, color="C1")
error.set(xlabel="time [s]", ylabel="error [deg]")
plt.show()

# %%
# A ring of targets
# -----------------
# The catheter bends in one plane and is rolled about its axis. The ring has the radius ``rho`` around an axis that
# lies ``theta_0`` off the catheter's own. At the place ``psi`` of the ring, bend and roll are
#
# .. code-block:: text
#
#     cos(theta) = cos(theta_0) cos(rho) - sin(theta_0) sin(rho) cos(psi)
#     tan(roll)  = sin(rho) sin(psi) / (sin(theta_0) cos(rho) + cos(theta_0) sin(rho) cos(psi))
#
# The planner rolls the catheter. The controller bends it. The friction of this device is 1.2 times that of the model.

AXIS, RADIUS = math.radians(58.0), math.radians(15.0)


def place(psi):
    """Roll and bend at a place of the ring [deg]."""
    off = math.sin(RADIUS) * math.cos(psi)
    bend = math.acos(math.cos(AXIS) * math.cos(RADIUS) - math.sin(AXIS) * off)
    roll = math.atan2(math.sin(RADIUS) * math.sin(psi), math.sin(AXIS) * math.cos(RADIUS) + math.cos(AXIS) * off)
    return math.degrees(roll), math.degrees(bend)


PAUSE_S = 1.0
bench, visits = Bench(friction=1.2), []
for roll_deg, bend_deg in [place(psi) for psi in 2.0 * np.pi * np.arange(8) / 8]:
    reach = bench.tip.set_target(bend_deg)  # says whether the target can be reached
    assert reach, reach.reason
    started = bench.tip.state().time_s
    while not bench.tip.state().settled and bench.tip.state().time_s < started + 5.0:
        bench.step()
    settled_s = bench.tip.state().time_s - started
    for _ in range(round(PAUSE_S / bench.tip.dt)):
        bench.step()
    paused_deg = np.array(bench.log)[-round(PAUSE_S / bench.tip.dt) :, 2]
    visits.append((roll_deg, bend_deg, settled_s, np.max(np.abs(paused_deg - bend_deg))))

roll_deg, bend_deg, settled_s, pause_error_deg = np.array(visits).T
time_s, reference_deg, true_deg, command_mm = np.array(bench.log).T
figure, (angle, command) = plt.subplots(2, 1, figsize=(7.0, 3.8), sharex=True, height_ratios=(3, 2))
angle.plot(time_s, reference_deg, color="C6", linewidth=2.4, alpha=0.45, label="reference")
angle.plot(time_s, true_deg, color="C0", label="tip")
angle.set(ylabel="bend [deg]", title=f"Eight targets, settled after {settled_s.mean():.1f} s in the mean")
angle.legend(loc="lower center")
command.step(time_s, command_mm, where="pre", color="C2")
command.set(xlabel="time [s]", ylabel="command [mm]")
plt.show()

# %%
# The command rests in each pause. The friction that the model does not know costs no steady error, since the estimate
# of the controller takes it up.

figure, axes = plt.subplots(figsize=(4.6, 3.4))
ring = np.array([place(psi) for psi in np.linspace(0.0, 2.0 * np.pi, 200)])
axes.plot(*ring.T, color="C6", linewidth=2.4, alpha=0.45)
points = axes.scatter(roll_deg, bend_deg, c=pause_error_deg, cmap="viridis", vmin=0.0, zorder=3)
axes.set(xlabel="roll [deg]", ylabel="bend [deg]", title="The ring as roll and bend")
figure.colorbar(points, label="greatest error in the pause [deg]")
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert scan_rmse_deg < 0.8
assert max(abs(scan_error_deg)) < 3
assert max(settled_s) < 3
assert max(pause_error_deg) < 1.5
assert np.allclose(roll_deg[1:4], -roll_deg[:4:-1])
# sphinx_gallery_end_ignore
plt.show()
