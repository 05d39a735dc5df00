"""What holds for every trajectory, whatever it is made of."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.trajectories import excitation
from hystmpc.trajectories.config import MOTIONS, parse_motion
from hystmpc.trajectories.point_to_point import PointToPoint
from hystmpc.trajectories.trajectory import PreviewTable, Sampled, Trajectory, TrajectoryChain, preview, sample
from hystmpc_lab import paper_commands

SCAN = {"start_deg": 30, "centre_deg": 60, "frequency_hz": 0.5, "cycles": 1.5}
EXAMPLES: list[tuple[dict[str, Any], float]] = [  # motion, start value
    ({"kind": "point_to_point", "start_deg": 30, "targets_deg": [60, 60, 45], "holds_s": [0.5, 0.2, 0]}, 30),
    ({"kind": "point_to_point", "start_deg": 30, "targets_deg": [30], "holds_s": [1]}, 30),
    ({"kind": "random_point_to_point", "seed": 1, "start_deg": 40, "range_deg": [30, 90], "moves": 4}, 40),
    ({"kind": "scan_sinusoid", "amplitude_deg": 20, **SCAN}, 30),
    ({"kind": "scan_sinusoid", "amplitude_deg": 20, **SCAN, "start_deg": 85}, 85),
    ({"kind": "scan_triangle", "amplitude_deg": 20, **SCAN}, 30),
    ({"kind": "scan_triangle", "amplitude_deg": 20, "limits": {}, **SCAN}, 30),
    ({"kind": "raster", "amplitudes_deg": [5, 10, 20], **SCAN}, 30),
    ({"kind": "raster", "amplitudes_deg": [20, 5], "shape": "triangle", "limits": {}, **SCAN}, 30),
    ({"kind": "sampled", "file": "motion.csv"}, 33),
]
EXCITATIONS: dict[str, tuple[Trajectory, float]] = {
    **{f"S1 zero baseline {f} Hz": (excitation.s1_zero_baseline(f), 0.0) for f in paper_commands.S1_TRAIN_HZ},
    **{f"S1 raised baseline {f} Hz": (excitation.s1_raised_baseline(f), 0.0) for f in paper_commands.S1_TRAIN_HZ},
    "S1 (a)": (paper_commands.s1_test_a(), 0.0),
    "S1 (b)": (paper_commands.s1_test_b(), 1.2),
    "S1 (c)": (paper_commands.s1_test_c(), 0.0),
    "S1 (d)": (paper_commands.S1_ARBITRARY(4), 0.0),
    **{f"S2 {o}": (excitation.s2_sinusoid(0.3, o), 0.0) for o in ("0BL", "MidBL", "EndBL")},  # type: ignore[arg-type]
    "S2 train": (excitation.s2_point_to_point(2), 0.0),
    "S2 test": (excitation.s2_point_to_point(2, "test"), 0.0),
    "S2 initialisation": (excitation.s2_initialisation(), 0.0),
    "sampled": (Sampled(np.array([1.0, 2.0, 4.0]), np.array([5.0, 3.0, 4.0])), 5.0),
    "chain": (TrajectoryChain((PointToPoint(1, [2], [0]), PointToPoint(2, [0], [0]))), 1.0),
}
IDS = [f"{k} {data['kind']}" for k, (data, _) in enumerate(EXAMPLES)] + list(EXCITATIONS)


@pytest.fixture(params=range(len(IDS)), ids=IDS)
def case(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Trajectory, float]:
    """A trajectory and the value it is said to start at."""
    k = request.param
    if k >= len(EXAMPLES):
        return EXCITATIONS[IDS[k]]
    with (tmp_path / "motion.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("time_s", "angle_deg"), (2, 33), (2.5, 40), (4, 38)])
    data, start = EXAMPLES[k]
    return parse_motion(data).build(tmp_path), start


def test_every_kind_of_motion_has_an_example() -> None:
    assert {data["kind"] for data, _ in EXAMPLES} == set(MOTIONS)


def test_starts_where_it_says_and_holds_its_ends(case: tuple[Trajectory, float]) -> None:
    trajectory, start = case
    end = trajectory(trajectory.duration_s)
    assert trajectory.duration_s > 0
    assert trajectory(0.0) == pytest.approx(start, abs=1e-12)
    assert trajectory(-1.0) == trajectory(0.0)
    np.testing.assert_array_equal(trajectory(trajectory.duration_s + np.array([0.0, 0.01, 1e6])), end)


def test_vectorised_equals_scalar_and_keeps_the_shape(case: tuple[Trajectory, float]) -> None:
    trajectory, _ = case
    t = np.random.default_rng(0).uniform(-0.5, trajectory.duration_s + 0.5, (5, 8))
    values = trajectory(t)
    assert values.shape == t.shape
    assert values.dtype == np.float64
    assert np.isfinite(values).all()
    one_by_one = [float(trajectory(float(x))) for x in t.flat]
    np.testing.assert_allclose(values.ravel(), one_by_one, rtol=1e-14, atol=1e-14)


def test_does_not_jump(case: tuple[Trajectory, float]) -> None:
    trajectory, _ = case
    steps = [np.abs(np.diff(trajectory(np.linspace(0, trajectory.duration_s, n)))).max() for n in (20001, 40001)]
    # A jump keeps its height when the grid is halved; a step of a continuous signal halves too.
    assert steps[1] < 0.6 * steps[0] or steps[0] < 1e-9


def test_sampling_ends_with_the_end_value(case: tuple[Trajectory, float]) -> None:
    trajectory, _ = case
    t, values = sample(trajectory, 25.0)
    assert t.shape == values.shape
    assert trajectory.duration_s <= t[-1] + 1e-9 < trajectory.duration_s + 1 / 25 + 1e-6
    assert values[-1] == pytest.approx(float(trajectory(trajectory.duration_s)), abs=1e-6)
    np.testing.assert_allclose(np.diff(t), 1 / 25, rtol=1e-9)


def test_preview_shifts_by_one_sample(case: tuple[Trajectory, float]) -> None:
    trajectory, _ = case
    dt, horizon = 0.04, 12
    for t in np.linspace(-0.1, trajectory.duration_s + 0.1, 9):
        now, later = preview(trajectory, t, dt, horizon), preview(trajectory, t + dt, dt, horizon)
        assert now.shape == (horizon,)
        np.testing.assert_allclose(later[:-1], now[1:], atol=1e-9)
        assert now[0] == pytest.approx(float(trajectory(t + dt)), abs=1e-12)


def test_table_agrees_with_preview(case: tuple[Trajectory, float]) -> None:
    trajectory, _ = case
    table = PreviewTable(trajectory, 0.04, 7)
    for k in {0, 1, table.steps // 2, table.steps - 1, table.steps, table.steps + 5}:
        np.testing.assert_allclose(table.at(k), preview(trajectory, k * 0.04, 0.04, 7), atol=1e-9)
        assert table.value(k) == pytest.approx(float(trajectory(k * 0.04)), abs=1e-9)
    np.testing.assert_array_equal(table.at(table.steps), np.full(7, trajectory(trajectory.duration_s)))
