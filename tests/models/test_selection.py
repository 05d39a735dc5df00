"""Search for the causes: it goes on after an exchange, and a sure second cause is not hidden by a large first one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.identify.cross_validation import HeldOutErrors, Hypothesis
from hystmpc.models.identify.selection import SelectionSettings, select_again

SETTINGS, FLOOR = SelectionSettings(), 0.01
BLOCKS, SAMPLES = 24, 10


def judged(names: tuple[str, ...], mse: float) -> HeldOutErrors:
    """A hypothesis with even errors of that size on four trials [deg^2]."""
    effects = [SimpleNamespace(effect=name, free=()) for name in names]
    problem = cast("Any", SimpleNamespace(effects=effects, terms=SimpleNamespace(names=())))
    energy = mse * SAMPLES * (1 + 0.1 * np.cos(np.arange(BLOCKS)))
    run = np.arange(BLOCKS) // 6
    return HeldOutErrors(energy, np.full(BLOCKS, SAMPLES), run, Hypothesis(problem, np.empty(0), mse), (), ())


def chosen(**errors: float) -> set[str]:
    """Causes chosen among these, each with its error [deg^2]; names of several are joined by `__`."""
    made = [judged(tuple(name.split("__")) if name != "nothing" else (), mse) for name, mse in errors.items()]
    return set(select_again({j.hypothesis.effects: j for j in made}, SETTINGS, FLOOR).chosen.hypothesis.effects)


def test_after_an_exchange_a_further_cause_is_looked_for() -> None:
    found = chosen(nothing=10.0, nonlinear_gain=0.9, slack=1.0, nonlinear_gain__creep=0.88, slack__asymmetry=0.1)
    assert found == {"slack", "asymmetry"}


@given(st.floats(0.02, 0.6))
def test_beside_a_large_cause_a_sure_one_needs_most_of_what_is_left(left: float) -> None:
    found = chosen(nothing=10.0, lag=0.6, lag__creep=left)
    fall = 0.6 - left
    assert ("creep" in found) == (fall > SETTINGS.most_share * (0.6 - FLOOR) and fall > SETTINGS.sure_share * 9.99)
