"""Stick-slip by its jumps: seen where a tip sticks and slips, absent where it moves; tremors and steps are not it."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from hystmpc.gap.decide.remaining_structure import Jumps, find_jumps
from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.logs.preparation import prepare
from hystmpc.models.chain import Chain
from hystmpc.models.identify.cross_validation import CrossValidation
from hystmpc.trials.trial import Trial
from hystmpc_lab.blind.generators import lugre_tip
from hystmpc_lab.blind.run import closed_in_later_session
from hystmpc_lab.devices.cores import FINE_S, Scene

from ..models.zoo import BACKLASH
from .engine_examples import DT, Vec, moves, simulator_of, sine, trials_of

SCENE = Scene(0, 0, 0.0, 6.0, 20.0, 60.0)
SHAPE = {"ratio": 0.4, "stribeck_deg_s": 15.0}


def ramps(seconds: float) -> Vec:
    """Up and down over the whole range in that time each, with rests."""
    up = np.linspace(0.0, 6.0, round(seconds / DT))
    rest = np.full(25, 0.0)
    return np.concatenate([rest, up, rest + 6.0, up[::-1], rest])


COMMANDS = [ramps(12.0), sine(0.1), moves(1, 20.0, 1.0), ramps(8.0), moves(2, 20.0, 1.0)]


def through(trials: list[Trial], break_away: float, shape: Mapping[str, float] = SHAPE) -> list[Trial]:
    """The same devices with tips that rub in their lumen by LuGre friction."""
    found = []
    for trial in trials:
        fine = np.arange(round(trial.t[-1] / FINE_S) + 1) * FINE_S
        angle = lugre_tip(np.interp(fine, trial.t, trial.angle), SCENE, break_away, shape)
        found.append(replace(trial, angle=np.interp(trial.t, fine, angle)))
    return found


def noisy(trials: list[Trial], sigma: float = 0.05, step: float = 0.0) -> list[Trial]:
    """With noise, and rounded where a step is given."""
    random = np.random.default_rng(0)
    made = []
    for trial in trials:
        angle = trial.angle + sigma * random.standard_normal(len(trial))
        made.append(replace(trial, angle=np.round(angle / step) * step if step else angle))
    return made


@functools.cache
def clean() -> list[Trial]:
    """Trials of a backlash without noise."""
    return trials_of(Chain(BACKLASH), COMMANDS, noise_deg=0.0)


def jumps_of(trials: list[Trial]) -> Jumps:
    """What is seen in trials."""
    prepared = prepare(trials, simulator_of(BACKLASH))
    return find_jumps(
        prepared.everything, CrossValidation(prepared.baseline, prepared.development).retuned(), prepared.signs
    )


@pytest.mark.parametrize("break_away", [4.0, 8.0])
def test_a_tip_that_sticks_and_slips_is_seen(break_away: float) -> None:
    jumps = jumps_of(noisy(through(clean(), break_away)))
    assert jumps.seen
    assert not jumps.absent
    assert 0.1 * break_away < jumps.height_deg < break_away
    assert jumps.mse == pytest.approx(jumps.height_deg**2 / 12)


def sines_of(*hz: float) -> list[Trial]:
    return trials_of(Chain(BACKLASH), [sine(f) for f in hz], noise_deg=0.0)


def test_sines_show_it_although_their_speed_is_hardly_ever_steady() -> None:
    shape = {"ratio": 0.2, "stribeck_deg_s": 120.0}
    assert jumps_of(noisy(through(sines_of(0.25, 0.3), 8.0, shape))).seen


def test_fast_sines_exclude_nothing() -> None:
    jumps = jumps_of(noisy(sines_of(0.3, 0.35, 0.35)))
    assert (jumps.seen, jumps.absent) == (False, False)


@pytest.mark.parametrize(("carried", "seen"), [(0.3, True), (0.2, False)])
def test_jumps_that_are_rare_count_by_the_motion_that_they_carry(carried: float, seen: bool) -> None:
    assert Jumps(200, 0.8, 0.02, 0.0, carried, 12.0, 9.0).seen == seen


@pytest.mark.parametrize("sigma", [0.02, 0.1])
def test_a_tip_that_moves_is_not_said_to_stick(sigma: float) -> None:
    jumps = jumps_of(noisy(clean(), sigma))
    assert not jumps.seen
    assert jumps.absent
    assert jumps.mse == 0.0


def test_a_tremor_is_no_stick_slip() -> None:
    shaken = [replace(t, angle=t.angle + 4.0 * np.sin(2 * np.pi * 1.1 * t.t)) for t in clean()]
    assert not jumps_of(noisy(shaken)).seen


def test_a_coarse_sensor_is_no_stick_slip() -> None:
    assert not jumps_of(noisy(clean(), step=1.0)).seen


def test_too_little_steady_motion_says_nothing() -> None:
    steps = np.repeat([0.0, 4.0, 1.0, 5.0, 2.0, 3.0, 0.5, 4.5], 75)
    trials = noisy(trials_of(Chain(BACKLASH), [steps, steps[::-1], steps], noise_deg=0.0))
    jumps = jumps_of(trials)
    assert not jumps.seen
    assert not jumps.absent


@pytest.mark.slow
def test_the_diagnosis_names_it_and_says_that_its_share_stays_open() -> None:
    trials = noisy(through(clean(), 6.0))
    findings = find_causes(trials, simulator_of(BACKLASH))
    diagnosis, _ = conclude(findings)
    again = closed_in_later_session(findings, trials)  # 0 where jumps count as in no free run
    assert abs(again - diagnosis.gap.closed_share) < 0.2
    assert diagnosis.verdict in ("named", "one_of")
    assert "stick_slip" in {effect.name for effect in diagnosis.effects}
    assert any("cannot be predicted in a free run" in note for note in diagnosis.notes)
    assert not any("trial_shift" in names for names in findings.attribution.selection.tried)
    assert any("Shifts between trials are not looked for" in note for note in diagnosis.notes)
    left_out = find_causes(trials, simulator_of(BACKLASH), without=("stick_slip",))
    without, _ = conclude(left_out)
    assert "stick_slip" not in {effect.name for effect in without.effects}
    assert any("trial_shift" in names for names in left_out.attribution.selection.tried)
