"""Planned motions start settled; intervals hold the truth; the corrected simulator says what the device does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hystmpc.gap.logs.preparation import PreparedTrials, prepare
from hystmpc.gap.next.open_hypotheses import open_hypothesis
from hystmpc.models.chain import Chain
from hystmpc.models.decades import Decades
from hystmpc.models.effects.place import effect_from
from hystmpc.models.identify.corrected_simulator import EFFECTS_FILE, corrected_simulator, network_effects, settled
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.problem import Problem, TrialTerms
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.uncertainty import parameter_rows, uncertainty
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.measurement import PeriodicDisturbance
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep, Drift, FirstFlexure
from hystmpc.trials.config import read_yaml
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.zoo import BACKLASH, STATIC_PI
from .engine_examples import BASELINES, DT, moves, simulator_of, trials_of
from .test_engine import named

SIMULATOR = simulator_of(BACKLASH)


def prepared_of(
    *before: Operator, after: tuple[Operator, ...] = (), noise: float = 0.05, seed: int = 0
) -> PreparedTrials:
    """Four trials of a backlash with some effects."""
    trials = trials_of(Chain(BACKLASH, before, after), [moves(k, 16.0) for k in range(4)], noise, seed)
    return prepare(trials, SIMULATOR)


def fitted(
    prepared: PreparedTrials, label: str, start: tuple[float, ...], terms: TrialTerms = TrialTerms()
) -> Hypothesis:
    """Baseline and one candidate."""
    validation = CrossValidation(prepared.baseline, prepared.development)
    made = validation.with_causes((named("backlash", label),), terms, prepared.baseline.nominal, [[start]])
    return validation.polished(made)


@pytest.mark.parametrize("core", [BACKLASH, STATIC_PI])
@pytest.mark.parametrize(
    ("before", "after"),
    [((Creep((0.3,), (40.0,)),), ()), ((), (Creep((-0.4,), (60.0,)),)), ((Lag(2.0),), (Lag(3.0),))],
)
def test_a_settled_chain_stays_where_it_is(
    core: Operator, before: tuple[Operator, ...], after: tuple[Operator, ...]
) -> None:
    chain = Chain(core, before, after)
    state = settled(chain, 2.0, 30.0, -np.inf, 0.0)
    held = StagedChain(chain).simulate(np.full((500, 1), 2.0), DT, state[:, None])[0]
    assert np.ptp(held) < 1e-6


def test_clocks_and_maxima_are_those_of_the_device() -> None:
    chain = Chain(BACKLASH, (FirstFlexure(0.3, 1.0),), (Drift(6.0, 0.0, 0.0),))
    state = settled(chain, 1.0, 28.0, 5.0, 90.0)
    assert state[0] == 5.0
    assert state[-3:-1].tolist() == [90.0, 0.0]
    assert settled(chain, 1.0, 28.0, -np.inf, 0.0)[0] == 1.0


def test_contenders_do_not_move_before_the_motion_does() -> None:
    prepared = prepared_of(Creep((0.15,), (3.0,)))
    contender = open_hypothesis("creep", fitted(prepared, "creep/command", (0.1, 2.0)), prepared)
    command = np.concatenate([np.zeros(50), moves(9)])
    for simulate in (contender.simulate, *contender.retunings):
        angle = simulate(command, DT)
        assert angle.shape == command.shape
        assert np.ptp(angle[:50]) < 1e-6
        assert np.ptp(angle) > 10
    assert len(contender.retunings) == 5


def test_a_set_that_was_taken_shows_no_more() -> None:
    prepared = prepared_of(FirstFlexure(0.3, 1.0))
    once = open_hypothesis("first_flexure", fitted(prepared, "first_flexure/once", (0.2, 1.0)), prepared)
    again = open_hypothesis("first_flexure", fitted(prepared, "first_flexure/every trial", (0.2, 1.0)), prepared)
    opening = np.concatenate([np.linspace(0, 5, 100), np.linspace(5, 0, 100)])
    twice = np.tile(opening, 2)
    first, second = np.split(once.simulate(twice, DT), 2)
    np.testing.assert_allclose(first[150:], second[150:], atol=1e-6)
    np.testing.assert_allclose(first[50:100], second[50:100], atol=1e-6)
    first, second = np.split(again.simulate(twice, DT), 2)
    assert np.abs(first[50:90] - second[50:90]).max() > 0.3


@pytest.mark.slow
def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    """Creep's share at 24 seeds of noise; a binomial of 90 % has less than 17 hits once in 500."""
    hits = 0
    for seed in range(24):
        prepared = prepared_of(Creep((0.15,), (3.0,)), noise=0.3, seed=seed)
        found = fitted(prepared, "creep/command", (0.1, 2.0))
        rows = {row.name: row for row in parameter_rows(found, prepared.development, {}) if row.owner == "creep"}
        hits += rows["share"].ci90[0] <= 0.15 <= rows["share"].ci90[1]
    assert hits >= 17


def test_what_the_logs_do_not_show_is_called_flat() -> None:
    """The time constant of a creep that is not there, and a stop beyond every angle."""
    prepared = prepared_of()
    problem = Problem(prepared.baseline, (named("backlash", "creep/command"),))
    q = problem.start(prepared.baseline.nominal, [(1e-9, 3.0)])
    found = uncertainty(problem, q, prepared.development)
    assert found.flat[-1]
    assert not found.flat[:3].any()
    rows = parameter_rows(Hypothesis(problem, q, 0.0), prepared.development, {})
    assert next(row for row in rows if row.name == "tau_s").flat


def test_a_parameter_at_its_bound_is_said_so() -> None:
    prepared = prepared_of()
    problem = Problem(prepared.baseline, (named("backlash", "delay/command"),))
    rows = parameter_rows(
        Hypothesis(problem, problem.start(prepared.baseline.nominal, [(0.0,)]), 0.0), prepared.development, {}
    )
    (row,) = [row for row in rows if row.owner == "delay"]
    assert row.at_bound
    assert not row.flat
    assert np.isnan(row.ci90).all()


def disturbed() -> tuple[PreparedTrials, Hypothesis, Vec]:
    """Trials with a disturbance of one phase; the hypothesis that knows it; the last trial's angle without noise."""
    shaken = PeriodicDisturbance(1.1, (1.5,), (0.8,))
    prepared = prepared_of(after=(shaken,), noise=0.02)
    problem = Problem(prepared.baseline, (), TrialTerms(frequency_hz=1.1))
    hypothesis = Hypothesis(problem, problem.start(prepared.baseline.nominal, []), 0.0)
    return prepared, hypothesis, prepared.everything[-1].angle


def of(prepared: PreparedTrials) -> tuple[Sequence[Run], Sequence[Run], Sequence[Trial], Sequence[Trial], Decades]:
    """What a correction takes of prepared trials."""
    return prepared.everything, prepared.development, prepared.checked.trials, prepared.checked.given, prepared.decades


def test_the_corrected_simulator_has_the_disturbance_of_the_last_trial() -> None:
    prepared, hypothesis, angle = disturbed()
    fixed = corrected_simulator(SIMULATOR, hypothesis, *of(prepared))
    (operator,) = fixed.chain.after
    assert isinstance(operator, PeriodicDisturbance)
    assert operator.frequency_hz == pytest.approx(1.1)
    assert operator.amplitudes[0] == pytest.approx(1.5, rel=0.02)
    assert operator.phases_rad[0] == pytest.approx(0.8, abs=0.05)
    run, staged = prepared.everything[-1], StagedChain(fixed.chain)
    start = staged.rest(run.command[:1], np.array([run.rest_angle]))
    theta = staged.simulate(run.command[:, None], DT, start)[0][:, 0]
    assert np.sqrt(np.mean((theta - angle)[50:] ** 2)) < 0.1
    assert "phase of the last trial" in fixed.identification.method


def test_shifts_between_trials_stay_out_of_the_file() -> None:
    prepared = prepared_of()
    problem = Problem(prepared.baseline, (), TrialTerms(shift=True))
    hypothesis = Hypothesis(problem, problem.start(prepared.baseline.nominal, []), 0.0)
    fixed = corrected_simulator(SIMULATOR, hypothesis, *of(prepared))
    assert fixed.chain.operators == (fixed.chain.core,)
    assert "not in this file" in fixed.identification.method


def test_effects_beside_a_network_can_be_read_back(tmp_path: Path) -> None:
    prepared = prepared_of(Lag(0.2))
    problem = Problem(BASELINES["network"], (named("network", "lag/command"),))
    hypothesis = Hypothesis(problem, problem.start(BASELINES["network"].nominal, [(0.2,)]), 0.0)
    files = network_effects(hypothesis, BASELINES["network"], prepared.everything[-1], DT, "net.onnx", Decades())
    (tmp_path / EFFECTS_FILE).write_text(files[EFFECTS_FILE], encoding="utf-8")
    content = read_yaml(tmp_path / EFFECTS_FILE)
    assert content["format"] == "hystmpc-effects/1"
    assert "net.onnx" in content["note"]
    (spec,) = content["effects"]
    placed = effect_from(spec, DT)
    assert placed.effect.name == "lag"
    assert placed.operator.values[0] == pytest.approx(0.2)
    alone = Hypothesis(Problem(BASELINES["network"]), BASELINES["network"].nominal, 0.0)
    assert network_effects(alone, BASELINES["network"], prepared.everything[-1], DT, "net.onnx", Decades()) == {}
