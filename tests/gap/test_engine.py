"""Laws of the free run with candidates: exact derivatives, neutral values, tied and carried parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.effects.effect import CORE, Candidate
from hystmpc.models.identify.cross_validation import fit_problem
from hystmpc.models.identify.problem import Problem
from hystmpc.models.operators.dynamics import Lag
from hystmpc.trials.types import Vec

from .engine_examples import BASELINES, CANDIDATES, DT, EVERY, LABELS, device_runs, neutral_values

RUNS = device_runs()
_STEP = 2e-6


def problem_of(name: str, *effects: Candidate) -> tuple[Problem, Vec]:
    """A problem a little off its nominal values, effects at their first start."""
    baseline = BASELINES[name]
    problem = Problem(baseline, effects)
    q = problem.start(baseline.nominal, [c.starts[0] for c in effects])
    away = 0.02 * np.sin(1.0 + np.arange(q.size))
    return problem, np.clip(q + away, problem.lower + 2 * _STEP, problem.upper - 2 * _STEP)


def named(name: str, label: str) -> Candidate:
    """The candidate of that label."""
    return next(c for c in CANDIDATES[name] if c.label == label)


@pytest.mark.parametrize(("name", "candidate"), EVERY, ids=LABELS)
def test_derivatives_are_those_of_the_run(name: str, candidate: Candidate) -> None:
    """Central differences agree but at the samples where a play or a stop switches within the step."""
    problem, q = problem_of(name, candidate)
    run = RUNS[1]
    theta, by_q = problem.linearised(q, run)
    np.testing.assert_allclose(theta, problem.angles(q, run), rtol=1e-9, atol=1e-9)
    for k, row in enumerate(_STEP * np.eye(q.size)):
        found = (problem.angles(q + row, run) - problem.angles(q - row, run)) / (2 * _STEP)
        off = np.abs(by_q[:, k] - found) > 1e-4 * (np.abs(found).max() + 1e-6) + 1e-6
        assert np.mean(off) <= 0.03, f"unknown {k} of {candidate.label}: {np.mean(off):.0%} of the samples are off"


@pytest.mark.parametrize(("name", "candidate"), EVERY, ids=LABELS)
def test_neutral_candidates_do_nothing(name: str, candidate: Candidate) -> None:
    baseline = BASELINES[name]
    alone, joined = Problem(baseline), Problem(baseline, (candidate,))
    without = alone.angles(alone.start(baseline.nominal, []), RUNS[0])
    joint = joined.angles(joined.start(baseline.nominal, [neutral_values(candidate)]), RUNS[0])
    fastest = float(np.abs(np.diff(without)).max()) / DT  # a pole of a microsecond leaves that of the way
    np.testing.assert_allclose(joint, without, atol=1e-6 + 2.1e-6 * fastest)


@pytest.mark.parametrize(("name", "candidate"), EVERY, ids=LABELS)
def test_starts_lie_within_the_bounds(name: str, candidate: Candidate) -> None:
    problem = Problem(BASELINES[name], (candidate,))
    for start in candidate.starts:
        q = problem.start(BASELINES[name].nominal, [start])
        assert np.all(problem.lower <= q)
        assert np.all(q <= problem.upper)
        problem.fitted_chain(q)  # raises where a value is out of its operator's bounds


@pytest.mark.parametrize(("name", "candidate"), EVERY, ids=LABELS)
def test_what_is_searched_for_shows_in_the_derivatives(name: str, candidate: Candidate) -> None:
    """Every free parameter moves the angle from some start: a search has something to go by."""
    problem = Problem(BASELINES[name], (candidate,))
    sizes = []
    for start in candidate.starts:
        # A second shape parameter shows only where the first is not at its neutral value.
        q = problem.start(BASELINES[name].nominal, [start]) + 1e-3
        sizes += [np.abs(problem.linearised(q, run)[1]).max(axis=0) for run in (*RUNS, *device_runs(60.0))]
    assert np.all(np.max(sizes, axis=0)[problem.size - len(candidate.free) :] > 0)


@given(st.data())
def test_scaled_and_plain_are_inverse(data: st.DataObject) -> None:
    name, candidate = data.draw(st.sampled_from(EVERY))
    problem = Problem(BASELINES[name], (candidate,))
    shares = data.draw(st.lists(st.floats(0, 1), min_size=problem.size, max_size=problem.size))
    q = problem.lower + np.array(shares) * (problem.upper - problem.lower)
    np.testing.assert_allclose(problem.scaled(problem.plain(q)), q, rtol=1e-9, atol=1e-9)


def test_poles_of_one_lag_share_their_time_constant() -> None:
    problem, q = problem_of("backlash", replace(named("backlash", "lag/command"), operators=(Lag(0.1), Lag(0.1))))
    one, two = problem.fitted_chain(q).before
    assert one.values == two.values
    assert problem.size == Problem(BASELINES["backlash"]).size + 1


@pytest.mark.parametrize(("name", "effect"), [("backlash", "asymmetry"), ("plays", "rate_dependence")])
def test_retuning_leaves_an_effect_of_the_core_alone(name: str, effect: str) -> None:
    """Unless the effect is a candidate, its number in the core stays nominal."""
    baseline = BASELINES[name]
    ((label, at),) = baseline.effects[effect].items()
    core = next(c for c in CANDIDATES[name] if c.effect == effect and c.variant == CORE)
    alone, joined = Problem(baseline), Problem(baseline, (core,))
    assert joined.size == alone.size + 1
    q = alone.start(baseline.nominal, []) + 0.05
    assert alone.retuned(q)[at] == baseline.nominal[at]
    moved = joined.start(baseline.nominal, [()])
    moved[at] += 0.5
    assert joined.identified(moved)[effect][label] == pytest.approx(baseline.nominal[at] + 0.5 * baseline.scale[at])
    assert np.ptp(joined.angles(moved, RUNS[0]) - alone.angles(alone.start(baseline.nominal, []), RUNS[0])) > 1e-3


def test_a_set_taken_once_is_carried_to_later_trials() -> None:
    once, again = named("backlash", "first_flexure/once"), named("backlash", "first_flexure/every trial")
    values, later = (0.3, 1.0), RUNS[1]
    angles = []
    for candidate in (once, again):
        problem = Problem(BASELINES["backlash"], (candidate,))
        angles.append(problem.angles(problem.start(BASELINES["backlash"].nominal, [values]), later))
    assert later.bent_before == RUNS[0].command.max() > 1.0
    forgotten = Problem(BASELINES["backlash"], (once,))
    q = forgotten.start(BASELINES["backlash"].nominal, [values])
    fresh = forgotten.angles(q, replace(later, bent_before=later.rest_command))
    np.testing.assert_allclose(fresh, angles[1], atol=1e-9)
    assert np.abs(angles[0] - angles[1]).max() > 0.5


def test_a_drift_goes_on_between_trials() -> None:
    over = named("backlash", "drift/offset, over all trials")
    problem = Problem(BASELINES["backlash"], (over,))
    none, some = (problem.start(BASELINES["backlash"].nominal, [(v,)]) for v in (0.0, 3.0))
    for run in RUNS:
        drifted = problem.angles(some, run) - problem.angles(none, run)
        t = run.clock_s + run.dt_s * (1 + np.arange(run.command.size))
        # The angle at rest is known: the core starts lower by what has drifted so far.
        np.testing.assert_allclose(np.diff(drifted), np.diff(3.0 * t / 60), atol=0.05)
    assert RUNS[1].clock_s == pytest.approx(RUNS[0].command.size * RUNS[0].dt_s)


@pytest.mark.parametrize("name", ["backlash", "plays"])
def test_a_fit_recovers_what_made_the_angles(name: str) -> None:
    """Noise-free angles of the problem itself."""
    candidate = named(name, "creep/command")
    problem = Problem(BASELINES[name], (candidate,))
    true = problem.start(BASELINES[name].nominal, [(0.15, 3.0)])
    runs = [replace(run, angle=problem.angles(true, run)) for run in RUNS]
    found = fit_problem(problem, runs, problem.start(BASELINES[name].nominal, [candidate.starts[0]]), 60, 1e-9)
    assert found.mse < 1e-4
    (values,) = problem.effect_values(found.q)
    assert values["share"] == pytest.approx(0.15, rel=0.1)
    assert values["tau_s"] == pytest.approx(3.0, rel=0.15)
