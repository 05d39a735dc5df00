"""The reconstruction experiment: its laws, its errors, and the smallest run from command to test and figures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.report import Report
from hystmpc_lab.reconstruction.geometry import Oct, ReconstructionSettings, Segment
from hystmpc_lab.reconstruction.protocol import Protocol, Scan, record_scans, session
from hystmpc_lab.reconstruction.reconstruct import Reconstruction, rank_test, reconstruct
from hystmpc_lab.reconstruction.report import (
    ERROR_COLUMNS,
    PAPER_ERROR_MM,
    PAPER_REDUCTION_PERCENT,
    PRINTED,
    TEST_COLUMNS,
    error_map_figure,
    error_rows,
    paper_error,
    paper_section,
    rank_test_rows,
    reconstruction_pieces,
    section_figure,
    setup_figure,
)

IDEAL = ReconstructionSettings(oct=Oct(noise_mm=0.0, axial_resolution_mm=0.0))
NOISY = ReconstructionSettings(seed=3)
STROKE = 31.0 * np.sin(np.linspace(0.0, np.pi, 41)) ** 2
DEG_PER_BAR = 10.4


def scan(rotation: float = 0.0, true: np.ndarray = STROKE, **estimates: np.ndarray) -> Scan:
    """A scan whose sensor is exact."""
    return Scan(rotation, true, true, estimates)


def play(u: np.ndarray, half_width: float) -> np.ndarray:
    """The play operator from rest at 0, the hysteresis of this test's device."""
    z, out = 0.0, np.empty_like(u)
    for k, x in enumerate(u):
        z = max(x - half_width, min(x + half_width, z))
        out[k] = z
    return out


def device(command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A hysteretic device with a noisy angle sensor."""
    true = DEG_PER_BAR * play(command, 0.15)
    return true, true + 0.02 * np.random.default_rng(5).standard_normal(true.shape)


MODELS = {
    "knows the play": lambda command: DEG_PER_BAR * play(command, 0.13),
    "middle line": lambda command: DEG_PER_BAR * command,
}


@pytest.fixture(scope="module")
def demo() -> Reconstruction:
    """18 scans of a hysteretic device at 25 Hz, by a model with the play and by one without."""
    scans = record_scans(Protocol(rate_hz=25.0), device, MODELS)
    return reconstruct(NOISY, scans, compared=("knows the play", "middle line"))


@given(st.lists(st.integers(0, 17), min_size=1, max_size=4, unique=True))
def test_the_exact_angle_reconstructs_the_cap_exactly(turns: list[int]) -> None:
    result = reconstruct(IDEAL, [scan(15.0 * k, exact=STROKE) for k in turns])
    assert np.all(result.errors("exact") == 0.0)
    assert np.array_equal(result.truth_mm, result.surface_mm)


def test_distance_noise_alone_is_no_error_of_a_model() -> None:
    """Truth and estimate share the distance, so it cancels; it shows in the ground truth itself."""
    result = reconstruct(NOISY, [scan(exact=STROKE)])
    assert np.all(result.errors("exact") == 0.0)
    assert 0.0 < np.mean(result.sensor_error_mm()) < 0.02


@given(st.floats(0.0, 89.9))
def test_errors_do_not_depend_on_the_rotation_within_a_pattern(rotation: float) -> None:
    fixed, turned = (reconstruct(NOISY, [scan(r, model=0.9 * STROKE)]) for r in (0.0, rotation))
    assert turned.errors("model") == pytest.approx(fixed.errors("model"), abs=1e-12)
    assert np.hypot(*turned.truth_mm[:, :2].T) == pytest.approx(np.hypot(*fixed.truth_mm[:, :2].T), abs=1e-12)
    assert turned.truth_mm[:, 2] == pytest.approx(fixed.truth_mm[:, 2], abs=1e-12)


@given(st.floats(-1e-3, 1e-3).filter(lambda d: abs(d) > 1e-6), st.sampled_from([0.0, 90.0, 180.0]))
def test_a_small_constant_offset_costs_its_lever(offset: float, rotation: float) -> None:
    result = reconstruct(NOISY, [scan(rotation, model=STROKE + offset)])
    lever = Segment(NOISY.segment_length_mm).lever(STROKE, result.distance_mm)
    assert result.errors("model") == pytest.approx(abs(offset) * lever, rel=1e-4)


def test_the_ground_truth_is_what_the_sensor_says() -> None:
    """A model that repeats the sensor has no error; the sensor's own is told apart from it."""
    sensed = STROKE + 1e-3
    result = reconstruct(IDEAL, [Scan(0.0, STROKE, sensed, {"sensor": sensed, "tip": STROKE})])
    lever = Segment(IDEAL.segment_length_mm).lever(STROKE, result.distance_mm)
    assert np.all(result.errors("sensor") == 0.0)
    assert result.sensor_error_mm() == pytest.approx(1e-3 * lever, rel=1e-4)
    assert result.errors("tip") == pytest.approx(result.sensor_error_mm(), rel=1e-12)


@given(st.floats(0.1, 3.0), st.floats(1.01, 2.0))
def test_a_greater_offset_costs_more_everywhere(offset: float, factor: float) -> None:
    result = reconstruct(NOISY, [scan(less=STROKE + offset, more=STROKE + factor * offset)])
    assert np.all(result.errors("less") < result.errors("more"))


def test_points_are_where_they_are_by_hand() -> None:
    result = reconstruct(IDEAL, [Scan(90.0, np.zeros(1), np.zeros(1), {"bent": np.array([30.0])})])
    assert result.truth_mm[0] == pytest.approx([0.0, 0.0, 60.75])
    t = math.pi / 6
    r, z = 54.75 * (1 - math.cos(t)) / t + 6 * math.sin(t), 54.75 * math.sin(t) / t + 6 * math.cos(t)
    assert result.estimates_mm["bent"][0] == pytest.approx([0.0, r, z], abs=1e-12)
    assert result.errors("bent")[0] == pytest.approx(math.hypot(r, z - 60.75))


def test_a_seed_repeats_and_another_differs() -> None:
    once, again = (reconstruct(NOISY, [scan(model=0.9 * STROKE)]) for _ in range(2))
    other = reconstruct(NOISY.model_copy(update={"seed": 4}), [scan(model=0.9 * STROKE)])
    assert np.array_equal(once.distance_mm, again.distance_mm)
    assert not np.array_equal(once.distance_mm, other.distance_mm)


def test_the_session_is_that_of_the_paper() -> None:
    plan = session(Protocol())
    assert len(plan.samples) == 18
    assert plan.rotations_deg == tuple(15.0 * k for k in range(18))
    assert (plan.dt_s, plan.command.min(), plan.command.max()) == (0.004, 0.0, 2.95)
    assert plan.command.size == 250 * (10 + 1 + 18 * 11)
    assert [at[0] for at in plan.samples] == [250 * 11 * k for k in range(1, 19)]  # after the lead-in
    for at in plan.samples:  # 0.1 Hz, from rest at 0 up and back, at 25 Hz
        t = np.arange(250) / 25.0
        assert plan.command[at] == pytest.approx(2.95 / 2 * (np.sin(2 * np.pi * 0.1 * t - np.pi / 2) + 1), abs=1e-12)


def test_demo_the_model_that_knows_the_play_is_better(demo: Reconstruction) -> None:
    assert demo.patterns == ("I", "II", "III")
    for pattern in demo.patterns:
        better, worse = (demo.summary(name, demo.in_pattern(pattern)) for name in demo.models)
        assert better.n == worse.n == 6 * 250
        assert better.mean_mm < 0.3 * worse.mean_mm
        assert worse.mean_mm == pytest.approx(0.15 * DEG_PER_BAR * 0.57, rel=0.15)  # half width times lever
    points, scans = demo.rank_tests[:3], demo.rank_tests[3:]
    assert [(test.pattern, test.unit, test.n) for test in points] == [(p, "points", 1500) for p in demo.patterns]
    assert [(test.pattern, test.unit, test.n) for test in scans] == [(p, "scans", 6) for p in demo.patterns]
    assert all(test.p < 0.01 and test.probability_smaller > 0.9 for test in demo.rank_tests)
    assert demo.compare("middle line", "knows the play")[0].probability_smaller < 0.1


def test_demo_errors_are_distances_between_paired_points(demo: Reconstruction) -> None:
    assert demo.truth_mm.shape == (18 * 250, 3)
    for name in demo.models:
        apart = demo.estimates_mm[name] - demo.truth_mm
        assert demo.errors(name) == pytest.approx(np.sqrt(np.sum(apart**2, axis=1)), rel=1e-12)
    whole = demo.summary("middle line")
    parts = [demo.summary("middle line", demo.in_pattern(p)).mean_mm for p in demo.patterns]
    assert whole.mean_mm == pytest.approx(np.mean(parts))


def test_the_test_over_scans_compares_their_means() -> None:
    offsets = {"a": [1.0, 2.0, 0.5, 3.0, 1.5, 0.7], "b": [0.9, 2.5, 2.2, 0.6, 3.5, 1.2]}
    scans = [scan(15.0 * k, **{name: STROKE + values[k] for name, values in offsets.items()}) for k in range(6)]
    result = reconstruct(IDEAL, scans)
    means = {n: [np.mean(result.errors(n)[result.in_scan(15.0 * k)]) for k in range(6)] for n in offsets}
    (test,) = result.compare("a", "b", unit="scans")
    assert test.u == sum(a > b for a in means["a"] for b in means["b"])
    assert test.n == 6


def test_u_and_p_by_hand() -> None:
    low, high = np.array([1.0, 2.0, 3.0, 4.0]), np.array([5.0, 6.0, 7.0, 8.0])
    test = rank_test(("a", "b"), (low, high), "I", "scans")
    assert (test.u, test.probability_smaller, test.n) == (0.0, 1.0, 4)
    assert test.p == pytest.approx(2 / math.comb(8, 4))  # exact: the two extreme orders of 70
    assert rank_test(("a", "b"), (high, low), "I", "scans").u == 16.0
    same = rank_test(("a", "b"), (np.zeros(5), np.zeros(5)), "I", "points")
    assert (same.p, same.probability_smaller) == (1.0, 0.5)


def test_tables_stand_beside_the_paper(demo: Reconstruction) -> None:
    rows = error_rows(demo)
    assert len(rows) == 2 * 3 + 2  # patterns, and the section of pattern I at 45 deg
    assert {len(row) for row in rows} == {len(ERROR_COLUMNS)}
    assert [row[-1] for row in rows] == ["-"] * 8
    assert {len(row) for row in rank_test_rows(demo)} == {len(TEST_COLUMNS)}
    assert (paper_error("lstm", "III"), paper_error("DRDPI", "I")) == ("0.25", "0.54 [I]")
    assert paper_section("DRDPI") == "0.58"
    few = reconstruct(IDEAL, [scan(90.0, exact=STROKE, off=STROKE + 1.0)], compared=("off", "exact"))
    assert len(error_rows(few)) == 2
    assert [row[-2] for row in rank_test_rows(few)] == ["-", "-"]  # no ratio to an error of 0


def test_inferred_numbers_of_the_paper_follow_from_printed_ones() -> None:
    for pattern, reduction in PAPER_REDUCTION_PERCENT.items():
        lstm, drdpi = PAPER_ERROR_MM["LSTM", pattern], PAPER_ERROR_MM["DRDPI", pattern]
        assert (lstm.mark == PRINTED, drdpi.mark == PRINTED) == (True, False)
        assert drdpi.value == pytest.approx(lstm.value / (1 - reduction.value / 100), abs=0.005)


@pytest.mark.slow
def test_figures(demo: Reconstruction) -> None:
    section = section_figure(demo, 45.0)
    assert section.axes[0].get_title(loc="left").startswith("knows the play: mean error 0.")
    assert len(section.axes) == 3
    maps = error_map_figure(demo)
    colours = [mesh.get_clim() for axes in maps.axes for mesh in axes.collections if mesh.get_cmap().name == "cividis"]
    assert len(colours) >= 2
    assert len(set(colours[:2])) == 1  # one scale for all models
    assert len(setup_figure(NOISY).axes) == 3
    one = reconstruct(IDEAL, [scan(90.0, exact=STROKE)])
    assert len(error_map_figure(one).axes) == 2  # one map and its scale, though all errors are 0


@pytest.mark.slow
def test_the_report_has_every_figure_and_the_lever(demo: Reconstruction) -> None:
    page = Report("reconstruction", reconstruction_pieces(demo)).html()
    assert page.count("<svg") == 5
    assert "0.58 mm" in page  # the lever is stated


@pytest.mark.parametrize(
    ("scans", "kind", "message"),
    [
        ([], ConfigError, "got no scans"),
        ([scan()], ModelError, "scan at 0 deg: got no model's angles"),
        ([scan(a=STROKE), scan(15.0, b=STROKE)], ModelError, "scan at 15 deg: got models b, expected a"),
        ([scan(a=STROKE), scan(a=STROKE)], ConfigError, "scan at 0 deg: occurs twice"),
        ([scan(270.0, a=STROKE)], ConfigError, "got rotation 270 deg"),
        ([scan(true=np.array([60.0]), a=np.zeros(1))], ConfigError, "misses it|reached the cap"),
        ([scan(true=np.array([95.0]), a=np.zeros(1))], ConfigError, r"scan at 0 deg, true angle: got angle 95 deg"),
        ([scan(a=STROKE + 95.0)], ModelError, r"scan at 0 deg, model 'a': got angle 95 deg at sample 0"),
    ],
)
def test_scans_that_do_not_go_together_are_refused(scans: list[Scan], kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        reconstruct(IDEAL, scans)


def test_angles_that_are_none_are_refused() -> None:
    gap = np.where(np.arange(41) == 7, math.nan, STROKE)
    good = scan(a=STROKE)
    with pytest.raises(ConfigError, match=r"true angles of shape \(0,\), expected \(T,\) with T > 0"):
        scan(true=np.empty(0))
    with pytest.raises(ConfigError, match="true angles: got nan at sample 7, expected finite angles"):
        replace(good, true_deg=gap)
    with pytest.raises(ConfigError, match=r"sensed angles: got shape \(40,\), expected \(41,\)"):
        replace(good, sensed_deg=STROKE[1:])
    with pytest.raises(ModelError, match="model 'a': got nan at sample 7"):
        scan(a=gap)


def test_answers_of_another_length_are_refused() -> None:
    protocol = Protocol(rate_hz=25.0, scans=1)
    with pytest.raises(ConfigError, match=r"device: got true angles of shape \(534,\), expected \(550,\)"):
        record_scans(protocol, lambda u: (u[16:], u), {})
    with pytest.raises(ModelError, match=r"model 'a': got angles of shape \(549,\)"):
        record_scans(protocol, lambda u: (u, u), {"a": lambda u: u[1:]})


def test_questions_without_an_answer_are_refused(demo: Reconstruction) -> None:
    with pytest.raises(ModelError, match="no model 'LSTM', available: knows the play, middle line"):
        demo.errors("LSTM")
    with pytest.raises(ConfigError, match="no points in pattern 'IV'"):
        demo.in_pattern("IV")
    with pytest.raises(ConfigError, match="no scan at 50 deg, available: 0, 15"):
        demo.in_scan(50.0)
    with pytest.raises(ConfigError, match="got no points"):
        demo.summary("middle line", np.zeros(18 * 250, bool))
    with pytest.raises(ConfigError, match="does not divide"):
        Protocol.parse({"oct_rate_hz": 60.0})
    with pytest.raises(ConfigError, match="at least 4 samples a period"):
        Protocol.parse({"rate_hz": 0.3, "oct_rate_hz": 0.3})
