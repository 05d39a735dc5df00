"""Report of free runs: tables, figures and a page that compare model and measurement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from hystmpc.trials.figures import Look, LoopPanel, SimulatedTrial, loop_figure, time_figure
from hystmpc.trials.report import MEASURED, MODEL, Heading, Paragraph, Piece, Plot, Report, Table

from .evaluate import ERROR_COLUMNS, TrialEvaluation, error_rows, error_sentence, start_sentences

_SHOWN = 3  # trials in a figure
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
    note = f"Model less measurement [{unit}]. No bias: without the mean error. Hold drift: while the command rests."
    yield Table(ERROR_COLUMNS, error_rows(results), note)
    yield from (Paragraph(f"{sentence}.") for sentence in start_sentences(results))
    drawn = "of all trials" if len(results) <= _SHOWN else f"of the {_SHOWN} trials with the greatest error"
    worst = _worst(results)
    yield Plot(
        free_run_figure(results), f"Measured and simulated output {drawn}, and the error of the model below.", True
    )
    loops = loop_figure([_loop(run) for run in worst], command, unit)
    yield Plot(loops, f"Output [{unit}] over command [{command}] of the same trials.")


def free_run_figure(results: Sequence[TrialEvaluation]) -> Figure:
    """Figure of measurement, model and error over time, for the three trials with the greatest error."""
    return time_figure([_simulated(run) for run in _worst(results)], "error")


def _worst(results: Sequence[TrialEvaluation]) -> list[TrialEvaluation]:
    return sorted(results, key=lambda run: -run.errors.rmse_deg)[:_SHOWN]


def _simulated(run: TrialEvaluation) -> SimulatedTrial:
    unit, trial = run.trial.units.angle, run.trial
    title = f"{Path(trial.source).name}: RMSE {run.errors.rmse_deg:.3g} {unit}"
    return SimulatedTrial(title, trial.t, (trial.angle, _MEASURED), [(run.theta, _MODEL)], unit, run.start)


def _loop(run: TrialEvaluation) -> LoopPanel:
    command = run.trial.command
    return LoopPanel(Path(run.trial.source).name, [(command, run.trial.angle, _MEASURED), (command, run.theta, _MODEL)])
