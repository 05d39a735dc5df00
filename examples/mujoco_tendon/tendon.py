"""A catheter in MuJoCo whose tendon has hysteresis: pip install mujoco, then python examples/mujoco_tendon/tendon.py

MuJoCo computes links, inertia and contacts. The operator stands between the drive and the tendon's actuator: it turns
the travel of the drive [mm] into the bend that the tendon asks for. The drive goes up and down in triangles.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

import hystmpc

SAMPLE_S = 0.01  # of the operator: every fifth step of MuJoCo


class HystereticTendon:
    """An actuator of a MuJoCo model behind a simulator of hystmpc.

    Args:
        actuator: index of a position actuator whose tendon measures the bend [rad].
        plant: without noise; its sample time is a whole number of MuJoCo's steps.
    """

    def __init__(self, model: mujoco.MjModel, actuator: int, plant: hystmpc.SimulatedPlant) -> None:
        self._actuator, self._plant = actuator, plant
        self._every = round(plant.dt / model.opt.timestep)
        self._steps = 0
        self.asked_deg = plant.reset()

    def pull(self, data: mujoco.MjData, travel_mm: float) -> None:
        """Call it before every mj_step, with the travel of the drive."""
        if self._steps % self._every == 0:
            self.asked_deg = self._plant.apply(travel_mm)
        self._steps += 1
        data.ctrl[self._actuator] = np.radians(self.asked_deg)


def main() -> None:
    """Two slow triangles of 0 to 6 mm; prints the bend at 3 mm on the way up and on the way down."""
    model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("catheter.xml")))
    data = mujoco.MjData(model)
    simulator = hystmpc.load_model("builtin:tendon-catheter").simulator
    tendon = HystereticTendon(model, model.actuator("pull").id, hystmpc.SimulatedPlant(simulator, dt_s=SAMPLE_S))
    period_s, asked, bent = 8.0, [], []
    times = np.arange(0.0, 2 * period_s, model.opt.timestep)
    travels = 6.0 - np.abs(6.0 - 12.0 * (times / period_s % 1.0))
    for travel in travels:
        tendon.pull(data, float(travel))
        mujoco.mj_step(model, data)
        asked.append(tendon.asked_deg)
        bent.append(np.degrees(data.ten_length[0]))
    for way, time_s in (("up", 1.25 * period_s), ("down", 1.75 * period_s)):
        k = round(time_s / model.opt.timestep)
        print(f"{way}: {travels[k]:.2f} mm, operator {asked[k]:.2f} deg, MuJoCo {bent[k]:.2f} deg")


if __name__ == "__main__":
    main()
