"""Rules that take what a selection fitted and decide by the fit alone: BIC, and the largest single fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hystmpc.models.identify.cross_validation import HeldOutErrors, Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.selection import Selection
from hystmpc.trials.types import Vec

NOTHING = "none"


def fit_rules(selection: Selection, runs: Sequence[Run]) -> dict[str, str]:
    """What each rule would name: `bic` and `single fit`; no fit is made that the selection has not made.

    A rule that chooses several names is asked for the one which alone lowers the error of the fit the most.

    Args:
        selection: with everything that it tried.
        runs: the development runs that it fitted.
    """
    alone = {next(iter(names)): judged.hypothesis.mse for names, judged in selection.tried.items() if len(names) == 1}
    chosen = bic_choice(selection.tried, runs)
    return {
        "bic": min(sorted(chosen), key=lambda name: alone.get(name, np.inf), default=NOTHING),
        "single fit": min(sorted(alone), key=lambda name: alone[name], default=NOTHING),
    }


def bic_choice(tried: Mapping[frozenset[str], HeldOutErrors], runs: Sequence[Run]) -> frozenset[str]:
    """The set of effects with the least information criterion among those tried.

        BIC = n ln(mse) + k ln(n),    n = N (1 - r) / (1 + r)

    over the samples that were fitted: mse of the fit, k what it had free (what each trial has of its own counted by
    trial), N their number, and r the correlation of neighbouring residuals of the best fit of all, as of an AR(1)
    process, whose mean N samples determine like n independent ones. Source: G. Schwarz, Ann. Stat. 6 (1978) 461; n from
    G. V. Bayley and J. M. Hammersley, J. R. Stat. Soc. Suppl. 8 (1946) 184.

    Raises:
        ValueError: if nothing was tried.
    """
    best = min((judged.hypothesis for judged in tried.values()), key=lambda h: h.mse)
    n = effective_samples([best.problem.error(best.q, run)[0] for run in runs])

    def criterion(names: frozenset[str]) -> float:
        hypothesis = tried[names].hypothesis
        return n * float(np.log(max(hypothesis.mse, 1e-300))) + _free(hypothesis, runs) * float(np.log(n))

    return min(sorted(tried, key=lambda names: (len(names), sorted(names))), key=criterion)


def effective_samples(errors: Sequence[Vec]) -> float:
    """N (1 - r) / (1 + r) of errors (T,) by run, r their common correlation of neighbours; at least 2, at most N."""
    mean = float(np.mean(np.concatenate(list(errors))))
    centred = [error - mean for error in errors]
    power = sum(float(error[:-1] @ error[:-1] + error[1:] @ error[1:]) / 2 for error in centred)
    r = sum(float(error[1:] @ error[:-1]) for error in centred) / power if power > 0 else 0.0
    count = sum(error.size for error in errors)
    return float(np.clip(count * (1 - r) / (1 + r), 2.0, count)) if r > -1 else float(count)


def _free(hypothesis: Hypothesis, runs: Sequence[Run]) -> int:
    """Numbers that a fit could choose."""
    problem, q = hypothesis.problem, hypothesis.q
    count = q.size + bool(problem.terms.frequency_hz)
    if problem.terms.names:
        for run in runs:
            theta, by_q = problem.linearised(q, run)
            count += problem.terms.columns(run, theta[run.counts], by_q[run.counts]).shape[1]
    return count
