"""Motions in YAML: what is built, and how mistakes are answered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.trajectories import MotionLimits, PointToPoint, SinusoidScan, random_point_to_point
from hystmpc.trajectories.config import Motion, parse_motion
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, TrajectoryError

SCAN: dict[str, Any] = {
    "kind": "scan_sinusoid",
    "start_deg": 30,
    "centre_deg": 60,
    "amplitude_deg": 20,
    "frequency_hz": 0.2,
    "cycles": 3,
}


class Run(Settings):
    """A block that holds a motion, as run configurations do."""

    reference: Motion


def test_values_reach_the_motion() -> None:
    assert parse_motion(SCAN).build() == SinusoidScan(30, 60, 20, 0.2, 3)
    data = {
        "kind": "point_to_point",
        "start_deg": 30,
        "targets_deg": [60, 40],
        "holds_s": [1, 2],
        "limits": {"velocity_deg_s": 20},
    }
    assert parse_motion(data).build() == PointToPoint(30, [60, 40], [1, 2], MotionLimits(velocity_deg_s=20))


def test_a_drawn_motion_takes_every_setting() -> None:
    drawn = {"seed": 7, "start_deg": 35.0, "range_deg": [40.0, 80.0], "moves": 3, "hold_range_s": [0.1, 0.2]}
    data = {"kind": "random_point_to_point", **drawn, "limits": {"jerk_deg_s3": 900.0}}
    assert parse_motion(data).build() == random_point_to_point(
        7,
        start_deg=35,
        range_deg=(40, 80),
        moves=3,
        hold_range_s=(0.1, 0.2),
        limits=MotionLimits(jerk_deg_s3=900),
    )


def test_a_motion_inside_another_block() -> None:
    run = Run.parse({"reference": SCAN})
    assert run.reference.build() == SinusoidScan(30, 60, 20, 0.2, 3)
    assert Run.parse(run.model_dump(mode="json")) == run


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({**SCAN, "kind": "scan_sinusoidal"}, r"unknown kind 'scan_sinusoidal', available: .*scan_triangle.* 'scan_s"),
        ({k: v for k, v in SCAN.items() if k != "kind"}, "no key 'kind', available: point_to_point"),
        ({**SCAN, "amplitude": 3}, "unknown key 'amplitude', .*did you mean 'amplitude_deg'"),
        ({**SCAN, "amplitude_deg": -3}, "amplitude_deg: .*greater than 0, got -3"),
        ({**SCAN, "cycles": 0.7}, "cycles: .*multiple of 0.5"),
        ({**SCAN, "limits": {"velocity": 3}}, "limits: unknown key 'velocity', .*'velocity_deg_s'"),
        ({"kind": ["x"]}, "unknown kind"),
    ],
)
def test_mistakes_are_named_alone_and_nested(data: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said) as alone:
        parse_motion(data, "run.yaml")
    assert str(alone.value).startswith("run.yaml: ")
    with pytest.raises(ConfigError, match=said) as nested:
        Run.parse({"reference": data}, "run.yaml")
    assert str(nested.value).startswith("run.yaml: reference")
    assert "\n" not in str(alone.value) + str(nested.value)


@pytest.mark.parametrize("data", ["scan_sinusoid", None, [1]])
def test_a_motion_is_a_mapping(data: Any) -> None:
    with pytest.raises(ConfigError, match="expected a mapping"):
        parse_motion(data)
    with pytest.raises(ConfigError):
        Run.parse({"reference": data})


def test_settings_that_do_not_fit_together_are_refused() -> None:
    data = {"kind": "point_to_point", "start_deg": 30, "targets_deg": [60], "holds_s": [1, 2]}
    with pytest.raises(ConfigError, match=r"run\.yaml: .*1 targets and 2 holds"):
        parse_motion(data, "run.yaml")


def test_a_changed_copy_is_another_motion() -> None:
    motion = parse_motion(SCAN)
    other = motion.model_copy(update={"start_deg": 45.0})
    assert float(other.build()(0.0)) == 45.0
    with pytest.raises(TrajectoryError, match="amplitude_deg"):
        motion.model_copy(update={"amplitude_deg": -1.0})


def write(folder: Path, text: str) -> Any:
    """Build the sampled motion of a file with this text."""
    (folder / "m.csv").write_text(text, encoding="utf-8")
    return parse_motion({"kind": "sampled", "file": "m.csv"}).build(folder)


def test_sampled_file(tmp_path: Path) -> None:
    text = "\ufeffnote,angle_deg, time_s\nx,30,5\n,40,6\n\n,35,8\n"
    motion = write(tmp_path, text)
    assert motion.duration_s == 3.0
    np.testing.assert_allclose(motion([0, 0.5, 1, 2, 3]), [30, 35, 40, 37.5, 35])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no column time_s, available: none"),
        ("time_s,angle\n0,1\n", "no column angle_deg, available: time_s, angle"),
        ("time_s,angle_deg\n0,1\n1,abc\n", "row 3: angle_deg is 'abc'"),
        ("time_s,angle_deg\n0,1\n1\n", "row 3: angle_deg is ''"),
        ("time_s,angle_deg\n0,1\n", "T >= 2"),
        ("time_s,angle_deg\n", "T >= 2"),
        ("time_s,angle_deg\n0,1\n0,2\n", "strictly increasing"),
        ("time_s,angle_deg\n0,1\n1,nan\n", "sample 1: got t 1.0, value nan"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TrajectoryError, match=said) as raised:
        write(tmp_path, text)
    assert str(raised.value).startswith(str(tmp_path / "m.csv"))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match=r"absent\.csv: cannot be read"):
        parse_motion({"kind": "sampled", "file": "absent.csv"}).build(tmp_path)
