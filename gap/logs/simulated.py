"""The user's own simulator: its recorded output, and the stand-in that says how an effect would change this output.

    prediction = stand_in(effect(command)) + simulated - stand_in(command)

The stand-in's error on the recorded commands is known, and taken off: the prediction without an effect is what the
user's simulator gave. Both runs of the stand-in begin at the same command, one at the first measured angle and the
other at the first simulated one, so that another state at the start is no gap.

Source: additive correction of a surrogate model: Eldred, Giunta, Collis, Second-order corrections for surrogate-based
optimization with model hierarchies, AIAA 2004-4457.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import GapError
from hystmpc.trials.layouts import CANONICAL, OUTPUT_COLUMN, Layout
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

SIMULATED = "simulated"
"""Channel with the output of the user's simulator; `simulated_UNIT`, as `simulated_deg`, in a log."""

PLAYED = Layout(
    name="simulated",
    summary="time_s, command (or command_mm, command_bar, ...), simulated_deg (or simulated_mm, ...)",
    time=CANONICAL.time,
    command=CANONICAL.command,
    angle=f"{SIMULATED}_deg",
    other_angles={f"{SIMULATED}_{unit}": unit for unit in OUTPUT_COLUMN if unit != "deg"},
)
"""Columns of a file with the output of a simulator and no measured angle."""

_SAME_COMMAND = 0.01  # of the command's range, RMS: rounding and another clock stay below


def simulated_name(trial: Trial) -> str | None:
    """Name of the channel with the simulator's output; None where the trial has none."""
    names = (f"{SIMULATED}_{trial.units.angle}", SIMULATED)
    return next((name for name in names if name in trial.channels), None)


def simulated_angle(trial: Trial) -> Vec:
    """Output (T,) of the user's simulator, in the unit of the angle.

    Raises:
        GapError: if the trial has none, or not at every sample.
    """
    name = simulated_name(trial)
    if name is None:
        raise GapError(
            f"{trial.source}: no column {SIMULATED}_{trial.units.angle}, expected the simulator's output as in the "
            "other logs, or --sim and no such column"
        )
    values = trial.channels[name]
    if missing := int(np.count_nonzero(~np.isfinite(values))):
        raise GapError(f"{trial.source}: {name} lacks {missing} of {values.size} samples, expected one at every time")
    return values


def have_simulated(trials: Sequence[Trial]) -> bool:
    """Whether the trials hold the output of the user's simulator.

    Raises:
        GapError: if some do and others do not, or if samples are missing.
    """
    if not any(simulated_name(trial) for trial in trials):
        return False
    for trial in trials:
        simulated_angle(trial)
    return True


def as_simulated(trial: Trial) -> Trial:
    """Trial whose angle is the output of the user's simulator, without further channels."""
    return replace(trial, angle=simulated_angle(trial), channels={})


def with_output(trial: Trial, output: Vec) -> Trial:
    """Trial with the output (T,) of the user's simulator as a channel, in place of an older one."""
    channels: Mapping[str, Vec] = {**trial.channels, SIMULATED: output}
    kept = {name: values for name, values in channels.items() if name != f"{SIMULATED}_{trial.units.angle}"}
    return replace(trial, channels=kept)


def with_simulated(trials: Sequence[Trial], folder: Path, read: Callable[[Path], Trial]) -> list[Trial]:
    """Trials with the simulator's output from the files of a folder that have the same names.

    Args:
        read: reads one file; its channel `simulated_UNIT` counts, else its angle.

    Raises:
        GapError: if a file is missing, is of another command, or ends before the trial.
    """
    return [_joined(trial, read(_same_name(trial, folder))) for trial in trials]


def _same_name(trial: Trial, folder: Path) -> Path:
    file = folder / Path(trial.source).name
    if not file.is_file():
        raise GapError(f"{file}: no such file, expected the simulator's output for the command of {trial.source}")
    return file


def _joined(trial: Trial, played: Trial) -> Trial:
    if played.units != trial.units:
        got, wanted = played.units, trial.units
        raise GapError(
            f"{played.source}: {got.command} to {got.angle}, expected {wanted.command} to {wanted.angle} as in the log"
        )
    late = 1.5 * trial.dt
    if played.t[0] > trial.t[0] + late or played.t[-1] < trial.t[-1] - late:
        raise GapError(
            f"{played.source}: {played.t[0]:.4g} to {played.t[-1]:.4g} s, expected all of {trial.t[0]:.4g} to "
            f"{trial.t[-1]:.4g} s as in the log"
        )
    command = np.interp(trial.t, played.t, played.command)
    off, span = float(np.sqrt(np.mean((command - trial.command) ** 2))), float(np.ptp(trial.command))
    if off > _SAME_COMMAND * span:
        raise GapError(
            f"{played.source}: its command differs by {off:.3g} {trial.units.command} RMS from that of {trial.source}, "
            f"expected the same command, within {100 * _SAME_COMMAND:g} % of its range"
        )
    output = simulated_angle(played) if simulated_name(played) else played.angle
    return with_output(trial, np.interp(trial.t, played.t, output))
