"""What every kind of model owes, forward and inverse: the tests run over the one list that the command line reads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import evaluate, free_run
from hystmpc.models.identify.chain_kinds import FRICTION_KINDS
from hystmpc.models.identify.estimation_noise import ReferenceModel
from hystmpc.models.kinds.catalogue import all_kinds, kind_named
from hystmpc.models.kinds.kind import FitRequest, ModelKind
from hystmpc.models.prediction.build import predictor_for
from hystmpc.trials.errors import FitError, LogError, ModelError
from hystmpc.trials.trial import Trial

from .casadi_predictor import CasadiPredictor
from .lstm_examples import DT, four_trials
from .tiny_kinds import BEHIND, FORWARD, INVERSE, Example, example, kind_of, tiny_trainings, trials_of

pytest.importorskip("torch", reason="torch is an extra")
pytestmark = pytest.mark.slow

BOTH = [(k.name, d) for k in all_kinds() for d in (FORWARD, INVERSE) if d == FORWARD or k.invertible]
# A drive is put before any kind in one way: a recurrent network, one with a state of its own, and two regressions.
BOTH += [(name + BEHIND, FORWARD) for name in ("lstm", "hb1", "svr", "play_kernel")]
every_kind = pytest.mark.parametrize("kind", all_kinds(), ids=lambda kind: kind.name)
every_model = pytest.mark.parametrize("case", BOTH, ids=lambda case: "-".join(case))


def visited(case: Example, count: int) -> Iterator[tuple[np.ndarray, float]]:
    """States (S,) along a trial's motion and the input that acts on them."""
    reference, trial = case.found.bundle.reference, case.trials[0]
    state = case.model.metadata.initial.state(np.array([[trial.angle[0]]]))
    chosen = set(np.linspace(3, len(trial) - 2, count).astype(int).tolist())
    for k, u in enumerate(trial.command):
        if k in chosen:
            yield state[0], float(u)
        _, state = reference.advance(state, np.array([[u]]))


@every_model
def test_the_file_says_what_the_model_is(case: tuple[str, str]) -> None:
    one, trial = example(*case), example(*case).trials[0]
    facts = one.model.metadata
    assert facts.inverted == (case[1] == INVERSE)
    assert (facts.command_unit, facts.angle_unit) == (trial.units.command, trial.units.angle)
    assert facts.dt_s == DT
    low, high = (f(float(f(t.command)) for t in one.trials) for f in (min, max))
    assert (facts.trained_command.lower, facts.trained_command.upper) == (low, high)
    assert len(one.found.history) > 0
    assert "\n" not in one.found.report


@every_model
def test_a_step_leaves_the_state_alone_and_repeats_itself(case: tuple[str, str]) -> None:
    model = example(*case).model
    x, u = model.initial(np.array([[45.0]])), np.array([[example(*case).trials[0].command[40]]])
    kept = x.copy()
    once = model.step(x, u)
    np.testing.assert_array_equal(x, kept)
    model.step(once, 1.1 * u)  # another branch in between
    np.testing.assert_array_equal(model.step(x, u), once)


@every_model
def test_a_batch_is_its_rows(case: tuple[str, str]) -> None:
    one = example(*case)
    points = list(visited(one, 6))
    states, u = np.array([s for s, _ in points]), np.array([[v] for _, v in points])
    whole = np.hstack(one.model.advance(states, u))
    rows = np.vstack([np.hstack(one.model.advance(states[k : k + 1], u[k : k + 1])) for k in range(len(points))])
    np.testing.assert_allclose(whole, rows, rtol=1e-5, atol=1e-5)


@every_model
def test_the_file_runs_as_its_reference(case: tuple[str, str]) -> None:
    one, trial = example(*case), example(*case).trials[1]
    expected = free_run(ReferenceModel(one.found.bundle), trial.command, trial.angle[0])
    np.testing.assert_allclose(free_run(one.model, trial.command, trial.angle[0]), expected, rtol=0, atol=1e-3)


@every_model
def test_the_jacobian_is_that_of_finite_differences_away_from_kinks(case: tuple[str, str]) -> None:
    one = example(*case)
    reference, compared = one.found.bundle.reference, 0
    for state, u in visited(one, 12):
        above, below = (differences(reference.advance, state, u, step) for step in (1e-6, -1e-6))
        if np.allclose(above, below, rtol=1e-3, atol=1e-3):  # on a kink, where plays rest, the two sides differ
            middle = 0.5 * (above + below)
            np.testing.assert_allclose(reference.jacobian(state, u), middle, rtol=1e-3, atol=1e-3)
            compared += 1
    assert compared >= 3


def differences(advance, state: np.ndarray, u: float, step: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    """One-sided differences of (theta, next state) by (state, u)."""
    point = np.append(state, u)
    here, beside = (np.hstack(advance(p[:, :-1], p[:, -1:])) for p in (point[None], point + step * np.eye(point.size)))
    return ((beside - here) / step).T


@every_model
def test_evaluation_is_finite_and_a_hold_holds_within_the_range(case: tuple[str, str]) -> None:
    one, kind = example(*case), kind_of(case[0])
    result = evaluate(one.model, one.trials[0])
    assert np.all(np.isfinite(result.theta))
    assert result.outside == 0.0
    assert result.errors.hold_drift_deg < np.ptp(one.trials[0].angle)
    if (kind.readable and not kind.rings) or not kind.recurrent:  # operators without creep, maps without memory
        assert result.errors.hold_drift_deg < 1e-3


# The trials lag behind their command: what leads it, as sliders do, gets no weight.
@pytest.mark.parametrize("kind", [k for k in all_kinds() if k.name not in FRICTION_KINDS], ids=lambda kind: kind.name)
def test_a_map_without_memory_has_none(kind: ModelKind) -> None:
    one = example(kind.name, FORWARD)
    states = np.array([s for s, _ in visited(one, 8)])
    theta, _ = one.model.advance(states, np.full((len(states), 1), one.trials[0].command.mean()))
    assert (np.ptp(theta) > 1e-9) == kind.recurrent


@pytest.mark.parametrize("name", [name for name, _ in BOTH if name.endswith(BEHIND)])
def test_behind_a_drive_the_fast_route_is_the_file(name: str) -> None:
    one = example(name, FORWARD)
    predictor, model = predictor_for(one.model), one.model
    state, plan = predictor.initial(45.0, 0.0), one.trials[0].command[20:40]
    x, angles = state[None], []
    for u in plan.tolist():
        theta, x = model.advance(x, np.array([[u]]))
        angles.append(float(theta[0, 0]))
    np.testing.assert_allclose(predictor.rollout(state, plan[None])[0], angles, rtol=0, atol=1e-3)


@every_model
def test_export_repeats_itself_to_the_byte(case: tuple[str, str], tmp_path: Path) -> None:
    one = example(*case)
    export_onnx(one.found.bundle, tmp_path / "again.onnx")
    assert (tmp_path / "again.onnx").read_bytes() == one.path.read_bytes()
    assert load_onnx(tmp_path / "again.onnx").hash == one.model.hash


@every_kind
def test_a_forward_model_predicts_plans_with_its_exact_slope(kind: ModelKind) -> None:
    one = example(kind.name, FORWARD)
    predictor = CasadiPredictor(one.model.casadi_function(), one.model.metadata)
    rest, plan = one.trials[0].command[0], one.trials[0].command[20:26]
    start = predictor.initial(45.0, float(rest))
    steps, state = [], start
    for u in plan:
        theta, state = predictor.advance(state, float(u))
        steps.append(theta)
    np.testing.assert_allclose(predictor.rollout(start, plan[None])[0], steps, rtol=0, atol=1e-3)
    theta, jacobian = predictor.linearise(start, plan)
    np.testing.assert_allclose(theta, steps, rtol=0, atol=1e-3)
    assert not np.triu(jacobian, 1).any()
    ends = [predictor.rollout(start, (plan + s * 1e-4 * np.eye(plan.size)))[:, -1] for s in (1, -1)]
    np.testing.assert_allclose(jacobian[-1], (ends[0] - ends[1]) / 2e-4, rtol=1e-3, atol=1e-3)


@every_kind
def test_unusable_trials_are_one_line_errors(kind: ModelKind) -> None:
    trials = four_trials()
    rest = Trial(trials[0].t, 0 * trials[0].t, trials[0].angle, source="rest")
    slow = Trial(2 * trials[0].t, trials[0].command, trials[0].angle, source="slow")
    short = trials[0].select(0, 40)
    for unusable, text in (([], "no trials"), ([*trials, short], "40 samples"), ([*trials, rest], "constant")):
        with pytest.raises(FitError, match=text) as caught:
            kind.fit(unusable, FitRequest(training=kind.trainings[0]))
        assert "\n" not in str(caught.value)
    with pytest.raises(FitError, match=r"sampled every 0\.08 s"):
        kind.fit([*trials, slow], FitRequest(training=kind.trainings[0]))
    with pytest.raises(FitError, match="no training 'wrong'"):
        kind.fit(trials, FitRequest(training="wrong"))
    if not kind.invertible:
        with pytest.raises(FitError, match="inverse"):
            kind.fit(trials_of(INVERSE), FitRequest(training=kind.trainings[0]))


def test_not_a_number_never_becomes_a_trial() -> None:
    trial = four_trials()[0]
    angle = trial.angle.copy()
    angle[7] = np.nan
    with pytest.raises(LogError, match="angle is nan at sample 7"):
        Trial(trial.t, trial.command, angle)


@every_model
def test_trials_of_another_rate_or_unit_are_not_evaluated(case: tuple[str, str]) -> None:
    one, trial = example(*case), four_trials()[0]
    with pytest.raises(ModelError, match=r"sampled every 0\.08 s"):
        evaluate(one.model, Trial(2 * trial.t, trial.command, trial.angle))


@every_model
def test_commands_beyond_the_identified_range_are_counted(case: tuple[str, str]) -> None:
    one, trial = example(*case), example(*case).trials[0]
    middle = trial.command.mean()
    wide = Trial(trial.t, middle + 1.5 * (trial.command - middle), trial.angle, units=trial.units)
    beyond = ~one.model.metadata.trained_command.contains(wide.command)
    assert 0 < evaluate(one.model, wide).outside <= beyond.mean()


@pytest.mark.parametrize("direction", [FORWARD, INVERSE])
@pytest.mark.parametrize("name", ["fnn", "fnn_hib", "lstm", "gru", "hb1", "hb2"])
def test_a_diverging_training_is_an_error(name: str, direction: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny_trainings(monkeypatch, learning_rate=1e30)
    with pytest.raises(FitError, match=r"^training diverged: [^\n]*learning_rate$"):
        kind_named(name).fit(trials_of(direction), FitRequest())


@every_kind
def test_an_estimate_is_a_time_or_nothing(kind: ModelKind, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny_trainings(monkeypatch)
    request = FitRequest(training=kind.trainings[0])
    seconds = kind.estimate(four_trials(), request)
    if seconds is not None:
        assert 0 < seconds < 600
        steps = kind.steps(request)
        assert steps is not None
        assert steps > 0
