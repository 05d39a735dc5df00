"""
What hysteresis is
==================

A tendon that slips in its sheath does not move the tip at once when it turns. The tip angle then depends on the past of
the command, not only on its present value. This page builds that behaviour from its smallest part: the play operator.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# One play
# --------
# A play of half-width r is a pin in a slot of width 2 r. The command moves the slot. The pin moves only when an end of
# the slot pushes it. The memory of the play is the position z of the pin.


def play(command, r):
    """Positions of the pin for a sequence of commands; it starts in the middle of its slot."""
    z, positions = command[0], []
    for u in command:
        z = max(u - r, min(u + r, z))
        positions.append(z)
    return np.array(positions)


time_s = np.arange(0.0, 20.0, 0.04)
command_mm = 3.0 - 3.0 * np.cos(2.0 * np.pi * 0.2 * time_s) * np.exp(-0.08 * time_s)
pin_mm = play(command_mm, 0.6)

figure, (over_time, loop) = plt.subplots(1, 2, figsize=(7.0, 3.0), width_ratios=(3, 2))
over_time.plot(time_s, command_mm, color="C2", label="command")
over_time.plot(time_s, pin_mm, color="C1", label="pin of the play")
over_time.set(xlabel="time [s]", ylabel="position [mm]", ylim=(-0.2, 7.4), title="The pin waits at each turn")
over_time.legend(loc="upper right", ncols=2)
loop.plot(command_mm, pin_mm, color="C1")
loop.set(xlabel="command [mm]", ylabel="pin [mm]", title="Its loops are parallelograms")
plt.show()

# %%
# The pin stands still after each turn until the command has moved by 2 r. One command therefore belongs to many
# positions: which one holds depends on the last turns.
#
# Many plays
# ----------
# Friction along a real tendon does not let go everywhere at once. A weighted sum of plays of different widths describes
# that. It is called the Prandtl-Ishlinskii model. More plays make rounder loops.

figure, axes = plt.subplots(1, 3, figsize=(7.0, 2.6), sharey=True)
for each, plays in zip(axes, (1, 3, 12), strict=True):
    radii = 1.2 * np.arange(1, plays + 1) / (plays + 1)
    total = 0.4 * command_mm + 0.6 * np.mean([play(command_mm, r) for r in radii], axis=0)
    each.plot(command_mm, total, color="C1")
    each.set(xlabel="command [mm]", title=f"{plays} play{'s' * (plays > 1)}")
axes[0].set_ylabel("output [mm]")
plt.show()

# %%
# A catheter
# ----------
# ``builtin:tendon-catheter`` is a simulated catheter with four plays. Its numbers reproduce the loop of a published
# one. The same command now gives a tip angle in degrees. Two angles at 3 mm, one on the way up and one on the way down,
# show how large the hysteresis is.

device = hystmpc.SimulatedPlant(hystmpc.load_model("builtin:tendon-catheter").simulator)
device.reset()
angle_deg = np.array([device.apply(u) for u in command_mm])

turn = int(np.argmax(command_mm))
up_deg = np.interp(3.0, command_mm[:turn], angle_deg[:turn])
down_deg = np.interp(3.0, command_mm[2 * turn : turn : -1], angle_deg[2 * turn : turn : -1])
height_deg = down_deg - up_deg
figure, axes = plt.subplots(figsize=(5.0, 3.2))
axes.plot(command_mm, angle_deg, color="C0")
axes.plot([3.0, 3.0], [up_deg, down_deg], "o-", color="C3", label=f"{height_deg:.1f} deg at one command")
axes.set(xlabel="command [mm]", ylabel="tip angle [deg]", title="The catheter remembers where it turned")
axes.legend()
# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert np.allclose(pin_mm, np.clip(pin_mm, command_mm - 0.6, command_mm + 0.6))
assert height_deg > 5
# sphinx_gallery_end_ignore
plt.show()
