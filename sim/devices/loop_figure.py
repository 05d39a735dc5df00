"""Loops of a data set: tip angle over command, one panel a trial."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.report import MEASURED, new_figure
from hystmpc.trials.trial import Trial

_COLUMNS = 4
_PANEL_INCH = 1.9


def loop_figure(trials: Sequence[Trial], columns: int = _COLUMNS) -> Figure:
    """Measured loops, all on the same axes' limits, titled by the last part of the trial's source.

    Raises:
        ConfigError: if no trial is given, or commands of different units.
    """
    units = {trial.units.command for trial in trials}
    if len(units) != 1:
        raise ConfigError(
            f"loops: got commands in {', '.join(sorted(units)) or 'no unit'}, expected trials in one unit"
        )
    columns = min(columns, len(trials))
    rows = -(-len(trials) // columns)
    with new_figure(0.4 + _PANEL_INCH * columns, 0.4 + _PANEL_INCH * rows) as figure:
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, trial in zip(grid, trials, strict=False):
            axes.plot(trial.command, trial.angle, color=MEASURED, linewidth=0.8)
            axes.set_title(trial.source.rpartition("/")[2].removesuffix(".csv").replace("_", " "), fontsize=8.0)
        for axes in grid[len(trials) :]:
            axes.remove()
        figure.supxlabel(f"command [{units.pop()}]", fontsize=9.0)
        figure.supylabel("tip angle [deg]", fontsize=9.0)
        for axes in grid[max(len(trials) - columns, 0) : len(trials)]:
            axes.tick_params(labelbottom=True)
    return figure
