"""Trials of two bending axes: further commands and the second angle are channels of a log of one axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .errors import LogError
from .layouts import ANGLE_Y
from .signals import UncheckedLog
from .trial import Trial
from .types import Vec

COMMAND_Y = "command_y"
"""Channel of the second command of two, perhaps with the unit of the first one, as in `command_y_bar`."""

_FURTHER = "command_{}"  # channels of the second to last command of three and more


def both_axes(trials: Sequence[Trial]) -> list[Trial] | None:
    """Trials of commands (T, n) and two angles (T, 2), where all have the channels of a second axis; else None.

    The second of two commands is `command_y`. Of more, such as those of three tendons, the second one is `command_2`
    and so on.

    Raises:
        LogError: if some have them and others not, a channel holds what is no number, or the angles are not in deg.
    """
    have = [_further(trial) if ANGLE_Y in trial.channels else [] for trial in trials]
    if not any(have):
        return None
    for trial, names in zip(trials, have, strict=True):
        if len(names) != (most := max(map(len, have))):
            wanted = f"{COMMAND_Y} and {ANGLE_Y}" if most == 1 else f"{most + 1} commands"
            got = "one axis" if not names else f"{len(names) + 1} commands"
            raise LogError(f"{trial.source}: got {got}, expected {wanted} as in the other logs")
    return [_joined(trial, names) for trial, names in zip(trials, have, strict=True)]


def pulls(commands: Vec, angles_deg: Vec) -> Vec:
    """Travel of each axis by every command (2, n), by the gains of a line from commands (T, n) to angles (T, 2).

        theta = G u + constant by least squares,    row i = sqrt(2 / n) G_i / |G_i|

    Tendons at the angles phi_k that pull alike get Clarke's coordinates, 2 / n [cos phi_k; sin phi_k]. Commands that
    never move apart share their gain. The row of an angle that follows no command is zero.
    """
    u, theta = commands - commands.mean(0), angles_deg - angles_deg.mean(0)
    gains = np.linalg.lstsq(u, theta, rcond=1e-6)[0].T
    sizes = np.linalg.norm(gains, axis=1, keepdims=True)
    return np.asarray(np.sqrt(2 / u.shape[1]) * gains / np.maximum(sizes, 1e-300))


def in_channels(trial: Trial) -> Trial:
    """Trial of one axis with the second one in channels, of a trial of commands (T, 2) and angles (T, 2).

    Raises:
        LogError: if it has neither one axis nor two.
    """
    if trial.commands.shape[1] == 1 and trial.angles.shape[1] == 1:
        return trial
    n, m = trial.commands.shape[1], trial.angles.shape[1]
    if n < 2 or m != 2:
        raise LogError(f"{trial.source}: got {n} commands and {m} angles, expected one of each, or two angles")
    (u, *others), (x, y) = trial.commands.T, trial.angles.T
    names = [COMMAND_Y] if n == 2 else [_FURTHER.format(k) for k in range(2, n + 1)]
    channels = {**trial.channels, **dict(zip(names, others, strict=True)), ANGLE_Y: y}
    return Trial(trial.t, u, x, channels, trial.units, trial.source, trial.command_noise, trial.inputs)


def require_one_axis(trial: Trial) -> None:
    """Refuse a log of two axes where one is expected.

    Raises:
        LogError: if it has the channels of a second axis.
    """
    if _further(trial) and ANGLE_Y in trial.channels:
        raise LogError(
            f"{trial.source}: a log of two axes, expected one here; `fit` and `check` take both, `evaluate` and "
            "`diagnose` do with a model of two axes, a mapping file names the columns of one"
        )


def axes_apart(log: UncheckedLog) -> tuple[UncheckedLog, ...]:
    """Both axes of a log of two, each as a log of one; the log itself where it has one axis.

    Of more than two commands each axis gets its travel, see `pulls`, of the samples that are finite.
    """
    names = _further(log)
    if not names or ANGLE_Y not in log.channels:
        return (log,)
    theta = np.stack([log.angle, log.channels[ANGLE_Y]], axis=1)
    commands = np.stack([log.command, *(log.channels[name] for name in names)], axis=1)
    if len(names) > 1:
        finite = np.isfinite(commands).all(axis=1) & np.isfinite(theta).all(axis=1)
        commands = commands @ pulls(commands[finite], theta[finite]).T if finite.any() else commands[:, :2]
    first = replace(log, command=commands[:, 0])
    return first, replace(log, command=commands[:, 1], angle=theta[:, 1], channels={}, cells=None, note="")


def _further(trial: Trial | UncheckedLog) -> list[str]:
    """Channels of the commands behind the first one: that of two, or `command_2` to the last one without a gap."""

    def channel(name: str) -> str:
        return next((one for one in (name, f"{name}_{trial.units.command}") if one in trial.channels), "")

    if y := channel(COMMAND_Y):
        return [y]
    made: list[str] = []
    while name := channel(_FURTHER.format(len(made) + 2)):
        made.append(name)
    return made


def _joined(trial: Trial, further: Sequence[str]) -> Trial:
    if trial.units.angle != "deg":
        raise LogError(f"{trial.source}: got an output in {trial.units.angle}, expected two angles in deg")
    names = *further, ANGLE_Y
    others = [np.asarray(trial.channels[name], dtype=np.float64) for name in names]
    for name, values in zip(names, others, strict=True):
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            raise LogError(
                f"{trial.source}: {name} has no number in {gaps.size} samples, the first {gaps[0]}, expected all"
            )
    return replace(
        trial,
        command=np.stack([trial.command, *others[:-1]], axis=1),
        angle=np.stack([trial.angle, others[-1]], axis=1),
        channels={name: values for name, values in trial.channels.items() if name not in names},
    )
