"""A controller starts where the device of its model rests, not at the lower end of what it may send."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hystmpc.ctrl.planner.tip_controller import TipController
from hystmpc.models.chain import Chain
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.metadata import Range
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.simulator import Identification, Simulator, simulator_bundle
from hystmpc.sim.plants.simulated import SimulatedPlant

BOTH_WAYS = Range(lower=-4.0, upper=4.0)
DEVICE = Simulator(
    chain=Chain(PrandtlIshlinskii(8.0, (4.0, 2.0), 0.3, 0.0, 0.0)),
    dt_s=0.04,
    command_unit="mm",
    command_limits=BOTH_WAYS,
    command_rate_per_s=10.0,
    trained_command=BOTH_WAYS,
    trained_angle_deg=Range(lower=-56.0, upper=56.0),
    trained_rate_per_s=10.0,
    identification=Identification(method="by hand"),
)


@pytest.mark.parametrize("ending", [".yaml", pytest.param(".onnx", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("rest", "expected"), [(0.0, 0.0), (1.0, 1.0), (None, -4.0)])
def test_a_controller_of_a_device_that_bends_both_ways_starts_at_its_rest(
    tmp_path: Path, ending: str, rest: float | None, expected: float
) -> None:
    device, path = replace(DEVICE, rest_command=rest), tmp_path / f"device{ending}"
    if ending == ".yaml":
        device.save(path)
    else:
        export_onnx(simulator_bundle(device), path)
    tip = TipController.from_config({"model": str(path), "controller": {"kind": "inverse"}})
    assert tip.state().command == expected
    plant = SimulatedPlant(device)
    assert plant.rest_command == expected
    command = tip.step(plant.reset())
    assert "not started" not in command.status
    assert command.u == pytest.approx(expected, abs=0.2)
