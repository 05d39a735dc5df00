"""What goes on within trials: a drift does, a shift from one trial to the next does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.uncertainty import uncertainty

_SLOW_S = 3.0


def slow_within(hypothesis: Hypothesis, runs: Sequence[Run]) -> float:
    """Mean square of what an explanation leaves in means over three seconds [deg^2].

    A shift of each trial takes their mean away; what another cause moves within a trial stays.
    """
    total, count = 0.0, 0
    for run in runs:
        error, blocks = hypothesis.problem.error(hypothesis.q, run)[0], run.blocks(_SLOW_S)
        blocks = blocks - blocks.min()
        samples = np.bincount(blocks)
        means = np.bincount(blocks, error)[samples > 0] / samples[samples > 0]
        total, count = total + float(np.sum(means**2)), count + means.size
    return total / count


def drift_is_significant(validation: CrossValidation, hypothesis: Hypothesis, errors: float) -> bool:
    """Whether a drift shows within trials, once each trial may have a shift of its own beside it.

    Args:
        court: of the development runs.
        hypothesis: with a drift and without `trial_shift`.
        errors: standard errors by which its rate has to differ from zero, in the direction that it had without shifts.
    """
    problem = hypothesis.problem
    values = [list(v.values()) for v in problem.effect_values(hypothesis.q)]
    terms = replace(problem.terms, shift=True)
    shifted = validation.with_causes(problem.effects, terms, problem.retuned(hypothesis.q), [values])
    known = uncertainty(shifted.problem, shifted.q, validation.runs)
    k = problem.size - sum(len(c.free) for c in problem.effects)
    for c in problem.effects:
        for _ in c.free:
            error = float(np.sqrt(known.covariance[k, k]))
            if c.effect == "drift" and error > 0 and shifted.q[k] * np.sign(hypothesis.q[k]) > errors * error:
                return True
            k += 1
    return False
