r"""
A catheter in a block diagram of python-control
===============================================

``to_control()`` makes a system of `python-control <https://python-control.readthedocs.io>`_ of any model: discrete
time, our exact step, named signals. This page closes a loop around the catheter with blocks of its own, looks at the
two slopes of hysteresis, and compares the limit cycle that a describing function predicts with the one of the loop.
"""

import control
import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# The loop
# --------
# The motor is your own model, here a lag of 0.2 s. It becomes a block at the sample time of the catheter. The catheter
# shows its angle at the end of a sample, and the motor has to move within that sample too: its output is that of the
# next state, ``C A x + C B u``. ``control.interconnect`` joins blocks by the names of their signals.

model = hystmpc.load_model("builtin:backlash", start="conditioned")
catheter, dt = model.to_control("catheter"), model.dt
held = control.sample_system(control.ss(control.tf([1.0], [0.2, 1.0])), dt)
parts = held.A, held.B, held.C @ held.A, held.C @ held.B, dt
motor = control.ss(*parts, inputs=["u"], outputs=["command_mm"], name="motor")
error = control.summing_junction(["target_deg", "-angle_deg"], "error_deg", name="difference")


def loop_with(kp, ki):
    """Motor, catheter and a PI controller [mm/deg, mm/(deg s)] as one system."""
    pi = control.ss([[1.0]], [[ki * dt]], [[1.0]], [[kp]], dt, inputs=["error_deg"], outputs=["u"], name="pi")
    shown = ["angle_deg", "command_mm"]
    return control.interconnect([error, pi, motor, catheter], inputs=["target_deg"], outputs=shown)


def run(loop, angle_deg, command_mm, target_deg):
    """Response from rest at a command and its angle."""
    rest = control.find_operating_point(motor, np.zeros(motor.nstates), [command_mm]).states
    start = np.concatenate([[command_mm], rest, model.resting_x(angle_deg, command_mm)])
    time_s = dt * np.arange(target_deg.size)
    return time_s, control.input_output_response(loop, time_s, target_deg, start).outputs


target_deg = np.where(np.arange(300) < 150, 50.0, 40.0)
time_s, (angle_deg, command_mm) = run(loop_with(0.02, 0.2), 45.0, 2.2, target_deg)

figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(7, 4))
upper.plot(time_s, target_deg, linestyle="--", label="target")
upper.plot(time_s, angle_deg, label="catheter")
upper.set_ylabel("angle [deg]")
upper.legend()
lower.plot(time_s, command_mm)
lower.set(xlabel="time [s]", ylabel="command [mm]")
plt.show()

# %%
# Two slopes
# ----------
# After a rise the command may go on or turn. Where it goes on, the angle follows with the slope of the loading line.
# Where it turns, the command first crosses the dead band, and nothing moves. A linearisation has to be told which.

after_a_rise = model.run_on(model.resting_x(30.0, 0.5)[None, :-1], np.linspace(0.5, 3.0, 60)[None])
edge = np.append(after_a_rise[1][0], after_a_rise[0][0, -1])
rising, falling = (control.linearize(catheter, edge, [3.0], params={"branch": way}) for way in (1, -1))
slopes = [float(abs(system(np.exp(1j * 0.1)))) for system in (rising, falling)]

figure, axis = plt.subplots(figsize=(7, 2.6))
axis.bar(["goes on", "turns"], slopes)
axis.set(ylabel="slope [deg/mm]", xlabel="what the command does after a rise [-]")
plt.show()

# %%
# The limit cycle
# ---------------
# With more gain the loop oscillates around the play. ``describing_function_response`` of the library finds where the
# Nyquist curve of the linear blocks crosses -1 / N(A) of the hysteresis.

kp, ki = 0.02, 1.5
pi = control.tf([kp, ki * dt - kp], [1.0, -1.0], dt)
late = control.tf([1.0], [1.0, 0.0], dt)  # a command shows at the end of its sample
linear = pi * control.tf(motor) * late
amplitudes = np.geomspace(0.35, 2.9, 200)
(backlash,) = model.operators
play = hystmpc.models.OperatorNonlinearity(backlash, centre=3.0)
values = control.describing_function(play, amplitudes)
omega = np.geomspace(0.2, np.pi / dt, 600)
curve = linear(np.exp(1j * omega * dt))

time_s, (angle_deg, command_mm) = run(loop_with(kp, ki), 45.0, 2.2, np.full(1500, 52.0))
last = slice(-700, None)
seen_mm = 0.5 * np.ptp(command_mm[last])
up = np.flatnonzero(np.diff(np.sign(angle_deg[last] - angle_deg[last].mean())) > 0)
seen_hz = (up.size - 1) / ((up[-1] - up[0]) * dt)

figure, (left, right) = plt.subplots(1, 2, figsize=(7, 3.2))
left.plot(curve.real, curve.imag, label="linear blocks")
left.plot((-1 / values).real, (-1 / values).imag, linestyle="--", label="-1 / N(A)")
left.set(xlim=(-0.6, 0.05), ylim=(-0.6, 0.1), xlabel="real part [mm/deg]", ylabel="imaginary part [mm/deg]")
left.legend()
right.plot(time_s[last], angle_deg[last])
right.set(xlabel="time [s]", ylabel="angle [deg]", xlim=(time_s[-150], time_s[-1]))
plt.show()

# %%
# The crossing is at the amplitude and the frequency of the limit cycle. ``hystmpc analyse`` does this for every
# controller of a configuration, with the higher harmonics and with doubts where the method is not valid.

distance = np.abs(1.0 + np.outer(curve, values[amplitudes > 0.5]))
row, column = np.unravel_index(np.argmin(distance), distance.shape)
predicted_mm, predicted_hz = amplitudes[amplitudes > 0.5][column], omega[row] / (2 * np.pi)
print(f"predicted {predicted_mm:.2f} mm at {predicted_hz:.2f} Hz")
print(f"simulated {seen_mm:.2f} mm at {seen_hz:.2f} Hz")

# sphinx_gallery_start_ignore
assert slopes[0] > 5.0 > 1e-6 > slopes[1]
assert abs(predicted_mm / seen_mm - 1.0) < 0.15
assert abs(predicted_hz / seen_hz - 1.0) < 0.1
# sphinx_gallery_end_ignore
