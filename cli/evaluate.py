"""`hystmpc evaluate`: how well does a model reproduce recorded trials?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.models.evaluate import ERROR_COLUMNS, error_rows, error_sentence, start_sentences
from hystmpc.tasks.evaluate import Evaluation
from hystmpc.tasks.evaluate import evaluate as evaluate_model

from .bars import progress_of
from .console import out, say, table
from .options import Figures, Force, LayoutName, Logs, Page, SampledHz, SkipFirstFlexure


def evaluate(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="A simulator (.yaml), exported model (.onnx) or builtin:NAME.")
    ],
    logs: Logs,
    layout: LayoutName = "auto",
    sampled_hz: SampledHz = None,
    skip_first_flexure: SkipFirstFlexure = False,
    json: Annotated[Path | None, typer.Option("--json", help="Write hystmpc-evaluation/1 here.")] = None,
    page: Page = None,
    figures: Figures = None,
    force: Force = False,
) -> None:
    """Free run from the command alone against the measured angle.

    An inverse map runs from the angle to the command.
    """
    with progress_of("evaluate") as progress:
        evaluation = evaluate_model(
            model,
            logs,
            layout=layout,
            sampled_hz=sampled_hz,
            skip_first_flexure=skip_first_flexure,
            json=json,
            report=page,
            figures=figures,
            force=force,
            progress=progress,
            say=say,
        )
    print_errors(f"{model}: free run{', from the first reversal on' if skip_first_flexure else ''}", evaluation)
    out.print(f"{error_sentence(evaluation.trials)}.", soft_wrap=True, highlight=False)
    if page is not None:
        out.print(f"report: {page}", soft_wrap=True)


def print_errors(title: str, evaluation: Evaluation) -> None:
    """Errors a trial and their mean, in the output's unit; `no bias` is the offset-free RMSE; then where runs begin."""
    runs = evaluation.trials
    out.print(table(f"{title}, in {runs[0].trial.units.angle}", ERROR_COLUMNS, error_rows(runs), last_apart=True))
    for sentence in start_sentences(runs):
        out.print(f"{sentence}.", soft_wrap=True, highlight=False)
