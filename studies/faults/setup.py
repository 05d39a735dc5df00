"""The two configurations that every case of the campaign starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from hystmpc.models.library import model_path
from hystmpc.trials.config import dump_yaml

from .cases import Case

RATE_HZ = 25.0
LOWER, UPPER, RATE_PER_S, SAFE = 0.0, 6.0, 10.0, 0.0
OVERSHOOT = min(0.2, 0.02 * (UPPER - LOWER))
"""How far a device may move away from the safe command after a fault [mm]."""
IN_FLIGHT_S = 1.5 / RATE_HZ
"""How long after a fault a command that had left before may still come to the device and move it [s]."""

Kind = Literal["udp", "dds"]
KINDS: tuple[Kind, ...] = ("udp", "dds")

DEVICE: Mapping[str, Any] = {
    "rate_hz": RATE_HZ,
    "command_unit": "mm",
    "plant": {"simulator": "builtin:tendon-catheter", "noise_deg": 0.15},
    "limits": {"lower": LOWER, "upper": UPPER, "rate_per_s": RATE_PER_S},
    "link": {"kind": "udp", "bind_port": 0},
    "watchdog_s": 0.5,
    "watchdog_rate_per_s": 2.0,
    "log": "device.csv",
    "seed": 1,
}
RUN: Mapping[str, Any] = {
    "name": "campaign",
    "rate_hz": RATE_HZ,
    "command_unit": "mm",
    "limits": {"lower": LOWER, "upper": UPPER, "rate_per_s": RATE_PER_S},
    "ramps": {"velocity_per_s": 3.5, "acceleration_per_s2": 70.0, "jerk_per_s3": 10_000.0},
    "safe_command": SAFE,
    "latch_file": "latched.json",
    "sensor": {
        "lower_deg": 0.0,
        "upper_deg": 120.0,
        "rate_limit_deg_s": 400.0,
        "age_limit_s": 0.1,
        "dead_after_s": 0.5,
    },
    "controller": {"model": "builtin:pi"},
    "reference": {
        "kind": "scan_sinusoid",
        "start_deg": 40.0,
        "centre_deg": 55.0,
        "amplitude_deg": 15.0,
        "frequency_hz": 0.4,
        "cycles": 3,
    },
}


@dataclass(frozen=True)
class Link:
    """How device and controller of a case find each other.

    Attributes:
        kind: of the wire.
        port: of the device over UDP; 0 lets it choose.
        domain: of DDS; cases that are played at the same time need one each.
    """

    kind: Kind = "udp"
    port: int = 0
    domain: int = 0

    @property
    def of_device(self) -> dict[str, Any]:
        """Block `link` of a device."""
        return {"kind": "udp", "bind_port": self.port} if self.kind == "udp" else self._dds

    @property
    def of_run(self) -> dict[str, Any]:
        """Block `transport` of a run."""
        return {"kind": "udp", "port": self.port} if self.kind == "udp" else self._dds

    @property
    def _dds(self) -> dict[str, Any]:
        return {"kind": "dds", "message": "float64_stamped", "domain": self.domain}


def write_device(case: Case, folder: Path, link: Link = Link()) -> Path:
    """Write `device.yaml`."""
    settings = {**_merged(DEVICE, case.drive), "link": link.of_device, "faults": [dict(f) for f in case.device]}
    path = folder / "device.yaml"
    path.write_text(dump_yaml(settings), encoding="utf-8")
    return path


def write_run(case: Case, folder: Path, link: Link) -> Path:
    """Write `run.yaml` for a device at a link."""
    settings = {**_merged(RUN, case.settings), "transport": link.of_run}
    if case.corrupt_model:
        model = model_path("builtin:pi").read_text(encoding="utf-8")
        (folder / "half.yaml").write_text(model[: len(model) // 6], encoding="utf-8")
        settings["controller"] = {"model": "half.yaml"}
    path = folder / "run.yaml"
    path.write_text(dump_yaml(settings), encoding="utf-8")
    return path


def watchdog_s(case: Case) -> float:
    """The longest time that the device's own watchdog takes to bring it to the safe command [s]."""
    drive = _merged(DEVICE, case.drive)
    return float(drive["watchdog_s"] + (UPPER - LOWER) / drive["watchdog_rate_per_s"])


def _merged(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with nested changes."""
    return {
        **settings,
        **{
            key: _merged(settings[key], value)
            if isinstance(value, Mapping) and isinstance(settings.get(key), Mapping)
            else value
            for key, value in changes.items()
        },
    }
