"""Without a known order of recording, the order of the files changes nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.logs.preparation import prepare
from hystmpc.gap.logs.trial_choice import NEEDS_ORDER, in_recording_order
from hystmpc.gap.report.folder import diagnosis_json
from hystmpc.gap.report.words import order_sentences
from hystmpc.models.chain import Chain
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.trials.errors import GapError
from hystmpc.trials.trial import Trial

from ..models.zoo import BACKLASH
from .engine_examples import moves, simulator_of, sine, trials_of

COMMANDS = [moves(1, 20.0, 3.0), sine(0.1), moves(2, 20.0, 1.0), moves(3, 20.0, 4.0), sine(0.1)]
TRIALS = trials_of(Chain(BACKLASH, (Creep((0.15,), (3.0,)),)), COMMANDS)
SIMULATOR = simulator_of(BACKLASH)


def later(trial: Trial, start_s: float) -> Trial:
    """The trial on a clock that was started earlier."""
    return replace(trial, t=trial.t + start_s)


@given(st.permutations(TRIALS))
def test_the_order_by_content_is_that_of_no_file(given_: list[Trial]) -> None:
    found, order = in_recording_order(given_, ordered=False)
    assert order == "unknown"
    assert [t.source for t in found] == [t.source for t in in_recording_order(TRIALS, ordered=False)[0]]


@given(st.permutations(range(5)))
def test_time_stamps_come_before_the_order_of_the_files(places: list[int]) -> None:
    recorded = [later(trial, 100.0 * k) for k, trial in enumerate(TRIALS)]
    found, order = in_recording_order([recorded[k] for k in places], ordered=False)
    assert order == "known"
    assert [t.source for t in found] == [t.source for t in TRIALS]


def test_a_claim_that_the_clock_contradicts_is_refused() -> None:
    recorded = [later(TRIALS[0], 100.0), TRIALS[1]]
    with pytest.raises(GapError, match=r"--ordered: got trial_0\.csv as trial 1, expected trial_1\.csv"):
        in_recording_order(recorded, ordered=True)
    assert in_recording_order(TRIALS, ordered=True) == (TRIALS, "known")
    assert in_recording_order(TRIALS[:1], ordered=False) == (TRIALS[:1], "known")


@cache
def final_names() -> list[str]:
    """Of the trials kept for the end, whatever the order of the files."""
    return [run.name for run in prepare(TRIALS, SIMULATOR, ordered=False).final]


@pytest.mark.slow
@settings(max_examples=4)
@given(st.permutations(TRIALS))
def test_nothing_is_carried_from_trial_to_trial_without_an_order(given_: list[Trial]) -> None:
    prepared = prepare(given_, SIMULATOR, ordered=False)
    assert {run.clock_s for run in prepared.everything} == {0.0}
    assert all(run.bent_before == run.command[0] for run in prepared.everything)
    assert [r.name for r in prepared.final] == final_names()


@pytest.mark.slow
def test_permuted_files_give_the_same_diagnosis() -> None:
    texts = []
    for order in (range(5), np.random.default_rng(0).permutation(5)):
        diagnosis, _ = conclude(find_causes([TRIALS[k] for k in order], SIMULATOR, seed=3, ordered=False))
        texts.append(diagnosis_json(diagnosis))
    assert texts[0] == texts[1]
    assert diagnosis.order == "unknown"
    assert [u.name for u in diagnosis.untestable] == list(NEEDS_ORDER)
    assert not {e.name for e in diagnosis.effects} & set(NEEDS_ORDER)
    assert [e.name for e in diagnosis.effects] == ["creep"]
    assert len(order_sentences(diagnosis)) == 1 + len(NEEDS_ORDER)
