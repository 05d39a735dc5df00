"""An investigation of seconds: a simulated tendon catheter whose drive lags, judged by the simulator without lag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hystmpc.bench.config import InvestigateSettings, located_investigation
from hystmpc.bench.device import BenchDevice, MovableDevice, plants_in
from hystmpc.bench.investigate import investigate_device
from hystmpc.bench.rounds import Investigated
from hystmpc.ctrl.loop import Plant

from .small_commission import BENCH, Spied

BLOCK = {"model": "builtin:tendon-catheter", "minutes": 1.0, "longest_motion_s": 8.0}


def bench(**changes: Any) -> dict[str, Any]:
    """A bench file's content; `investigate` is changed key by key."""
    data = {key: value for key, value in BENCH.items() if key != "commission"} | changes
    plant = {"simulator": "builtin:tendon-catheter", "lag_s": 0.2, "noise_deg": 0.1}
    data.setdefault("plausibility", {"travel": 3.0})
    if "transport" not in changes:
        data["transport"] = {"kind": "simulated", "plant": plant}
    return data | {"investigate": BLOCK | changes.get("investigate", {})}


def settings(folder: Path, **changes: Any) -> InvestigateSettings:
    """The bench with its latch in a folder."""
    data = bench(**changes) | {"latch_file": str(folder / "latch.json")}
    return located_investigation(InvestigateSettings.parse(data), Path())


def investigated(made: InvestigateSettings, out: Path, sent: list[float]) -> Investigated:
    """An investigation of that device, behind a spy that keeps every command."""
    plants = plants_in(Path(), made.command_unit)

    def spied(block: Any, dt_s: float) -> tuple[Plant, float]:
        plant, held = plants(block, dt_s)
        return Spied(plant, sent, lambda k, u, y: y), held

    def device(root: Path, tick: Any) -> MovableDevice:
        return BenchDevice(made, spied, root, made.commission.angle_limits_deg)

    return investigate_device(made, device, out)
