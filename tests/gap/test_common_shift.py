"""With a shift of each trial the simulator is the one against which the shifts have no mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hystmpc.models.identify.cross_validation import fit_problem
from hystmpc.models.identify.problem import Problem, TrialTerms
from hystmpc.models.identify.runs import Run, RunsTogether

from .engine_examples import BASELINES, device_runs

RUNS = device_runs()


def moved(problem: Problem, q: np.ndarray, shifts: tuple[float, ...]) -> list[Run]:
    """Runs of the simulator itself, each moved by a shift of its own [deg]."""
    runs = [RUNS[k % len(RUNS)] for k in range(len(shifts))]
    return [
        replace(run, angle=problem.angles(q, run) + by, rest_angle=run.rest_angle + by)
        for run, by in zip(runs, shifts, strict=True)
    ]


@pytest.mark.parametrize("name", sorted(BASELINES))
@pytest.mark.parametrize("shifts", [(3.0, 3.0, 3.0, 3.0), (1.0, -2.0, 2.0, 0.5), (-4.0, 5.0, 1.0, 3.0)])
def test_a_fit_goes_to_the_mean_of_the_shifts_from_any_gain(name: str, shifts: tuple[float, ...]) -> None:
    problem, baseline = Problem(BASELINES[name], (), TrialTerms(shift=True)), BASELINES[name]
    truth = problem.start(baseline.nominal, [])
    runs = moved(problem, truth, shifts)
    away = np.clip(truth + 1.5, problem.lower, problem.upper)
    found = fit_problem(problem, runs, away, 60, 1e-10)
    own = np.array([row[:, -1] for row in problem.products(found.q, RunsTogether.of(runs))[1]])
    assert np.abs(own.mean(axis=0)).max() < 0.15
    gain, true_gain = (baseline.quantities(problem.retuned(q))["gain"] for q in (found.q, truth))
    assert gain == pytest.approx(true_gain, rel=0.1)
    offset, true_offset = (baseline.quantities(problem.retuned(q))["offset"] for q in (found.q, truth))
    assert offset - true_offset == pytest.approx(float(np.mean(shifts)), abs=0.5)


def test_without_shifts_there_is_nothing_in_common() -> None:
    problem = Problem(BASELINES["backlash"])
    q = problem.start(BASELINES["backlash"].nominal, [])
    assert problem.products(q, RunsTogether.of(RUNS))[1] == []
