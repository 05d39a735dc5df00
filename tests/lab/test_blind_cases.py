"""Cases: sealed, without hints, reproducible, of the size they claim; negative controls hold nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hystmpc.gap.residual import MOTION_PARTS, motion_part_labels
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, resample
from hystmpc_lab.blind.cases import INJECTIONS, Injection, injection_case, sized
from hystmpc_lab.blind.device import DEVICES
from hystmpc_lab.blind.generators import GENERATORS, LABELS, Withheld, generator_named
from hystmpc_lab.blind.make import CASES, SUITES, WHEEL, device_of, make_blind, make_case, places
from hystmpc_lab.blind.plan import ALIASED, POOR, draw_plan
from hystmpc_lab.blind.reading import load_scored
from hystmpc_lab.blind.retuning import retune, rms
from hystmpc_lab.blind.run import record_motion
from hystmpc_lab.blind.sealed import (
    ANSWERS,
    MANIFEST,
    densities,
    open_answers,
    read_case,
    read_manifest,
)
from hystmpc_lab.devices.cores import MuscleCore

WORDS = {
    *LABELS,
    *SUITES,
    *(g.name for g in GENERATORS),
    "unknown",
    "decoy",
    "capstan",
    "dahl",
    "rodcore",
    "muscle",
} - {"none"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four cases of unlike suites under one roof."""
    path = tmp_path_factory.mktemp("blind") / "check"
    make_blind(path, seed=11, cases=4, suite="single")
    return path


@pytest.mark.slow
def test_case_folders_look_alike_and_hold_no_hint(folder: Path) -> None:
    for case in sorted((folder / "cases").iterdir()):
        names = sorted(path.name for path in case.iterdir())
        logs = [name for name in names if name != "sim.yaml"]
        assert logs == [f"trial_{k:02d}.csv" for k in range(1, len(logs) + 1)]
        for path in case.iterdir():
            lines = path.read_text(encoding="utf-8").lower().splitlines()
            # The simulator was identified before the effect: its own operators are no hint.
            text = "\n".join(line for line in lines if not line.lstrip(" -").startswith(("operator:", "method:")))
            for key in (
                "lag_one",
                "skip_first_flexure",
                "sensor_sigma_deg",
                "sensor_resolution_deg",
                "drift_sigma_deg",
            ):  # of every file
                text = text.replace(key, "")
            assert not [word for word in WORDS if word in text]
        (header,) = {log.read_text().splitlines()[0] for log in case.glob("*.csv")}
        assert header.removesuffix(",simulated_deg") in ("time_s,command,angle_deg", "time_s,command_bar,angle_deg")
        assert all(read_csv(log).t[0] == 0 for log in case.glob("*.csv"))
    manifest = (folder / MANIFEST).read_text(encoding="utf-8").replace('"without"', "")
    assert not [word for word in WORDS if word in manifest]
    assert read_manifest(folder).cases == ("001", "002", "003", "004")


@pytest.mark.slow
def test_answers_are_sealed(folder: Path, tmp_path: Path) -> None:
    answers = open_answers(folder)
    assert set(answers) == {"001", "002", "003", "004"}
    for name in (ANSWERS, MANIFEST):
        (tmp_path / name).write_text((folder / name).read_text())
    text = (tmp_path / ANSWERS).read_text()
    (tmp_path / ANSWERS).write_text(text.replace('"main": true', '"main": false', 1))
    with pytest.raises(LogError, match="changed since sealed"):
        open_answers(tmp_path)
    with pytest.raises(LogError, match="4 of 4 cases have no diagnosis"):
        load_scored(folder)


@pytest.mark.slow
def test_a_case_can_be_read_and_moved_again(folder: Path, tmp_path: Path) -> None:
    trials, simulator = read_case(folder, "001")
    assert all(trial.dt == pytest.approx(simulator.dt_s) for trial in trials)
    assert simulator.identification.residuals
    motion = tmp_path / "next_motion.csv"
    rows = [f"{t},{u}" for t, u in ((0, 0), (2, 4), (12, 4), (14, 0))]
    motion.write_text("\n".join(["time_s,command", *rows]))
    log = read_csv(record_motion(folder, "001", motion))
    assert log.command.max() == 4.0
    assert log.duration_s == pytest.approx(14.0)
    motion.write_text("time_s,command\n0,0\n1,9\n")
    with pytest.raises(ConfigError, match="expected within 0 to"):
        record_motion(folder, "001", motion)
    with pytest.raises(ConfigError, match="no case '099'"):
        record_motion(folder, "099", motion)


@pytest.mark.slow
def test_equal_seeds_give_equal_cases_and_others_others() -> None:
    first, again, other = (make_case(seed, "misset", 0) for seed in (3, 3, 4))
    assert first.answer == again.answer
    assert all(np.array_equal(a.angle, b.angle) for a, b in zip(first.trials, again.trials, strict=True))
    assert first.simulator.chain.values.tolist() == again.simulator.chain.values.tolist()
    assert first.trials[0].angle.tolist() != other.trials[0].angle.tolist()


@pytest.mark.slow
def test_an_effect_leaves_the_gap_that_its_answer_claims() -> None:
    case = make_case(11, "single", 2)
    (effect,) = case.answer.effects
    commands = [trial.command for trial in case.trials]
    device = case.answer.blind_device()
    affected, plain = device.true_angles(commands), device.with_effects([]).true_angles(commands)
    noisy = rms([trial.angle - angle for trial, angle in zip(case.trials, affected, strict=True)])
    assert noisy == pytest.approx(case.answer.noise_deg, rel=0.1)
    gaps = [retune(case.simulator, commands, angles).rmse_deg for angles in (plain, affected)]
    assert gaps[0] == pytest.approx(case.answer.form_deg, rel=0.1)
    assert gaps[1] ** 2 == pytest.approx(gaps[0] ** 2 + effect.gap_deg**2, rel=0.5)
    assert case.answer.floor_deg == pytest.approx(np.hypot(case.answer.noise_deg, case.answer.form_deg))


@pytest.mark.slow
@pytest.mark.parametrize(("number", "variant"), [(0, "shuffled_residual"), (1, "simulator_and_noise")])
def test_a_negative_control_holds_nothing_but_noise(number: int, variant: str) -> None:
    case = make_case(2, "controls", number)
    assert case.answer.variant == variant
    assert case.answer.truth == "none"
    commands, angles = [t.command for t in case.trials], [t.angle for t in case.trials]
    tuned = retune(case.simulator, commands, angles)
    error = np.concatenate([a - b for a, b in zip(angles, tuned.angles, strict=True)])
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.1
    assert tuned.rmse_deg < 1.3 * case.answer.floor_deg


@pytest.mark.parametrize("injection", INJECTIONS, ids=lambda i: i.name)
def test_an_injection_changes_angles_by_what_it_says(injection: Injection) -> None:
    change = injection.change
    t = np.arange(1000) * 0.04
    angle = 30 + 20 * np.sin(2 * np.pi * 0.2 * t)
    changed = change(angle, t, 60.0, 0.2, np.random.default_rng(0))
    assert 0 < rms([changed - angle]) < 8
    still = change(np.full(1000, 30.0), t, 0.0, 0.2, np.random.default_rng(0))
    moves = injection.label == "drift"
    assert (np.ptp(still) > 0.05) == moves


@pytest.mark.slow
def test_injection_into_real_logs(real_logs: list[Path]) -> None:
    logs = [resample(trial, 25.0) for trial in read_trials(real_logs)]
    case = injection_case(logs, 0, np.random.default_rng(0))
    assert case.answer.truth == "delay"
    assert case.answer.ratio == pytest.approx(3.0, rel=0.15)
    assert all(not trial.channels for trial in case.trials)


def test_plans_name_what_they_can_show() -> None:
    rich, sines = draw_plan(np.random.default_rng(0), "rich"), draw_plan(np.random.default_rng(0), "sines")
    assert all(rich.separates(label) for label in LABELS)
    assert not sines.separates("delay")
    assert sines.separates("sensor")
    assert not draw_plan(np.random.default_rng(0), "no_repeats").separates("first_flexure")
    drawn = [draw_plan(np.random.default_rng(seed)) for seed in range(60)]
    assert 0.2 < np.mean([plan.name in POOR for plan in drawn]) < 0.5
    assert {"rich", "short", *POOR} >= {plan.name for plan in drawn}
    for plan in drawn:
        assert all(u[0] == 0 and u.min() >= 0 and u.max() <= 6 and 20 < u.size / 25 < 70 for u in plan.commands)
        assert np.array_equal(plan.commands[-2], plan.commands[0]) == ("repeat" in plan.features)


def test_places_deal_out_every_suite() -> None:
    dealt = [suite for suite, _ in places("all", 40, with_logs=True)]
    assert set(dealt) == set(SUITES)
    whole = places("all")
    assert len(whole) == len(set(whole)) == CASES
    assert {suite for suite, _ in whole} == set(SUITES) - {"injection"}
    assert [n for suite, n in places("all", 100) if suite == "pairs"] == list(range(7))
    assert len(places("triple")) == 10
    assert places("unknown", 3) == [("unknown", 0), ("unknown", 1), ("unknown", 2)]
    with pytest.raises(ConfigError, match="did you mean 'pairs'"):
        places("pair", 3)


def test_the_wheel_measures_every_bar_on_all_devices() -> None:
    assert 220 <= CASES <= 240
    assert sum(WHEEL[name] for name in ("none", "misset", "controls", "retuned")) >= 60
    singles = [(LABELS[n % len(LABELS)], device_of("single", n)) for n in range(WHEEL["single"])]
    hidden = {(label, MuscleCore) for label in ("contact", "nonlinear_gain", "rate_dependence")}
    assert set(singles) == {(label, kind) for label in LABELS for kind in DEVICES} - hidden
    for suite, count in WHEEL.items():
        dealt = [device_of(suite, n) for n in range(count)]
        assert min(dealt.count(kind) for kind in DEVICES) >= count // 6


@pytest.mark.parametrize("name", ALIASED)
def test_an_aliased_plan_is_one_motion_at_one_frequency(name: str) -> None:
    plan = draw_plan(np.random.default_rng(4), name, 3.0)
    assert 3 <= len(plan.commands) <= 6
    for u in plan.commands:
        moved = u[25:-1] - u[25:-1].mean()
        power = np.abs(np.fft.rfft(moved))
        assert np.fft.rfftfreq(moved.size, 0.04)[power.argmax()] == pytest.approx(plan.aliased_hz, rel=0.1)
        assert 2.0 < u.max() <= 3.0
    assert plan.seconds == pytest.approx(sum(u.size for u in plan.commands) / 25)


def test_a_device_in_two_configurations_is_made_with_its_trials() -> None:
    case = make_case(1805000, "configuration", 1)
    assert case.answer.labels == ("configuration_change",)
    assert case.answer.variant == "gain"
    assert 2 <= len(case.answer.second) < len(case.trials) - 1
    assert case.answer.ratio > 2.5
    again = case.answer.blind_device().record([t.command for t in case.trials])
    assert all(np.array_equal(a.angle, b.angle) for a, b in zip(case.trials, again, strict=True))


def test_an_aliased_disturbance_lies_within_one_over_the_length_of_the_trials() -> None:
    case = make_case(1805000, "aliased", 2)
    (effect,) = case.answer.effects
    assert case.answer.truth == "unknown"
    seconds = sum(len(trial) for trial in case.trials) / 25
    turns = effect.shape["hz"] * seconds
    moved = case.trials[0].command[25:-1]
    peak = np.fft.rfftfreq(8 * moved.size, 0.04)[np.abs(np.fft.rfft(moved - moved.mean(), 8 * moved.size)).argmax()]
    assert min(abs(turns - h * peak * seconds) for h in (1, 2, 3)) < 0.05 * turns + 1


def test_making_refuses_what_cannot_be_made(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="got no logs"):
        make_blind(tmp_path / "a", 1, 2, "injection")
    with pytest.raises(ConfigError, match="at least 1"):
        make_blind(tmp_path / "a", 1, 0)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    with pytest.raises(ConfigError, match="not empty"):
        make_blind(tmp_path / "full", 1, 1)
    (tmp_path / MANIFEST).write_text(json.dumps({"format": "other"}))
    with pytest.raises(LogError, match="hystmpc-blind/1"):
        read_manifest(tmp_path)


def test_sizes_are_found_for_curved_gaps_and_stop_at_the_bound() -> None:
    effect = Withheld(generator_named("weight"), 3.0, {"mounting_deg": 0.0})
    found, gap = sized(effect, 2.0, lambda e: 0.01 * e.size**1.7)
    assert gap == pytest.approx(2.0, rel=0.06)
    assert 0.01 * found.size**1.7 == gap
    found, gap = sized(effect, 1e6, lambda e: e.size)
    assert found.size == gap == generator_named("weight").greatest


def test_regions_are_exclusive_and_densities_average_one() -> None:
    t = np.arange(1200) / 25
    command = np.interp(t, [0, 1, 5, 15, 20, 30, 48], [0, 0, 5, 5, 1, 4, 0])
    trial = Trial(t, command, command)
    region = motion_part_labels(trial)
    assert {MOTION_PARTS[k] for k in np.unique(region)} == set(MOTION_PARTS)
    error = np.random.default_rng(0).standard_normal(t.size)
    found = densities([trial], [error])
    shares = {name: float(np.mean(region == k)) for k, name in enumerate(MOTION_PARTS)}
    assert sum(found[name] * shares[name] for name in found) == pytest.approx(1.0)
    assert densities([trial], [(region == 3).astype(float)])["hold"] == pytest.approx(1 / shares["hold"])
