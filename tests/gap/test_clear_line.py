"""A line that is clear is no other effect, even where another one is missing too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hystmpc.gap.decide.ambiguity import ambiguity_of
from hystmpc.models.identify.cross_validation import HeldOutErrors
from hystmpc.models.identify.selection import Selection

from ..models.test_selection import BLOCKS, SAMPLES, judged


def with_errors(names: tuple[str, ...], mse: float, uneven: float) -> HeldOutErrors:
    """A hypothesis with errors of that size, every other block worse by `uneven` [deg^2]."""
    made = judged(names, mse, uneven)
    signs = np.random.default_rng(len(names)).choice([-1.0, 1.0], (BLOCKS, SAMPLES))
    errors = np.sqrt(made.energy / SAMPLES)[:, None] * signs
    return replace(made, errors=tuple(errors.reshape(4, -1)))


@pytest.mark.parametrize(("uneven", "sets"), [(0.0, ()), (0.25, (("periodic_disturbance", "creep"),))])
def test_only_an_unclear_line_could_be_a_creep(uneven: float, sets: tuple[tuple[str, ...], ...]) -> None:
    lag, line = with_errors(("lag",), 0.32, 0.0), with_errors(("lag", "periodic_disturbance"), 0.28, uneven)
    creep = with_errors(("lag", "creep"), 0.22, 0.0)
    nothing = with_errors((), 3.0, 0.0)
    tried = {one.hypothesis.effects: one for one in (nothing, lag, line, creep)}
    assert ambiguity_of(Selection(nothing, line, tried), lambda hypothesis: True) == sets
