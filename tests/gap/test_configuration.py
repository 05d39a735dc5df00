"""Differences between trials: by groups that share a configuration, by a measured input, or without a pattern."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.decide.trial_differences import NAME, configuration_of, dependences_of
from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.models.chain import Chain
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.problem import Problem, TrialTerms
from hystmpc.models.identify.runs import runs_of

from ..models.zoo import BACKLASH
from .engine_examples import BASELINES, moves, simulator_of, trials_of

COMMANDS = [moves(k, 10.0) for k in range(8)]


def shifted(shifts: list[float], seed: int = 0) -> tuple[Hypothesis, tuple[str, ...], CrossValidation]:
    """The known device with an offset of each trial [deg]."""
    runs = runs_of(trials_of(Chain(BACKLASH), COMMANDS, seed=seed, shifts=tuple(shifts)))
    baseline = BASELINES["backlash"]
    problem = Problem(baseline, (), TrialTerms(shift=True))
    found = Hypothesis(problem, problem.start(baseline.nominal, []), 0.0)
    return found, tuple(run.name for run in runs), CrossValidation(baseline, runs)


@settings(max_examples=10, deadline=None)
@given(st.permutations([0, 0, 0, 1, 1, 1, 1, 1]), st.floats(0.5, 8.0), st.booleans())
def test_groups_are_found_whatever_their_order_and_size(group: list[int], size: float, down: bool) -> None:
    hypothesis, names, validation = shifted([(-size if down else size) * g for g in group])
    found = configuration_of(hypothesis, validation.runs)
    assert found is not None
    assert found.groups == tuple(tuple(n for n, g in zip(names, group, strict=True) if g == k) for k in (1, 0))
    assert found.sizes["offset_deg"] == pytest.approx(size, rel=0.1, abs=0.1)
    assert abs(found.sizes["gain_share"]) < 0.04


@pytest.mark.parametrize("seed", range(4))
def test_scatter_and_a_single_odd_trial_are_no_configuration(seed: int) -> None:
    random = np.random.default_rng(seed)
    even = np.linspace(-3.0, 3.0, 8)[random.permutation(8)]
    for shifts in (even.tolist(), [0.0] * 7 + [4.0]):
        hypothesis, _, validation = shifted(shifts, seed)
        found = configuration_of(hypothesis, validation.runs)
        assert found is None or len(found.groups) > 2


def test_without_shifts_there_are_no_groups() -> None:
    *_, validation = shifted([0.0] * 8)
    assert configuration_of(validation.retuned(), validation.runs) is None


def test_the_diagnosis_names_it_with_its_groups() -> None:
    trials = trials_of(Chain(BACKLASH), COMMANDS, shifts=(0.0, 3.0, 3.0, 0.0, 0.0, 3.0, 0.0, 3.0))
    found = conclude(find_causes(trials, simulator_of(BACKLASH), only=("trial_shift", "drift")))[0]
    assert found.verdict in ("named", "one_of")
    assert found.effects[0].name == NAME
    assert {len(names) for names in found.groups} == {4}
    assert dict(found.ranking)[NAME] == found.effects[0].probability
    assert found.effects[0].units["offset_deg"] == "deg"


@settings(max_examples=10, deadline=None)
@given(st.permutations([0.0, 0.0, 1.0, 2.0, 3.0, 3.0, 4.0, 7.0]), st.floats(-3.0, 3.0).filter(lambda x: abs(x) > 0.3))
def test_a_measured_input_that_shifts_trials_is_recovered_with_its_slope(levels: list[float], slope: float) -> None:
    hypothesis, _, validation = shifted([slope * z for z in levels])
    noise = np.random.default_rng(0).normal(0.0, 0.05, 8)
    runs = [
        replace(run, inputs={"pressure_bar": np.full(run.angle.size, z), "other": np.full(run.angle.size, z + n)})
        for run, z, n in zip(validation.runs, levels, 20 * noise, strict=True)
    ]
    (found,) = dependences_of(hypothesis, runs)
    assert (found.input, found.parameter) == ("pressure_bar", "offset_deg")
    assert found.slope == pytest.approx(slope, rel=0.1)
    assert 0.87 <= found.share <= 1.02


@pytest.mark.parametrize("seed", range(4))
def test_scatter_follows_no_input(seed: int) -> None:
    random = np.random.default_rng(seed)
    hypothesis, _, validation = shifted(random.normal(0.0, 3.0, 8).tolist(), seed)
    runs = [
        replace(run, inputs={"temperature": np.full(run.angle.size, z), "constant": np.ones(run.angle.size)})
        for run, z in zip(validation.runs, random.normal(20.0, 2.0, 8), strict=True)
    ]
    assert dependences_of(hypothesis, runs) == ()
    assert dependences_of(hypothesis, validation.runs) == ()


def test_the_diagnosis_says_which_input_and_what_to_do() -> None:
    levels = (1.0, 2.0, 3.0, 1.5, 2.5, 3.5, 1.2, 2.2)
    trials = [
        replace(trial, inputs={"pressure_bar": np.full(len(trial), z)})
        for trial, z in zip(
            trials_of(Chain(BACKLASH), COMMANDS, shifts=tuple(2.0 * z for z in levels)), levels, strict=True
        )
    ]
    found = conclude(find_causes(trials, simulator_of(BACKLASH), only=("trial_shift", "drift")))[0]
    (one,) = found.depends_on
    assert one.input == "pressure_bar"
    assert one.slope == pytest.approx(2.0, rel=0.1)
    assert found.as_json()["depends_on"][0]["parameter"] == "offset_deg"
    assert any("fit auto LOGS --input pressure_bar" in note for note in found.notes)


def test_one_trial_has_no_shift_from_trial_to_trial() -> None:
    (trial,) = trials_of(Chain(BACKLASH), [moves(1, 40.0)])
    later = trial.t > trial.t[0] + 0.35 * trial.duration_s
    jumped = replace(trial, angle=trial.angle + 4.0 * later)
    found = conclude(find_causes([jumped], simulator_of(BACKLASH), only=("trial_shift", "drift")))[0]
    assert dict(found.ranking)["trial_shift"] == 0.0
