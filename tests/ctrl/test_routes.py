"""Every kind of model by its fast route and by the reference route through CasADi: one command."""

from __future__ import annotations

import numpy as np
import pytest

from hystmpc.models.inverse.inverses import AccompaniedPredictor, CompanionInverse
from hystmpc.models.kinds.catalogue import all_kinds
from hystmpc.models.load import library_file
from hystmpc.models.model import Inverse, InvertiblePredictor, Predictor
from hystmpc.models.prediction.build import controller_model, predictor_for
from hystmpc.models.simulator import load_simulator

from ..models.casadi_predictor import CasadiPredictor
from ..models.tiny_kinds import FORWARD, example
from .test_solvers import compared, controller_for

pytest.importorskip("torch", reason="torch is an extra")
pytestmark = pytest.mark.slow

Pair = tuple[Predictor, Inverse]


def routes(kind: str) -> tuple[Pair, Pair]:
    """The fast route and the reference, each with its own inverse, over the same state."""
    model = example(kind, FORWARD).model
    invertible = isinstance(predictor_for(model), InvertiblePredictor)
    fast = controller_model(model, None if invertible else load_simulator(library_file("backlash"))).predictive
    slow = CasadiPredictor(model.casadi_function(), model.metadata)
    if invertible:
        return fast, (slow, fast[1])
    predictor, inverse = fast
    assert isinstance(predictor, AccompaniedPredictor)
    assert isinstance(inverse, CompanionInverse)
    beside = AccompaniedPredictor(slow, predictor.companion)
    return fast, (beside, CompanionInverse(beside, inverse.inverse))


# The state of a gated LSTM moves with |du|, which has a kink where the command rests: there each route takes another of
# its one-sided derivatives, so that plans that begin at rest may differ. In motion the derivatives are one.
KINKED = ("lstm",)


@pytest.mark.parametrize("kind", KINKED)
@pytest.mark.parametrize("moves", [(0.03,) * 8, (0.1, 0.1, 0.1, -0.1, -0.1, -0.1, 0.1, 0.1)], ids=["ramp", "turns"])
def test_two_routes_have_one_derivative_in_motion(kind: str, moves: tuple[float, ...]) -> None:
    (fast, _), (slow, _) = routes(kind)
    state, plan = fast.initial(45.0, 1.0), 1.0 + np.cumsum(moves)
    for ours, theirs in zip(fast.linearise(state, plan), slow.linearise(state, plan), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=TOLERANCE[kind])


# Operators have one fast route, whose derivatives tests/models/test_backends.py compares with CasADi for each of them:
# here one that inverts itself, and one that takes its inverse from another model.
OPERATORS = ("pi", "bouc_wen")
COMPARED = [
    kind.name for kind in all_kinds() if kind.name not in KINKED and (not kind.readable or kind.name in OPERATORS)
]


@pytest.mark.parametrize(
    ("kind", "blocks"), [*((kind, None) for kind in COMPARED), ("pi", (1, 2, 4, 8)), ("gru", (1, 2, 4, 8))]
)
def test_two_routes_give_one_command(kind: str, blocks: tuple[int, ...] | None) -> None:
    fast, slow = (controller_for(*pair, None, blocks) for pair in routes(kind))
    y = float(fast.init(45.0, 1.0).estimate.angles[0])
    ours, theirs = compared(fast, slow, y, 1.0, 15)
    assert np.ptp(ours) > 0.1
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=OF_COMMANDS.get(kind, 1e-6))


# Networks run in single precision: 1e-7 of 85 deg over 10 deg/mm, amplified by the weight of an error against a move.
TOLERANCE = dict.fromkeys(("lstm", "gru", "hb1", "hb2", "fnn", "fnn_hib", "svr"), 5e-6)
# In a command it is amplified once more, by the second linearisation of a plan on a close model: most of all in hb2.
OF_COMMANDS = TOLERANCE | {"hb2": 2e-5}
