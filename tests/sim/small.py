"""Small studies on the models that ship with the package."""

from __future__ import annotations

from typing import Any

from hystmpc.models.load import library_file
from hystmpc.models.simulator import Simulator, load_simulator
from hystmpc.sim.config import SimulationConfig

MOVE = {
    "kind": "point_to_point",
    "start_deg": 29.0,
    "targets_deg": [40.0, 35.0],
    "holds_s": [0.8, 0.8],
    "limits": {"velocity_deg_s": 40.0},
}
SCAN = {
    "kind": "scan_sinusoid",
    "start_deg": 29.0,
    "centre_deg": 40.0,
    "amplitude_deg": 8.0,
    "frequency_hz": 0.5,
    "cycles": 1.0,
}


def catheter() -> Simulator:
    """The shipped tendon catheter."""
    return load_simulator(library_file("tendon-catheter"))


def study_data(**changes: Any) -> dict[str, Any]:
    """Settings of a study as they stand in YAML: an operator as model, no noise."""
    data: dict[str, Any] = {
        "plant": {"simulator": "builtin:tendon-catheter"},
        "model": "builtin:pi",
        "motions": {"move": MOVE},
        "controllers": {"mpc": {"kind": "linearised_mpc"}, "pid": {"kind": "pid"}},
    }
    return data | changes


def study(**changes: Any) -> SimulationConfig:
    """The same, validated."""
    return SimulationConfig.parse(study_data(**changes))
