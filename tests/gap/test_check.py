"""Refusals in one exact line, kinds of motion, excitation, and what it can tell apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.logs.check import CheckedTrials, check_trials
from hystmpc.gap.logs.excitation import LONG_HOLD_S, confusability, excitation_of
from hystmpc.gap.logs.motion_type import command_segments, motion_type
from hystmpc.gap.logs.noise_floor import find_repeats
from hystmpc.trials.errors import GapError
from hystmpc.trials.trial import Trial, Units

from ..models.zoo import BACKLASH, Chain, simulator
from .motions import DT, KINDS, LEVELS, THREE_SPEEDS, TRIANGLE, moves, sine, trial

SIMULATOR = simulator(Chain(BACKLASH), DT)  # trained on 0 to 6 mm and 20 to 95 deg
LONG = moves(LEVELS, 1.0, 5.0)


def check(*trials: Trial) -> CheckedTrials:
    return check_trials(trials, SIMULATOR)


def changed(command: float = 1.0, angle: float = 1.0, units: Units | None = None) -> Trial:
    """The trial of `LONG` in other units."""
    plain = trial(LONG)
    return Trial(plain.t, command * plain.command, angle * plain.angle, units=units or Units(), source="log.csv")


STILL = Trial(np.arange(100) * DT, np.full(100, 2.0), np.random.default_rng(0).normal(30, 0.1, 100), source="a.csv")
REFUSED = {
    "no trial": ([], "no trial given, expected one or more logs of the simulator's device"),
    "unit": (
        [changed(units=Units("bar", "deg"))],
        "log.csv: command in bar and angle in deg, expected mm and deg as the simulator has them",
    ),
    "angle unit": (
        [changed(units=Units("mm", "rad"))],
        "log.csv: command in mm and angle in rad, expected mm and deg as the simulator has them",
    ),
    "constant command": (
        [STILL, replace(STILL, source="b.csv")],
        "a.csv, b.csv: the command is constant in every trial, expected one that moves",
    ),
    "constant angle": (
        [Trial(np.arange(LONG.size) * DT, LONG, np.full(LONG.size, 3.0), source="log.csv")],
        "log.csv: the angle is 3 deg throughout while the command moves, expected an angle that follows it",
    ),
    "sign": (
        [changed(angle=-1.0)],
        "log.csv: the angle falls as the command rises (correlation -0.99), expected it to rise; flip the sign of one "
        "of them",
    ),
    "radians": (
        [changed(angle=np.pi / 180)],
        "log.csv: the angle ranges over 0.8727 deg, expected about 62.5 deg from the simulator (factor 0.014: looks "
        "like radians)",
    ),
    "another angle": (
        [changed(angle=9.0)],
        "log.csv: the angle ranges over 450 deg, expected about 62.5 deg from the simulator (factor 7.2; another unit "
        "or device?)",
    ),
    "metres": (
        [changed(command=1e-3)],
        "log.csv: command 0 to 0.005 mm, expected within about 0 to 6 mm (factor 0.000833: looks like m)",
    ),
    "micrometres": (
        [changed(command=1e3)],
        "log.csv: command 0 to 5000 mm, expected within about 0 to 6 mm (factor 833: looks like um)",
    ),
    "too short": ([trial(LONG).select(0, 40)], "log.csv: 1.56 s long, expected 2 s or more"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals_say_what_is_wrong_in_one_line(case: str) -> None:
    trials, message = REFUSED[case]
    with pytest.raises(GapError) as caught:
        check(*trials)
    assert str(caught.value) == message


def test_an_offset_command_is_refused() -> None:
    plain = trial(LONG)
    with pytest.raises(GapError, match=r"command 50 to 55 mm.*outside by more than the whole range"):
        check(Trial(plain.t, plain.command + 50, plain.angle))


def test_outliers_of_a_faulty_sensor_are_no_other_unit() -> None:
    log = changed()
    angle = log.angle.copy()
    angle[::97] += 1e4
    assert check(replace(log, angle=angle)).trials


def test_an_inverse_map_is_refused() -> None:
    facts = SIMULATOR.metadata()
    inverse = facts.model_copy(update={"command_unit": "deg", "angle_unit": "mm"})
    with pytest.raises(GapError, match=r"the simulator maps deg to mm as an inverse, expected a forward model"):
        check_trials([trial(LONG)], inverse)


@settings(max_examples=15)
@given(st.floats(0.4, 2.5), st.floats(-40.0, 40.0), st.floats(0.2, 1.0))
def test_a_mis_set_device_passes(gain: float, offset: float, amplitude: float) -> None:
    plain = trial(amplitude * LONG)
    check(Trial(plain.t, plain.command, gain * (plain.angle - 20) + offset))


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_of_motion_are_told_from_the_command(kind: str) -> None:
    found = []
    for command in KINDS[kind]:
        own = trial(command)
        found.append(motion_type(own, command_segments(own)))
    assert found == [kind] * len(found)


@settings(max_examples=40)
@given(st.floats(0.1, 50.0), st.floats(-10.0, 10.0), st.sampled_from(sorted(KINDS)))
def test_scale_and_offset_of_the_command_do_not_matter(scale: float, offset: float, kind: str) -> None:
    own = trial(scale * KINDS[kind][0] + offset)
    assert motion_type(own, command_segments(own)) == kind


@pytest.mark.parametrize("kind", ["sine", "holds", "steps", "point_to_point", "ramps"])
def test_noise_of_a_measured_command_does_not_matter(kind: str) -> None:
    command = KINDS[kind][0]
    own = trial(command + 0.002 * np.random.default_rng(1).standard_normal(command.size))
    assert motion_type(own, command_segments(own)) == kind


def test_the_rate_is_the_simulators_where_near_else_the_logs_up_to_50_hz() -> None:
    def rate(log_hz: float, own_dt: float) -> float:
        t = np.arange(round(30 * log_hz)) / log_hz
        u = 2.5 - 2.5 * np.cos(t)
        return 1 / check_trials([Trial(t, u, 10 * u)], simulator(Chain(BACKLASH), own_dt)).dt

    assert rate(500, 0.02) == pytest.approx(50)
    assert rate(500, 0.002) == pytest.approx(50)
    assert rate(30, 0.04) == pytest.approx(25)
    assert rate(25, 0.02) == pytest.approx(25)
    assert rate(40, 0.1) == pytest.approx(10)
    assert rate(50, 0.04) == pytest.approx(25)
    assert rate(25, 0.01) == pytest.approx(25)
    assert rate(40, 0.2) == pytest.approx(40)


def test_a_network_is_run_at_its_own_rate() -> None:
    facts = simulator(Chain(BACKLASH), 0.1).metadata()
    assert check_trials([trial(LONG)], facts).dt == pytest.approx(0.1)


def test_gaps_are_cut_and_noted() -> None:
    own = trial(LONG)
    kept = np.r_[0:300, 400 : len(own)]
    checked = check(Trial(own.t[kept], own.command[kept], own.angle[kept], source="log.csv"))
    assert [part.t[0] for part in checked.trials] == pytest.approx([0.0, 16.0])
    assert "log.csv: gaps in time; cut into 2 trials: 0 to 11.96 s, 16 to 48 s." in checked.notes


def test_notes_say_what_is_missing() -> None:
    notes = " ".join(check(trial(sine())).notes)
    assert "One trial only" in notes
    assert "No hold of 3 s" in notes
    assert "Single sines only" in notes
    full = " ".join(check(trial(LONG), trial(LONG), trial(THREE_SPEEDS)).notes)
    assert full == ""


def test_a_log_that_sits_at_its_extreme_is_noted() -> None:
    own = trial(LONG)
    clipped = Trial(own.t, own.command, np.minimum(own.angle, 40.0), source="log.csv")
    assert any("the angle sits at its greatest value, 40 deg" in note for note in check(clipped).notes)


def test_excitation_flags() -> None:
    holds = excitation_of([trial(KINDS["holds"][1])])
    assert holds.longest_hold_s >= LONG_HOLD_S
    assert holds.longest_hold_s == pytest.approx(38.0, abs=0.1)
    assert not holds.repeats
    ramps = excitation_of([trial(THREE_SPEEDS)])
    assert ramps.ramp_speeds == pytest.approx((0.5, 5 / 3, 5.0), rel=0.05)
    assert ramps.opening_repeated is False
    assert excitation_of([trial(KINDS["steps"][0])]).steps == len(LEVELS)
    scan = excitation_of([trial(TRIANGLE)])
    assert scan.opening_repeated
    assert scan.top_levels == 1
    small = sine(0.05, 20.0) + 0.2 * np.sin(2 * np.pi * 3.0 * np.arange(501) * DT)
    assert excitation_of([trial(small)]).fast_small >= 8


@pytest.mark.parametrize(
    ("command", "pairs"),
    [
        (sine(), set()),
        (
            KINDS["steps"][0],
            {("lag", "delay", "rate_dependence"), ("contact", "nonlinear_gain"), ("slack", "nonlinear_gain")},
        ),
        (KINDS["holds"][1], {("lag", "creep")}),
        (THREE_SPEEDS, {("stick_slip", "lag")}),
    ],
)
def test_a_motion_separates_what_the_table_says(command: np.ndarray, pairs: set[tuple[str, ...]]) -> None:
    table = confusability(excitation_of([trial(command)]))
    found = {row.effects for row in table if row.separable}
    assert found - {("creep", "first_flexure")} == pairs


def test_what_algebra_makes_equal_is_never_separable() -> None:
    everything = excitation_of([trial(command) for kind in KINDS.values() for command in kind] * 2)
    table = confusability(everything)
    assert {row.effects for row in table if not row.separable} == {row.effects for row in table if row.one_class}


def test_repeats_are_found_within_and_across_trials() -> None:
    within = find_repeats([trial(sine(0.2, 20.0))])
    assert [round(r.shift * DT) for r in within] == [5, 10, 15]
    assert all((r.first, r.second) == (0, 0) for r in within)
    late = trial(np.concatenate([np.zeros(33), LONG]))
    (across,) = find_repeats([trial(LONG), late])
    assert (across.first, across.second, across.shift) == (0, 1, 33.0)
    assert not find_repeats([trial(LONG), trial(LONG[::-1])])
    assert not find_repeats([trial(sine(0.2, 20.0, decay=0.1))])


@settings(max_examples=20)
@given(st.floats(0.05, 0.95))
def test_repeats_are_aligned_to_fractions_of_a_sample(part: float) -> None:
    t = np.arange(800) * DT
    first, second = (2.5 - 2.5 * np.cos(2 * np.pi * 0.15 * (t - late * DT)) for late in (0.0, 8 + part))
    best = min(
        find_repeats([trial(first[:500]), trial(second[:500])]), key=lambda r: (r.first == r.second, r.shift < 0)
    )
    assert best.shift % 1 == pytest.approx(part, abs=0.03)
