"""Laws of the commissioning study: its devices, its bars, and one device from the bench to the table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hystmpc_lab.commission.job import PreparedPlant, bench_settings
from hystmpc_lab.commission.settings import (
    CommissionOutcome,
    CommissionResult,
    CommissionStudySettings,
    bars,
    gap_agrees,
    over_rival,
)
from hystmpc_lab.commission.study import STUDY, commission_report
from hystmpc_lab.devices.drawn import DrawnDevice, DrawnPlant, draw_devices, worn

FOUR = draw_devices(4, 3, quick=True)  # one of each family


def stroke(device: DrawnDevice) -> tuple[float, float]:
    """Angle over the whole travel, and greatest width of the loop of a slow stroke [deg]."""
    plant = DrawnPlant(replace(device, lag_s=0.0, damping=0.0, delay_s=0.0, creep=0.0, noise_deg=0.0), 0)
    up = np.linspace(0.0, device.limits.upper, 200)
    angles = np.array([plant.apply(float(u)) for u in np.concatenate([up, up[::-1]])])
    return float(np.ptp(angles)), float(np.max(np.abs(angles[:200] - angles[:199:-1])))


@pytest.mark.parametrize("device", FOUR, ids=lambda d: d.family)
def test_friction_changes_the_width_of_the_loop_and_stiffness_shortens_the_stroke(device: DrawnDevice) -> None:
    whole, width = stroke(device)
    wider = stroke(worn(device, 2.0, 1.0))[1] / width
    assert (1.0 / wider if device.family == "muscle" else wider) > 1.3  # a muscle's friction falls by the factor
    assert stroke(worn(device, 1.0, 2.0))[0] == pytest.approx(0.5 * whole, rel=0.05)
    assert worn(device, 1.0, 1.0) == device


@pytest.mark.parametrize("device", FOUR, ids=lambda d: d.family)
def test_a_prepared_device_rests_behind_flexures_within_its_limits(device: DrawnDevice) -> None:
    plant = PreparedPlant(DrawnPlant(device, 1), 1)
    limits = device.limits
    assert plant.commands.size == plant.angles_deg.size
    assert plant.commands.min() >= limits.lower
    assert plant.commands.max() <= limits.upper
    assert np.max(np.abs(np.diff(plant.commands, prepend=0.0))) <= limits.rate * plant.dt * (1 + 1e-9)
    plant.reset()
    first = plant.true_angle
    plant.apply(0.5 * limits.upper)
    plant.reset()
    assert plant.true_angle == first
    assert np.ptp(plant.angles_deg) > 0.5 * np.ptp(DrawnPlant(device, 1).reachable_deg)


def test_a_bench_file_of_a_drawn_device_is_one_that_a_user_could_write(tmp_path: Path) -> None:
    for device in FOUR:
        settings = bench_settings(DrawnPlant(device, 1), {"minutes": 5.0, "diagnose": False}, tmp_path)
        assert settings.limits.upper == device.limits.upper
        assert settings.commission.minutes == 5.0


def results(settings: CommissionStudySettings) -> tuple[CommissionResult, ...]:
    """Every job done, with figures that meet all bars."""
    good = {
        "commission": {
            "device_s": 280.0,
            "pid.rmse_deg": 1.0,
            "inverse_pid.rmse_deg": 0.8,
            "commissioned.rmse_deg": 0.2,
        }
        | {"learning_off.rmse_deg": 0.2, "commissioned.violations": 0.0, "commissioned.stops": 0.0},
        "compare": {"sibling.rmse_deg": 0.4, "stranger.rmse_deg": 0.6, "wrong_lag.rmse_deg": 0.4}
        | {f"{name}.rmse_deg": 0.2 for name in ("friction", "stiffness", "none", "imaging")}
        | {f"{name}_off.rmse_deg": 0.5 for name in ("friction", "stiffness")}
        | {"imaging_pid.rmse_deg": 0.6, "none.within_band": 0.9}
        | {"as_identified_none.rmse_deg": 0.1, "as_identified_inverse.rmse_deg": 0.1},
        "gap": {"gap.said": 1.0, "gap.said_before_deg": 1.0, "gap.said_after_deg": 0.5, "gap.floor_deg": 0.02}
        | {"gap.before_deg": 2.0, "gap.after_deg": 1.0},
    }
    return tuple(
        replace(STUDY.blank(job, settings, Path()), status="done", figures=good[job.stage])
        for job in STUDY.jobs(settings, STUDY.draw(settings))
    )


def test_bars_count_a_lost_device_as_infinitely_bad(tmp_path: Path) -> None:
    settings = CommissionStudySettings.of(devices=4, seed=3, quick=True, diagnose=True)
    whole = results(settings)
    assert {bar.state for bar in bars(CommissionOutcome(settings, whole, tmp_path))} == {"met"}
    lost = (replace(whole[0], status="failed", figures={}), *whole[1:])
    outcome = CommissionOutcome(settings, lost, tmp_path)
    judged = {bar.name: bar for bar in bars(outcome)}
    assert judged["commissioned, over the best tuned rival: worst"].state == "missed"
    assert judged["commissioned, over the best tuned rival: median"].state == "met"
    assert over_rival("commissioned")(outcome.figures[FOUR[0].key]) == np.inf
    page, tables = commission_report(outcome)
    assert "FAILED" in page.html()
    assert {table.name for table in tables} == {"bars", "devices", "figures"}


@pytest.mark.parametrize(
    ("before", "after", "agrees"), [(2.0, 1.0, True), (2.0, 1.25, True), (2.0, 1.9, False), (2.0, 0.1, False)]
)
def test_the_fall_that_was_said_agrees_within_thirty_per_cent_of_its_share(
    before: float, after: float, agrees: bool
) -> None:
    said = {"gap.said": 1.0, "gap.said_before_deg": 1.0, "gap.said_after_deg": 0.5, "gap.floor_deg": 0.02}
    assert gap_agrees({**said, "gap.before_deg": before, "gap.after_deg": after}) is agrees
    assert gap_agrees({"gap.said": 0.0}) is None
