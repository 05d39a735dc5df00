r"""
The model in your own CasADi problem
====================================

``load_model(file).casadi_function()`` is one sample of any model, with exact derivatives: ``(state, u) -> (theta, next
state)``. It works for a simulator and for a network in an ONNX file. This page builds an optimal control problem from
it, solves it with IPOPT at every sample, and compares the commands with those of the linearised controller.
"""

import time

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# The problem
# -----------
# Single shooting over H samples, with an output disturbance d, the limits of the command and those of its rate:
#
# .. code-block:: text
#
#     minimise over u:  sum_k (theta_k + d - r_k)^2 + w (u_k - u_(k-1))^2
#
# What follows can be changed at will: other costs, other constraints, several actuators.

HORIZON, TERMINAL, RATE = 5, 2.0, 3.0  # samples; factor on the last error; weight of a move [1/mm^2]


def optimal_control_problem(step, limits, dt):
    """A function (state, last command, disturbance, reference, first guess) -> commands (H,)."""
    opti = ca.Opti()
    u = opti.variable(HORIZON)
    state, last, disturbance = opti.parameter(step.numel_in(0)), opti.parameter(), opti.parameter()
    reference = opti.parameter(HORIZON)
    x, errors = state, []
    for k in range(HORIZON):
        theta, x = step(x, u[k])
        errors.append(theta + disturbance - reference[k])
    errors[-1] *= np.sqrt(TERMINAL)
    moves = u - ca.vertcat(last, u[:-1])
    opti.minimize(ca.sumsqr(ca.vertcat(*errors)) + RATE * ca.sumsqr(moves))
    opti.subject_to(opti.bounded(limits.lower, u, limits.upper))
    opti.subject_to(opti.bounded(-limits.rate * dt, moves, limits.rate * dt))
    quiet = {"print_level": 0, "sb": "yes", "hessian_approximation": "limited-memory", "tol": 1e-6}
    opti.solver("ipopt", {"print_time": False}, quiet)
    return opti.to_function("plan", [state, last, disturbance, reference, u], [u])


plain = hystmpc.load_model("builtin:pi", start="conditioned")
facts = plain.metadata
limits = hystmpc.Limits(facts.command_limits.lower, facts.command_limits.upper, facts.command_rate)
problem = optimal_control_problem(plain.casadi_function(), limits, plain.dt)
at_rest = plain.at_rest(28.5, 0.0)  # angle [deg] and command of the device before the plan
target_deg = np.full(HORIZON, 40.0)
plan_mm = np.asarray(problem(at_rest, 0.0, 0.0, target_deg, np.zeros(HORIZON))).ravel()
x, plan_deg = at_rest, []
for u in plan_mm:
    theta, x = plain.casadi_function()(x, u)
    plan_deg.append(float(theta))

figure, (command, angle) = plt.subplots(1, 2, figsize=(7.0, 2.4))
command.step(np.arange(HORIZON + 1), np.append(0.0, plan_mm), where="pre", color="C2")
command.set(xlabel="sample [1]", ylabel="command [mm]", title="One plan to 40 deg: the rate limit holds")
angle.plot(np.arange(1, HORIZON + 1), plan_deg, "o-", color="C1", markersize=3)
angle.set(xlabel="sample [1]", ylabel="tip angle [deg]", title="What the model expects of it")
plt.show()

# %%
# The plan is at the rate limit until its last sample. The model then expects the tip to go on while the command rests,
# since the plays of this model are wider in fast motion. A plan can use that because its model knows it.
#
# Two solvers, one model
# ----------------------
# Both get the same state, disturbance and reference at each sample. The linearised controller drives the device. It
# linearises four times a sample here, so that it converges too, and it learns nothing, as IPOPT's model does not.

SETTINGS = {
    "kind": "linearised_mpc",
    "horizon": HORIZON,
    "iterations": 4,
    "weights": {"terminal": TERMINAL, "discount": 1.0, "rate": RATE, "effort": 0.0},
    "adaptation": None,
}


def compare(name, samples):
    """Commands (T, 2) [mm] and times (T, 2) [s] of the linearised controller and of IPOPT along a scan."""
    model = hystmpc.load_model(name, start="conditioned")
    step, facts = model.casadi_function(), model.metadata
    limits = hystmpc.Limits(facts.command_limits.lower, facts.command_limits.upper, facts.command_rate)
    problem = optimal_control_problem(step, limits, model.dt)
    tip = hystmpc.TipController.from_config({"model": name, "controller": SETTINGS})
    device = hystmpc.SimulatedPlant(hystmpc.load_model("builtin:tendon-catheter").simulator, seed=1)
    rest = measured = device.reset()
    last, guess = device.rest_command, np.full(HORIZON, device.rest_command)
    state = np.asarray(step(model.at_rest(rest, last), last)[1]).ravel()  # the controller has held it for a sample
    tip.set_reference(lambda t: rest + 15.0 * (1.0 - np.cos(2.0 * np.pi * 0.5 * t)))
    commands, seconds = [], []
    for _ in range(samples):
        started = time.perf_counter()
        command = tip.step(measured)
        between = time.perf_counter()
        plan = problem(state, last, command.disturbance, tip.plan().reference_deg, guess)
        seconds.append((between - started, time.perf_counter() - between))
        guess = np.asarray(plan).ravel()
        commands.append((command.u, guess[0]))
        measured, last = device.apply(command.u), command.u
        state = np.asarray(step(state, last)[1]).ravel()
        guess = np.append(guess[1:], guess[-1])
    return np.array(commands), np.array(seconds)


difference_mm = {}
figure, (plan, cost) = plt.subplots(1, 2, figsize=(7.0, 2.8), width_ratios=(3, 2))
for colour, (name, samples) in zip(("C0", "C1"), (("builtin:lstm", 8), ("builtin:pi", 12)), strict=True):
    commands_mm, seconds = compare(name, samples)
    difference_mm[name] = float(np.max(np.abs(commands_mm[:4, 0] - commands_mm[:4, 1])))
    plan.plot(commands_mm[:, 0], color=colour, label=f"{name}, linearised")
    plan.plot(commands_mm[:, 1], "o", color=colour, markersize=3, label=f"{name}, IPOPT")
    cost.semilogy(1e3 * seconds[:, 0], color=colour)
    cost.semilogy(1e3 * seconds[:, 1], "o", color=colour, markersize=3)
plan.set(xlabel="sample [1]", ylabel="command [mm]", title="Commands")
plan.legend()
cost.set(xlabel="sample [1]", ylabel="time of a step [ms]", title="Time")
print(difference_mm)
plt.show()

# %%
# Along the network both solvers find the same commands. Along the sum of plays they agree at first and then part: plays
# have kinks, and at a kink two local searches may stop at different points. IPOPT takes longer, since it does not use
# the form of the problem.

# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert max(difference_mm.values()) < 4e-3
assert plan_deg[-1] > plan_deg[0] + 3
# sphinx_gallery_end_ignore
