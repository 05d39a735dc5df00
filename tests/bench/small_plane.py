"""A small commissioning of two axes: a simulated device on a simulated clock, and what its tests share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.bench.commission import Commissioned, commission_device
from hystmpc.bench.config import PlaneCommissionSettings
from hystmpc.bench.device import BenchDevice, MovableDevice, plants_in
from hystmpc.models.two_axes.model import CrossFriction, TwoAxisModel
from hystmpc.rig.config import BenchSettings

from ..models.two_axis_examples import two_axes

Pair = tuple[float, float]
Angle = Callable[[int, Any, Any], Any]

PLANE: dict[str, Any] = {
    "name": "small-plane",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": [-3, -3], "upper": [3, 3], "rate_per_s": [8, 6]},
    "ramps": {"velocity_per_s": 6, "acceleration_per_s2": 60, "jerk_per_s3": 1000},
    "safe_command": [0, 0],
    "sensor": {"lower_deg": -60, "upper_deg": 60},
    "commission": {
        "minutes": 7.0,
        "diagnose": False,
        "tune_evaluations": 24,
        "range_steps": 5,
        "motions": {"circle": {"kind": "circle", "centre": [0, 0], "radius": 10, "period_s": 3}},
    },
}


def turned(degrees: float, friction: CrossFriction | None = None) -> TwoAxisModel:
    """A device whose tendons are turned by an angle."""
    c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
    return two_axes(((c, s), (-s, c)), cross=friction)


def plane_settings(folder: Path, model: TwoAxisModel | None = None, **changes: Any) -> PlaneCommissionSettings:
    """The bench with its device and its latch in a folder; `commission` is changed key by key."""
    (model or turned(10.0)).save(folder / "both.yaml")
    plant = {"simulator": str(folder / "both.yaml"), "noise_deg": 0.1}
    data = PLANE | {"latch_file": str(folder / "latch.json"), "transport": {"kind": "simulated", "plant": plant}}
    data |= changes | {"commission": PLANE["commission"] | changes.get("commission", {})}
    return PlaneCommissionSettings.parse(data)


class SpiedPlane:
    """A plant that keeps every pair of commands it got, and may answer with other angles."""

    def __init__(self, plant: Any, sent: list[Pair], angle: Angle) -> None:
        self._plant, self._sent, self._angle = plant, sent, angle
        self.dt = plant.dt

    def reset(self) -> Any:
        return self._plant.reset()

    def apply(self, u: Any) -> Any:
        self._sent.append((float(u[0]), float(u[1])))
        return self._angle(len(self._sent), u, self._plant.apply(u))

    def stop(self) -> None:
        self._plant.stop()


def spied_plane(
    bench: PlaneCommissionSettings, root: Path, sent: list[Pair], angle: Angle = lambda k, u, y: y
) -> MovableDevice:
    """The device of the settings behind a spy."""
    plants = plants_in(Path(), bench.command_unit)

    def made(block: Any, dt_s: float) -> Any:
        plant, held = plants(block, dt_s)
        return SpiedPlane(plant, sent, angle), held

    return BenchDevice(bench, made, root, bench.commission.angle_limits_deg)


def commissioned_plane(
    bench: PlaneCommissionSettings, out: Path, sent: list[Pair], angle: Angle = lambda k, u, y: y
) -> Commissioned:
    """A commissioning of that device."""
    return commission_device(bench, lambda root, tick: spied_plane(bench, root, sent, angle), out)


def require_within(sent: list[Pair], bench: BenchSettings) -> None:
    """Every command of either axis is within value and rate."""
    for u, limits in zip(np.array(sent).T, bench.axes_limits, strict=True):
        assert limits.lower - 1e-9 <= u.min() <= u.max() <= limits.upper + 1e-9
        assert np.abs(np.diff(u)).max(initial=0.0) <= limits.rate * bench.dt_s + 1e-9
