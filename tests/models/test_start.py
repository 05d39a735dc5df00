"""The law of the start: a free run begins where its trial does, and its error is then the noise of the sensor."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.chain import Chain
from hystmpc.models.contract.export import model_bytes
from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.contract.metadata import DeviceLimits, InitialRule, ModelMetadata, Range, rest_within
from hystmpc.models.evaluate import TrialEvaluation, evaluate, evaluation_json, start_sentences, started
from hystmpc.models.identify.baseline import FreeCoreBaseline
from hystmpc.models.identify.free_run import FreeRuns, StagedChain
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.runs import angle_range, command_range, runs_of
from hystmpc.models.identify.simulators import simulator_of
from hystmpc.models.model import LoadedModel
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.static_curves import NonlinearGain
from hystmpc.models.prediction.build import predictor_for
from hystmpc.models.rest import ChainRest
from hystmpc.models.simulator import ChainModel, simulator_bundle
from hystmpc.models.start import search_box, trial_start
from hystmpc.sim.plants.simulated import Effects, SimulatedPlant

from .start_examples import NOISE_DEG, StagedModel, model_of, random_chain, rested, trial_of, wandering
from .zoo import BACKLASH, DT, STATIC_PI, simulator

seeds = st.integers(0, 10**6)


def off(result: TrialEvaluation) -> np.ndarray:
    """Error of every sample, scored or not (T,) [deg]."""
    return result.theta - result.trial.angle


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_from_rest_at_any_command_the_error_is_the_noise_from_the_first_sample_on(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = model_of(random_chain(rng))
    result = evaluate(model, rested(rng, model))
    assert result.began.at_rest
    assert result.start == 0
    assert result.start_line == ""
    error = off(result)
    assert np.sqrt(np.mean(error**2)) < 1.15 * NOISE_DEG
    assert np.max(np.abs(error)) < 6 * NOISE_DEG


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(seeds)
def test_search_fit_and_evaluation_run_a_trial_alike(seed: int) -> None:
    """What a fit minimises, what its search minimises, and what an evaluation scores are the same free run."""
    rng = np.random.default_rng(seed)
    model = model_of(random_chain(rng))
    chain, trial = model.chain, rested(rng, model, 6.0)
    expected = evaluate(model, trial).theta
    (fitted,) = FreeRuns(chain, [trial]).angles(chain.values)
    np.testing.assert_allclose(fitted, expected, atol=1e-6)
    problem = Problem(FreeCoreBaseline(chain, Range(lower=0.0, upper=6.0)))
    q = problem.start(problem.baseline.nominal, [])
    (run,) = runs_of([trial])
    np.testing.assert_allclose(problem.angles(q, run), expected, atol=1e-6)
    np.testing.assert_allclose(problem.linearised(q, run)[0], expected, atol=1e-6)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(seeds)
def test_a_rest_stays_where_it_is_and_what_it_shows_it_can_show_again(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain = random_chain(rng)
    staged, u, y = StagedChain(chain), rng.uniform(0.0, 6.0, 12), rng.uniform(10.0, 95.0, 12)

    def shown(angles: np.ndarray) -> np.ndarray:
        x = ChainRest(chain, DT).states(u, angles)
        theta = staged.simulate(np.tile(u, (3, 1)), DT, np.ascontiguousarray(x.T))[0]
        np.testing.assert_allclose(theta[0], theta[2], atol=1e-6)  # drives rest at the command
        return theta[0]

    once = shown(y)
    np.testing.assert_allclose(shown(once), once, atol=1e-5)


def test_parts_of_longer_logs_are_scored_at_the_noise_whatever_their_plays_keep() -> None:
    """Cut at any time. Where the command happens to stand still at the cut, the part cannot be told from a rest."""
    ratios = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        model = model_of(random_chain(rng))
        whole = rested(rng, model, 50.0)
        first, count = int(rng.integers(100, len(whole) - 550)), int(rng.integers(300, 500))
        part = whole.select(first, first + count)
        result = evaluate(model, replace(part, t=part.t - part.t[0]))
        if result.began.at_rest:
            continue
        assert result.start == result.began.lead <= count // 2
        ratios.append(result.errors.rmse_deg / NOISE_DEG)
    assert len(ratios) >= 23
    assert np.median(ratios) < 1.05
    assert np.quantile(ratios, 0.9) < 1.3
    assert max(ratios) < 10.0


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(seeds)
def test_a_run_that_begins_in_motion_begins_alike_in_search_and_evaluation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = model_of(random_chain(rng))
    trial = trial_of(rng, model, wandering(rng, 20.0)[40:], model.at_rest(40.0, 3.0))
    result, (run,) = evaluate(model, trial), runs_of([trial])
    assert run.lead == result.began.lead
    if not run.lead:
        return
    assert not run.counts[: run.lead].any()
    problem = Problem(FreeCoreBaseline(model.chain, Range(lower=0.0, upper=6.0)))
    q, facts = problem.start(problem.baseline.nominal, []), model.metadata
    begun = problem.begun(q, run, search_box(facts.trained_command, facts.trained_angle))
    np.testing.assert_allclose(problem.angles(q, begun), result.theta, atol=1e-6)
    theta, by_q = problem.linearised(q, begun)
    assert theta.shape == (len(trial),)
    assert by_q.shape == (len(trial), q.size)
    near = np.abs(theta - result.theta)[run.lead :]
    assert np.sqrt(np.mean(near**2)) < 2 * NOISE_DEG  # to first order it looks for the same start


def test_what_a_fit_says_is_what_an_evaluation_says() -> None:
    """Trials that rest at 1, 3 and 5 mm: the residuals in the file are the errors of the evaluation."""
    rng, chain = np.random.default_rng(3), Chain(STATIC_PI, before=(Lag(0.4),))
    model, trials = model_of(chain), []
    for k, u in enumerate((3.0, 1.0, 5.0)):
        command = np.concatenate([np.full(30, u), np.linspace(u, 3.0, 50), wandering(rng, 10.0, 3.0, 6.0)])
        trials.append(replace(trial_of(rng, model, command, model.at_rest(20 + 10 * u, u)), source=f"{k}.csv"))
    made = simulator_of(chain, trials, DeviceLimits(), "by hand")
    assert made.rest_command == pytest.approx(3.0)
    for trial, stored in zip(trials, made.identification.residuals, strict=True):
        assert stored.rmse_deg == pytest.approx(evaluate(ChainModel(made), trial).errors.rmse_deg, rel=1e-9)
        assert stored.rmse_deg < 1.15 * NOISE_DEG
    assert made.identification.noise is not None
    assert made.identification.noise.sensor_sigma_deg == pytest.approx(NOISE_DEG, rel=0.1)


@pytest.mark.parametrize("through_valve", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_an_exported_chain_rests_where_its_simulator_does(through_valve: bool) -> None:
    valve = (NonlinearGain(0.04, 0.0, 2.0),) if through_valve else ()
    device = replace(simulator(Chain(STATIC_PI, before=(*valve, Lag(0.3)))), rest_command=2.0)
    given, exported = ChainModel(device), OnnxModel(model_bytes(simulator_bundle(device)))
    for u, y in ((0.5, 30.0), (3.0, 47.0), (5.5, 70.0)):
        np.testing.assert_allclose(exported.at_rest(y, u), given.at_rest(y, u), atol=1e-9)
        theta, _ = predictor_for(exported).advance(predictor_for(exported).initial(y, u), u)
        assert theta == pytest.approx(given.run(np.full(2, u), y)[0], abs=1e-9)
    assert exported.metadata.rests_at == 2.0


def test_older_files_have_rules_of_the_angle_alone() -> None:
    facts = ChainModel(simulator(Chain(BACKLASH, before=(Lag(0.3),)))).metadata
    properties = facts.to_properties()
    for gone in ("chain", "rest_command"):
        del properties[f"hystmpc.{gone}"]
    for rule in ("initial", "conditioned"):
        own = json.loads(properties[f"hystmpc.{rule}"])
        properties[f"hystmpc.{rule}"] = json.dumps({name: own[name] for name in ("offset", "slope")})
    older = ModelMetadata.from_properties(properties, "older.onnx")
    assert older.chain is None
    assert older.rests_at == older.command_limits.lower
    np.testing.assert_array_equal(
        older.initial.state(np.array([[40.0]]), np.array([[3.0]])), older.initial.state(np.array([[40.0]]))
    )


def test_a_rule_by_the_command_holds_at_its_own_without_one() -> None:
    rule = InitialRule(offset=(1.0, 2.0), slope=(0.0, 0.5), by_command=(1.0, 0.0), at_command=3.0)
    np.testing.assert_allclose(rule.state(np.array([[4.0]])), [[1.0, 4.0]])
    np.testing.assert_allclose(rule.state(np.array([[4.0]]), np.array([[5.0]])), [[3.0, 4.0]])
    assert rule.behind(1).by_command == (0.0,)


@pytest.mark.parametrize(
    ("command", "at_rest"),
    [
        (np.r_[np.full(5, 1.0), np.full(200, 4.0)], True),  # an early step
        (3.0 - 2.0 * np.cos(np.arange(300) * DT), True),
        (1.0 + np.linspace(0.0, 1.0, 300) ** 2, True),
        (3.0 + 2.0 * np.sin(np.arange(300) * DT), False),
        (3.0 + 2.0 * np.cos(np.arange(300) * DT + 0.3), False),
        (np.linspace(0.0, 6.0, 300), False),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_a_command_tells_whether_a_trial_begins_at_rest(command: np.ndarray, at_rest: bool, noise: float) -> None:
    command = command + noise * np.random.default_rng(0).standard_normal(command.size)
    assert trial_start(command, 10 * command, DT).at_rest == at_rest


def test_an_angle_that_still_moves_is_no_rest_and_it_is_said() -> None:
    """A part of a log that begins in a hold, in which a slow drive is under way."""
    rng, model = np.random.default_rng(1), model_of(Chain(BACKLASH, before=(Lag(4.0),)))
    steps = np.repeat([1.0, 5.0, 2.0, 4.0, 1.0, 5.0, 2.0], 100)
    whole = trial_of(rng, model, steps, model.at_rest(30.0, 1.0))
    part = replace(whole.select(150), t=whole.t[150:] - whole.t[150], source="logs/part.csv")
    result = evaluate(model, part)
    assert not result.began.at_rest
    (said,) = start_sentences([result])
    assert "part.csv begins in motion" in said
    assert "not scored" in said
    row = evaluation_json([result])["trials"][0]
    assert row["unscored_s"] == pytest.approx(result.began.lead * DT)
    assert result.errors.rmse_deg < 1.3 * NOISE_DEG
    behind = evaluate(model, part, before=whole.select(0, 150))
    assert behind.start == 0  # what was before is known: nothing is left unscored
    assert np.max(np.abs(off(behind))) < 6 * NOISE_DEG


def test_a_single_noisy_sample_does_not_begin_a_run() -> None:
    command = np.r_[np.full(40, 2.0), np.linspace(2.0, 5.0, 100)]
    angle = 20.0 + 10 * command
    angle[0] += 1.0
    assert trial_start(command, angle, DT).angle == pytest.approx(40.0, abs=0.05)


def test_inverse_maps_start_at_their_first_sample() -> None:
    angle = 40.0 + 20.0 * np.sin(np.arange(200) * DT)
    start = trial_start(angle, 0.1 * angle, DT, inverted=True)
    assert (start.command, start.angle, start.lead) == (angle[0], 0.1 * angle[0], 0)


@pytest.mark.parametrize(("rest", "expected"), [(None, -4.0), (0.0, 0.0), (2.0, 2.0), (-9.0, -4.0), (9.0, 4.0)])
def test_a_device_rests_at_its_own_command_within_its_limits(rest: float | None, expected: float) -> None:
    assert rest_within(rest, -4.0, 4.0) == expected


BOTH_WAYS = Range(lower=-4.0, upper=4.0)


@pytest.mark.parametrize("rest", [None, -4.0, 0.0, 1.5, 4.0])
@pytest.mark.parametrize("virgin", [False, True])
def test_a_plant_of_a_device_that_bends_both_ways_starts_at_its_rest(rest: float | None, virgin: bool) -> None:
    device = replace(
        simulator(Chain(STATIC_PI, before=(Lag(0.3),))),
        rest_command=rest,
        command_limits=BOTH_WAYS,
        trained_command=BOTH_WAYS,
        trained_angle_deg=Range(lower=-25.0, upper=65.0),
    )
    plant, at = SimulatedPlant(device, Effects(virgin=virgin)), -4.0 if rest is None else rest
    assert plant.rest_command == device.rests_at == device.metadata().rests_at == at
    first = plant.reset()
    assert plant.apply(at) == pytest.approx(first, abs=1e-3)


def test_the_ranges_of_a_search_hold_the_trials() -> None:
    trial = rested(np.random.default_rng(0), model_of(Chain(BACKLASH)))
    command, angle = search_box(command_range([trial]), angle_range([trial]))
    assert command.contains(trial.command).all()
    assert angle.contains(trial.angle).all()


def test_a_model_that_forgets_the_angle_is_started_by_commands_alone() -> None:
    """As a network is: its state at rest does not depend on the angle."""

    class Forgetful(LoadedModel):
        def advance(self, state: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            play = np.maximum(u - 1.0, np.minimum(u + 1.0, state))
            return 20.0 + 10.0 * play, play

        def casadi_function(self) -> None:
            raise NotImplementedError

    facts = StagedModel(simulator(Chain(BACKLASH))).metadata
    rule = InitialRule(offset=(0.0,), slope=(0.0,), by_command=(1.0,))
    facts = facts.model_copy(update={"chain": None, "initial": rule, "conditioned": rule, "warmup_samples": 2})
    model, rng = Forgetful(facts, "initial"), np.random.default_rng(2)
    command = wandering(rng, 30.0)
    whole = trial_of(rng, model, command, model.at_rest(0.0, 3.0))
    part = whole.select(210)
    assert started(model, part).lead > 0
    assert evaluate(model, replace(part, t=part.t - part.t[0])).errors.rmse_deg < 1.2 * NOISE_DEG
