"""Networks and what they are made of: hybrids contain the operator itself, gradients exact, trainings the papers'."""

from __future__ import annotations

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.kinds.catalogue import all_kinds
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.networks.nodes import Scaling
from hystmpc.models.networks.settings import (
    DeviceFacts,
    NetworkSettings,
    RecurrentSettings,
    StreamTraining,
    WindowTraining,
)
from hystmpc.models.operators.hysteresis import Backlash, InverseBacklash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.simulator import ChainModel
from hystmpc.models.train.networks import fit_network
from hystmpc.models.train.runs import prepared, rest_of, scaling_of
from hystmpc.trials.errors import ConfigError, FitError
from hystmpc.trials.trial import Trial, Units
from hystmpc_lab.rivals.backlash import fitted_backlash, scaled_operator
from hystmpc_lab.rivals.kinds import FeedForwardSettings, HybridSettings

from .lstm_examples import DT, four_trials
from .tiny_kinds import NETWORKS
from .zoo import BACKLASH, simulator

torch = pytest.importorskip("torch", reason="torch is an extra")

from hystmpc_lab.rivals.networks_ import operator_step  # noqa: E402

FORWARD, INVERSE = Scaling(3.0, 3.0, 60.0, 30.0), Scaling(60.0, 30.0, 3.0, 3.0)
OPERATORS: dict[str, tuple[Operator, Scaling]] = {
    "backlash": (BACKLASH, FORWARD),
    "inverse backlash": (InverseBacklash(10.27, 10.70, 2.822, 2.003, 0.3), INVERSE),
}
every_operator = pytest.mark.parametrize(("operator", "scaling"), OPERATORS.values(), ids=OPERATORS.keys())
RECURRENT = ("lstm", "gru", "hb1", "hb2")


def motion(scaling: Scaling) -> np.ndarray:
    """Inputs (T,) with turns of all sizes, in the unit of what goes in."""
    t = np.arange(300) * DT
    return scaling.u_offset + 0.9 * scaling.u_scale * np.sin(2 * t) * np.exp(-0.1 * t) * np.cos(0.3 * t)


def by_operator(operator: Operator, u: np.ndarray, y: float) -> np.ndarray:
    """Outputs (T,) of the operator as the library has it, at rest at the first input and the output `y`."""
    chain = Chain(operator)
    model = ChainModel(simulator(chain))
    state = np.asarray(chain.rest(y, u[0], chain.values)).ravel()[None]
    outputs = []
    for v in u:
        theta, state = model.advance(state, np.array([[v]]))
        outputs.append(theta[0, 0])
    return np.array(outputs)


def hybrid(form: str, operator: Operator) -> object:
    """A hybrid whose LSTM says nothing yet."""
    torch.manual_seed(0)
    return HybridSettings(form=form, hidden=4, head_gain=0.0).network(DeviceFacts(operator=operator))


@every_operator
@pytest.mark.parametrize("form", ["serial", "parallel"])
def test_a_hybrid_that_has_learned_nothing_is_the_operator(form: str, operator: Operator, scaling: Scaling) -> None:
    net, u = hybrid(form, scaled_operator(operator, scaling)).double(), motion(scaling)  # type: ignore[attr-defined]
    first = float(by_operator(operator, u[:1], 0.0)[0])
    v = torch.tensor(scaling.scale_in(u))[None]
    with torch.no_grad():
        y, _ = net(v, net.start(torch.tensor([scaling.scale_out(np.array(first))], dtype=torch.float64)))
    found, expected = scaling.to_units(y[0].numpy()), by_operator(operator, u, first)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)  # parameters are single precision
    assert np.ptp(expected) > 0.5 * scaling.theta_scale


@every_operator
def test_gradients_through_the_recursion_are_those_of_finite_differences(operator: Operator, scaling: Scaling) -> None:
    from hystmpc_lab.rivals.networks_ import OperatorLayer

    inside = scaled_operator(operator, scaling)
    layer, rng = OperatorLayer(operator_step(inside)), np.random.default_rng(1)
    u = torch.tensor(rng.uniform(-1, 1, (2, 8)), requires_grad=True)
    p = torch.tensor(np.tile(inside.values, (2, 8, 1)), requires_grad=True)
    state = layer.start(torch.tensor(rng.uniform(-0.5, 0.5, 2))).requires_grad_()
    assert torch.autograd.gradcheck(lambda *parts: layer(*parts)[0], (u, p, state), eps=1e-7, atol=1e-5)


@every_operator
@pytest.mark.parametrize("form", ["serial", "parallel"])
def test_a_run_cut_in_two_is_one_run(form: str, operator: Operator, scaling: Scaling) -> None:
    net = hybrid(form, scaled_operator(operator, scaling))
    v = torch.tensor(scaling.scale_in(motion(scaling)), dtype=torch.float32)[None]
    with torch.no_grad():
        start = net.start(torch.zeros(1))  # type: ignore[attr-defined]
        whole, last = net(v, start)  # type: ignore[operator]
        head, state = net(v[:, :120], start)  # type: ignore[operator]
        tail, again = net(v[:, 120:], state)  # type: ignore[operator]
    torch.testing.assert_close(torch.cat([head, tail], dim=1), whole)
    torch.testing.assert_close(again, last)


def test_the_parallel_hybrid_starts_windows_from_its_own_backlash() -> None:
    net = hybrid("parallel", scaled_operator(BACKLASH, FORWARD))
    v = torch.tensor(FORWARD.scale_in(motion(FORWARD)), dtype=torch.float32)[None]
    with torch.no_grad():
        whole, _ = net(v, net.start(torch.zeros(1)))  # type: ignore[attr-defined, operator]
        shown = net.shown(v, torch.zeros_like(v))  # type: ignore[attr-defined]
        part, _ = net(v[:, 77:99], net.begin(v[:, :0], shown[:, 77]))  # type: ignore[attr-defined, operator]
    torch.testing.assert_close(part, whole[:, 77:99])


def test_a_history_buffer_holds_the_inputs_before() -> None:
    torch.manual_seed(0)
    net = FeedForwardSettings(hidden=(8, 8), history=5).network(DeviceFacts(rest=-0.7))
    v = torch.linspace(-1, 1, 30)[None]
    with torch.no_grad():
        outputs, state = net(v, net.start(torch.zeros(1)))
        padded = torch.cat([torch.full((1, 4), -0.7), v], dim=1)
        for k in (0, 3, 29):
            alone, _ = net(padded[:, k + 4 : k + 5], padded[:, k : k + 4])
            torch.testing.assert_close(alone[:, 0], outputs[:, k])
    torch.testing.assert_close(state, v[:, -4:])


@pytest.mark.parametrize("inverted", [False, True])
def test_the_backlash_of_a_hybrid_is_the_one_behind_the_trials(inverted: bool) -> None:
    trials = [trial.swapped() for trial in four_trials()] if inverted else four_trials()
    found = fitted_backlash(trials, skip_first_flexure=True)
    assert isinstance(found, InverseBacklash if inverted else Backlash)
    truth = Backlash(10.5, 10.5, 30 / 10.5, 23 / 10.5)
    tolerance = 0.1 if inverted else 1e-3  # an inverse backlash jumps across the dead band; the device did not
    np.testing.assert_allclose(found.values[:4], truth.values, rtol=tolerance)


def test_scaling_and_rest_follow_unit_and_direction() -> None:
    trials = four_trials()
    paper = NETWORKS["fnn_hib"].settings["paper"]
    pairs = [(trials, Scaling(0, 6, 0, 90), 0.0), ([t.swapped() for t in trials], Scaling(0, 90, 0, 6), 30 / 90)]
    for given, scaling, rest in pairs:
        assert scaling_of(given, paper.scaling) == scaling
        assert rest_of(given, scaling, paper.rest) == pytest.approx(rest)
    bar = [Trial(t.t, 0.4 * t.command, t.angle, units=Units("bar")) for t in trials]
    found = scaling_of(bar, paper.scaling)
    assert found.scale_in(np.array([min(t.command.min() for t in bar)])) == pytest.approx(-1, abs=1e-6)
    assert rest_of(bar, found, paper.rest) == pytest.approx(-1, abs=1e-6)


def test_windows_of_the_papers_begin_with_rest() -> None:
    trials = four_trials()
    for kind, before in (("lstm", 50), ("fnn", 50), ("fnn_hib", 50)):
        paper = NETWORKS[kind].settings["paper"]
        (ready,) = prepared(trials[:1], scaling_of(trials, paper.scaling), paper)
        assert ready.command.size == len(trials[0]) + before
        np.testing.assert_array_equal(ready.command[:before], 0.0)
        np.testing.assert_allclose(ready.angle[:before], 30 / 90)


@pytest.mark.parametrize("kind", sorted(NETWORKS))
def test_trainings_are_those_of_the_papers(kind: str) -> None:
    paper, best = NETWORKS[kind].settings["paper"], NETWORKS[kind].settings["best"]
    way = paper.training
    assert isinstance(way, WindowTraining)
    assert (way.length, way.batch, way.epochs, way.keep_after) == (50 if kind in RECURRENT else 1, 16, 100, 10)
    assert (paper.seed, paper.learning_rate, paper.warmup_samples) == (1, 1e-3, 0)
    if isinstance(paper.network, FeedForwardSettings):
        assert (paper.network.hidden, paper.network.history) == ((64, 64), 50 if kind == "fnn_hib" else 1)
    else:
        assert (paper.network.hidden, paper.network.layers, paper.network.memory_samples) == (64, 2, 0)
    assert isinstance(best.training, StreamTraining)
    for training in NETWORKS[kind].settings.values():
        assert training.kind == kind
        assert NetworkSettings.parse(training.model_dump()) == training
    assert [k.trainings for k in all_kinds() if k.name == kind] == [tuple(NETWORKS[kind].settings)]


def test_a_request_changes_what_it_names() -> None:
    asked = FitRequest(training="paper", seed=7, steps=3, hold_out=2, constancy_weight=1e-4, skip_first_flexure=True)
    for kind in NETWORKS:
        settings = NETWORKS[kind].training(asked)
        assert (settings.seed, settings.steps, settings.validation_trials) == (7, 3, 2)
        assert settings.first_flexure_weight == 0.0
        assert (settings.training.constancy_weight, settings.training.length) == (1e-4, 50)
    with pytest.raises(ConfigError, match="expected length >= 2"):
        WindowTraining.parse({"length": 1, "constancy_weight": 1e-4})


def small(epochs: int, keep_after: int, **changes: object) -> NetworkSettings:
    return NetworkSettings(
        network=RecurrentSettings(hidden=4, layers=1),
        warmup_samples=0,
        training=WindowTraining(length=20, epochs=epochs, keep_after=keep_after, windows_per_epoch=64),
        **changes,
    )


@pytest.mark.slow
def test_early_epochs_are_kept_only_where_no_later_one_is() -> None:
    fit = fit_network(four_trials(), small(5, 3, learning_rate=1e-12))
    late = fit.history[3:]
    assert fit.best_step > 3
    assert fit.validation_rmse_deg == min(look.validation_rmse_deg for look in late)
    early = fit_network(four_trials(), small(2, 3))
    assert early.validation_rmse_deg == min(look.validation_rmse_deg for look in early.history)


def test_constant_in_is_rewarded_for_constant_out() -> None:
    from hystmpc.models.train.updates_ import constancy

    still, moving = torch.zeros(4, 50), torch.linspace(0, 1, 50).repeat(4, 1)
    assert float(constancy(still, moving)) == 0.0
    assert float(constancy(moving, moving)) == pytest.approx(1.0, rel=1e-3)
    assert float(constancy(moving, still)) == pytest.approx(float(moving[0].std()) / 1e-4, rel=1e-3)


def test_a_hybrid_of_a_falling_angle_says_so() -> None:
    falling = [Trial(t.t, t.command, -t.angle, source=t.source) for t in four_trials()]
    with pytest.raises(FitError, match="the angle falls with the command"):
        fit_network(falling, NETWORKS["hb2"].settings["best"])
