"""The state at rest of the engine, where an exported controller starts, is that of the predictor in Python."""

import numpy as np
import pytest

from hystmpc.core.library import engine
from hystmpc.models.chain import Chain
from hystmpc.models.load import library_file, load_model
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.operators.static_curves import Contact, NonlinearGain
from hystmpc.models.prediction.build import ParallelPredictor, controller_model, predictor_for
from hystmpc.models.prediction.compiled import CompiledPredictor
from tests.models.start_examples import random_chain
from tests.models.test_connections import CASES, model_of
from tests.models.zoo import BACKLASH, DEADBAND, DT, RATE_PI, simulator


def at_rest(predictor, y, u):
    """State (S,) by the engine."""
    rule, part, x = predictor.rest_part, predictor.part, np.empty(predictor.part.fields["states"])
    room = np.empty(engine().at_rest_bytes(rule.address, part.address), np.uint8)
    assert engine().at_rest(rule.address, part.address, y, u, x, room) == 0
    return x


def same(predictor, points, tolerance=1e-8):
    for y, u in points:
        np.testing.assert_allclose(at_rest(predictor, y, u), predictor.initial(y, u), rtol=1e-7, atol=tolerance)


POINTS = [(45.0, 2.0), (60.0, 3.3), (25.0, 0.0), (80.0, 6.0), (0.0, 0.0), (200.0, 5.0), (-50.0, 1.0)]
CHAINS = {
    "backlash": Chain(BACKLASH),
    "plays": Chain(RATE_PI),
    "behind a lag": Chain(RATE_PI, before=(Delay(2 * DT, 2), Lag(0.08))),
    "curve behind": Chain(BACKLASH, after=(DEADBAND,)),
    "curves on either side": Chain(
        BACKLASH, (NonlinearGain(0.03, 0.0, 2.0), Lag(0.1)), (Contact(60.0, 0.4, 5.0), Lag(0.05))
    ),
    "creep": Chain(BACKLASH, before=(Creep((0.15,), (8.0,)),)),
}


@pytest.mark.parametrize("name", CHAINS)
def test_a_chain(name):
    same(CompiledPredictor.of_simulator(simulator(CHAINS[name])), POINTS)


@pytest.mark.parametrize("seed", range(12))
def test_any_chain(seed):
    rng = np.random.default_rng(seed)
    predictor = CompiledPredictor.of_simulator(simulator(random_chain(rng)))
    same(predictor, zip(rng.uniform(0, 90, 20).tolist(), rng.uniform(0, 6, 20).tolist(), strict=True), 1e-6)


@pytest.mark.parametrize("case", CASES, ids=" ".join)
def test_connected_models(case):
    same(predictor_for(model_of(*case)), POINTS[:4])


@pytest.mark.parametrize("name", ["lstm", "pi", "auto"])
@pytest.mark.parametrize("lag_s", [0.0, 0.08])
def test_models_of_controllers(name, lag_s):
    model = controller_model(load_model(library_file(name), start="conditioned"), actuator_lag_s=lag_s)
    same(model.predictive[0], POINTS[:4])


def test_two_chains_side_by_side():
    """The first one rests at the angle, the second one at zero."""
    first, second = (CompiledPredictor.of_simulator(simulator(CHAINS[name])) for name in ("backlash", "plays"))
    same(ParallelPredictor(first, second), POINTS[:4])


def test_odd_numbers_end():
    predictor = CompiledPredictor.of_simulator(simulator(Chain(Backlash(10.0, 10.0, 2.0, 1.0), after=(DEADBAND,))))
    for y, u in ((np.nan, 1.0), (np.inf, 1.0), (45.0, np.nan), (1e308, -1e308), (5e-324, np.inf)):
        assert at_rest(predictor, y, u).shape == (predictor.part.fields["states"],)
