"""Figures 5 and 6 of S2: what the device's hysteresis looks like, and the two ways to tip coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.models.chain import Chain
from hystmpc.models.fit.operators import OperatorFitSettings, fit_chain
from hystmpc.models.fit.starts import backlash_starts
from hystmpc.models.kernels.chain_kernels import compile_step
from hystmpc.models.maps import QuadraticMap
from hystmpc.trials.report import MEASURED, MODEL, PALETTE, REFERENCE, new_figure
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .job import Splits

FREQUENCY, REPEATS = "frequency", "repeatability"
TENSION, TIP_Y = "tension_n", "y_mm"


def hysteresis_figure(splits: Splits) -> Figure | None:
    """Figure 5: angle over displacement and over tension at several frequencies, and of equal trials; None without."""
    if FREQUENCY not in splits or REPEATS not in splits:
        return None
    with new_figure(7.0, 3.0) as figure:
        axes = figure.subplots(1, 3, sharey=True)
        for trial, colour in zip(splits[FREQUENCY], PALETTE * 2, strict=False):
            name, style = _name(trial), {"color": colour, "linewidth": 0.7}
            axes[0].plot(trial.command, trial.angle, label=name, **style)
            if TENSION in trial.channels:
                axes[1].plot(trial.channels[TENSION], trial.angle, **style)
        for trial, colour in zip(splits[REPEATS], PALETTE * 2, strict=False):
            axes[2].plot(trial.command, trial.angle, color=colour, linewidth=0.6)
        for axis, title, label in zip(
            axes,
            ("(a) by frequency", "(b) over tension", "(c) equal trials, 0.5 Hz"),
            ("displacement [mm]", "tension [N]", "displacement [mm]"),
            strict=True,
        ):
            axis.set(title=title, xlabel=label)
        axes[0].set_ylabel("tip angle [deg]")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _name(trial: Trial) -> str:
    return trial.source.rpartition("/")[2].replace("p", ".").replace("hz", " Hz")


@dataclass(frozen=True, eq=False)
class TipMapping:
    """Direct and composite map to the tip's Y by a backlash, on one test trial (S2 Fig. 6).

    Attributes:
        trial: the test trial with its channel Y.
        direct: backlash from command to Y [mm], (T,).
        composite: backlash from command to angle, then a parabola [mm], (T,).
        direct_rmse_mm, composite_rmse_mm: mean over all test trials of the RMSE of Y.
    """

    trial: Trial
    direct: Vec
    composite: Vec
    direct_rmse_mm: float
    composite_rmse_mm: float


def tip_mapping(splits: Splits, motion: str = "p2p") -> TipMapping | None:
    """Fit both maps on the training trials and run them over the test trials; None where trials have no Y.

    Raises:
        FitError: if a fit fails.
    """
    training, tests = splits[f"{motion}/train"], splits[f"{motion}/test"]
    if any(TIP_Y not in trial.channels for trial in (*training, *tests)):
        return None
    to_angle, to_y = _backlash(training), _backlash([_as_y(trial) for trial in training])
    angle, y = (np.concatenate([values(t) for t in training]) for values in (lambda t: t.angle, _y))
    parabola = QuadraticMap.fit(angle, y)
    direct = [_run(to_y, _as_y(trial)) for trial in tests]
    composite = [parabola(_run(to_angle, trial)) for trial in tests]
    errors = [
        float(np.mean([np.sqrt(np.mean((run - _y(t)) ** 2)) for run, t in zip(runs, tests, strict=True)]))
        for runs in (direct, composite)
    ]
    return TipMapping(tests[0], direct[0], composite[0], *errors)


def tip_mapping_figure(found: TipMapping) -> Figure:
    """Figure 6(c): Y over time, measured and by both maps, and their errors."""
    with new_figure(7.0, 4.0) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        t, measured = found.trial.t, _y(found.trial)
        above.plot(t, measured, color=REFERENCE, linewidth=2.2, alpha=0.5, label="device")
        for run, name, colour in ((found.direct, "direct", MODEL), (found.composite, "composite", MEASURED)):
            above.plot(t, run, color=colour, label=name)
            _error(below, t, run - measured, colour)
        above.set_ylabel("tip Y [mm]")
        below.set(xlabel="time [s]", ylabel="error [mm]")
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _error(axes: Axes, t: Vec, error: Vec, colour: str) -> None:
    axes.plot(t, error, color=colour, linewidth=0.9)
    axes.axhline(0.0, color=REFERENCE, linewidth=0.6)


def _y(trial: Trial) -> Vec:
    return trial.channels[TIP_Y]


def _as_y(trial: Trial) -> Trial:
    """The trial with Y in the place of the angle: what the direct map is fitted to."""
    return Trial(trial.t, trial.command, _y(trial), {}, trial.units, trial.source)


def _backlash(trials: list[Trial] | tuple[Trial, ...]) -> Chain:
    return fit_chain(backlash_starts(trials), trials, OperatorFitSettings(seed=1)).chain


def _run(chain: Chain, trial: Trial) -> Vec:
    """Free run (T,) from rest at the trial's first sample."""
    kernels = compile_step(chain.transition)
    rest = chain.rest(float(trial.angle[0]), float(trial.command[0]), chain.values)
    theta = np.empty((1, len(trial)))
    state, commands = np.array(rest).reshape(1, -1), trial.command[None].copy()
    kernels.simulate(state, commands, chain.values, np.array([trial.dt]), kernels.step_constants, theta)
    return theta[0]
