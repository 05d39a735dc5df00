"""Where on the motion: the residual's size along every trial, below the command."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.report import new_figure

from .evidence import Stage, TrialEvidence
from .look import COMMANDED, HEAT, LABEL, short, thin

_COLUMNS = 400  # more cannot be told apart across a page


def heat_figure(trials: Sequence[TrialEvidence], unit: str, stages: Sequence[Stage]) -> Figure:
    """Command over time, and below it |simulated - measured| as colour, one strip for each simulator.

    One scale of colour and one of time for all trials, so that strips can be compared.
    """
    longest = max(trial.trial.duration_s for trial in trials)
    sizes = np.concatenate([np.abs(trial.residual("retuned")) for trial in trials])
    top = float(np.quantile(sizes, 0.995)) or 1.0
    with new_figure(7.0, 0.7 + (0.72 + 0.17 * len(stages)) * len(trials)) as figure:
        ratios = (2.0, 0.6 * len(stages)) * len(trials)
        rows = figure.subplots(2 * len(trials), 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
        for command, strip, trial in zip(rows[::2], rows[1::2], trials, strict=True):
            _command(command, trial, unit)
            _strip(strip, trial, stages, top)
        rows[-1].set(xlim=(0.0, longest), xlabel="time [s]")
        bar = figure.colorbar(rows[-1].images[0], ax=rows.tolist(), aspect=14 * len(trials), pad=0.01, extend="max")
        bar.set_label("|residual| [deg]", fontsize=8.0)
    return figure


def _command(axes: Axes, trial: TrialEvidence, unit: str) -> None:
    t, command = thin(trial.trial.t - trial.trial.t[0], trial.trial.command)
    axes.plot(t, command, **COMMANDED)
    axes.set_ylabel(unit)
    axes.set_title(f"{short(trial.name, 50)} ({trial.role})", fontsize=8.5)


def _strip(axes: Axes, trial: TrialEvidence, stages: Sequence[Stage], top: float) -> None:
    """One row a simulator; samples that do not count stay white."""
    rows = np.array([_columns(trial, stage) for stage in stages])
    extent = (0.0, trial.trial.duration_s, len(stages) - 0.5, -0.5)
    axes.imshow(rows, aspect="auto", cmap=HEAT, vmin=0.0, vmax=top, extent=extent, interpolation="nearest")
    axes.set_yticks(range(len(stages)), [LABEL[stage] for stage in stages], fontsize=7.5)
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    for k in range(1, len(stages)):
        axes.axhline(k - 0.5, color="white", linewidth=1.2)


def _columns(trial: TrialEvidence, stage: Stage) -> np.ndarray:
    """Greatest |residual| in each of some equal parts of the trial [deg]."""
    size = np.full(len(trial.trial), np.nan)
    size[trial.start :] = np.abs(trial.residual(stage))
    parts = np.array_split(size, min(_COLUMNS, size.size))
    return np.array([np.nanmax(part) if np.isfinite(part).any() else np.nan for part in parts])
