"""The closed-loop benchmark on hand-made runs: figures, ratios, bars, plants and jobs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.loop import LoopLog
from hystmpc.sim.study import ClosedLoopRun
from hystmpc.trajectories.config import parse_motion
from hystmpc.trials.errors import ConfigError
from hystmpc_lab.control.bars import BARS, BarVerdict, ControlOutcome, control_figures, exact, limit_cycle, verdicts
from hystmpc_lab.control.loop import control_jobs, gains_file
from hystmpc_lab.control.plants import MISMATCH, PLANTS, half_width
from hystmpc_lab.control.report import bars_table, loop_table
from hystmpc_lab.control.settings import CONTROLLERS, MOTIONS, ControlJob, ControlResult, ControlSettings, motion
from hystmpc_lab.control.study import STUDY

DT = 0.1
LIMITS = CommandLimits(0.0, 6.0, 10.0)
FIGURES = {
    "rmse_deg": 0.1,
    "max_deg": 0.3,
    "hold_error_deg": 0.01,
    "hold_range": 0.0,
    "rest_range": 0.0,
    "cycling_holds": 0.0,
    "travel": 10.0,
    "violations": 0.0,
    "fallbacks": 0.0,
    "late_share": 0.0,
    "step_p99_ms": 1.0,
}


def held(command: list[float], source: str = "mpc") -> ClosedLoopRun:
    """A run that moves for two samples and then wants to rest; its command is given."""
    n = len(command)
    reference = np.array([1.0, 2.0, *[3.0] * (n - 2)])
    log = LoopLog(
        time_s=DT * np.arange(1, n + 1, dtype=np.float64),
        reference_deg=reference,
        measured_deg=np.full(n, 1e3),
        predicted_deg=np.full(n, math.nan),
        command=np.array(command),
        disturbance_deg=np.zeros(n),
        source=("mpc",) * (n - 1) + (source,),
        status=("ok",) * n,
        stage_s={"solve": np.where(np.arange(n) == 0, 2 * DT, 0.1 * DT)},
        interrupted=False,
    )
    return ClosedLoopRun(log, reference + 0.5, rest_command=0.0, dt=DT, unit="mm")


def result(plant: str, controller: str, motion: str = "point_to_point", **figures: float) -> ControlResult:
    """A run of which only some figures matter."""
    return ControlResult(ControlJob("run", plant, 25.0, controller, motion), "", "done", "", 1.0, FIGURES | figures)


def judged(*results: ControlResult) -> dict[tuple[str, str], BarVerdict]:
    """Verdicts by bar and controller."""
    return {(v.bar, v.controller): v for v in verdicts(outcome(*results))}


def outcome(*results: ControlResult) -> ControlOutcome:
    return ControlOutcome(ControlSettings(), results, Path())


def test_figures_of_a_hand_made_hold() -> None:
    """Ten samples of rest from the third on; its last half are the samples 7 to 11."""
    command = [0.5, 1.0, 1.0, 1.0, 1.3, 1.0, 1.0, 1.02, 1.0, 1.02, 1.0, 1.2]
    figures = control_figures(held(command, "hold"), LIMITS, half_width=0.5, preview=1)
    assert figures["rmse_deg"] == pytest.approx(0.5)
    assert figures["hold_error_deg"] == pytest.approx(0.5)
    assert figures["hold_range"] == pytest.approx(0.4)
    assert figures["rest_range"] == pytest.approx(0.04)
    assert figures["cycling_holds"] == 1.0
    assert figures["violations"] == 0.0
    assert figures["fallbacks"] == 1.0
    assert figures["late_share"] == pytest.approx(1 / 12)


def test_a_preview_longer_than_the_half_leaves_nothing_to_judge() -> None:
    figures = control_figures(held([0.5, 1.0, *[1.0] * 10]), LIMITS, half_width=0.5, preview=10)
    assert math.isnan(figures["rest_range"])
    assert figures["hold_range"] == 0.0


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ([1.0, 1.0, 1.0, 1.0], False),
        ([1.0, 1.2, 1.4, 1.6], False),  # on the way, not round
        ([1.0, 1.2, 1.0, 1.0], False),  # one reversal
        ([1.0, 1.2, 1.0, 1.2], True),
        ([1.0, 1.05, 1.0, 1.05], False),  # within the band
        ([1.0, 1.2, 1.1999, 1.2, 1.4], False),  # jitter on the way
    ],
)
def test_a_limit_cycle_leaves_the_band_and_turns_twice(command: list[float], expected: bool) -> None:
    assert limit_cycle(np.array(command), 0.1) is expected


def test_half_width_of_a_backlash_is_that_of_its_lines() -> None:
    simulator = PLANTS["backlash"].simulator(0.04)
    m_lo, m_up, c_lo, c_up = simulator.chain.core.values
    lower, upper = simulator.command_limits.lower, simulator.command_limits.upper
    middle = 0.5 * (m_lo * (lower + c_lo) + m_up * (upper + c_up))
    wanted = 0.5 * ((middle / m_up - c_up) - (middle / m_lo - c_lo))
    assert half_width(simulator) == pytest.approx(wanted, rel=1e-3)


def test_a_plant_that_is_off_differs_in_every_parameter() -> None:
    for name, plant in PLANTS.items():
        if not plant.off:
            continue
        ours, nominal = plant.simulator(0.04).chain, PLANTS[plant.family].simulator(0.04).chain
        assert ours.values == pytest.approx(MISMATCH * nominal.values), name
        assert plant.effects.lag_s == pytest.approx(MISMATCH * PLANTS[plant.family].lag_s)
        assert plant.effects.noise_deg == PLANTS[plant.family].noise_deg


@pytest.mark.parametrize("rate", [25.0, 250.0])
def test_the_oracle_knows_lag_and_delay(rate: float) -> None:
    """Whole samples of delay are told, the rest stands in the chain."""
    plant = PLANTS["noisy-off"]
    simulator, samples = plant.oracle(1 / rate)
    inside = dict(zip(simulator.chain.labels, simulator.chain.values, strict=True))
    assert samples / rate + inside.get("delay.delay_s", 0.0) == pytest.approx(plant.effects.delay_s)
    assert inside["lag.tau_s"] == pytest.approx(plant.effects.lag_s)


def test_every_plant_reaches_every_motion() -> None:
    """All angles of all motions lie between the plant's rest and its angle at the highest command."""
    for plant in PLANTS.values():
        device = plant.device(0.04)
        rest, upper = device.true_angle, device.simulator.command_limits.upper
        for _ in range(100):
            device.apply(upper)
        for name in MOTIONS:
            angles = parse_motion(motion(name, rest, 1)).build()(np.linspace(0, 60, 6001))
            assert float(np.max(angles)) < device.true_angle, (plant.name, name)
            assert float(np.min(angles)) >= rest - 1e-6, (plant.name, name)


def test_exactly_known_is_without_lag_delay_noise_and_mismatch() -> None:
    assert exact(result("backlash", "linearised_backlash"))
    assert exact(result("pi", "oracle"))
    assert exact(result("pi-off", "oracle"))
    assert not exact(result("pi", "linearised_backlash"))
    assert not exact(result("backlash-off", "linearised_backlash"))
    assert not exact(result("noisy", "oracle"))
    assert not exact(result("backlash", "linearised_lstm"))


def test_bars_are_met_up_to_their_limits_and_missed_beyond() -> None:
    oracle = result("noisy", "oracle", rmse_deg=0.4)
    rivals = [result("noisy", name, rmse_deg=1.0) for name in ("pid", "inverse", "inverse_pid")]
    good = judged(oracle, *rivals, result("noisy", "linearised_lstm", rmse_deg=0.5))
    assert good["RMSE over the oracle's", "linearised_lstm"].met
    assert good["RMSE over the best of PID, inverse, both", "linearised_lstm"].met
    bad = judged(oracle, *rivals, result("noisy", "linearised_lstm", rmse_deg=0.51, hold_range=0.11, cycling_holds=0.5))
    assert {v.bar for (_, name), v in bad.items() if name == "linearised_lstm" and not v.met} == {
        "RMSE over the oracle's",
        "RMSE over the best of PID, inverse, both",
        "range of a held command [half-widths]",
        "share of holds with a limit cycle",
    }
    assert bad["RMSE over the oracle's", "linearised_lstm"].worst == pytest.approx(0.51 / 0.4)
    assert ("RMSE over the oracle's", "oracle") not in bad


def test_the_bar_of_the_baselines_counts_only_where_they_leave_enough() -> None:
    """A ratio to the oracle of two is not more than two."""
    oracle = result("noisy", "oracle", rmse_deg=0.5)
    rivals = [result("noisy", name, rmse_deg=1.0) for name in ("pid", "inverse", "inverse_pid")]
    found = judged(oracle, *rivals, result("noisy", "sampling_hb2", rmse_deg=0.9))
    assert ("RMSE over the best of PID, inverse, both", "sampling_hb2") not in found


def test_bars_of_exactly_known_plants() -> None:
    found = judged(
        result("backlash", "linearised_backlash", hold_error_deg=0.06),
        result("backlash", "linearised_backlash", "scan_0p1hz", hold_error_deg=math.nan, rmse_deg=0.2),
        result("backlash", "linearised_backlash", "scan_0p5hz", hold_error_deg=math.nan, rmse_deg=0.3),
    )
    holds = found["hold error, exactly known plant [deg]", "linearised_backlash"]
    assert (holds.within, holds.judged, holds.met) == (0, 1, False)
    scans = found["scan RMSE, exactly known plant [deg]", "linearised_backlash"]
    assert (scans.within, scans.judged, scans.motion) == (1, 2, "scan_0p5hz")


def test_faults_are_judged_for_every_controller() -> None:
    found = judged(result("pi", "pid", violations=1.0), result("pi", "inverse", fallbacks=2.0))
    assert not found["samples beyond a limit", "pid"].met
    assert found["samples beyond a limit", "inverse"].met
    assert not found["samples on a fallback level", "inverse"].met


def test_a_bar_that_nothing_is_about_is_not_met() -> None:
    table = bars_table(verdicts(outcome(result("pi", "pid"))))
    words = dict(zip((row[0] for row in table.rows), (str(row[-1]) for row in table.rows), strict=True))
    assert words["RMSE over the oracle's"].startswith("not judged")
    assert len(words) == len(BARS)


def test_a_table_says_nothing_where_there_is_nothing() -> None:
    run = result("pi", "pid", "scan_0p1hz", hold_error_deg=math.nan, hold_range=math.nan, cycling_holds=math.nan)
    (row,) = loop_table(outcome(run), "pi", 25.0).rows
    assert row[:5] == ["pid", "-", 0.1, 0.3, "-"]


def test_jobs_come_in_stages_and_networks_only_at_their_rate() -> None:
    jobs = control_jobs(ControlSettings())
    assert len({job.key for job in jobs}) == len(jobs)
    stages = [job.stage for job in jobs]
    assert stages == sorted(stages, key=("fit", "tune", "retune", "run").index)
    assert {job.rate_hz for job in jobs if job.stage == "run" and "lstm" in job.subject} == {25.0}
    assert {job.plant for job in jobs if job.stage == "fit"} == {"backlash", "pi", "noisy"}


def test_a_run_depends_on_the_gains_that_a_search_leaves(tmp_path: Path) -> None:
    settings = ControlSettings.of(plants=["pi"], controllers=["pid"])
    run = next(job for job in control_jobs(settings) if job.stage == "run")
    before = STUDY.fingerprint(run, settings, tmp_path)
    file = gains_file(tmp_path, "pi", 25.0, "pid")
    file.parent.mkdir()
    file.write_text("{}")
    assert STUDY.fingerprint(run, settings, tmp_path) != before
    assert STUDY.fingerprint(run, settings.model_copy(update={"seed": 2}), tmp_path) != before


def test_the_rate_weight_keeps_its_meaning_at_another_rate() -> None:
    """Of one motion, ten times as many samples with moves a tenth as large: a hundred times the weight."""
    mpc = CONTROLLERS["linearised_backlash"]
    slow, fast = mpc.settings(0.04, 2), mpc.settings(0.004, 20)
    assert fast["weights"]["rate"] == pytest.approx(100 * slow["weights"]["rate"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plants": ("backlach",)}, "did you mean 'backlash'"),
        ({"controllers": ("pid", "mpc")}, "no controller 'mpc'"),
        ({"motions": ("scan",)}, "no motion 'scan'"),
        ({"rates_hz": (0.0,)}, "rates_hz"),
    ],
)
def test_unusable_settings_are_told(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ControlSettings.of(**changes)
