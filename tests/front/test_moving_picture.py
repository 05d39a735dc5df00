"""The moving picture of the README: its geometry, its animations, and the numbers that it tells."""

from __future__ import annotations

import importlib.util
import re
import sys
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "docs" / "figures" / "ring.svg"
STAR = SHIPPED.with_name("star.svg")
LEGEND = re.compile(r">([\d.]+) deg</text><text[^>]*>(\d+) mm<")  # error and travel of each controller


@cache
def script() -> ModuleType:
    """`docs/figures/moving_picture.py`, which is part of no package."""
    spec = importlib.util.spec_from_file_location("moving_picture", SHIPPED.with_name("moving_picture.py"))
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["moving_picture"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def small_picture() -> str:
    """The picture of a made-up run of 8 samples a target."""
    drawn = script()
    targets = np.array([drawn.place(2.0 * np.pi * k / drawn.TARGETS) for k in range(drawn.TARGETS + 1)])
    stops = np.arange(drawn.TARGETS + 1)
    way = np.concatenate([[0.0], *(np.minimum(k + np.arange(1, 9) / 4, k + 1.0) for k in range(drawn.TARGETS))])
    roll_deg, bend_deg = (np.interp(way, stops, targets[:, k]) for k in (0, 1))
    tracks = {name: drawn.Track(bend_deg - k, bend_deg / 20, 0.5 * k, 10.0) for k, name in enumerate(drawn.SHOWN)}
    return str(drawn.svg(drawn.Ring(0.04 * np.arange(len(way)), bend_deg, roll_deg, targets, tracks)))


def elements(picture: str, name: str) -> list[tuple[Any, Any]]:
    """Every element of a name, with the one that it stands in."""
    root = ET.fromstring(picture)
    return [(outer, inner) for outer in root.iter() for inner in outer if inner.tag.endswith("}" + name)]


@settings(deadline=None)
@given(bend_deg=st.floats(1.0, 100.0), roll_deg=st.floats(-180.0, 180.0))
def test_the_catheter_is_an_arc_of_constant_curvature_and_unit_length(bend_deg: float, roll_deg: float) -> None:
    points = script().arc(bend_deg, roll_deg)
    t = np.linspace(0.0, 1.0, 201)[:, None]
    x, y, z = (
        (1 - t) ** 3 * points[0] + 3 * t * (1 - t) ** 2 * points[1] + 3 * t**2 * (1 - t) * points[2] + t**3 * points[3]
    ).T
    bend = np.radians(bend_deg)
    np.testing.assert_allclose(np.hypot(np.hypot(x, y) - 1 / bend, z), 1 / bend, rtol=1e-3)
    assert np.sum(np.sqrt(np.diff(x) ** 2 + np.diff(y) ** 2 + np.diff(z) ** 2)) == pytest.approx(1.0, rel=1e-3)
    np.testing.assert_allclose(np.arctan2(y[1:], x[1:]), np.radians(roll_deg), atol=1e-6)


def test_a_ring_lies_at_its_radius_from_its_axis() -> None:
    drawn = script()
    roll, bend = np.radians([drawn.place(psi) for psi in np.linspace(0.0, 6.0, 25)]).T
    axis = np.radians(drawn.AXIS_DEG)
    off = np.sin(bend) * np.cos(roll) * np.sin(axis) + np.cos(bend) * np.cos(axis)
    np.testing.assert_allclose(np.degrees(np.arccos(off)), drawn.RADIUS_DEG, rtol=1e-9)


@pytest.mark.parametrize(
    "picture",
    [
        pytest.param(small_picture, id="small"),
        pytest.param(SHIPPED.read_text, id="shipped"),
        pytest.param(STAR.read_text, id="star"),
    ],
)
def test_every_animation_can_be_played(picture: Any) -> None:
    animations = elements(picture(), "animate")
    assert len({animation.get("dur") for _, animation in animations}) == 1
    for animated, animation in animations:
        values = animation.get("values").split(";")
        shapes = {
            re.sub(r"[-\d.]+", "0", value) for value in (animated.get(animation.get("attributeName"), "0"), *values)
        }
        assert len(shapes) == 1  # else nothing is drawn between two values
        if "keyTimes" in animation.attrib:
            times = [float(time) for time in animation.get("keyTimes").split(";")]
            assert len(times) == len(values)
            assert times[0] == 0.0
            assert times == sorted(times)
            assert times[-1] <= 1.0


@pytest.mark.parametrize(
    "picture", [pytest.param(small_picture, id="small"), pytest.param(SHIPPED.read_text, id="shipped")]
)
def test_the_picture_stands_alone_and_has_a_still_form(picture: Any) -> None:
    text = picture()
    assert len(text) < 300_000
    assert elements(text, "script") == []
    assert not re.search(r"href|url\(|https?://(?!www\.w3\.org/2000/svg)", text)
    still = [group for _, group in elements(text, "g") if group.get("class") == "still"]
    assert [len(list(group.iter())) > 10 for group in still] == [True]
    assert [found for group in still for found in group.iter() if found.tag.endswith("animate")] == []
    assert {"prefers-color-scheme:dark", "prefers-reduced-motion:reduce"} <= set(
        re.findall(r"\((prefers[^)]*)\)", text)
    )


def test_the_readme_tells_the_numbers_of_the_picture() -> None:
    (_, _), (_, _), rival, ours = LEGEND.findall(SHIPPED.read_text(encoding="utf-8"))
    (row,) = [
        line for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines() if "friction doubled" in line
    ]
    assert re.findall(r"([\d.]+) deg, (\d+) mm", row) == [ours, rival]


@pytest.mark.slow
def test_the_shipped_picture_is_of_this_package() -> None:
    tracks = script().simulate_ring().tracks
    shipped = LEGEND.findall(SHIPPED.read_text(encoding="utf-8"))
    for name, (rmse_deg, travel) in zip(script().SHOWN, shipped, strict=True):
        assert tracks[name].rmse_deg == pytest.approx(float(rmse_deg), rel=0.1)
        assert tracks[name].travel == pytest.approx(float(travel), rel=0.1)


def test_the_star_stands_alone_and_has_a_still_form() -> None:
    text = STAR.read_text(encoding="utf-8")
    assert len(text) < 300_000
    assert not re.search(r"<script|href|url\(|https?://(?!www\.w3\.org/2000/svg)", text)
    (still,) = [group for _, group in elements(text, "g") if group.get("class") == "still"]
    assert len([path for path in still.iter() if path.tag.endswith("path")]) == 6  # a star and a way of each controller
    assert not [found for found in still.iter() if found.tag.endswith("animate")]
