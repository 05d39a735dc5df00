"""Laws of the verdict: deadlines are named where they are the cause, and no error is claimed below a sensor's steps."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.bench.device import Track, track_of
from hystmpc.bench.identify import rounding_ignored
from hystmpc.bench.motions import CONTROLLERS
from hystmpc.bench.verify import MPC, PID, Verification, judge_tracks
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.feedback import PidControllerSettings
from hystmpc.rig.recording.sample import Sample
from hystmpc.sim.tuning.gains import PidTuning

DT, SAMPLES = 0.04, 500
LIMITS = CommandLimits(0.0, 6.0, 10.0)
ERRORS = {MPC: 0.1, PID: 0.5, "inverse": 0.4}


def track(error_deg: float, source: str = "mpc", fallbacks: int = 0, late: int = 0, step: float = 0.0) -> Track:
    """A sine with an error, its first samples answered by a fallback, of which so many had no time."""
    t = DT * np.arange(1, SAMPLES + 1)
    reference = 50.0 + 20.0 * np.sin(t)
    measured = reference + error_deg * np.random.default_rng(1).standard_normal(SAMPLES)
    return Track(
        t=t,
        reference_deg=reference,
        measured_deg=np.round(measured / step) * step if step else measured,
        command=np.full(SAMPLES, 3.0),
        source=("shifted plan",) * fallbacks + (source,) * (SAMPLES - fallbacks),
        late=(True,) * late + (False,) * (SAMPLES - late),
    )


def verdict(sigma: float = 0.05, step: float = 0.0, **of_mpc: int) -> Verification:
    runs = {name: track(ERRORS[name], "controller", step=step) for name in CONTROLLERS if name != MPC}
    return judge_tracks({"scan": {MPC: track(ERRORS[MPC], step=step, **of_mpc), **runs}}, LIMITS, DT, sigma, 0.1)


@given(st.integers(11, SAMPLES))
def test_missed_deadlines_are_the_cause_whatever_the_errors_are(late: int) -> None:
    found = verdict(fallbacks=late, late=late)
    assert not found.verified
    assert "missed deadlines" in found.verdict
    assert "not valid" in found.verdict
    assert f"linearised MPC {100 * late / SAMPLES:.0f} %" in found.verdict
    assert "better than" not in found.verdict
    assert any("realtime" in step and "rate_hz" in step and "programs" in step for step in found.steps)


def test_a_few_late_samples_are_none_and_a_late_sample_that_was_answered_is_none() -> None:
    assert verdict().verified
    assert verdict(fallbacks=10, late=10).verified
    assert verdict(late=SAMPLES).verified
    assert verdict(late=SAMPLES).scores[MPC].late_share == 0.0


def test_fallbacks_in_time_are_no_late_ones() -> None:
    found = verdict(fallbacks=100)
    assert found.scores[MPC].fallback_share == pytest.approx(0.2)
    assert found.scores[MPC].late_share == 0.0
    assert "deadlines" not in found.verdict


def test_late_samples_of_a_rival_count_too() -> None:
    runs = {name: track(ERRORS[name], "controller") for name in CONTROLLERS}
    runs[PID] = track(ERRORS[PID], "controller", 50, 50)
    assert "not valid" in judge_tracks({"scan": runs}, LIMITS, DT, 0.05, 0.1).verdict


@given(st.integers(5, 100))
def test_skipped_samples_had_no_time(skipped: int) -> None:
    whole = track(ERRORS[MPC])
    kept = np.r_[0:50, 50 + skipped : SAMPLES]
    cut = Track(
        *(column[kept] for column in (whole.t, whole.reference_deg, whole.measured_deg, whole.command)),
        ("mpc",) * kept.size,
    )
    runs = {name: track(ERRORS[name], "controller") for name in CONTROLLERS} | {MPC: cut}
    found = judge_tracks({"scan": runs}, LIMITS, DT, 0.05, 0.1)
    assert found.scores[MPC].late_share == pytest.approx(skipped / SAMPLES)
    assert ("not valid" in found.verdict) == (skipped > 10)


@given(st.floats(0.3, 3.0))
def test_no_error_is_claimed_below_that_of_the_steps(step: float) -> None:
    found = verdict(0.0, step)
    assert found.sensor_sigma_deg == pytest.approx(step / math.sqrt(12.0), rel=0.01)
    said = re.search(r"in steps of ([0-9.]+) deg", found.verdict)
    assert said is not None
    assert float(said[1]) == pytest.approx(step, rel=5.1e-3)  # three digits
    assert f"no RMS below {step / math.sqrt(12.0):.3f} deg" in found.verdict


def test_a_continuous_sensor_has_its_noise_alone() -> None:
    found = verdict(0.15)
    assert found.sensor_sigma_deg == 0.15
    assert "steps" not in found.verdict


def sample(sequence: int, missed: bool = False) -> Sample:
    return Sample(DT * sequence, 0, 50.0, 50.0, 3.0, "mpc", "ok", math.nan, (), DT, 0.0, missed, (), sequence)


def test_what_follows_a_missed_deadline_or_a_skipped_sample_was_late(tmp_path: Path) -> None:
    rows = [sample(0), sample(1, missed=True), sample(2), sample(3), sample(6), sample(7), sample(8)]
    found = track_of(rows, 8 * DT, DT)
    assert found.late == (False, False, True, False, True, False)
    assert Track.load(found.save(tmp_path / "scan.mpc.csv")).late == found.late


def test_tracks_of_earlier_versions_are_read(tmp_path: Path) -> None:
    file = track(0.1).save(tmp_path / "scan.mpc.csv")
    lines = [line.rpartition(",")[0] for line in file.read_text(encoding="utf-8").splitlines()]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert Track.load(file).late == ()


def test_gains_that_are_deaf_enough_stay_as_they_were_found() -> None:
    found = PidTuning(PidControllerSettings(), 0.3, 0.4, 24)
    assert rounding_ignored(found, None, 0.1) is found  # type: ignore[arg-type]  # nothing is run again
