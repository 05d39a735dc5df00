"""Measured inputs in the exported controller: the commands of Python's, and an FMU that refuses them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from hystmpc.codegen import export_controller
from hystmpc.ctrl.planner.tip_controller import TipController
from hystmpc.models.simulator import save_simulator

from ..ctrl.test_inputs import CHAIN
from ..models.zoo import simulator
from .compiled import Library


@pytest.mark.parametrize("kind", ["linearised_mpc", "inverse_pid"])
def test_an_exported_controller_measures_its_inputs_as_in_python(kind: str, tmp_path: Path) -> None:
    settings = {"model": str(save_simulator(simulator(CHAIN), tmp_path / "m.yaml")), "controller": {"kind": kind}}
    export = export_controller(settings)
    assert "#define HYSTMPC_INPUT_BAR 0" in export.header
    made, tip = Library(export, tmp_path / "c"), TipController.from_config(settings)
    assert made.init(40.0, tip.snapshot().command.u) == 0
    made.set_target(60.0)
    tip.reset(40.0)
    tip.set_reference([60.0] * 200)
    for k in range(60):
        y, bar = 40.0 + 0.3 * k, 1.0 + 0.05 * k
        if k > 5:
            assert made.input(0, bar) == 1
        u = tip.step(y, inputs={"bar": bar} if k > 5 else None).u
        assert made.step(y).u == u
    assert made.input(0, math.nan) == 0
    assert made.input(1, 2.0) == 0
    assert made.input(-1, 2.0) == 0
