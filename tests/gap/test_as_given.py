"""The simulator as given: a diagnosis and `evaluate` say the same of it, whatever its operators and sample times."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.diagnose import diagnose_trials
from hystmpc.gap.logs.preparation import PreparedTrials, evaluated_mse, prepare, resampled_or_none
from hystmpc.gap.logs.trial_choice import choose_trials
from hystmpc.gap.next.open_hypotheses import free_run
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.evaluate import evaluate
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.problem import Problem
from hystmpc.models.operators.dynamics import Delay
from hystmpc.models.operators.hysteresis import Stop
from hystmpc.models.operators.measurement import PeriodicDisturbance
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Line
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.trials.check import Severity
from hystmpc.trials.errors import GapError, LogError, ModelError
from hystmpc.trials.findings import clock_of, time_findings
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.zoo import BACKLASH, EXAMPLES, simulator
from .consistency import contradictions

OUTPUTS = ("deadband", "periodic_disturbance", "sensor")
RATES = (10.0, 12.5, 25.0, 30.0, 50.0, 80.0, 100.0, 250.0)
CORES = (
    "backlash",
    "bouc_wen",
    "curved_plays",
    "drdpi",
    "line",
    "maxwell_slip",
    "oscillator",
    "prandtl_ishlinskii",
    "state_network",
)


def device(operator: Operator, dt_s: float) -> Simulator:
    """A tendon device with that operator: as its core, or on one side of a backlash."""
    if operator.name in CORES:
        return simulator(Chain(operator), dt_s)
    if operator.name == "stop":
        operator = Stop(5.0)
    sides = {"after" if operator.name in OUTPUTS else "before": (operator,)}
    return simulator(Chain(BACKLASH, **sides), dt_s)


def command(t: Vec, seed: int) -> Vec:
    """Moves to random levels with holds at times t (T,), from a rest at zero and back to it."""
    random, times, levels = np.random.default_rng(seed), [0.0, 1.0], [0.0, 0.0]
    while times[-1] < t[-1] - 4.0:
        level = float(random.uniform(1.5, 6.0)) * (len(times) % 4 > 0)
        times += [times[-1] + 0.3 + abs(level - levels[-1]) / 5.0, times[-1] + 1.5 + abs(level - levels[-1]) / 5.0]
        levels += [level, level]
    return np.interp(t, [*times, times[-1] + 2.0], [*levels, 0.0])


def recorded(given: Simulator, log_hz: float, seed: int, seconds: float = 16.0) -> list[Trial]:
    """Two logs of a device that is the simulator itself, run at its own sample time, and a sensor of 0.02 deg."""
    random, staged, logs = np.random.default_rng(seed), StagedChain(given.chain), []
    for k in range(2):
        fine = np.arange(0.0, seconds, given.dt_s)
        commands = command(fine, seed + k)
        rest = staged.settled(np.zeros(1), np.array([25.0]), given.dt_s)[0]
        if given.chain.core.name in ("oscillator", "state_network"):  # at rest only after its own swing
            rest = staged.simulate(np.zeros((round(60 / given.dt_s), 1)), given.dt_s, rest)[1]
        theta = staged.simulate(commands[:, None], given.dt_s, rest)[0][:, 0]
        t = np.arange(0.0, fine[-1], 1 / log_hz)
        angle = np.interp(t, fine, theta) + 0.02 * random.standard_normal(t.size)
        logs.append(Trial(t, np.interp(t, fine, commands), angle, source=f"log_{seed}_{k}.csv"))
    return logs


def made_for(given: Simulator, logs: list[Trial]) -> Simulator:
    """The simulator with the ranges of its logs, as an identification writes them."""
    low, high = (float(f([f(log.angle) for log in logs])) for f in (np.min, np.max))
    return replace(given, trained_angle_deg=Range(lower=low, upper=high))


def given_rmse(prepared: PreparedTrials) -> float:
    """RMSE of the simulator as given over all trials, as a diagnosis has it [deg]."""
    problem = Problem(prepared.baseline)
    start = problem.start(prepared.baseline.nominal, [])
    pairs = zip(prepared.counted, prepared.raw, strict=True)
    errors = [(problem.angles(start, run) - raw)[run.counts] for run, raw in pairs]
    return prepared.decades.angle * math.sqrt(float(np.mean(np.concatenate(errors) ** 2)))


def first_flexure_end_s(log: Trial) -> float:
    """When the command turns for the first time [s]."""
    return float(log.t[first_flexure_end(log)])


def label(operator: Operator) -> str:
    return "-".join((operator.name, *map(str, operator.structure.values())))


FORWARD = [
    o
    for o in EXAMPLES
    if not o.name.startswith("inverse") and o.name != "delay"  # a store has another size
]
PAIRS = [(own, log) for own in RATES for log in RATES if log >= own]


def own_rmse(given: Simulator, logs: list[Trial]) -> float:
    """RMSE of the simulator at its own sample time over whole logs, as `evaluate` says it [deg]."""
    found = evaluated_mse(given, logs)
    assert found is not None
    return math.sqrt(found)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(FORWARD)), ids=lambda k: label(FORWARD[k]))
def test_a_diagnosis_sees_the_simulator_as_it_is_at_its_own_rate(number: int) -> None:
    """Whatever its operators, its rate and that of its logs, but for the noise of other readings."""
    random = np.random.default_rng([20261125, number])
    own_hz, log_hz = PAIRS[random.integers(len(PAIRS))]
    plain = device(FORWARD[number], 1 / own_hz)
    logs = recorded(plain, log_hz, int(random.integers(100)), seconds=12.0)
    given_one = made_for(plain, logs)
    prepared = prepare(logs, given_one)
    assert given_rmse(prepared) == pytest.approx(own_rmse(given_one, logs), rel=0.05, abs=0.02)


@pytest.mark.parametrize("own_hz", [25.0, *(pytest.param(hz, marks=pytest.mark.slow) for hz in (10.0, 100.0))])
@pytest.mark.parametrize("log_hz", [10.0, 25.0, 50.0, 250.0])
def test_the_errors_of_evaluate_and_diagnose_are_equal_as_given(own_hz: float, log_hz: float) -> None:
    """Of a simulator with a delay, wrong by 20 % of its gain, over whatever logs `evaluate` takes."""
    given_one = simulator(Chain(BACKLASH, before=(Delay.at_rate(0.06, 1 / own_hz),)), 1 / own_hz)
    logs = [replace(log, angle=1.2 * log.angle) for log in recorded(given_one, log_hz, 5)]
    prepared, evaluated = prepare(logs, given_one), evaluated_mse(given_one, logs)
    notes = [note for note in prepared.checked.notes if "`evaluate`" in note]
    if log_hz < own_hz / 1.5:
        assert evaluated is None
        assert len(notes) == 1
        assert "does not run it over these trials" in notes[0]
    else:
        assert evaluated is not None
        assert given_rmse(prepared) == pytest.approx(math.sqrt(evaluated), rel=0.02)
        assert not notes


def test_a_first_flexure_is_skipped_as_evaluate_skips_it() -> None:
    """The same samples count, in a diagnosis of many trials and in one that is cut in parts."""
    given_one = simulator(Chain(BACKLASH))
    for count in (1, 2, 4):
        logs = [log for seed in (1, 2) for log in recorded(given_one, 50.0, seed)][:count]
        spoilt = [replace(log, angle=log.angle + 9.0 * (log.t < first_flexure_end_s(log))) for log in logs]
        prepared, evaluated = (
            prepare(spoilt, given_one, skip_first_flexure=True),
            evaluated_mse(given_one, spoilt, True),
        )
        assert evaluated is not None
        assert given_rmse(prepared) == pytest.approx(math.sqrt(evaluated), rel=0.02)
        assert given_rmse(prepared) < 0.1 < given_rmse(prepare(spoilt, given_one))
        for run in (*prepared.development, *prepared.final):
            (log,) = (log for log in spoilt if log.source == run.name)
            assert run.counts.any()
            assert run.dt_s * np.flatnonzero(run.counts)[0] >= first_flexure_end_s(log) - run.dt_s


def test_a_report_warns_where_evaluate_gives_another_error() -> None:
    """A simulator slower than any diagnosis, whose delay is exact for ramps at its own sample time alone."""
    given_one = simulator(Chain(BACKLASH, before=(Delay(0.2, 1),)), 0.25)
    logs = recorded(given_one, 25.0, 3)
    prepared = prepare(logs, given_one)
    (note,) = (note for note in prepared.checked.notes if "`evaluate`" in note)
    evaluated = evaluated_mse(given_one, logs)
    assert evaluated is not None
    assert f"{math.sqrt(evaluated):.3g} deg RMS over all trials instead of {given_rmse(prepared):.3g} deg" in note


@pytest.mark.slow
def test_what_is_compared_is_what_evaluate_says() -> None:
    given_one = simulator(Chain(BACKLASH, before=(Delay(0.1, 3),)))
    logs = recorded(given_one, 100.0, 2)
    own = [log for log in (resampled_or_none(log, 1 / given_one.dt_s) for log in logs) if log is not None]
    found = [evaluate(ChainModel(given_one), log) for log in own]
    squares = [run.errors.rmse_deg**2 * len(run.trial) for run in found]
    assert evaluated_mse(given_one, logs) == pytest.approx(sum(squares) / sum(map(len, own)))


@given(delay=st.floats(0.0, 0.5), own_hz=st.sampled_from(RATES), other_hz=st.sampled_from(RATES))
def test_a_delay_is_never_longer_than_its_store(delay: float, own_hz: float, other_hz: float) -> None:
    """Not in a file written by hand, not at another sample time; what is too long never becomes an angle of zero."""
    by_hand = simulator(Chain(BACKLASH, before=(Delay(delay, 1),)), 1 / own_hz)
    for dt_s, chain in ((1 / own_hz, by_hand.chain), (1 / other_hz, by_hand.at_sample_time(1 / other_hz).chain)):
        (store,) = chain.before
        assert isinstance(store, Delay)
        assert store.samples * dt_s >= delay * (1 - 1e-6)
        assert store.delay_s == delay
    staged, held = StagedChain(Chain(Line(10.0, 5.0), before=(Delay(delay, 1),))), np.full((3, 1), 2.0)
    state = staged.rest(held[0], np.array([25.0]))
    if delay > 1.001 / other_hz:
        with pytest.raises(ModelError, match=r"delay: .* expected at most .* from its store of 1 samples"):
            staged.simulate(held, 1 / other_hz, state)
    else:
        np.testing.assert_allclose(staged.simulate(held, 1 / other_hz, state)[0], 25.0)


@given(frequency=st.floats(0.2, 3.0), other_hz=st.sampled_from(RATES))
def test_a_disturbance_keeps_its_phase_at_another_sample_time(frequency: float, other_hz: float) -> None:
    wave = simulator(Chain(Line(0.0, 0.0), after=(PeriodicDisturbance(frequency, (1.0, 0.3), (0.4, -1.0)),)))
    seen = []
    for run in (wave, wave.at_sample_time(1 / other_hz)):
        staged, t = StagedChain(run.chain), np.arange(0.0, 3.0, run.dt_s)
        state = staged.rest(np.zeros(1), np.zeros(1))
        theta = staged.simulate(np.zeros((t.size, 1)), run.dt_s, state)[0][:, 0]
        turns = 2 * np.pi * frequency * t
        seen.append(theta - np.sin(turns + 2 * np.pi * frequency * wave.dt_s + 0.4))
        np.testing.assert_allclose(
            seen[-1], 0.3 * np.sin(2 * turns + 4 * np.pi * frequency * wave.dt_s - 1.0), atol=1e-9
        )


@given(
    rows=st.lists(st.tuples(st.integers(10, 150), st.floats(0.02, 3.0)), min_size=1, max_size=5),
    log_hz=st.sampled_from((10.0, 25.0)),
)
def test_check_and_diagnose_agree_on_gaps(rows: list[tuple[int, float]], log_hz: float) -> None:
    """A log with pauses: refused by both, or cut by both into the same parts."""
    stretches = [np.arange(count) / log_hz for count, _ in rows]
    begins = np.cumsum([0.0, *(part[-1] + pause for part, (_, pause) in zip(stretches, rows, strict=True))])
    t = np.concatenate([part + start for part, start in zip(stretches, begins[:-1], strict=True)])
    log = Trial(t, command(t, 3), 10.0 * command(t, 3) + 25.0, source="log.csv")
    (found,) = (
        f for f in time_findings(clock_of(log.t, log.command), log.command, log.angle, str) if f.topic == "gaps"
    )
    said, facts = "", simulator(Chain(BACKLASH)).metadata()
    try:
        chosen = choose_trials([log], facts, False, 0)
    except (LogError, GapError) as error:
        said = str(error)
    if said:
        assert (found.severity is Severity.ERROR) == ("gap of" in said)
        assert "gap of" in said or "no part of 2 s or more" in said
    else:
        assert found.severity is not Severity.ERROR
        assert len(chosen.given) == max(found.message.count(" to "), 1)
        assert all(f"{part.t[0]:.6g} to " in found.message or found.severity is Severity.OK for part in chosen.given)


@pytest.mark.parametrize("dt_s", [0.01, 0.02, 0.04, 0.1])
def test_what_is_open_is_simulated_at_the_sample_time_of_its_motion(dt_s: float) -> None:
    """A motion may be planned at another rate than that of the logs, for which the store of a delay was made."""
    chain = Chain(Line(10.0, 5.0), before=(Delay(0.16, 4),))
    t = np.arange(0.0, 6.0, dt_s)
    theta = free_run(chain, 5.0)(command(t, 1), dt_s)
    np.testing.assert_allclose(theta, 10.0 * command(np.maximum(t - 0.16, 0.0), 1) + 5.0, atol=1.5 * dt_s * 50 / 4)


@pytest.mark.slow
def test_a_whole_diagnosis_skips_the_first_flexure() -> None:
    """A set in the first motion of every trial is a gap, and none of what comes after it."""
    given_one = simulator(Chain(BACKLASH))
    logs = [log for seed in (1, 2) for log in recorded(given_one, 25.0, seed)]
    spoilt = [replace(log, angle=log.angle + 9.0 * (log.t < first_flexure_end_s(log))) for log in logs]
    done = diagnose_trials(spoilt, given_one, skip_first_flexure=True)
    assert done.diagnosis.verdict == "none"
    assert done.diagnosis.gap.nominal_rmse_deg < 0.1
    assert done.data.fixed is not None
    assert done.data.fixed.identification.skip_first_flexure
    assert all(trial.start > 0 and trial.rmse("nominal") < 0.1 for trial in done.data.trials)
    assert contradictions(done.data) == []
