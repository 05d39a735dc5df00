"""A simulator of one's own for `hystmpc diagnose`: a tip in MuJoCo that a tendon bends. It needs pip install mujoco."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

SETTLE_S = 2.0  # at the first command
PRETENSION_MM = 2.0  # travel at the command zero


class Tip:
    """Four links on elastic joints with dry friction, see tip.xml.

    Args:
        friction: of the joints, as a multiple of that in the file.
    """

    def __init__(self, friction: float = 1.0) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("tip.xml")))
        self.model.dof_frictionloss *= friction

    def run(self, command: np.ndarray, dt: float) -> np.ndarray:
        """Bend of the tip (T,) [deg] for travels of the drive (T,) [mm], each held for `dt` [s]; it begins at rest."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        straight_m, steps = float(data.ten_length[0]), round(dt / self.model.opt.timestep)

        def bend(travel_mm: float, steps: int) -> float:
            data.ctrl[0] = straight_m - (PRETENSION_MM + travel_mm) / 1000.0
            mujoco.mj_step(self.model, data, steps)
            return float(np.degrees(data.qpos.sum()))

        bend(command[0], round(SETTLE_S / self.model.opt.timestep))
        return np.array([bend(travel_mm, steps) for travel_mm in command])
