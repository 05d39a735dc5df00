"""Support-vector regression: the graph against skl2onnx's, its derivative, its settings, and bad input."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.trial import Trial
from hystmpc_lab.rivals.kinds import SvrKind
from hystmpc_lab.rivals.svr import SvrStep, SvrWeights, svr_step_graph
from hystmpc_lab.rivals.svr_ import SVR_TRAININGS, SvrSettings, fit_svr

from ..models.lstm_examples import four_trials

pytest.importorskip("sklearn", reason="scikit-learn is an extra")

SMALL = SvrSettings(lags=12, stride=2, c=(10.0,), gamma=(0.05,), epsilon=(0.02,))


def weights(stride: int = 1, lags: int = 6) -> SvrWeights:
    rng = np.random.default_rng(2)
    return SvrWeights(rng.uniform(-1, 1, (9, lags)), rng.normal(0, 1, 9), 0.1, 0.4, 3.0, 3.0, 60.0, 32.0, stride)


def machine(trials: list[Trial], settings: SvrSettings):  # type: ignore[no-untyped-def]
    """scikit-learn's own model on windows that are built here anew (libsvm stops early: rounding must be equal)."""
    from sklearn.svm import SVR

    low, high = (float(f([f(t.command) for t in trials])) for f in (np.min, np.max))
    bottom, top = (float(f([f(t.angle) for t in trials])) for f in (np.min, np.max))
    rows, angles = [], []
    for trial in trials:
        for k in range(len(trial)):
            ages = settings.stride * np.arange(settings.lags - 1, -1, -1)
            rows.append((2 * trial.command[np.maximum(k - ages, 0)] - low - high) / (high - low))
            angles.append((2 * trial.angle[k] - bottom - top) / (top - bottom))
    fitted = SVR(kernel="rbf", C=settings.c[0], gamma=settings.gamma[0], epsilon=settings.epsilon[0])
    return fitted.fit(np.array(rows), np.array(angles)), np.array(rows), 0.5 * (bottom + top), 0.5 * (top - bottom)


def test_the_graph_is_what_skl2onnx_writes(tmp_path: Path) -> None:
    """skl2onnx's SVMRegressor in onnxruntime, single precision, over a whole trial."""
    skl2onnx = pytest.importorskip("skl2onnx")
    import onnxruntime as ort
    from skl2onnx.common.data_types import FloatTensorType

    trials = four_trials()
    fitted, rows, middle, half = machine(trials, SMALL)
    proto = skl2onnx.convert_sklearn(fitted, initial_types=[("windows", FloatTensorType([None, SMALL.lags]))])
    assert [node.op_type for node in proto.graph.node][:1] == ["SVMRegressor"]
    session = ort.InferenceSession(proto.SerializeToString(), providers=["CPUExecutionProvider"])
    (scaled,) = session.run(None, {"windows": rows[: len(trials[0])].astype(np.float32)})
    step = SvrStep(fit_svr(trials, SMALL).weights)
    state, ours = np.full((1, step.state_size), trials[0].command[0]), []
    for u in trials[0].command:
        theta, state = step.advance(state, np.array([[u]]))
        ours.append(theta[0, 0])
    np.testing.assert_allclose(ours, middle + half * fitted.predict(rows[: len(ours)]), rtol=0, atol=1e-9)
    rounding = np.finfo(np.float32).eps * np.abs(fitted.dual_coef_).sum() * half
    np.testing.assert_allclose(ours, middle + half * np.ravel(scaled), rtol=0, atol=4 * rounding)
    assert 4 * rounding < 0.05


@pytest.mark.parametrize("stride", [1, 3])
def test_the_derivative_is_that_of_finite_differences(stride: int) -> None:
    step = SvrStep(weights(stride))
    rng = np.random.default_rng(0)
    point = rng.uniform(0, 6, step.state_size + 1)
    nudges = 1e-5 * np.eye(point.size)
    ends = [np.hstack(step.advance((point + s * nudges)[:, :-1], (point + s * nudges)[:, -1:])) for s in (1, -1)]
    numeric = ((ends[0] - ends[1]) / 2e-5).T
    np.testing.assert_allclose(step.jacobian(point[:-1], float(point[-1])), numeric, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("stride", [1, 3])
def test_only_the_window_counts(stride: int) -> None:
    """Two pasts that agree over the window give the same angle; a command in it matters."""
    step = SvrStep(weights(stride))
    state = np.random.default_rng(1).uniform(0, 6, (1, step.state_size))
    theta, following = step.advance(state, np.array([[2.0]]))
    np.testing.assert_array_equal(following, np.append(state[0, 1:], 2.0)[None])
    for k in range(step.state_size):
        moved = state.copy()
        moved[0, k] += 0.5
        assert (step.advance(moved, np.array([[2.0]]))[0] != theta).item() == (k % stride == 0)


def test_a_hold_longer_than_the_window_holds_exactly() -> None:
    step = SvrStep(weights(2))
    state = np.random.default_rng(1).uniform(0, 6, (1, step.state_size))
    theta = []
    for _ in range(step.state_size + 10):
        angle, state = step.advance(state, np.array([[2.5]]))
        theta.append(angle.item())
    assert np.ptp(theta[step.state_size :]) == 0.0
    assert np.ptp(theta) > 0.0


@pytest.fixture(scope="module", params=["forward", "inverse"])
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> OnnxModel:
    trials = [t.swapped() for t in four_trials()] if request.param == "inverse" else four_trials()
    path = tmp_path_factory.mktemp("svr") / "model.onnx"
    report = export_onnx(SvrKind().fit(trials, FitRequest(training="paper")).bundle, path)
    assert report.kinks == 0
    assert report.casadi_deg < 1e-9
    assert report.runtime_deg < 1e-4
    return load_onnx(path)


@pytest.mark.slow
def test_the_file_carries_its_window_and_reproduces_its_trials(model: OnnxModel) -> None:
    facts = model.metadata
    assert facts.state_size == facts.warmup_samples == 49
    assert facts.training["c"] == 10.0
    result = evaluate(model, four_trials()[0])
    spread = facts.trained_angle.upper - facts.trained_angle.lower
    assert result.errors.rmse_deg < 0.05 * spread  # epsilon is a twentieth of the range


def test_trials_with_rest_before_them_give_windows_of_rest() -> None:
    """A trial held at its first command changes nothing: what lies before it is taken to be rest."""
    trial = four_trials()[0]
    held = np.concatenate([np.full(30, trial.command[0]), trial.command])
    t = 0.04 * np.arange(held.size)
    longer = Trial(t, held, np.concatenate([np.full(30, trial.angle[0]), trial.angle]))
    ours, theirs = (SvrStep(fit_svr([x], SMALL).weights) for x in (trial, longer))
    state, u = np.full((1, ours.state_size), 2.0), np.array([[2.3]])
    assert ours.advance(state, u)[0] == pytest.approx(theirs.advance(state, u)[0], abs=1.5)


def test_the_paper_trainings_are_the_papers() -> None:
    paper, grid = SVR_TRAININGS["paper"], SVR_TRAININGS["grid"]
    assert (paper.lags, paper.stride, paper.c, paper.gamma, paper.epsilon) == (50, 1, (10.0,), (0.1,), (0.1,))
    assert grid.c == (0.001, 0.01, 0.1, 1.0, 10.0)
    assert grid.gamma == (0.001, 0.01, 0.1, 1.0)
    assert (grid.folds, grid.epsilon, grid.by_trial) == (10, (0.1,), False)


@pytest.mark.parametrize("by_trial", [False, True])
def test_the_comparison_keeps_the_least_error_left_out(by_trial: bool) -> None:
    settings = SMALL.model_copy(
        update={"c": (1e-3, 10.0), "gamma": (1e-3, 0.05), "by_trial": by_trial, "folds": 3, "compared_samples": 200}
    )
    seen: list[tuple[int, float]] = []
    fit = fit_svr(four_trials(), settings, progress=lambda done, error: seen.append((done, error)))
    assert len(fit.judged) == 4
    assert fit.judged[fit.choice] == min(fit.judged.values())
    assert [done for done, _ in seen] == [1, 2, 3, 4, 5]
    assert all(a >= b for a, b in zip([e for _, e in seen], [e for _, e in seen][1:], strict=False))
    again = fit_svr(four_trials(), settings)
    np.testing.assert_array_equal(again.weights.coefficients, fit.weights.coefficients)


def test_no_more_samples_than_asked_for() -> None:
    fit = fit_svr(four_trials(), SMALL.model_copy(update={"samples": 120}))
    assert fit.samples == 120
    assert len(fit.weights.supports) <= 120


def test_an_angle_within_epsilon_is_an_error() -> None:
    with pytest.raises(FitError, match=r"no support vector.*expected a smaller epsilon"):
        fit_svr(four_trials(), SMALL.model_copy(update={"epsilon": (2.5,)}))


@pytest.mark.parametrize("changes", [{"gamma": 0.0}, {"bias": math.nan}, {"stride": 0}, {"coefficients": np.zeros(3)}])
def test_impossible_weights_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ModelError, match="SVR: got"):
        SvrWeights(**{**vars(weights()), **changes})


def test_the_graph_uses_operators_with_derivatives_only() -> None:
    assert "SVMRegressor" not in {node.op_type for node in svr_step_graph(weights()).node}
