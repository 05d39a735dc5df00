"""Laws of the tip of a bend of constant curvature, and logs whose angles are given by it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc import read_trials
from hystmpc.models.maps import QuadraticMap, TipMap
from hystmpc.trials.axes import both_axes
from hystmpc.trials.errors import ConfigError, FitError, HystmpcError, LogError, TrajectoryError
from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.tip import FARTHEST_DEG, angles_from_bend, angles_from_tip, angles_from_tip_aside, tip_from_angles

bends, planes, lengths = st.floats(0.0, 170.0), st.floats(-180.0, 180.0), st.floats(1.0, 300.0)


@given(bends, planes, lengths)
def test_the_tip_is_the_end_of_an_arc_of_the_length(bend: float, plane: float, length: float) -> None:
    """The integral of the tangent along an arc whose direction turns evenly from z to the bend."""
    s = (np.arange(4000) + 0.5) / 4000
    along = np.deg2rad(bend) * s
    aside, up = length * np.mean(np.sin(along)), length * np.mean(np.cos(along))
    tip = tip_from_angles(angles_from_bend(bend, plane), length)
    direction = np.array([np.cos(np.deg2rad(plane)), np.sin(np.deg2rad(plane))])
    np.testing.assert_allclose(tip, [*(aside * direction), up], atol=1e-5 * length)


def test_a_bend_of_a_quarter_turn_ends_at_equal_distances() -> None:
    radius = 50 / (np.pi / 2)
    np.testing.assert_allclose(tip_from_angles((90.0, 0.0), 50.0), [radius, 0.0, radius])
    np.testing.assert_allclose(tip_from_angles((0.0, 0.0), 50.0), [0.0, 0.0, 50.0])


@given(bends, planes, lengths)
def test_angles_follow_from_the_position_without_the_length(bend: float, plane: float, length: float) -> None:
    angles = angles_from_bend(bend, plane)
    np.testing.assert_allclose(angles_from_tip(tip_from_angles(angles, length)), angles, atol=1e-6)


@given(st.floats(0.0, FARTHEST_DEG - 1.0), planes, lengths)
def test_angles_follow_from_x_and_y_with_the_length(bend: float, plane: float, length: float) -> None:
    angles = angles_from_bend(bend, plane)
    np.testing.assert_allclose(angles_from_tip_aside(tip_from_angles(angles, length)[:2], length), angles, atol=1e-5)


@given(lengths, planes, st.floats(1.0001, 10.0))
def test_a_tip_beyond_the_farthest_bend_is_refused_in_a_line(length: float, plane: float, times: float) -> None:
    farthest = tip_from_angles(angles_from_bend(FARTHEST_DEG, plane), length)[:2]
    assert np.linalg.norm(angles_from_tip_aside(farthest * (1 - 1e-9), length)) == pytest.approx(FARTHEST_DEG, abs=0.1)
    for beyond in (farthest * times, [np.nan, 0.0]):
        with pytest.raises(TrajectoryError, match="reach") as refused:
            angles_from_tip_aside(beyond, length)
        assert len(str(refused.value)) <= 300


MAP = TipMap(QuadraticMap(-3.6e-3, -4.6e-2, 70.5), QuadraticMap(-3.3e-3, 0.77, 0.2))


@given(st.floats(0.0, 110.0), planes)
def test_a_fitted_shape_stands_in_the_place_of_an_arc(bend: float, plane: float) -> None:
    """Alike in all planes: the tip is in the plane of the bend, and the angles follow from it."""
    angles = angles_from_bend(bend, plane)
    tip = tip_from_angles(angles, MAP)
    np.testing.assert_allclose(np.hypot(*tip[:2]), MAP.y(bend) - MAP.y.c, atol=1e-9)
    np.testing.assert_allclose(tip[2], MAP.x(bend))
    np.testing.assert_allclose(angles_from_tip_aside(tip[:2], MAP), angles, atol=1e-6)


def test_a_shape_is_fitted_to_positions_in_all_planes() -> None:
    random = np.random.default_rng(2)
    angles = angles_from_bend(random.uniform(0, 100, 400), random.uniform(-180, 180, 400))
    seen = TipMap.of_plane(angles, tip_from_angles(angles, MAP) + 0.2 * random.standard_normal((400, 3)))
    np.testing.assert_allclose(tip_from_angles(angles, seen), tip_from_angles(angles, MAP), atol=0.25)
    with pytest.raises(TrajectoryError, match="reach"):
        angles_from_tip_aside((80.0, 0.0), MAP)
    with pytest.raises(FitError, match="expected \\(T, 2\\)"):
        TipMap.of_plane(angles[:, 0], angles)


def test_a_tip_behind_its_base_has_no_plane() -> None:
    with pytest.raises(LogError, match="in front of its base"):
        angles_from_tip([[0.0, 0.0, -3.0]])


T = 0.04 * np.arange(300)
ANGLES = np.stack([40 * np.sin(T), 30 * np.cos(0.7 * T) - 5], axis=1)


def written(path: Path) -> Path:
    """A log of bend, plane and position of a tip."""
    bend, plane = np.hypot(*ANGLES.T), np.rad2deg(np.arctan2(ANGLES[:, 1], ANGLES[:, 0]))
    columns = [T, np.sin(T), np.cos(T), bend, plane % 360, np.deg2rad(plane), tip_from_angles(ANGLES, 45.0)]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header="t,u,v,bend,plane,phi,px,py,pz", comments="")
    return path


@pytest.mark.parametrize(
    "tip",
    [
        {"bend": {"signal": "bend", "unit": "deg"}, "plane": "plane"},
        {"bend": "bend", "plane": {"signal": "phi", "unit": "rad"}},
        {"x": "px", "y": "py", "z": "pz"},
        {"x": {"signal": "px", "scale": 0.1}, "y": {"signal": "py", "scale": 0.1}, "z": {"signal": "pz", "scale": 0.1}},
    ],
)
def test_logs_of_a_tip_have_two_angles(tmp_path: Path, tip: dict[str, Any]) -> None:
    log = written(tmp_path / "log.csv")
    mapping = LogMapping.parse({"time": "t", "command": "u", "channels": {"command_y": "v"}, "tip": tip})
    (trial,) = both_axes(read_trials(log, mapping)) or []
    np.testing.assert_allclose(trial.angles, ANGLES, atol=1e-9)
    assert trial.units.angle == "deg"
    (slower,) = both_axes(read_trials(log, mapping, rate_hz=20)) or []
    np.testing.assert_allclose(slower.angles[:, 0], 40 * np.sin(slower.t), atol=0.05)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"tip": {"bend": "bend"}}, "got bend, expected bend and plane, or x, y and z"),
        ({"tip": {"x": "px", "y": "py"}}, "got x, y"),
        ({"tip": {"bend": {"signal": "bend", "unit": "mm"}, "plane": "plane"}}, "in deg or rad"),
        ({"tip": {"bend": "bend", "plane": "plane"}, "angle": "bend"}, "got angle and tip"),
        ({"tip": {"bend": "bend", "plane": "nowhere"}}, "nowhere"),
        ({"tip": 3}, "tip"),
    ],
)
def test_wrong_mappings_of_a_tip_are_one_line(tmp_path: Path, keys: dict[str, Any], words: str) -> None:
    with pytest.raises((ConfigError, HystmpcError), match=words) as refused:
        read_trials(written(tmp_path / "log.csv"), LogMapping.parse({"time": "t", "command": "u", **keys}, "map.yaml"))
    assert len(str(refused.value)) <= 300
