"""Motions that are safe whatever the limits, and a choice that follows the physics of the candidates."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.next.motion_design import (
    EvaluatedMotion,
    MotionProposal,
    Noise,
    OpenHypothesis,
    expected_probability,
    propose,
    separations,
    write_motion,
)
from hystmpc.gap.next.motions import TEMPLATES, SampledMotion, menu
from hystmpc.gap.next.open_hypotheses import decides, open_explanations, within_one_sample
from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.operators.dynamics import Delay, Servo
from hystmpc.models.operators.hysteresis import Play
from hystmpc.models.operators.operator import Operator
from hystmpc.trajectories.trajectory import read_sampled
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import FitError
from hystmpc.trials.recording import SEPARATION_COLUMN
from hystmpc.trials.types import Vec

from .contenders import CREEP, DELAY, LAG, baseline, creep, lag

LIMITS = CommandLimits(0.0, 6.0, 12.0)
NOISE = Noise(0.1, form_deg=1.0)
MOTIONS = menu(LIMITS, 0.04)

any_limits = st.builds(
    lambda lower, span, rate: CommandLimits(lower, lower + span, rate),
    st.floats(-100, 100),
    st.floats(1e-3, 1e3),
    st.floats(1e-3, 1e4),
)


@given(limits=any_limits, dt=st.floats(0.001, 0.2))
@settings(max_examples=25)
def test_every_motion_stays_within_box_and_rate_and_rests_at_both_ends(limits: CommandLimits, dt: float) -> None:
    longest = {plan.name: plan.longest_s for plan in TEMPLATES}
    for motion in menu(limits, dt):
        u, slack = motion.command, 1e-9 * max(1.0, abs(limits.lower), abs(limits.upper))
        assert u.min() >= limits.lower
        assert u.max() <= limits.upper
        assert np.abs(np.diff(u)).max() <= limits.rate * dt + slack
        assert motion.duration_s <= longest[motion.name] + 1e-6
        resting = int(0.5 / dt)
        assert np.abs(u[: resting + 1] - limits.lower).max() <= slack
        assert np.abs(u[-resting - 1 :] - limits.lower).max() <= slack
        assert np.ptp(u) > 0


def test_a_slow_actuator_gets_a_smaller_motion_not_a_longer_one() -> None:
    slow = {m.name: m for m in menu(CommandLimits(0.0, 6.0, 0.05), 0.04)}
    for motion in MOTIONS:
        assert np.ptp(slow[motion.name].command) < np.ptp(motion.command)
    assert len({plan.name for plan in TEMPLATES}) == len(MOTIONS) == len(slow)


def held_s(motion: SampledMotion) -> float:
    """Longest time at one command above the lowest."""
    longest = run = 0
    for moved, up in zip(np.diff(motion.command), motion.command[1:] > LIMITS.lower + 0.1, strict=True):
        run = run + 1 if up and abs(moved) < 1e-12 else 0
        longest = max(longest, run)
    return longest * motion.dt


def fast_share(motion: SampledMotion) -> float:
    """Share of the command's movement (its energy of speed) above 1 Hz."""
    power = np.abs(np.fft.rfft(np.diff(motion.command))) ** 2
    return float(power[np.fft.rfftfreq(motion.t.size - 1, motion.dt) > 1.0].sum() / power.sum())


def odds_of(*pair: OpenHypothesis) -> dict[str, float]:
    """Odds of every motion of the menu."""
    return {option.motion.name: option.probability for option in propose(pair, MOTIONS, NOISE).options}


def test_lag_against_creep_is_told_by_moves_with_holds_and_not_at_a_crawl() -> None:
    odds = odds_of(LAG, CREEP)
    with_holds = [odds[motion.name] for motion in MOTIONS if held_s(motion) >= 3.0]
    at_a_crawl = [odds[motion.name] for motion in MOTIONS if fast_share(motion) < 0.05]
    assert len(with_holds) >= 2 <= len(at_a_crawl)
    assert min(with_holds) > max(at_a_crawl)
    assert max(odds.values()) > 0.95


def test_lag_against_delay_is_told_by_fast_motion() -> None:
    odds = odds_of(LAG, DELAY)
    fast = [odds[motion.name] for motion in MOTIONS if fast_share(motion) > 0.4]
    slow = [odds[motion.name] for motion in MOTIONS if fast_share(motion) < 0.4]
    assert len(fast) >= 3
    assert min(fast) > max(slow)


def test_three_candidates_are_told_by_what_separates_the_closest_pair() -> None:
    three = propose((LAG, DELAY, CREEP), MOTIONS, NOISE)
    two = propose((LAG, DELAY), MOTIONS, NOISE)
    assert three.names == ("lag", "delay", "creep")
    assert three.chosen.motion.name == two.chosen.motion.name


@pytest.mark.parametrize("count", [2, 3, 5])
def test_identical_simulators_leave_it_to_chance(count: int) -> None:
    same = [OpenHypothesis(f"copy {k}", lag(0.1)) for k in range(count)]
    proposal = propose(same, MOTIONS, NOISE)
    assert proposal.chosen.probability == pytest.approx(1 / count, abs=1e-6)
    shortest = min(MOTIONS, key=lambda motion: motion.duration_s)
    assert proposal.chosen.motion.name == shortest.name


def test_what_retuning_absorbs_is_no_separation() -> None:
    def moved(command: np.ndarray, dt: float) -> np.ndarray:
        return 3 + 1.2 * lag(0.1)(command, dt)

    proposal = propose((OpenHypothesis("lag", lag(0.1)), OpenHypothesis("same, mounted anew", moved)), MOTIONS, NOISE)
    assert proposal.chosen.probability == pytest.approx(0.5, abs=1e-6)


@given(
    distances=st.lists(st.floats(0, 8), min_size=6, max_size=6),
    more=st.floats(0.01, 3),
    which=st.integers(0, 5),
)
def test_odds_grow_with_every_distance(distances: list[float], more: float, which: int) -> None:
    def matrix(values: list[float]) -> np.ndarray:
        out = np.zeros((3, 3))
        out[~np.eye(3, dtype=bool)] = values
        return out

    less = expected_probability(matrix(distances))
    further = expected_probability(matrix([d + more * (k == which) for k, d in enumerate(distances)]))
    assert 1 / 3 - 1e-12 <= less <= further <= 1.0


def test_odds_grow_with_the_size_of_the_effect_and_fall_with_the_floor() -> None:
    def odds(share: float, floor: float) -> float:
        pair = (
            OpenHypothesis("nothing", baseline, (baseline,)),
            OpenHypothesis("creep", creep(share, 5.0), (creep(share + 0.01, 5.0), creep(share, 5.5))),
        )
        small = menu(CommandLimits(0.0, 0.6, 1.0), 0.04)
        return propose(pair, small, Noise(floor)).chosen.probability

    sizes = [odds(share, 1.0) for share in (0.1, 0.2, 0.4)]
    assert sizes == sorted(sizes)
    floors = [odds(0.2, floor) for floor in (4.0, 1.0, 0.25)]
    assert floors == sorted(floors)
    assert sizes[0] < sizes[-1] - 0.01
    assert floors[0] < floors[-1] - 0.05


def test_a_form_error_bounds_the_odds_where_noise_does_not() -> None:
    odds = [propose((LAG, DELAY), MOTIONS, Noise(1e-3, form_deg=form)).chosen.probability for form in (0.0, 3.0, 30.0)]
    assert odds[0] > 0.99
    assert odds == sorted(odds, reverse=True)
    assert odds[2] < 0.9


def test_a_motion_on_which_a_simulator_diverges_is_left_out() -> None:
    def breaks(command: np.ndarray, dt: float) -> np.ndarray:
        return lag(0.2)(command, dt) * (np.nan if np.ptp(command) > 5 else 1.0)

    proposal = propose((LAG, OpenHypothesis("breaks", breaks)), MOTIONS, NOISE)
    assert 0 < len(proposal.options) < len(MOTIONS)
    wide = [motion for motion in MOTIONS if np.ptp(motion.command) > 5]
    with pytest.raises(FitError, match="none of"):
        propose((LAG, OpenHypothesis("breaks", breaks)), wide, NOISE)


def test_the_file_reads_back_as_log_and_as_reference(tmp_path: Path) -> None:
    proposal = propose((LAG, DELAY), MOTIONS, NOISE)
    motion = proposal.chosen.motion
    for unit in ("mm", "bar"):
        path = write_motion(tmp_path / "next_motion.csv", proposal, unit)
        trial = read_csv(path)
        assert trial.units.command == unit
        assert np.array_equal(trial.command, motion.command)
        assert SEPARATION_COLUMN in trial.channels
        assert np.abs(np.diff(trial.t) - motion.dt).max() < 1e-8
        reference = read_sampled(path)
        assert reference.duration_s == pytest.approx(motion.duration_s)
        assert np.allclose(reference.values, proposal.chosen.angles.mean(axis=0))


def test_the_summary_is_the_diagnosis_form() -> None:
    proposal = propose((LAG, DELAY), MOTIONS, NOISE)
    summary = proposal.summary()
    assert summary.separates == ("lag", "delay")
    assert summary.duration_s == proposal.chosen.motion.duration_s
    assert summary.expected_probability == proposal.chosen.probability


def test_at_equal_odds_the_shorter_motion_wins() -> None:
    short = min(MOTIONS, key=lambda motion: motion.duration_s)
    doubled = SampledMotion(
        "twice",
        "the same twice",
        np.arange(2 * short.t.size) * short.dt,
        np.concatenate((short.command, short.command)),
    )
    proposal = propose((LAG, CREEP), (doubled, short), Noise(1e-3))
    assert isinstance(proposal, MotionProposal)
    assert all(isinstance(option, EvaluatedMotion) for option in proposal.options)
    assert proposal.chosen.motion is short


def test_directions_hold_offset_and_gain_of_each_candidate() -> None:
    command = MOTIONS[0].command
    angles, directions = separations((LAG, DELAY), command, 0.04)
    assert np.array_equal(angles[0], LAG.simulate(command, 0.04))
    assert all(np.all(basis[0] == 1.0) for basis in directions)
    assert np.array_equal(directions[1][1], angles[1])


def hypothesis(*names: str) -> Any:
    """A hypothesis that is known by its causes alone."""
    return SimpleNamespace(effects=frozenset(names), problem=SimpleNamespace(effects=names))


def test_the_motion_asks_about_every_set_that_is_open() -> None:
    chosen = hypothesis("lag", "contact")
    others = [hypothesis(*names) for names in (("delay", "contact"), ("lag", "slack"), ("lag",), ("contact",))]
    findings: Any = SimpleNamespace(
        conclusion=SimpleNamespace(
            chosen=chosen,
            decision=SimpleNamespace(
                effects_unknown=False, ambiguity=(("lag", "delay"), ("contact", "slack", "trial_shift"))
            ),
        ),
        attribution=SimpleNamespace(
            retuned=hypothesis(),
            selection=SimpleNamespace(tried={h.effects: SimpleNamespace(hypothesis=h) for h in (chosen, *others)}),
        ),
    )
    found = {name: set(h.effects) for name, h in open_explanations(findings).items()}
    assert found == {
        "lag": {"lag", "contact"},  # what was chosen, once for both sets
        "delay": {"delay", "contact"},
        "slack": {"lag", "slack"},
        "trial_shift": {"lag"},
    }


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_motion_that_leaves_chance_as_it_was_does_not_decide_and_a_sure_one_does(count: int) -> None:
    assert not decides(1 / count, count)
    assert decides(1.0, count)
    assert decides(0.5 * (1 + 1 / count), count)  # takes half of the doubt


@pytest.mark.parametrize(
    ("late_s", "ambiguity", "expected"),
    [
        (0.023, (("delay", "lag"),), 0.023),
        (0.023, (("delay", "lag", "rate_dependence"),), 0.023),
        (0.025, (("delay", "lag"),), 0.0),
        (0.023, (("delay", "rate_dependence"),), 0.0),
        (0.023, (), 0.0),
    ],
)
def test_a_lag_and_a_delay_within_one_sample_are_the_same(
    late_s: float, ambiguity: tuple[tuple[str, ...], ...], expected: float
) -> None:
    problem = SimpleNamespace(effects=[SimpleNamespace(effect="delay")], effect_values=lambda q: [{"delay_s": late_s}])
    findings: Any = SimpleNamespace(
        conclusion=SimpleNamespace(
            chosen=SimpleNamespace(problem=problem, q=None), decision=SimpleNamespace(ambiguity=ambiguity)
        ),
        prepared=SimpleNamespace(checked=SimpleNamespace(dt=0.04)),
    )
    assert within_one_sample(findings) == expected


@pytest.mark.parametrize(("samples", "same"), [(0.2, True), (0.6, True), (3.0, False)])
def test_a_delay_up_to_six_tenths_of_a_sample_is_a_lag_of_second_order_in_any_motion(
    samples: float, same: bool
) -> None:
    dt, late = 0.04, samples * 0.04

    def angles(operator: Operator, command: Vec) -> Vec:
        run = StagedChain(Chain(Play(0.1), (operator,)))
        return run.simulate(command[:, None], dt, run.rest(command[:1], command[:1]))[0][:, 0]

    worst = 0.0
    for motion in menu(CommandLimits(0.0, 6.0, 40.0), dt):
        delayed = angles(Delay.at_rate(late, dt), motion.command)
        fit = least_squares(
            lambda q: angles(Servo(q[0], q[1]), motion.command) - delayed,  # noqa: B023  # called at once
            [late, 0.7],
            bounds=([1e-4, 0.05], [1.0, 0.999]),
        )
        worst = max(worst, float(np.sqrt(np.mean(fit.fun**2))) / 6.0)
    assert (worst < 0.002) == same
