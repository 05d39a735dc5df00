"""The expected fall of the tracking error, and what runs say of it afterwards."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.diagnosis import FORMAT, MotionTracking, TrackingGap, Verdict
from hystmpc.gap.expected_tracking import (
    ROUGHNESS,
    UnexplainedPlant,
    covered_motions,
    expected_tracking,
    next_disturbance,
    with_tracking,
)
from hystmpc.gap.measured_tracking import MeasuredRun, fall_lines, fall_pieces, measured_runs, tracking_falls
from hystmpc.gap.report.folder import diagnosis_json
from hystmpc.gap.report.page import diagnosis_report
from hystmpc.gap.report.report_data import ReportData
from hystmpc.gap.report.words import tracking_sentence
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.simulator import Identification, Simulator, save_simulator
from hystmpc.rig.config import RunSettings
from hystmpc.sim.compare import compare
from hystmpc.sim.config import SimulationConfig
from hystmpc.trajectories.drawn import approached
from hystmpc.trajectories.point_to_point import PointToPoint
from hystmpc.trials.config import dump_yaml, load_settings
from hystmpc.trials.errors import GapError, LogError
from hystmpc.trials.report import Folded, Paragraph, Plot, Table
from hystmpc.trials.run_folder import RunFolder

from ..cli.test_verbs import run
from ..models.zoo import CHAINS, simulator
from ..rig.test_processes import RUN, SIMULATED
from ..sim.small import MOVE
from .report_examples import report_data

NOISE = NoiseModel(
    sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=0.2, motion_sigma_deg_per_sqrt_unit=0.2, model_sigma_deg=0.3
)
LARGE = NoiseModel(
    sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=0.5, motion_sigma_deg_per_sqrt_unit=0.4, model_sigma_deg=0.6
)
NOMINAL = simulator(Chain(Backlash(9.2, 9.6, 1.6, 2.003)))
CORRECTED = replace(simulator(CHAINS["backlash"]), identification=Identification(method="by hand", noise=NOISE))
QUIET = replace(CORRECTED, identification=Identification(method="by hand"))
TARGETS = PointToPoint(35.0, (55.0, 45.0), (0.6, 0.6))
MOTIONS = (approached("move", 25.0, 35.0, TARGETS),)


def evidence(verdict: Verdict = "named", nominal: Simulator | None = NOMINAL) -> ReportData:
    """Hand-made evidence of a device that is the corrected simulator."""
    made = report_data(verdict, 3)
    return replace(made, nominal=nominal, fixed=CORRECTED if nominal else None)


@cache
def tracked() -> ReportData:
    return with_tracking(evidence())


def test_a_wrong_model_is_worse_than_the_right_one_and_motions_make_up_the_whole() -> None:
    found, curves = expected_tracking(NOMINAL, CORRECTED, MOTIONS, seeds=(3, 4, 5))
    assert found.after_deg < found.before_deg
    assert found.before_range_deg[0] <= found.before_deg <= found.before_range_deg[1]
    assert found.after_range_deg[0] < found.after_deg < found.after_range_deg[1]
    assert [m.name for m in found.motions] == [curve.name for curve in curves] == ["move"]
    assert found.motions[0].before_deg == pytest.approx(found.before_deg)


def test_where_nothing_is_missing_no_fall_is_expected() -> None:
    found, _ = expected_tracking(CORRECTED, CORRECTED, MOTIONS)
    assert found.before_deg == found.after_deg
    said = tracking_sentence(replace(report_data("none", 1).diagnosis, tracking=found))
    assert said.startswith("No fall of the closed-loop tracking error is expected")


def test_where_the_unexplained_decides_no_fall_is_foretold() -> None:
    unclear = replace(CORRECTED, identification=Identification(method="by hand", noise=LARGE))
    found, curves = expected_tracking(NOMINAL, unclear, MOTIONS)
    assert re.search(r"unexplained decides the fall of the error: \d\d % to \d\d\d? %", found.why_not)
    assert math.isnan(found.fall_deg)
    assert not curves


def test_simulators_of_different_devices_are_refused() -> None:
    with pytest.raises(GapError, match=r"dt_s 0\.02, expected that of the nominal one, 0\.04"):
        expected_tracking(NOMINAL, CORRECTED.at_sample_time(0.02), MOTIONS)


@given(st.floats(0.01, 2.0), st.floats(0.0, 5.0), st.floats(0.05, 3.0), st.floats(0.0, 4.0))
def test_what_is_unexplained_keeps_its_size(drift: float, motion: float, size: float, travel: float) -> None:
    """d' = a d + b w with a^2 size^2 + b^2 = size^2: a process of that size keeps it, at any speed."""
    noise = NoiseModel(
        sensor_sigma_deg=0.1,
        drift_sigma_deg_per_sqrt_s=drift,
        motion_sigma_deg_per_sqrt_unit=motion,
        model_sigma_deg=size,
    )
    kept, added = (next_disturbance(d, travel, 0.04, noise, w) for d, w in ((size, 0.0), (0.0, 1.0)))
    assert kept**2 + added**2 == pytest.approx(size**2)
    assert added <= ROUGHNESS * math.sqrt(drift**2 * 0.04 + motion**2 * travel) * (1 + 1e-9)


def test_the_same_seed_is_the_same_device() -> None:
    plant = UnexplainedPlant(CORRECTED, 7)
    runs = []
    for device in (plant, plant, plant.reseeded(8)):
        device.reset()
        runs.append([device.apply(u) for u in np.linspace(0.0, 3.0, 20)])
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_motions_stay_within_what_the_trials_covered() -> None:
    made = evidence()
    angles = np.concatenate([trial.with_effects for trial in made.trials])
    for seed in (1, 2, 3):
        for motion in covered_motions(made.trials, CORRECTED, seed):
            counted = motion.wanted(0.04)[motion.first(0.04) :]
            assert angles.min() <= counted.min()
            assert counted.max() <= angles.max()
            assert np.ptp(counted) > 1.0


def test_a_diagnosis_says_it_in_words_and_in_json() -> None:
    diagnosis = tracked().diagnosis
    found = diagnosis.tracking
    assert found is not None
    assert found.fall_deg > 0
    assert "is expected to fall by" in tracking_sentence(diagnosis)
    told = json.loads(diagnosis_json(diagnosis))["tracking"]
    motions = tuple(MotionTracking(**motion) for motion in told.pop("motions"))
    ranges = {key: tuple(told.pop(key)) for key in ("before_range_deg", "after_range_deg")}
    assert TrackingGap(**told, **ranges, motions=motions) == found


@pytest.mark.parametrize(
    ("verdict", "nominal", "why"),
    [
        ("named", None, "the simulator is a network"),
        ("too_little", NOMINAL, "do not allow a diagnosis"),
        ("unknown", NOMINAL, "a cause that is not known"),
    ],
)
def test_it_says_where_nothing_can_be_said(verdict: Verdict, nominal: Simulator | None, why: str) -> None:
    found = with_tracking(evidence(verdict, nominal)).diagnosis
    assert found.tracking is not None
    assert math.isnan(found.tracking.fall_deg)
    assert why in tracking_sentence(found)
    assert json.loads(diagnosis_json(found))["tracking"]["before_deg"] is None


def test_too_much_left_open_is_no_device() -> None:
    made = evidence()
    gap = replace(made.diagnosis.gap, closed_share=0.6)
    found = with_tracking(replace(made, diagnosis=replace(made.diagnosis, gap=gap))).diagnosis
    assert "closes 60 % of the structural gap" in tracking_sentence(found)


def simulated(out: Path, model: Simulator) -> Path:
    """A study of the quiet device with that model, as a folder."""
    out.mkdir()
    data = {
        "plant": {"simulator": str(save_simulator(QUIET, out.parent / "device.yaml"))},
        "model": str(save_simulator(model, out.parent / f"{out.name}.yaml")),
        "motions": {"move": MOVE},
        "controllers": {"mpc": {"kind": "linearised_mpc"}},
    }
    compare(SimulationConfig.parse(data), out / "run")
    return out / "run"


def changed(run: Path, out: Path, name: str = "move", **changes: Any) -> Path:
    """A copy of a run whose settings say that it tracked something else."""
    shutil.copytree(run, out)
    settings = RunFolder.open(out).config()
    motion = settings["motions"].pop("move") | changes
    (out / "move").rename(out / name)
    (out / "config.yaml").write_text(dump_yaml(settings | {"motions": {name: motion}}))
    return out


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs before and after the correction, one of another reference, and the diagnosis."""
    folder = tmp_path_factory.mktemp("runs")
    made = {
        "before": simulated(folder / "before", NOMINAL),
        "after": simulated(folder / "after", QUIET),
        "empty": folder / "empty",
        "diagnosis": folder / "diagnosis",
    }
    made["other"] = changed(made["before"], folder / "other", start_deg=30.0, targets_deg=[41.0, 36.0])
    made["longer"] = changed(made["before"], folder / "longer", holds_s=[0.8, 1.6])
    made["renamed"] = changed(made["before"], folder / "renamed", "scan")
    for name in ("empty", "diagnosis"):
        made[name].mkdir()
        (made[name] / "diagnosis.json").write_text(json.dumps({"format": FORMAT}))
    save_simulator(NOMINAL, made["diagnosis"] / "sim.given.yaml")
    save_simulator(QUIET, made["diagnosis"] / "sim.fixed.yaml")
    return made


@pytest.mark.slow
def test_on_the_corrected_simulator_itself_the_fall_is_the_one_expected(runs: dict[str, Path]) -> None:
    (fall,) = tracking_falls(runs["after"], [runs["before"]], runs["diagnosis"])
    assert fall.before is not None
    assert fall.expected is not None
    assert fall.before.rmse_deg == pytest.approx(fall.expected.before_deg, rel=0.03)
    assert fall.after.rmse_deg == pytest.approx(fall.expected.after_deg, rel=0.03)
    assert fall.share > 0.2
    assert fall.agrees
    lines = fall_lines([fall])
    assert "the tracking error fell from" in lines[0]
    assert lines[1].endswith("the measured fall is within 30 % of it")
    assert len(fall_pieces([fall])) == 5


def test_a_run_that_did_not_follow_its_diagnosis_is_told(runs: dict[str, Path]) -> None:
    (fall,) = tracking_falls(runs["before"], [runs["before"]], runs["diagnosis"])
    assert fall.share == 0.0
    assert fall_lines([fall])[1].endswith("the measured fall is not within 30 % of it")


def test_a_run_alone_is_set_beside_what_is_expected(runs: dict[str, Path]) -> None:
    (fall,) = tracking_falls(runs["after"], [], runs["diagnosis"])
    first, second = fall_lines([fall])
    assert "the tracking error is" in first
    assert "within" not in second


@pytest.mark.parametrize(
    ("before", "diagnosis", "message"),
    [
        ("other", None, "a reference up to 1 deg beside that of"),
        ("longer", None, "expected that of"),
        ("renamed", None, "got scan, mpc, expected runs of the names in"),
        ("empty", None, "expected the folder of a run"),
        ("before", "before", "expected a folder of `diagnose`"),
        ("before", "empty", "got no sim.given.yaml"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_line(
    before: str, diagnosis: str | None, message: str, runs: dict[str, Path]
) -> None:
    with pytest.raises(LogError) as refused:
        tracking_falls(runs["after"], [runs[before]], runs[diagnosis] if diagnosis else None)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def bench_run(folder: Path, lost: int = 0, noise_deg: float = 0.1) -> MeasuredRun:
    """The folder of an experiment with an error of 0.5 deg beside its noise, and what is read from it."""
    (folder.parent / "run.yaml").write_text(SIMULATED + RUN)
    settings = load_settings(RunSettings, folder.parent / "run.yaml")
    model = replace(QUIET, identification=Identification(method="by hand", noise=NOISE))
    tip = settings.controller.model_copy(update={"model": str(save_simulator(model, folder.parent / "model.yaml"))})
    settings = settings.model_copy(update={"controller": tip})
    reference, n = settings.reference.build(), 200
    count = round(reference.duration_s / settings.dt_s)
    track = np.full(n, np.nan)
    track[40:60] = np.linspace(29.0, 35.0, 20)  # the way to the start of the reference
    track[60 : 60 + count] = reference(settings.dt_s * np.arange(1, count + 1))
    if lost:
        track[60 + count - lost :] = np.nan
        track[40 : 60 + lost] = np.nan
    angle = np.full(n, 29.0)
    wanted = np.isfinite(track[:-1])
    noise = np.random.default_rng(1).normal(0, noise_deg, n)
    angle[1:][wanted] = track[:-1][wanted] + 0.5 + noise[1:][wanted]
    angle[1:60] += 20.0  # what does not count
    RunFolder.create(folder, settings).write_log(
        {
            "time_s": settings.dt_s * np.arange(n),
            "command_mm": np.zeros(n),
            "angle_deg": angle,
            "reference_deg": track,
            "sequence": np.arange(n),
        }
    )
    (found,) = measured_runs(folder)
    return found


def test_at_a_bench_the_way_to_the_start_does_not_count_and_noise_is_taken_off(tmp_path: Path) -> None:
    found = bench_run(tmp_path / "run")
    assert found.noise_deg == 0.1
    assert found.t[-1] == pytest.approx(found.reference.duration_s, abs=0.04)
    assert found.rmse_deg == pytest.approx(0.5, abs=0.02)


def test_a_run_that_was_stopped_is_not_compared(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="a run that was stopped is not compared"):
        bench_run(tmp_path / "run", lost=10)


@pytest.mark.slow
def test_the_page_of_a_diagnosis_shows_both_loops() -> None:
    sections = [piece for piece in diagnosis_report(tracked()).pieces if isinstance(piece, Folded)]
    said, table, plot = next(one.pieces for one in sections if one.heading.startswith("What the controller gains"))
    assert said == Paragraph(tracking_sentence(tracked().diagnosis))
    assert isinstance(table, Table)
    assert [row[0] for row in table.rows] == ["point to point", "scan", "all motions"]
    assert isinstance(plot, Plot)


@pytest.mark.slow
def test_report_prints_the_fall_and_shows_it_on_the_page(
    runs: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--before", runs["before"], "--diagnosis", runs["diagnosis"]]
    code, out, err = run(capsys, "report", runs["after"], *arguments)
    assert code == 0, err
    assert "the measured fall is within 30 % of it" in " ".join(out.split())
    page = (runs["after"] / "report.html").read_text()
    assert "Fall of the tracking error" in page
    code, out, err = run(capsys, "report", runs["after"], "--before", runs["other"])
    assert code == 2
    assert [line for line in err.splitlines() if line.startswith("error: ")] == err.splitlines()
