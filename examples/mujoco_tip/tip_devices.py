"""Logs of five devices that differ from the simulator in tip.py by one effect each: python tip_devices.py lag logs

All of them are simulated: the same model in MuJoCo, behind another drive or with more friction in its joints.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from tip import Tip

DT_S = 0.04
NOISE_DEG = 0.1
EFFECTS = ("lag", "delay", "creep", "slack", "friction")


def drive(effect: str, command_mm: np.ndarray) -> np.ndarray:
    """Travel that reaches the tendon."""
    if effect == "delay":  # 0.12 s
        return np.concatenate([np.repeat(command_mm[0], 3), command_mm[:-3]])
    if effect == "slack":  # 1 mm
        return np.maximum(command_mm - 1.0, 0.0)
    behind_s, left = {"lag": (0.15, 1.0), "creep": (5.0, 0.15)}.get(effect, (1.0, 0.0))
    behind, travel_mm = command_mm[0], np.empty_like(command_mm)
    for k, u in enumerate(command_mm):  # a share `left` follows late, with the time constant `behind_s`
        behind += (u - behind) * -np.expm1(-DT_S / behind_s)
        travel_mm[k] = (1.0 - left) * u + left * behind
    return travel_mm


def commands_mm() -> list[np.ndarray]:
    """Slow sines, small quick ones, and four motions between levels with short and long holds; 0.2 to 5.8 mm."""
    time_s = np.arange(0.0, 40.0, DT_S)
    slow = [3.0 - 2.8 * np.cos(2 * np.pi * hz * time_s) for hz in (0.1, 0.3)]
    quick = 3.0 - 2.3 * np.cos(2 * np.pi * time_s / 20.0) - 0.5 * np.cos(2 * np.pi * 2.0 * time_s)
    motions = [*slow, quick]
    for seed in range(4):
        random = np.random.default_rng(seed)
        times_s, levels_mm = [0.0, 0.4], [0.2, 0.2]
        while times_s[-1] < 40.0:
            moved_s = times_s[-1] + random.choice([0.08, 0.3, 1.0])
            times_s += [moved_s, moved_s + random.choice([0.8, 2.0, 5.0])]
            levels_mm += [random.uniform(0.2, 5.8)] * 2
        motions.append(np.interp(time_s, times_s, levels_mm))
    return motions


def device(effect: str) -> Tip:
    """The tip of a device."""
    return Tip(friction=1.6 if effect == "friction" else 1.0)


def angles_deg(effect: str) -> list[np.ndarray]:
    """What the sensor of a device reads during `commands_mm`."""
    tip, noise = device(effect), np.random.default_rng(1)
    played = [tip.run(drive(effect, u), DT_S) for u in commands_mm()]
    return [angle + noise.normal(0.0, NOISE_DEG, angle.size) for angle in played]


def main(effect: str, folder: str) -> None:
    """Write the logs of one device."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    for k, (u, angle) in enumerate(zip(commands_mm(), angles_deg(effect), strict=True)):
        rows = np.column_stack([DT_S * np.arange(u.size), u, angle])
        file = Path(folder) / f"trial_{k}.csv"
        np.savetxt(file, rows, "%.6f", ",", header="time_s,command_mm,angle_deg", comments="")


if __name__ == "__main__":
    if len(sys.argv) != 3 or sys.argv[1] not in EFFECTS:
        sys.exit(f"got {sys.argv[1:]}, expected one of {', '.join(EFFECTS)}, and a folder for the logs")
    main(*sys.argv[1:])
