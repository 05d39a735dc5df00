"""
A simulator of your own: MuJoCo
===============================

Your simulator is a program, and no model of hystmpc. If it can be called, ``hystmpc.diagnose`` lets it play the
recorded commands, names what is missing in it, and lets it play again to confirm the name.

Here it is a tip in MuJoCo, with dry friction in its joints and a tendon that can only pull: the class ``Tip`` of
``examples/mujoco_tip/tip.py``. It needs ``pip install mujoco``.
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

sys.path.append(str(Path(sys.argv[0]).resolve().parents[1] / "mujoco_tip"))
from tip import Tip
from tip_devices import DT_S, angles_deg, commands_mm

plt.style.use("hystmpc.trials.report")

# %%
# What is compared
# ----------------
# The simulator is an object with ``run(command, dt)``: commands in, angles out. The device is simulated as well. It is
# the same tip behind a drive that lags by 0.15 s. Its sensor has a noise of 0.1 deg.

simulator = Tip()
trials = [
    hystmpc.Trial(DT_S * np.arange(u.size), u, angle, source=f"trial_{k}.csv")
    for k, (u, angle) in enumerate(zip(commands_mm(), angles_deg("lag"), strict=True))
]

# %%
# Name and confirm
# ----------------
# A stand-in, which ``fit auto`` makes, says how an effect would change the output. The last word is that of the
# simulator: it plays the commands of the trials kept for the end once more, behind the named effect. They are in the
# folder ``replay``. The library is cut to three effects, which keeps this page quick.

scratch = tempfile.TemporaryDirectory()
folder = Path(scratch.name) / "diagnosis"
diagnosis = hystmpc.diagnose(trials, simulator, only=("creep", "lag", "slack"), out=folder, ordered=True)
(effect,) = diagnosis.effects
confirmed = diagnosis.confirmed[effect.name]
print(f"{diagnosis.verdict}: {effect.name}, probability {effect.probability:.2f}")
print(f"closes {effect.closed_share:.2f} of the gap, as the stand-in says")
low, high = confirmed.ci90
print(f"closes {confirmed.closed_share:.2f} of it ({low:.2f} to {high:.2f}), as the simulator's own answer says")

# %%
# See it
# ------
# One of the trials kept for the end. Behind the lag the simulator does what the device does, over time and as a loop.

log = next(trial for trial in trials if diagnosis.replay[0].startswith(Path(trial.source).stem))
behind_mm = np.loadtxt(folder / "replay" / diagnosis.replay[0], delimiter=",", skiprows=1)[:, 1]
outputs_deg = {
    "simulator": simulator.run(log.command, DT_S),
    "simulator behind the lag": simulator.run(behind_mm, DT_S),
}

figure, (course, loop) = plt.subplots(1, 2, figsize=(7.0, 2.8), width_ratios=(2, 1), sharey=True)
for axes, x in ((course, log.t), (loop, log.command)):
    axes.plot(x, log.angle, color="0.65", linewidth=2.5, label="device")
    for name, color in zip(outputs_deg, ("C1", "C0"), strict=True):
        axes.plot(x, outputs_deg[name], color=color, linewidth=0.9, label=name)
course.set(xlim=(0, 15), xlabel="time [s]", ylabel="tip angle [deg]", title="Over time")
loop.set(xlabel="command [mm]", title="As loops")
figure.legend(*course.get_legend_handles_labels(), loc="outside lower center", ncols=3)
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert (diagnosis.verdict, effect.name) == ("named", "lag")
assert abs(confirmed.closed_share - effect.closed_share) < 0.1
assert diagnosis.confirmed_rmse_deg < 0.3 * diagnosis.gap.retuned_rmse_deg
# sphinx_gallery_end_ignore
plt.show()

# %%
# Build the lag into your simulator now. Its equation is in the library of effects, and its numbers are those of the
# diagnosis.

for name, value in effect.parameters.items():
    print(f"{name}: {value:.3g} {effect.units[name]}")
