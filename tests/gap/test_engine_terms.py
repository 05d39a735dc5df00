"""What each trial has of its own is projected out, and is estimated on other blocks where it is judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hystmpc.models.identify.motion_lines import strongest_line
from hystmpc.models.identify.problem import NO_TERMS, Problem, TrialTerms
from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Vec

from .engine_examples import BASELINES, DT, device_runs

RUN = device_runs()[1]
TERMS = [TrialTerms(shift=True, width=2), TrialTerms(frequency_hz=1.1), TrialTerms(shift=True, frequency_hz=0.7)]
BLOCK = round(4.0 / DT)


def linearised(run: Run = RUN) -> tuple[Vec, Vec, Vec]:
    """Angles, errors and derivatives of the baseline over a run."""
    problem = Problem(BASELINES["backlash"])
    theta, by_q = problem.linearised(problem.start(BASELINES["backlash"].nominal, []), run)
    return theta, theta - run.angle, by_q


def wave(hz: float, phase: float, size: float = 1.5) -> Vec:
    """A disturbance over the run."""
    return size * np.sin(2 * np.pi * hz * DT * np.arange(RUN.command.size) + phase)


@pytest.mark.parametrize("terms", TERMS)
def test_projection_is_idempotent_and_orthogonal(terms: TrialTerms) -> None:
    theta, error, by_q = linearised()
    both = np.column_stack([by_q, error])
    found = terms.projected(RUN, theta, both)
    once, slope = found[:, -1], found[:, :-1]
    again = terms.projected(RUN, theta, np.column_stack([by_q, once]))
    np.testing.assert_allclose(again[:, -1], once, atol=1e-9)
    columns = terms.columns(RUN, theta, by_q)
    np.testing.assert_allclose(columns.T @ once, 0.0, atol=1e-6)
    np.testing.assert_allclose(columns.T @ slope, 0.0, atol=1e-4)
    assert once @ once <= error @ error


def test_no_terms_change_nothing() -> None:
    theta, error, by_q = linearised()
    assert NO_TERMS.names == ()
    both = np.column_stack([by_q, error])
    assert NO_TERMS.projected(RUN, theta, both) is both
    assert NO_TERMS.cross_fitted(RUN, theta, error, by_q) is error


@pytest.mark.parametrize("terms", TERMS)
def test_what_the_terms_hold_is_taken_out(terms: TrialTerms) -> None:
    theta, error, by_q = linearised()
    added = error + terms.columns(RUN, theta, by_q) @ np.linspace(0.5, 1.0, terms.columns(RUN, theta, by_q).shape[1])
    left = [terms.projected(RUN, theta, np.column_stack([by_q, e]))[:, -1] for e in (added, error)]
    np.testing.assert_allclose(*left, atol=1e-8)


@pytest.mark.parametrize("terms", TERMS)
def test_a_block_does_not_see_its_own_errors(terms: TrialTerms) -> None:
    """What is taken off one block depends on blocks of the other parity alone."""
    theta, error, by_q = linearised()
    changed = error.copy()
    changed[:BLOCK] += np.random.default_rng(0).standard_normal(BLOCK)
    before = error - terms.cross_fitted(RUN, theta, error, by_q)
    after = changed - terms.cross_fitted(RUN, theta, changed, by_q)
    np.testing.assert_allclose(after[:BLOCK], before[:BLOCK], atol=1e-12)
    np.testing.assert_allclose(after[2 * BLOCK : 3 * BLOCK], before[2 * BLOCK : 3 * BLOCK], atol=1e-12)
    assert np.abs(after - before)[BLOCK : 2 * BLOCK].max() > 1e-3


def test_noise_is_not_explained_when_judged() -> None:
    """Projection always lowers the error; judged on other blocks, terms that are not there do not."""
    theta, _, by_q = linearised()
    noise, terms = np.random.default_rng(5).standard_normal(RUN.command.size), TERMS[2]
    projected = terms.projected(RUN, theta, np.column_stack([by_q, noise]))[:, -1]
    judged = terms.cross_fitted(RUN, theta, noise, by_q)
    assert projected @ projected < noise @ noise < judged @ judged


def test_amplitude_and_offset_are_read_off() -> None:
    theta, _, by_q = linearised()
    shaken = replace(RUN, angle=theta + wave(1.1, 0.7))
    assert TrialTerms(frequency_hz=1.1).amplitude(shaken, theta, by_q) == pytest.approx(1.5, rel=1e-6)
    moved = replace(RUN, angle=theta + 2.0)
    assert TrialTerms(shift=True).offset(moved, theta, by_q) == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("hz", [0.31, 1.1, 2.73])
def test_the_strongest_line_is_found_whatever_its_phase(hz: float) -> None:
    noise = np.random.default_rng(1)
    errors = [wave(hz, phase) + 0.5 * noise.standard_normal(RUN.command.size) for phase in (0.1, 2.0, -1.0)]
    assert strongest_line([RUN] * 3, errors, 0.15, 5.0) == pytest.approx(hz, abs=0.02)
