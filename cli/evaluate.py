"""`hystmpc evaluate`: how well does a model reproduce recorded trials?"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.evaluate import Errors, TrialEvaluation, evaluation_json, mean_errors
from hystmpc.models.evaluate import evaluate as score
from hystmpc.models.load import load_model
from hystmpc.trials.files import write_atomically

from .console import bar, decimals, errors, out, table
from .options import EVALUATION, Force, Layout, Logs, SampledHz, SkipFirstFlexure, check_output, files_read, trials_at

_COLUMNS = ("trial", "RMSE", "bias", "no bias", "max", "NRMSE %", "hold drift")


def evaluate(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="A simulator (.yaml) or exported model (.onnx).")],
    logs: Logs,
    preset: Layout = "auto",
    sampled_hz: SampledHz = None,
    skip_first_flexure: SkipFirstFlexure = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write hystmpc-evaluation/1 here.")] = None,
    force: Force = False,
) -> None:
    """Free run from the command alone against the measured angle.

    An inverse map runs from the angle to the command.
    """
    if json_file is not None:
        check_output("--json", json_file, (EVALUATION,), [model, *files_read(logs, preset)], force)
    opened = load_model(model)
    trials = trials_at(logs, preset, 1 / opened.metadata.dt_s, sampled_hz)
    results = []
    with bar("free runs", len(trials)) as show:
        for trial in trials:
            results.append(score(opened, trial, skip_first_flexure))
            show(len(results))
    out.print(errors_table(f"{model}: free run{', from the first reversal on' if skip_first_flexure else ''}", results))
    warn_outside(results, opened.metadata)
    if json_file is not None:
        write_atomically(json_file, json.dumps(evaluation_json(results), indent=2) + "\n")


def warn_outside(results: Sequence[TrialEvaluation], facts: ModelMetadata) -> None:
    """One line on standard error where commands leave the range that the model was identified on."""
    beyond = [result for result in results if result.outside > 0]
    if beyond:
        worst, trained = max(beyond, key=lambda result: result.outside), facts.trained_command
        errors.print(
            f"{len(beyond)} of {len(results)} trials leave the identified range of {trained.lower:.4g} to "
            f"{trained.upper:.4g} {facts.command_unit}, where the model guesses: {100 * worst.outside:.1f} % of the "
            f"samples of {Path(worst.trial.source).name}",
            style="yellow",
        )


def errors_table(title: str, results: Sequence[TrialEvaluation]) -> Table:
    """Errors a trial and their mean, in the output's unit; `no bias` is the offset-free RMSE."""
    places = decimals(max(float(np.ptp(result.trial.angle)) for result in results))
    rows = [_row(Path(result.trial.source).name, result.errors, places) for result in results]
    title = f"{title}, in {results[0].trial.units.angle}"
    return table(title, _COLUMNS, [*rows, _row("mean", mean_errors(results), places)], last_apart=True)


def _row(name: str, e: Errors, places: int) -> list[str]:
    figures = (e.rmse_deg, e.bias_deg, e.offset_free_rmse_deg, e.max_abs_error_deg)
    return [name, *(f"{x:.{places}f}" for x in figures), f"{100 * e.nrmse:.3f}", f"{e.hold_drift_deg:.{places}f}"]
