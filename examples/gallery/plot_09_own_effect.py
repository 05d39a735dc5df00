r"""
Write your own effect
=====================

An effect is an operator: one equation, written once with CasADi symbols. All else follows from it: the
simulation, derivatives for the controller, and the ONNX file. This page writes an effect that the library does not have
and puts it before a hysteresis core.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import hystmpc

plt.style.use("hystmpc.trials.report")

# %%
# The equation
# ------------
# A motor pulls the tendon over a pulley that is not centred. The travel y then departs from the command u by a sine of
# the pulley's angle. The elastic belt to the motor adds a lag, so that the effect has a state v as well:
#
# .. code-block:: text
#
#     tau v' + v = u,   y = v + e sin(2 pi v / c)
#
# ``equation`` gets state x, input u, parameters p and the sample time. It returns the next state and the output. A
# field with a ``Number`` is a parameter with its unit, bounds, usual value and meaning.


@dataclass(frozen=True)
class EccentricPulley(hystmpc.Operator):
    """A pulley that is not centred, behind an elastic belt."""

    offset: Annotated[float, hystmpc.Number("cmd", 0.0, 10.0, 0.0, "departure of the travel, to either side")]
    circumference: Annotated[float, hystmpc.Number("cmd", 1e-3, 1e3, 1.0, "travel of one turn of the pulley")]
    tau_s: Annotated[float, hystmpc.Number("s", 1e-3, 1e3, 0.1, "time constant of the belt")]
    name: ClassVar[str] = "eccentric_pulley"
    state_names: ClassVar[tuple[str, ...]] = ("v",)

    def equation(self, x, u, p, dt):
        """One sample, exact for a command that is held in it."""
        v = u + (x[0] - u) * ca.exp(-dt / p[2])
        return v, v + p[0] * ca.sin(2.0 * np.pi * v / p[1])

    def at_rest(self, u, y, p):  # noqa: ARG002  # here the input alone tells the state
        """The belt has settled."""
        return ca.vertcat(u)


# %%
# A device with it
# ----------------
# ``with_effect`` puts an operator on the command side or on the output side of a simulator's chain.

plain = hystmpc.load_model("builtin:pi").simulator
pulley = EccentricPulley(offset=0.2, circumference=2.0, tau_s=0.05)
eccentric = replace(plain, chain=hystmpc.with_effect(plain.chain, pulley, "command"))

command_mm = 3.0 - 3.0 * np.cos(2.0 * np.pi * 0.05 * np.arange(0.0, 20.0, plain.dt_s))
figure, axes = plt.subplots(figsize=(5.0, 3.2))
for label, simulator in (("centred pulley", plain), ("eccentric pulley", eccentric)):
    device = hystmpc.SimulatedPlant(simulator)
    device.reset()
    axes.plot(command_mm, [device.apply(u) for u in command_mm], linewidth=0.9, label=label)
axes.set(xlabel="command [mm]", ylabel="tip angle [deg]", title="The effect shows as waves on the loop")
axes.legend()
plt.show()

# %%
# Control
# -------
# The controller takes the simulator as it is and has exact derivatives of the new equation. With a model that lacks the
# effect it has to find the waves by feedback. (``"adaptation": None``: it learns nothing beyond an offset.)

device = hystmpc.SimulatedPlant(eccentric, hystmpc.Effects(noise_deg=0.1), seed=1)
scan = hystmpc.SinusoidScan(start_deg=29, centre_deg=56, amplitude_deg=20, frequency_hz=0.3, cycles=4)
figure, axes = plt.subplots(figsize=(7.0, 2.8))
rmse_deg = {}
for label, model in (("without the effect", plain), ("with the effect", eccentric)):
    controller = hystmpc.build_controller({"kind": "linearised_mpc", "adaptation": None}, model)
    run = hystmpc.run_closed_loop(controller, device, scan)
    rmse_deg[label] = float(np.sqrt(np.mean(run.error_deg**2)))
    text = f"model {label}: RMSE {rmse_deg[label]:.2f} deg"
    axes.plot(run.log.time_s, run.error_deg, linewidth=0.9, label=text)
axes.set(xlabel="time [s]", ylabel="true angle - reference [deg]", title="Predictive control behind the pulley")
figure.legend(loc="outside lower center", ncols=2)
plt.show()

# %%
# Export
# ------
# ``export`` compares the ONNX file with the simulator step by step. It refuses to write a file that differs.

scratch = tempfile.TemporaryDirectory()
report = hystmpc.export(eccentric, Path(scratch.name) / "eccentric.onnx")
print(report)

# sphinx_gallery_start_ignore
# What this page claims; `make docs` checks it.
assert rmse_deg["with the effect"] < 0.5 * rmse_deg["without the effect"]
# sphinx_gallery_end_ignore
