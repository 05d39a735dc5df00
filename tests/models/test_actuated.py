"""A model behind an actuator with a lag is the chain lag, model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.inverse.drive import Drive, DrivenInverse
from hystmpc.models.inverse.one_step import CompiledInverse
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.prediction.actuated import ActuatedPredictor
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.trials.errors import ModelError

from .zoo import CHAINS, simulator

LAG_S = 0.08


@pytest.mark.parametrize("name", ["backlash", "pi"])
def test_it_predicts_as_the_chain_of_lag_and_model(name: str) -> None:
    """Values, roll-outs and Jacobians; the chain's lag is an operator, ours a matrix."""
    core = CHAINS[name].core
    chain = CompiledPredictor.of_simulator(simulator(Chain(core, before=(Lag(LAG_S),))))
    ours = ActuatedPredictor(CompiledPredictor.of_simulator(simulator(Chain(core))), LAG_S)
    plan = 2.0 + np.cumsum(np.random.default_rng(5).normal(0, 0.3, 15))
    states, angles = [], []
    for predictor in (chain, ours):
        # The chain rests at its lowest command and is led to 2 mm; both have long forgotten how.
        state = predictor.initial(40.0, 0.0)
        for _ in range(200):
            _, state = predictor.advance(state, 2.0)
        states.append(state)
        x, stepped = state, []
        for u in plan:
            theta, x = predictor.advance(x, float(u))
            stepped.append(theta)
        angles.append(stepped)
    np.testing.assert_allclose(angles[1], angles[0], atol=1e-8)
    np.testing.assert_allclose(ours.rollout(states[1], np.stack([plan, plan[::-1]]))[0], angles[0], atol=1e-8)
    for mine, theirs in zip(ours.linearise(states[1], plan), chain.linearise(states[0], plan), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-8)


def test_the_inverse_is_the_command_at_which_it_comes_to_rest() -> None:
    inner = CompiledPredictor.of_simulator(simulator(CHAINS["pi"]))
    predictor = ActuatedPredictor(inner, LAG_S)
    inverse = DrivenInverse(
        CompiledInverse(inner, -5.0, 15.0), inner, Drive(predictor.lag), sizes=(1, 0), front_first=False
    )
    state, u = predictor.initial(45.0, 2.0), 2.0
    for wanted in 45 + 10 * np.sin(np.linspace(0, 6, 9)):
        for _ in range(60):
            u = inverse.command(state, float(wanted), u)
            theta, state = predictor.advance(state, u)
        assert theta == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("lag_s", [0.0, -0.1, math.nan, math.inf])
def test_an_impossible_lag_is_refused(lag_s: float) -> None:
    with pytest.raises(ModelError, match="expected a positive time constant"):
        ActuatedPredictor(CompiledPredictor.of_simulator(simulator(CHAINS["pi"])), lag_s)
