"""Simple rules for comparison with the diagnosis: correlation of signatures, BIC, largest single fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hystmpc.models.identify.cross_validation import HeldOutErrors, Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.selection import Selection
from hystmpc.models.simulator import Simulator
from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .retuning import retune, rms

_NEWS = 1.5  # retuned error over the simulator's own, below which the rule says that there is nothing
NOTHING = "none"


def correlation_rule(trials: Sequence[Trial], simulator: Simulator) -> str:
    """Name whose one-line signature correlates most with the retuned simulator's residual; `none` for a small one.

    Signatures: speed (lag), acceleration (delay), |speed| times direction of loading (rate_dependence), time in the
    hold (creep), clock (drift), before the first reversal (first_flexure), low command (slack), high command
    (contact), command squared (nonlinear_gain), direction times command (asymmetry), mean by trial (trial_shift).
    """
    commands = [trial.command for trial in trials]
    tuned = retune(simulator, commands, [trial.angle for trial in trials])
    errors = [trial.angle - run for trial, run in zip(trials, tuned.angles, strict=True)]
    known = [residual.rmse_deg for residual in simulator.identification.residuals] or [0.0]
    if rms(errors) < _NEWS * float(np.sqrt(np.mean(np.square(known)))):
        return "none"
    error = np.concatenate(errors)
    signatures = _signatures(trials, errors)
    scores = {name: abs(_correlation(signature, error)) for name, signature in signatures.items()}
    return max(scores, key=lambda name: scores[name])


def _signatures(trials: Sequence[Trial], errors: Sequence[Vec]) -> dict[str, Vec]:
    parts: dict[str, list[Vec]] = {}
    clock = 0.0
    for trial, error in zip(trials, errors, strict=True):
        u, segments = trial.command, segment(trial)
        speed, direction = np.gradient(u, trial.t), segments.labels.astype(np.float64)
        bend = (u - u.min()) / max(float(np.ptp(u)), 1e-9)
        held = np.zeros(len(trial))
        for start, stop in segments.runs(Motion.HOLD):
            held[start:stop] = (trial.t[start:stop] - trial.t[start]) * bend[start]
        first = int(segments.reversals[0]) if segments.reversals.size else 0
        new = {
            "lag": speed,
            "delay": np.gradient(speed, trial.t) + speed,
            "rate_dependence": np.sign(speed) * np.sqrt(np.abs(speed)),
            "creep": held,
            "drift": clock + trial.t,
            "first_flexure": (np.arange(len(trial)) <= first).astype(np.float64),
            "slack": np.exp(-bend / 0.1),
            "contact": np.maximum(bend - 0.7, 0.0),
            "nonlinear_gain": bend**2,
            "asymmetry": direction * bend,
            "trial_shift": np.full(len(trial), error.mean()),
        }
        for name, signature in new.items():
            parts.setdefault(name, []).append(signature)
        clock += trial.duration_s
    return {name: np.concatenate(pieces) for name, pieces in parts.items()}


def _correlation(a: Vec, b: Vec) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0


def fit_rules(selection: Selection, runs: Sequence[Run]) -> dict[str, str]:
    """Answers of the rules `bic` and `single fit`, from the fits of the selection.

    Of several names chosen by a rule, the one that alone lowers the error of the fit most is the answer.
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
    """
    best = min((judged.hypothesis for judged in tried.values()), key=lambda h: h.mse)
    n = effective_samples([best.error(run) for run in runs])

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
    """Number of free parameters of a fit."""
    problem, q = hypothesis.problem, hypothesis.q
    count = q.size + bool(problem.terms.frequency_hz)
    if problem.terms.names:
        for run in runs:
            theta, by_q = problem.linearised(q, run)
            count += problem.terms.columns(run, theta[run.counts], by_q[run.counts]).shape[1]
    return count
