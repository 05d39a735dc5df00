"""`hystmpc evaluate`: how well does a model reproduce recorded trials?"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.evaluate import (
    ERROR_COLUMNS,
    TrialEvaluation,
    error_rows,
    error_sentence,
    evaluation_json,
    start_sentences,
)
from hystmpc.models.evaluate import evaluate as score
from hystmpc.models.load import load_model
from hystmpc.models.model import LoadedModel
from hystmpc.trials.files import figures_to, write_atomically
from hystmpc.trials.trial import Trial

from .bars import bar, each
from .console import errors, out, table
from .options import (
    EVALUATION,
    Figures,
    Force,
    Layout,
    Logs,
    Page,
    SampledHz,
    SkipFirstFlexure,
    check_output,
    check_page,
    files_read,
    trials_at,
)


def evaluate(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="A simulator (.yaml), exported model (.onnx) or builtin:NAME.")
    ],
    logs: Logs,
    preset: Layout = "auto",
    sampled_hz: SampledHz = None,
    skip_first_flexure: SkipFirstFlexure = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write hystmpc-evaluation/1 here.")] = None,
    page: Page = None,
    figures: Figures = None,
    force: Force = False,
) -> None:
    """Free run from the command alone against the measured angle.

    An inverse map runs from the angle to the command.
    """
    inputs = [model, *files_read(logs, preset)]
    if json_file is not None:
        check_output("--json", json_file, (EVALUATION,), inputs, force)
    check_page(page, figures, inputs, force)
    opened = load_model(model)
    trials = trials_at(logs, preset, 1 / opened.metadata.dt_s, sampled_hz)
    results = free_runs(opened, trials, skip_first_flexure)
    out.print(errors_table(f"{model}: free run{', from the first reversal on' if skip_first_flexure else ''}", results))
    out.print(f"{error_sentence(results)}.", soft_wrap=True, highlight=False)
    say_starts(results)
    warn_outside(results, opened.metadata)
    if json_file is not None:
        write_atomically(json_file, json.dumps(evaluation_json(results), indent=2) + "\n")
    if page is not None:
        from hystmpc.models.evaluation_report import evaluation_report  # matplotlib takes a second to import

        with bar("report"), figures_to(figures):
            written = evaluation_report("Free run", str(model), [("", results)]).save(page)
        out.print(f"report: {written}")


def free_runs(model: LoadedModel, trials: Sequence[Trial], skip_first_flexure: bool) -> list[TrialEvaluation]:
    """Score a model on trials, behind a bar."""
    return [score(model, trial, skip_first_flexure) for trial in each("free runs", trials)]


def say_starts(results: Sequence[TrialEvaluation]) -> None:
    """One line on each trial that begins in motion, whose first seconds are not scored."""
    for sentence in start_sentences(results):
        out.print(f"{sentence}.", soft_wrap=True, highlight=False)


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
    return table(f"{title}, in {results[0].trial.units.angle}", ERROR_COLUMNS, error_rows(results), last_apart=True)
