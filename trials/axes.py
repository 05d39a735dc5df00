"""Trials of two bending axes: the second command and the second angle are channels of a log of one axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .errors import LogError
from .layouts import ANGLE_Y
from .signals import UncheckedLog
from .trial import Trial

COMMAND_Y = "command_y"
"""Channel of the second command, perhaps with the unit of the first one, as in `command_y_bar`."""


def both_axes(trials: Sequence[Trial]) -> list[Trial] | None:
    """Trials of two commands (T, 2) and two angles (T, 2), where all have the channels of a second axis; else None.

    Raises:
        LogError: if some have them and others not, a channel holds what is no number, or the angles are not in deg.
    """
    have = [_command_y(trial) != "" and ANGLE_Y in trial.channels for trial in trials]
    if not trials or not any(have):
        return None
    if not all(have):
        source = trials[have.index(False)].source
        raise LogError(f"{source}: got one axis, expected {COMMAND_Y} and {ANGLE_Y} as in the other logs")
    return [_joined(trial) for trial in trials]


def in_channels(trial: Trial) -> Trial:
    """Trial of one axis with the second one in channels, of a trial of commands (T, 2) and angles (T, 2).

    Raises:
        LogError: if it has neither one axis nor two.
    """
    if trial.commands.shape[1] == 1 and trial.angles.shape[1] == 1:
        return trial
    if trial.commands.shape[1] != 2 or trial.angles.shape[1] != 2:
        n, m = trial.commands.shape[1], trial.angles.shape[1]
        raise LogError(f"{trial.source}: got {n} commands and {m} angles, expected one of each, or two")
    (u, v), (x, y) = trial.commands.T, trial.angles.T
    channels = {**trial.channels, COMMAND_Y: v, ANGLE_Y: y}
    return Trial(trial.t, u, x, channels, trial.units, trial.source, trial.command_noise, trial.inputs)


def require_one_axis(trial: Trial) -> None:
    """Refuse a log of two axes where one is expected.

    Raises:
        LogError: if it has the channels of a second axis.
    """
    if _command_y(trial) and ANGLE_Y in trial.channels:
        raise LogError(
            f"{trial.source}: a log of two axes, expected one here; `fit` and `check` take both, `evaluate` and "
            "`diagnose` do with a model of two axes, a mapping file names the columns of one"
        )


def second_axis(log: UncheckedLog) -> UncheckedLog | None:
    """The second axis of a log of two, as a log of one; None where it has one axis."""
    name = _command_y(log)
    if not name or ANGLE_Y not in log.channels:
        return None
    return replace(log, command=log.channels[name], angle=log.channels[ANGLE_Y], channels={}, cells=None, note="")


def _command_y(trial: Trial | UncheckedLog) -> str:
    names = COMMAND_Y, f"{COMMAND_Y}_{trial.units.command}"
    return next((name for name in names if name in trial.channels), "")


def _joined(trial: Trial) -> Trial:
    if trial.units.angle != "deg":
        raise LogError(f"{trial.source}: got an output in {trial.units.angle}, expected two angles in deg")
    names = _command_y(trial), ANGLE_Y
    second = [np.asarray(trial.channels[name], dtype=np.float64) for name in names]
    for name, values in zip(names, second, strict=True):
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            raise LogError(
                f"{trial.source}: {name} has no number in {gaps.size} samples, the first {gaps[0]}, expected all"
            )
    return replace(
        trial,
        command=np.stack([trial.command, second[0]], axis=1),
        angle=np.stack([trial.angle, second[1]], axis=1),
        channels={name: values for name, values in trial.channels.items() if name not in names},
    )
