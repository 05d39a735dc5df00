"""Lag, delay and rate dependence: what is quick tells them apart beside a slow error, and what is held out in parts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.effects.effect import Candidate
from hystmpc.models.identify.cross_validation import CrossValidation, HeldOutErrors, Hypothesis, InParts
from hystmpc.models.identify.problem import NO_TERMS
from hystmpc.models.identify.runs import runs_of, whitened, whitening
from hystmpc.models.identify.timing import TIMING, by_timing, timing_errors, timing_rivals
from hystmpc.models.operators.dynamics import Delay, Servo
from hystmpc.models.operators.operator import Operator

from ..gap.engine_examples import BASELINES, CANDIDATES, DT, moves, trials_of
from .zoo import BACKLASH

SURE, BLOCKS, SAMPLES = 2.0, 24, 10
CAUSES = [c for c in CANDIDATES["backlash"] if c.effect in TIMING]


@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.integers(0, 99))
def test_what_the_past_predicts_is_taken_off(a: float, b: float, seed: int) -> None:
    """Of errors with two real poles, the noise that drives them is left."""
    noise, errors = np.random.default_rng(seed).standard_normal(4000), np.zeros(4000)
    for k in range(2, errors.size):
        errors[k] = (a + b) * errors[k - 1] - a * b * errors[k - 2] + noise[k]
    left = whitened(errors, whitening([errors[:2000], errors[2000:]]))
    assert left.shape == errors.shape
    assert np.sqrt(np.mean((left[6:] - noise[6:]) ** 2)) < 0.1


@pytest.mark.parametrize(("operator", "true"), [(Delay.at_rate(0.04, DT), "delay"), (Servo(0.04, 0.7), "lag")])
def test_a_slow_error_does_not_hide_what_is_quick(operator: Operator, true: str) -> None:
    """A sample of delay, and a lag as long, beside a slow error larger than what tells them apart."""
    trials = trials_of(Chain(BACKLASH, (operator,)), [moves(k) for k in (1, 2, 3)], 0.02)
    slow = [replace(t, angle=t.angle + np.sin(0.8 * t.t + k)) for k, t in enumerate(trials)]
    validation = CrossValidation(BASELINES["backlash"], runs_of(slow))
    first = next(c for c in CAUSES if c.effect == "lag")
    chosen = validation.with_causes((first,), NO_TERMS, BASELINES["backlash"].nominal, [[first.starts[0]]])
    found = timing_rivals(validation, CAUSES, chosen, None)
    assert set(found) == TIMING
    (false,) = TIMING - {true, "rate_dependence"}
    assert found[true][1].quick.sum() < 0.6 * found[false][1].quick.sum()
    assert found[true][1].held_out.sum() > 0.9 * found[false][1].held_out.sum()


@pytest.mark.parametrize("candidate", [c for c in CANDIDATES["backlash"] if c.free], ids=lambda c: c.label)
def test_held_out_trials_leave_no_less_than_the_fit_to_all(candidate: Candidate) -> None:
    """What a selection need not judge is known from the fit: E_k(q_k) >= E_k(q) for optimal q and q_k."""
    trials = trials_of(Chain(BACKLASH, (Servo(0.2, 0.7),)), [moves(k) for k in range(4)], 0.02)
    validation = replace(CrossValidation(BASELINES["backlash"], runs_of(trials)), evaluations=40, tolerance=1e-7)
    fitted = validation.finished(validation.with_one_more(validation.retuned(), candidate))
    assert validation.judge(fitted).mse >= (1 - 1e-3) * fitted.mse


def rival(
    name: str,
    held_out: float,
    quick: float,
    free: int = 1,
    *,
    scatter: float = 0.0,
    form: tuple[float, float] = (0.0, 0.0),
) -> HeldOutErrors:
    """A hypothesis with mean square errors of that size [deg^2], every other block of the first worse by `scatter`.

    Args:
        form: mean square error of noise and model form [deg^2], and the part of the form in it.
    """
    problem = cast("Any", SimpleNamespace(effects=[SimpleNamespace(effect=name)], terms=SimpleNamespace(names=())))
    ones, run = np.ones(BLOCKS), np.arange(BLOCKS) // 6
    uneven = SAMPLES * (held_out + scatter * (-1.0) ** np.arange(BLOCKS))
    parts = InParts(uneven, SAMPLES * quick * ones, free, *form)
    hypothesis = Hypothesis(problem, np.empty(0), held_out)
    return HeldOutErrors(uneven, SAMPLES * ones, run, hypothesis, (), (), parts)


def told(chosen: HeldOutErrors, *others: HeldOutErrors) -> str:
    """The effect that is chosen among these."""
    found = by_timing(chosen, {j.hypothesis.effects: j for j in (chosen, *others)}, SURE)
    return next(iter(found.hypothesis.effects))


@given(st.floats(0.1, 1.0), st.floats(0.0, 0.9))
def test_parts_decide_where_they_are_sure_and_else_what_is_quick(fall: float, scatter: float) -> None:
    lag, delay = rival("lag", 1.0 + fall, 1.0), rival("delay", 1.0, 2.0, scatter=scatter)
    sure = timing_errors(lag, delay)[0] > SURE
    assert told(lag, delay) == told(delay, lag) == ("delay" if sure else "lag")


@given(st.floats(0.5, 1.0), st.floats(0.5, 1.0), st.floats(0.0, 1.0))
def test_errors_below_noise_and_model_form_do_not_tell_apart(one: float, other: float, share: float) -> None:
    lag, delay = (rival(name, held_out, 1.0, form=(1.0, share)) for name, held_out in (("lag", one), ("delay", other)))
    assert timing_errors(lag, delay)[0] == timing_errors(delay, lag)[0] == 0.0


@given(st.floats(1.0, 2.0), st.floats(0.1, 1.0), st.floats(0.1, 1.0), st.floats(0.0, 0.5))
def test_no_error_is_surer_than_the_part_of_the_model_form_in_the_floor_allows(
    fall: float, quick_fall: float, share: float, scatter: float
) -> None:
    """Without scatter a fall as large as the form error would be infinitely sure."""
    pair = [("lag", 1.0 + fall, 1.0 + quick_fall), ("delay", 1.0, 1.0)]
    lag, delay = (rival(*each, scatter=scatter, form=(1.0, share)) for each in pair)
    in_parts, quick = timing_errors(lag, delay)
    assert 0 < in_parts <= fall / (0.1 * share) * (1 + 1e-9)
    assert 0 < quick <= quick_fall / (0.1 * share) * (1 + 1e-9)


@pytest.mark.parametrize(("held_out", "chosen"), [(0.9, "lag"), (3.0, "rate_dependence")])
def test_many_numbers_need_more_than_the_model_form_left_by_few(held_out: float, chosen: str) -> None:
    form = (1.0, 0.9)
    lag, flexible = rival("lag", held_out, 2.0, form=form), rival("rate_dependence", 0.3, 1.0, 5, form=form)
    assert told(lag, flexible) == told(flexible, lag) == chosen


@given(st.integers(1, 5), st.integers(1, 5))
def test_of_equal_errors_the_one_with_fewer_numbers_is_expected_to_do_better(one: int, other: int) -> None:
    lag, delay = rival("lag", 1.0, 1.0, one), rival("delay", 1.0, 1.0, other)
    if one != other:
        assert told(lag, delay) == told(delay, lag) == ("lag" if one < other else "delay")


def test_what_was_not_compared_stays() -> None:
    lag, delay = rival("lag", 2.0, 2.0), rival("delay", 1.0, 1.0)
    assert told(replace(lag, parts=None), delay) == "lag"
    assert timing_errors(replace(lag, parts=None), delay) == (0.0, 0.0)
    assert told(rival("creep", 2.0, 2.0), delay) == "creep"
