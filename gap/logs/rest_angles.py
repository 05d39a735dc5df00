"""Angles at rest: where they differ from trial to trial by more than any motion changes them, trials begin alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hystmpc.models.identify.runs import Run

_SAME = 0.01  # of the command's range: rests this near to each other are one
_LEAST_SAMPLES = 3
_BEYOND = 3.0  # times what motions change the angle at rest by: more does not come from a motion
_BEYOND_FORM = 2.0  # times the model-form error (RMS): less does not matter


def common_rest(runs: tuple[Run, ...], form_mse: float) -> tuple[Run, ...]:
    """The runs with one angle at rest where a friction cannot be why their angles at rest differ.

    A friction keeps an angle until a motion changes it. A trial that comes back to the command at which it rested shows
    how much its motion did. Where the angles at rest of the trials differ by three times the most that any of these
    motions did, something else has moved them between the trials: a mounting, a drift, a zero. A core must not take
    that up as the state in which its plays begin: wide plays would keep it for the whole trial. All runs then begin
    at the median angle, and what differs is left in the error.

    Args:
        runs: all trials.
        form_mse: model-form error of the simulator [deg^2].
    """
    span = max(float(run.command.max()) for run in runs) - min(float(run.command.min()) for run in runs)
    commands, angles = np.array([(run.rest_command, run.rest_angle) for run in runs]).T
    changes = [change for run in runs if (change := _change(run, _SAME * span)) is not None]
    spread = float(np.ptp(angles))
    if 2 * len(changes) < len(runs) or np.ptp(commands) > _SAME * span:
        return runs
    if spread <= max(_BEYOND * max(changes), _BEYOND_FORM * form_mse**0.5):
        return runs
    return tuple(replace(run, rest_angle=runs[0].rest_angle) for run in runs)


def _change(run: Run, near: float) -> float | None:
    """By how much the angle at rest has changed with the motion [deg]; None if the command does not come back."""
    away = np.flatnonzero(np.abs(run.command - run.rest_command) > near)
    back = run.angle[away[-1] + 1 :] if away.size else run.angle[:0]
    return abs(float(np.mean(back)) - run.rest_angle) if back.size >= _LEAST_SAMPLES else None
