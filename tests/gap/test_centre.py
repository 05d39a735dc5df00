"""What all trials have in common belongs to the simulator, not to their shifts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hystmpc.gap.centre import centred
from hystmpc.gap.problem import Problem
from hystmpc.gap.recording import Run
from hystmpc.gap.trial_terms import TrialTerms

from .engine_examples import BASELINES, device_runs

RUNS = device_runs()


def shifted(problem: Problem, q: np.ndarray, by: float) -> list[Run]:
    """Runs of the simulator itself, all moved by one offset [deg]."""
    return [replace(run, angle=problem.angles(q, run) + by, rest_angle=run.rest_angle + by) for run in RUNS]


@pytest.mark.parametrize("name", sorted(BASELINES))
@pytest.mark.parametrize("by", [-2.0, 5.0])
def test_a_shift_that_all_trials_have_is_none_of_each(name: str, by: float) -> None:
    problem = Problem(BASELINES[name], (), TrialTerms(shift=True))
    q = problem.start(BASELINES[name].nominal, [])
    runs = shifted(problem, q, by)
    moved = centred(problem, q, runs)
    plain = Problem(BASELINES[name])
    before, after = (rms([plain.angles(z, run) - run.angle for run in runs]) for z in (q, moved))
    assert before > 0.5
    assert after < 0.05 * before


def rms(errors: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def test_without_shifts_nothing_moves() -> None:
    problem = Problem(BASELINES["backlash"])
    q = problem.start(BASELINES["backlash"].nominal, [])
    assert centred(problem, q, shifted(problem, q, 1.0)) is q
