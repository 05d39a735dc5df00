"""Lack of fit: a corner leaves curves behind a polynomial, a smooth gain does not."""

from __future__ import annotations

import pytest

from hystmpc.gap.decide.remaining_structure import remaining_curvature
from hystmpc.gap.logs.preparation import PreparedTrials, prepare
from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.problem import NO_TERMS
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Contact, NonlinearGain

from ..models.zoo import BACKLASH
from .engine_examples import moves, simulator_of, sine, trials_of

NOISE_DEG = 0.05


def fitted(behind: Operator, effect: str) -> tuple[Hypothesis, PreparedTrials]:
    """An effect of the output side fitted to a device that has another one."""
    chain = Chain(BACKLASH, after=(behind,))
    trials = trials_of(chain, [moves(1, 20.0), sine(0.1), moves(2, 20.0), sine(0.2), moves(3, 20.0)], NOISE_DEG)
    prepared = prepare(trials, simulator_of(BACKLASH))
    validation = CrossValidation(prepared.baseline, prepared.development)
    retuned = validation.retuned()
    library = candidates(Scale.of(prepared.development), prepared.baseline.effects)
    candidate = next(c for c in library if c.effect == effect and c.side == "output")
    z = retuned.problem.retuned(retuned.q)
    found = validation.with_causes((candidate,), NO_TERMS, z, [[start] for start in candidate.starts])
    return validation.polished(found), prepared


@pytest.mark.parametrize("angle", [45.0, 55.0])
def test_a_corner_leaves_curves_behind_a_polynomial(angle: float) -> None:
    hypothesis, prepared = fitted(Contact(angle, 0.3), "nonlinear_gain")
    assert hypothesis.mse > 4 * NOISE_DEG**2
    assert remaining_curvature(hypothesis, prepared.development, NOISE_DEG**2) > 0.7


def test_a_polynomial_leaves_none_behind_a_polynomial() -> None:
    hypothesis, prepared = fitted(NonlinearGain(0.005, 0.0, 50.0), "nonlinear_gain")
    left = remaining_curvature(hypothesis, prepared.development, NOISE_DEG**2)
    structural = max(hypothesis.mse - NOISE_DEG**2, 0.0)
    assert left * structural < 0.1 * NOISE_DEG**2


def test_what_is_no_more_than_the_floor_leaves_nothing() -> None:
    hypothesis, prepared = fitted(Contact(50.0, 0.3), "contact")
    assert remaining_curvature(hypothesis, prepared.development, 2 * hypothesis.mse) == 0.0
