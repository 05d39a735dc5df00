"""Report of free runs: tables, figures and a page that compare model and measurement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from hystmpc.trials.figures import Look, LoopPanel, SimulatedTrial, loop_figure, time_figure
from hystmpc.trials.report import MEASURED, MODEL, Heading, Paragraph, Piece, Plot, Report, Table

from .evaluate import TrialEvaluation, error_sentence, error_table, start_sentences

_SHOWN, _SHOWN_OF_TWO = 3, 2  # trials in a figure, of one axis and of two
_MEASURED: Look = {"color": MEASURED, "label": "measured"}
_MODEL: Look = {"color": MODEL, "label": "model", "linewidth": 0.9}


def evaluation_report(
    title: str, subtitle: str, parts: Sequence[tuple[str, Sequence[TrialEvaluation]]], more: Sequence[Piece] = ()
) -> Report:
    """Page of an evaluation or a fit.

    Args:
        parts: sets of trials, the most important first, each with the words of `error_sentence`.
    """
    pieces = [piece for which, results in parts for piece in _pieces(which, results)]
    return Report(title, (*pieces, *more), subtitle)


def _pieces(which: str, results: Sequence[TrialEvaluation]) -> Iterator[Piece]:
    unit, command = results[0].trial.units.angle, results[0].trial.units.command
    yield Heading(error_sentence(results, which))
    what = "Tip: both angles." if results[0].axes else "No bias: without the mean error."
    note = f"Model less measurement [{unit}]. {what} Hold drift: while the command rests."
    yield Table(*error_table(results), note)
    yield from (Paragraph(f"{sentence}.") for sentence in start_sentences(results))
    shown = len(_worst(results))
    drawn = "of all trials" if len(results) <= shown else f"of the {shown} trials with the greatest error"
    outputs = "angles" if results[0].axes else "output"
    yield Plot(
        free_run_figure(results), f"Measured and simulated {outputs} {drawn}, and the error of the model below.", True
    )
    loops = [_loop(run) for run in _worst(results)]
    if results[0].axes:
        figure = loop_figure(loops, unit, unit, (f"angle x [{unit}]", f"angle y [{unit}]"))
        yield Plot(figure, f"Measured and simulated tip in the plane of both angles [{unit}], of the same trials.")
        return
    yield Plot(loop_figure(loops, command, unit), f"Output [{unit}] over command [{command}] of the same trials.")


def free_run_figure(results: Sequence[TrialEvaluation]) -> Figure:
    """Figure of measurement, model and error over time, for the trials with the greatest error."""
    return time_figure([panel for run in _worst(results) for panel in _simulated(run)], "error")


def _worst(results: Sequence[TrialEvaluation]) -> list[TrialEvaluation]:
    shown = _SHOWN_OF_TWO if results[0].axes else _SHOWN
    return sorted(results, key=lambda run: -run.errors.rmse_deg)[:shown]


def _simulated(run: TrialEvaluation) -> Iterator[SimulatedTrial]:
    """Panels of a trial, one for each axis."""
    unit, trial, theta = run.trial.units.angle, run.trial, run.theta.reshape(len(run.trial), -1)
    names = [f", {name}" for name in "xy"] if run.axes else [""]
    for i, (name, errors) in enumerate(zip(names, run.axes or (run.errors,), strict=True)):
        title = f"{Path(trial.source).name}{name}: RMSE {errors.rmse_deg:.3g} {unit}"
        measured = trial.angles[:, i], _MEASURED
        yield SimulatedTrial(title, trial.t, measured, [(theta[:, i], _MODEL)], unit, run.start)


def _loop(run: TrialEvaluation) -> LoopPanel:
    name, trial = Path(run.trial.source).name, run.trial
    if run.axes:
        return LoopPanel(name, [(*trial.angles.T, _MEASURED), (*run.theta.T, _MODEL)])
    return LoopPanel(name, [(trial.command, trial.angle, _MEASURED), (trial.command, run.theta, _MODEL)])
