"""Free runs as tables, figures and one page: what a model errs by, beside what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from hystmpc.trials.figure_data import draw_long
from hystmpc.trials.report import MEASURED, MODEL, REFERENCE, Heading, Paragraph, Piece, Plot, Report, Table, new_figure

from .evaluate import ERROR_COLUMNS, TrialEvaluation, error_rows, error_sentence, start_sentences

_SHOWN = 3  # trials in a figure


def evaluation_report(
    title: str, subtitle: str, parts: Sequence[tuple[str, Sequence[TrialEvaluation]]], more: Sequence[Piece] = ()
) -> Report:
    """The page of an evaluation or a fit.

    Args:
        title, subtitle: of the page.
        parts: sets of trials, the one that counts most first, each with the words of `error_sentence`.
        more: shown behind them.
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
    yield Plot(time_figure(results), f"Measured and simulated output {drawn}, and the error of the model below.", True)
    yield Plot(loop_figure(results), f"Output [{unit}] over command [{command}] of the same trials.")


def time_figure(results: Sequence[TrialEvaluation]) -> Figure:
    """Measurement and model over time, of the three trials with the greatest error, and below each the error."""
    worst = _worst(results)
    with new_figure(7.0, 0.6 + 2.5 * len(worst)) as figure:
        rows = figure.subplots(2 * len(worst), 1, height_ratios=(3, 1) * len(worst))
        for above, below, run in zip(rows[::2], rows[1::2], worst, strict=True):
            unit, t = run.trial.units.angle, run.trial.t
            draw_long(above, t, run.trial.angle, color=MEASURED, label="measured")
            draw_long(above, t, run.theta, color=MODEL, label="model", linewidth=0.9)
            name = Path(run.trial.source).name
            above.set(ylabel=f"[{unit}]", title=f"{name}: RMSE {run.errors.rmse_deg:.3g} {unit}")
            above.tick_params(labelbottom=False)
            draw_long(below, t[run.start :], (run.theta - run.trial.angle)[run.start :], color=MODEL, linewidth=0.8)
            below.axhline(0.0, color=REFERENCE, linewidth=0.6)
            below.set(ylabel=f"error [{unit}]")
            below.sharex(above)
        rows[-1].set(xlabel="time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def loop_figure(results: Sequence[TrialEvaluation]) -> Figure:
    """Output over command, measured and simulated, of the three trials with the greatest error."""
    worst = _worst(results)
    with new_figure(7.0, 2.9) as figure:
        row = figure.subplots(1, len(worst), squeeze=False, sharey=True)[0]
        for axes, run in zip(row, worst, strict=True):
            axes.plot(run.trial.command, run.trial.angle, color=MEASURED, label="measured")
            axes.plot(run.trial.command, run.theta, color=MODEL, label="model", linewidth=0.9)
            axes.set(xlabel=f"command [{run.trial.units.command}]", title=Path(run.trial.source).name)
        row[0].set(ylabel=f"output [{worst[0].trial.units.angle}]")
        figure.legend(*row[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def _worst(results: Sequence[TrialEvaluation]) -> list[TrialEvaluation]:
    return sorted(results, key=lambda run: -run.errors.rmse_deg)[:_SHOWN]
