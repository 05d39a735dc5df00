"""What a planner's controller is made from, what it can reach, and what loading it costs."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl import Source, TipController
from hystmpc.ctrl.planner.reach import Workspace
from hystmpc.trials.errors import ConfigError, ControllerError, ModelError

from .plays import PLAY
from .test_tip_controller import controller_for


def test_reach_says_why_not() -> None:
    tip = controller_for()
    low, high = PLAY.predictor.rollout(np.array([PLAY.y_rest]), np.array([[0.0, 6.0]]))[0]
    reach = tip.reachable(60.0)
    assert (bool(reach), reach.low_deg, reach.high_deg) == (True, low, pytest.approx(high))
    assert "above the greatest angle within the command limits" in tip.reachable(90.0).reason
    assert "below the least" in tip.set_target(10.0).reason
    assert "beyond the 30 to 80 deg that the model has seen" in tip.reachable(84.0).reason
    assert "expected a finite angle" in tip.reachable(math.nan).reason
    soft = Workspace((20.0, 90.0), (25.0, 70.0), (30.0, 80.0)).judge(75.0, 0.0)
    assert (bool(soft), soft.high_deg) == (False, 70.0)
    assert "soft angle limits" in soft.reason
    assert Workspace((20.0, 90.0), (25.0, 70.0), (30.0, 80.0)).judge(24.0, 5.0).low_deg == 25.0


def test_from_config_reads_files_from_the_files_own_folder(tmp_path: Path) -> None:
    from hystmpc.models.load import library_file

    (tmp_path / "model.yaml").write_bytes(library_file("pi").read_bytes())
    (tmp_path / "tip.yaml").write_text(
        "model: model.yaml\nactuator_lag_s: 0.05\ncontroller: {kind: inverse_pid}\nlimits: {lower: 0, upper: 4, "
        "rate_per_s: 5}\nstart_command: 1.0\n"
    )
    tip = TipController.from_config(tmp_path / "tip.yaml")
    assert tip.state().command == 1.0
    assert tip.step(40.0).source is Source.CONTROLLER
    assert tip.reachable(50.0).high_deg < TipController.from_config({"model": "builtin:pi"}).reachable(50.0).high_deg


@pytest.mark.parametrize(
    ("data", "error", "text"),
    [
        ({"modell": "builtin:pi"}, ConfigError, "did you mean 'model'"),
        ({"model": "builtin:pj"}, ModelError, "available: auto, backlash, lstm, pi"),
        ({"model": "builtin:pi", "controller": {"kind": "linearized_mpc"}}, ConfigError, "mean 'linearised_mpc'"),
        ({"model": "builtin:pi", "controller": {"horizon": 3}}, ConfigError, "got neither kind nor python"),
        ({"model": "builtin:pi", "controller": {"kind": "pid", "gain": {}}}, ConfigError, "did you mean 'gains'"),
        ({"model": "builtin:pi", "motion": {"velocity_deg_s": -1}}, ConfigError, "motion.velocity_deg_s"),
        ({"model": "builtin:pi", "start_command": 60}, ControllerError, "start_command: got 60"),
        ({"model": "missing.yaml"}, ModelError, "missing.yaml"),
    ],
)
def test_wrong_settings_end_in_one_clear_line(data: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text) as caught:
        TipController.from_config(data)
    assert "\n" not in str(caught.value)


def test_importing_it_loads_none_of_the_heavy_libraries() -> None:
    code = (
        "import sys\nfrom hystmpc.ctrl import TipController\n"
        "heavy = {'casadi', 'onnxruntime', 'osqp', 'scipy', 'matplotlib', 'control'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or None)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
