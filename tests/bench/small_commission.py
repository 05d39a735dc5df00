"""A commissioning that takes seconds: a simulated device on a simulated clock, few motions, a model of one kind."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from hystmpc.bench import commission, identify, motions
from hystmpc.bench.commission import Commissioned, commission_device
from hystmpc.bench.config import CommissionBlock, CommissionSettings
from hystmpc.bench.device import BenchDevice, MovableDevice, plants_in
from hystmpc.ctrl.loop import Plant
from hystmpc.rig.config import BenchSettings

SCAN = {
    "kind": "scan_sinusoid",
    "start_deg": 45.0,
    "centre_deg": 55.0,
    "amplitude_deg": 10.0,
    "frequency_hz": 0.5,
    "cycles": 1.0,
}
BENCH: dict[str, Any] = {
    "name": "small",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "ramps": {"velocity_per_s": 8, "acceleration_per_s2": 60, "jerk_per_s3": 1000},
    "safe_command": 0,
    "sensor": {"lower_deg": 0, "upper_deg": 120},
    "transport": {"kind": "simulated", "plant": {"simulator": "builtin:tendon-catheter", "noise_deg": 0.1}},
    "commission": {
        "minutes": 2.0,
        "diagnose": False,
        "tune_evaluations": 24,
        "range_steps": 5,
        "motions": {"scan": SCAN},
    },
}


def make_quick(patch: pytest.MonkeyPatch) -> None:
    """Short recordings, a quick kind of model, short tuning motions: the order of things stays the same."""
    patch.setattr(motions, "LEAST_SHARE", 0.05)
    patch.setattr(identify, "_KIND", "pi")
    patch.setattr(identify, "_TUNED_S", 2.0)
    patch.setattr(motions, "SCANS_HZ", {"fast_scan": 0.6})
    patch.setattr(commission, "CommissionBlock", partial(CommissionBlock, diagnose=False, tune_evaluations=24))


def settings(folder: Path, **changes: Any) -> CommissionSettings:
    """The bench with its latch in a folder; `commission` is changed key by key."""
    data = BENCH | {"latch_file": str(folder / "latch.json")} | changes
    data["commission"] = BENCH["commission"] | changes.get("commission", {})
    return CommissionSettings.parse(data)


class Spied:
    """A plant that keeps every command it got, and may do something at one of them.

    Args:
        plant: the device; only its angle is taken where `angle` is given.
        sent: where commands go, over all openings.
        angle: from the count of commands, the command and the true answer to what is measured.
    """

    def __init__(self, plant: Plant, sent: list[float], angle: Callable[[int, float, float], float]) -> None:
        self._plant, self._sent, self._angle = plant, sent, angle
        self.dt = plant.dt

    def reset(self) -> float:
        return self._plant.reset()

    def apply(self, u: float) -> float:
        self._sent.append(u)
        return self._angle(len(self._sent), u, self._plant.apply(u))

    def stop(self) -> None:
        self._plant.stop()


def spied_device(
    bench: CommissionSettings,
    root: Path,
    sent: list[float],
    angle: Callable[[int, float, float], float] = lambda k, u, y: y,
) -> MovableDevice:
    """The device of the settings behind a spy."""
    plants = plants_in(Path(), bench.command_unit)

    def made(block: Any, dt_s: float) -> tuple[Plant, float]:
        plant, held = plants(block, dt_s)
        return Spied(plant, sent, angle), held

    return BenchDevice(bench, made, root, bench.commission.angle_limits_deg)


def commissioned(
    bench: CommissionSettings,
    out: Path,
    sent: list[float],
    angle: Callable[[int, float, float], float] = lambda k, u, y: y,
) -> Commissioned:
    """A commissioning of that device."""
    return commission_device(bench, lambda root, tick: spied_device(bench, root, sent, angle), out)


def within(sent: list[float], bench: BenchSettings) -> bool:
    """Whether commands lie within the limits on value and rate."""
    limits = bench.limits.build()
    inside = all(limits.lower - 1e-9 <= u <= limits.upper + 1e-9 for u in sent)
    return inside and all(abs(b - a) <= limits.rate * bench.dt_s + 1e-9 for a, b in pairwise(sent))
