"""Evaluation of a model of two axes on recorded trials: free runs, and the errors of each axis and of the tip."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.segments import first_flexure_end, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..evaluate import (
    HOLD_S,
    Errors,
    TrialEvaluation,
    errors_of,
    free_run,
    inputs_for,
    outside_share,
    require_rate_and_units,
    started,
)
from ..simulator import ChainModel
from ..start import TrialStart
from .model import AXES, TwoAxisModel

_MOVES = 0.1  # of its identified range: the start of an axis that travels less is not estimated


def evaluate_two_axes(model: TwoAxisModel, trial: Trial, skip_first_flexure: bool = False) -> TrialEvaluation:
    """Evaluate the free run of a model over one trial of commands (T, n) and two angles (T, 2).

    The tip's error is the length of that of both angles, so RMSE_tip^2 = RMSE_x^2 + RMSE_y^2. Where an axis begins in
    motion, the first seconds serve to estimate its state and are not scored (`models.start`).

    Args:
        skip_first_flexure: score from the first reversal of both commands on; a command that never moves has none.

    Returns:
        Angles (T, 2) [deg], errors of the tip, and those of both axes.

    Raises:
        ModelError: if sample times or units differ, the model has other commands, or its angles are not finite.
        LogError: if the first flexure is to be skipped and a command that moves never turns, or an input is missing.
    """
    require_rate_and_units(trial, model.axes[0].metadata())
    if (n := len(model.command_limits)) != (got := trial.commands.shape[1]):
        raise ModelError(f"{trial.source}: got a log of {got} commands and a model of {n}, expected as many of both")
    travels = model.travels(trial.commands)
    each = [_axis(trial, trial.commands if n == AXES else travels, trial.angles, i) for i in range(AXES)]
    drives = [_axis(trial, travels, model.in_axes(trial.angles), i) for i in range(AXES)]
    axes = [ChainModel(axis) for axis in model.axes]
    begun = [_started(axis, drive) for axis, drive in zip(axes, drives, strict=True)]
    held = np.tile(trial.commands[-1], (round(HOLD_S / trial.dt), 1))
    inputs = [inputs_for(axis, drive) for axis, drive in zip(axes, drives, strict=True)]
    theta = _run(model, np.vstack([trial.commands, held]), begun, inputs)
    if not np.all(np.isfinite(theta)):
        raise ModelError(f"{trial.source}: the model's angles are not finite over these commands")
    moving = [one for one in each if np.ptp(one.command) > 0]
    first = max([begin.lead for begin in begun] + [first_flexure_end(one) for one in moving if skip_first_flexure])
    both = np.all([_rests(one) for one in each], axis=0)
    edges = np.flatnonzero(np.diff(both.astype(int), prepend=0, append=0))
    holds = [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if a >= first] + [(len(trial), len(theta))]
    x, y = (errors_of(one, theta[:, i], first, holds) for i, one in enumerate(each))
    beyond = max(outside_share(drive, axis.metadata) for drive, axis in zip(drives, axes, strict=True))
    tip = _of_tip(trial, theta[: len(trial)], first, x, y)
    began = max(begun, key=lambda begin: begin.lead)
    return TrialEvaluation(trial, theta[: len(trial)], first, tip, beyond, began, (x, y))


def _started(axis: ChainModel, drive: Trial) -> TrialStart:
    """Start of one axis; one that hardly moves in this trial is at rest, since its angle shows the other axis."""
    trained, travel = axis.metadata.trained_command, drive.command
    if np.ptp(travel) < _MOVES * (trained.upper - trained.lower):
        return TrialStart(float(travel[0]), float(drive.angle[0]))
    return started(axis, drive)


def _axis(trial: Trial, commands: Vec, angles: Vec, axis: int) -> Trial:
    """One axis of a trial, with these commands and angles (T, 2)."""
    command, angle = (np.ascontiguousarray(values[:, axis]) for values in (commands, angles))
    return replace(trial, command=command, angle=angle, channels={}, source=f"{trial.source} ({'xy'[axis]})")


def _rests(axis: Trial) -> Vec:
    """Samples within holds (T,)."""
    mask = np.zeros(len(axis), dtype=bool)
    for a, b in segment(axis).holds:
        mask[a:b] = True
    return mask


def _run(model: TwoAxisModel, commands: Vec, begun: Sequence[TrialStart], inputs: Sequence[Mapping[str, Vec]]) -> Vec:
    """Angles (T, 2) [deg] over commands (T, n), each axis from its start; the last values of inputs hold."""
    early = max(len(begin.approach) for begin in begun)
    ways = [begin.approach or (begin.command,) * early for begin in begun]
    w = np.vstack([np.reshape(ways, (AXES, early)).T, model.travels(commands)])
    y = []
    for i, (axis, begin) in enumerate(zip(model.axes, begun, strict=True)):
        known = {name: np.pad(z, (early, len(commands) - len(z)), mode="edge") for name, z in inputs[i].items()}
        y.append(free_run(ChainModel(axis), np.ascontiguousarray(w[:, i]), replace(begin, approach=()), known))
    shared = 0.0 if model.cross_friction is None else model.cross_friction.run(w, model.dt_s)
    return np.asarray((np.stack(y, axis=1) + shared) @ model.turn.T)[early:]


def _of_tip(trial: Trial, theta: Vec, first: int, x: Errors, y: Errors) -> Errors:
    """Errors of the tip: lengths of those of both axes; its range is the diagonal of the measured angles' box."""
    rmse, range_deg = math.hypot(x.rmse_deg, y.rmse_deg), math.hypot(*np.ptp(trial.angles[first:], axis=0))
    return Errors(
        rmse,
        math.hypot(x.bias_deg, y.bias_deg),
        math.hypot(x.offset_free_rmse_deg, y.offset_free_rmse_deg),
        float(np.max(np.hypot(*(theta - trial.angles)[first:].T))),
        rmse / range_deg if range_deg > 0 else math.inf,
        math.hypot(x.hold_drift_deg, y.hold_drift_deg),
    )
