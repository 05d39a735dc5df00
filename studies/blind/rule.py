"""A rule of thumb to set beside the diagnosis: the name whose signature correlates most with the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.models.simulator import Simulator
from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .retuning import retune, rms

_NEWS = 1.5  # retuned error over the simulator's own, below which the rule says that there is nothing


def correlation_rule(trials: Sequence[Trial], simulator: Simulator) -> str:
    """Name whose one-line signature correlates most with what the retuned simulator leaves; `none` for little.

    Signatures: speed (lag), acceleration (delay), |speed| times direction of loading (rate_dependence), time in the
    hold (creep), clock (drift), before the first reversal (first_flexure), low command (slack), high command
    (contact), command squared (nonlinear_gain), direction times command (asymmetry), mean by trial (trial_shift).

    Raises:
        FitError: if the simulator cannot be retuned.
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
