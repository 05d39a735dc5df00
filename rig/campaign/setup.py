"""The two configurations that every case of the campaign starts from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hystmpc.models.library import model_path
from hystmpc.trials.config import dump_yaml

from .cases import Case

RATE_HZ = 25.0
LOWER, UPPER, RATE_PER_S, SAFE = 0.0, 6.0, 10.0, 0.0

DEVICE: Mapping[str, Any] = {
    "rate_hz": RATE_HZ,
    "command_unit": "mm",
    "plant": {"simulator": "builtin:tendon-catheter", "noise_deg": 0.15},
    "limits": {"lower": LOWER, "upper": UPPER, "rate_per_s": RATE_PER_S},
    "link": {"kind": "udp", "bind_port": 0},
    "watchdog_s": 0.5,
    "log": "device.csv",
    "seed": 1,
}
RUN: Mapping[str, Any] = {
    "name": "campaign",
    "rate_hz": RATE_HZ,
    "command_unit": "mm",
    "limits": {"lower": LOWER, "upper": UPPER, "rate_per_s": RATE_PER_S},
    "ramps": {"velocity_per_s": 4.0, "acceleration_per_s2": 20.0, "jerk_per_s3": 200.0},
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


def write_device(case: Case, folder: Path, port: int = 0) -> Path:
    """Write `device.yaml`; port 0 lets the device choose."""
    settings = {**DEVICE, "link": {"kind": "udp", "bind_port": port}, "faults": [dict(f) for f in case.device]}
    path = folder / "device.yaml"
    path.write_text(dump_yaml(settings), encoding="utf-8")
    return path


def write_run(case: Case, folder: Path, port: int) -> Path:
    """Write `run.yaml` for a device at a port."""
    settings = {**RUN, "transport": {"kind": "udp", "port": port}, **case.settings}
    if case.corrupt_model:
        model = model_path("builtin:pi").read_text(encoding="utf-8")
        (folder / "half.yaml").write_text(model[: len(model) // 6], encoding="utf-8")
        settings["controller"] = {"model": "half.yaml"}
    path = folder / "run.yaml"
    path.write_text(dump_yaml(settings), encoding="utf-8")
    return path
