"""Laws of the rules beside the diagnosis that decide by the fit alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.identify.cross_validation import CrossValidation
from hystmpc.models.identify.runs import Run, runs_of
from hystmpc.models.identify.selection import Selection, SelectionSettings, select
from hystmpc.models.operators.dynamics import Lag
from hystmpc_lab.blind.rules import bic_choice, effective_samples, fit_rules

from ..gap.engine_examples import BASELINES, CANDIDATES, moves, trials_of
from ..models.zoo import BACKLASH

NOISE_DEG = 0.05


def runs_with(lag_s: float) -> tuple[Run, ...]:
    """Three trials of a backlash, with a lag unless that is zero."""
    chain = Chain(BACKLASH, (Lag(lag_s),)) if lag_s else Chain(BACKLASH)
    return runs_of(trials_of(chain, [moves(k) for k in (1, 2, 3)], NOISE_DEG))


def selection_on(runs: tuple[Run, ...]) -> Selection:
    """What a small library finds on them."""
    without = ("trial_shift", "periodic_disturbance")
    candidates = [c for c in CANDIDATES["backlash"] if c.effect in ("lag", "creep", "contact")]
    return select(CrossValidation(BASELINES["backlash"], runs), candidates, SelectionSettings(), NOISE_DEG**2, without)


@pytest.mark.slow
def test_both_rules_name_a_lag_that_is_there() -> None:
    runs = runs_with(0.2)
    selection = selection_on(runs)
    assert bic_choice(selection.tried, runs) >= {"lag"}
    assert fit_rules(selection, runs) == {"bic": "lag", "single fit": "lag"}


@pytest.mark.slow
def test_bic_names_nothing_where_there_is_nothing_and_the_largest_fit_always_does() -> None:
    runs = runs_with(0.0)
    selection = selection_on(runs)
    assert len(selection.tried) > 1
    found = fit_rules(selection, runs)
    assert found["bic"] == "none"
    assert found["single fit"] in ("lag", "creep", "contact")


@pytest.mark.slow
def test_what_is_left_out_of_the_tried_cannot_be_chosen() -> None:
    runs = runs_with(0.2)
    tried = {names: judged for names, judged in selection_on(runs).tried.items() if "lag" not in names}
    assert "lag" not in bic_choice(tried, runs)
    only = {frozenset[str](): tried[frozenset()]}
    assert bic_choice(only, runs) == frozenset()
    with pytest.raises(ValueError, match="empty"):
        bic_choice({}, runs)


@given(st.floats(-0.5, 0.95), st.integers(0, 1000))
def test_samples_of_an_autoregression_count_as_theory_says(r: float, seed: int) -> None:
    random, error = np.random.default_rng(seed), np.zeros(20000)
    for k, step in enumerate(random.standard_normal(error.size)):
        error[k] = (r * error[k - 1] if k else 0.0) + step
    parts = np.split(error, 4)
    expected = min(error.size * (1 - r) / (1 + r), error.size)
    assert effective_samples(parts) == pytest.approx(expected, rel=0.6 if r > 0.9 else 0.12)
    assert effective_samples([7 * part for part in parts]) == pytest.approx(effective_samples(parts))


def test_samples_that_do_not_vary_are_not_divided_by_zero() -> None:
    assert effective_samples([np.ones(50)]) == 50
    assert effective_samples([np.arange(50.0)]) < 10
