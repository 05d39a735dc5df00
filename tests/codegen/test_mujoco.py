"""The example in MuJoCo runs as it says."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from .compiled import EXAMPLES

pytest.importorskip("mujoco", reason="mujoco is installed by users of the example alone")


@pytest.mark.slow
def test_the_tendon_of_mujoco_has_the_loop_of_the_operator() -> None:
    """Bend of the tip on the way up and on the way down, within what the joints' own stiffness and damping take."""
    command = [sys.executable, EXAMPLES / "mujoco_tendon" / "tendon.py"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.findall(r"(\w+): 3.00 mm, operator ([\d.]+) deg, MuJoCo ([\d.]+) deg", done.stdout)
    (up, *asked_up), (down, *asked_down) = found
    assert (up, down) == ("up", "down")
    (operator_up, mujoco_up), (operator_down, mujoco_down) = map(float, asked_up), map(float, asked_down)
    assert operator_down - operator_up > 5.0
    assert mujoco_up == pytest.approx(operator_up, abs=1.0)
    assert mujoco_down == pytest.approx(operator_down, abs=1.0)
