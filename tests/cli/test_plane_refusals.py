"""Files of two axes where a user takes the wrong turn: one line says what is expected, or the file is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.bench.config import PlaneCommissionSettings
from hystmpc.ctrl.planner.settings import read_settings
from hystmpc.rig.experiment.record import PlaneRecordSettings
from hystmpc.rig.plane_config import PlaneRunSettings
from hystmpc.rig.recording.recording import McapLog
from hystmpc.rig.recording.sample import Sample
from hystmpc.trials.axes import both_axes
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.read import read_trials

from ..models.two_axis_examples import axis, two_axes
from .test_verbs import run

BENCH: dict[str, Any] = {
    "name": "two-planes",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": [-3, -3], "upper": [3, 3], "rate_per_s": [8, 8]},
    "safe_command": [0, 0],
    "sensor": {"lower_deg": -60, "upper_deg": 60},
    "transport": {"kind": "udp", "port": 47001},
}
LIMITS = {"lower": [-3, -3], "upper": [3, 3], "rate_per_s": [8, 8]}
CIRCLE = {"kind": "circle", "radius": 4, "period_s": 3}
RUN = {"controller": {"model": "both.yaml"}, "reference": CIRCLE | {"centre": [0, 0]}}
RAMPS = {"kind": "ramps", "start": [0, 0], "stops": [[1, 1]], "holds_s": [1]}
PAIR = "expected a list [x, y], a number for each axis"


@pytest.mark.parametrize("value", [0, [0], [0, 0, 0], {"x": 0}])
@pytest.mark.parametrize(
    ("kind", "more", "key"),
    [
        (PlaneCommissionSettings, {}, "safe_command"),
        (PlaneCommissionSettings, {}, "start_command"),
        (PlaneCommissionSettings, {}, "limits.lower"),
        (PlaneCommissionSettings, {}, "limits.upper"),
        (PlaneCommissionSettings, {}, "limits.rate_per_s"),
        (PlaneCommissionSettings, {"commission": {"motions": {"a": CIRCLE}}}, "commission.motions.a.centre"),
        (PlaneRunSettings, RUN, "reference.centre"),
        (PlaneRecordSettings, {"excitations": {"a": RAMPS}}, "excitations.a.start"),
    ],
)
def test_a_key_of_both_axes_says_that_it_takes_a_list(
    kind: type[Settings], more: dict[str, Any], key: str, value: Any
) -> None:
    data = {**BENCH, "limits": dict(LIMITS), **{name: dict(block) for name, block in more.items()}}
    *way, last = key.split(".")
    block = data
    for name in way:
        block[name] = dict(block[name])
        block = block[name]
    block[last] = value
    with pytest.raises(ConfigError) as refused:
        kind.parse(data, "bench.yaml")
    said = str(refused.value)
    assert PAIR in said
    assert last in said
    assert "tuple" not in said
    assert len(said) <= 300


def test_a_key_of_another_list_is_not_called_a_tuple() -> None:
    with pytest.raises(ConfigError, match="angle_limits_deg: expected a list, such as"):
        PlaneCommissionSettings.parse(BENCH | {"commission": {"angle_limits_deg": 5}}, "bench.yaml")


@pytest.mark.parametrize("axes", [1, 2])
def test_a_model_in_place_of_a_controller_is_refused_with_the_line_to_write(
    axes: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line is the one that is needed: a file with it alone is exported."""
    model = tmp_path / "model.yaml"
    (two_axes() if axes == 2 else axis()).save(model)
    code, _, said = run(capsys, "export-c", model, "--out", tmp_path / "c")
    text = " ".join(said.split())
    assert code == 2
    assert "got a model" in text
    assert "expected the file of a controller" in text
    assert "`model: model.yaml`" in text
    assert not (tmp_path / "c").exists()
    (tmp_path / "tip.yaml").write_text("model: model.yaml\n")
    assert run(capsys, "export-c", tmp_path / "tip.yaml", "--out", tmp_path / "c")[0] == 0


def test_an_onnx_model_in_place_of_a_controller_is_refused_as_one(tmp_path: Path) -> None:
    (tmp_path / "model.onnx").write_bytes(b"\x08\x0a\xff")
    with pytest.raises(ConfigError, match="got a model, format 'ONNX', expected the file of a controller"):
        read_settings(tmp_path / "model.onnx")


@pytest.mark.parametrize("unit", ["mm", "bar"])
def test_the_mcap_log_of_a_run_of_two_axes_is_read_as_its_csv(
    unit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both commands and both angles come back to the last bit."""
    pytest.importorskip("mcap")
    file, dt, rows = tmp_path / "log.mcap", 0.04, np.random.default_rng(1).uniform(-3, 3, (200, 2))
    log = McapLog(file, "command" if unit == "mm" else f"command_{unit}", axes=2)
    for k, u in enumerate(rows.cumsum(axis=0) / 20):
        held: Any = tuple(u.tolist())
        angle: Any = tuple((8.0 * u).tolist())
        nothing: Any = (float("nan"),) * 2
        log.add(Sample(dt * k, 10**18, nothing, angle, held, "record", "ok", nothing, (), dt, 0.0, False, (), k))
    log.close()
    assert run(capsys, "check", file)[0] == 0
    trials = both_axes(read_trials([file]))
    assert trials is not None
    assert trials[0].units.command == unit
    assert np.array_equal(trials[0].commands, rows.cumsum(axis=0) / 20)
    assert np.array_equal(trials[0].angles, 8.0 * (rows.cumsum(axis=0) / 20))
