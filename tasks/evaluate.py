"""Evaluation of a model: its free run over the commands of recorded trials against the measured angle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.brief import in_brief
from hystmpc.trials.errors import in_a_line
from hystmpc.trials.files import figures_to, write_atomically
from hystmpc.trials.read import AnyLayout
from hystmpc.trials.types import Progress

from .inputs import Logs, Model, Say, as_list, both_axes_of, files_read, of_two_axes, opened, trials_at
from .outputs import EVALUATION, check_output, check_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hystmpc.models.contract.metadata import ModelMetadata
    from hystmpc.models.evaluate import Errors, TrialEvaluation
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.two_axes.model import TwoAxisModel
    from hystmpc.trials.report import Report
    from hystmpc.trials.trial import Trial


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Free runs of a model over trials: from the command alone, against the measured angle.

    Attributes:
        trials: the runs, each with `trial`, the model's angle `theta` (T,) and `errors`; of two axes `theta` is (T, 2),
            `errors` are those of the tip, and `axes` those of x and y.
        subtitle: of the page; if empty, the number of trials.
        two_axes: the model, if it has two axes.
    """

    trials: tuple[TrialEvaluation, ...]
    subtitle: str = ""
    two_axes: TwoAxisModel | None = None

    @property
    def mean(self) -> Errors:
        """Mean of each error over the trials."""
        from hystmpc.models.evaluate import mean_errors

        return mean_errors(self.trials)

    def __repr__(self) -> str:
        if not self.trials:
            return in_brief(self, "no trials")
        worst = max(self.trials, key=lambda run: run.errors.rmse_deg)
        unit, mean = worst.trial.units.angle, self.mean.rmse_deg
        name = Path(worst.trial.source).name
        text = f"{len(self)} trials: RMSE {mean:.4g} {unit} in the mean, {worst.errors.rmse_deg:.4g} {unit} in {name}"
        return in_brief(self, text)

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[TrialEvaluation]:
        return iter(self.trials)

    def __getitem__(self, k: int) -> TrialEvaluation:
        return self.trials[k]

    def plot(self) -> Figure:
        """Draw measurement, model and error over time, of the three trials with the greatest error."""
        from hystmpc.models.evaluation_report import free_run_figure

        return free_run_figure(self.trials)

    @in_a_line
    def report(self, path: Path | str) -> Path:
        """Write one page with tables and figures, which opens offline."""
        return self._page().save(path)

    def _page(self) -> Report:
        from hystmpc.models.evaluation_report import evaluation_report
        from hystmpc.models.two_axes.report import joint_pieces

        more = () if self.two_axes is None else tuple(joint_pieces(self.two_axes))
        return evaluation_report("Free run", self.subtitle or f"{len(self)} trials", [("", self.trials)], more)

    def _repr_html_(self) -> str:
        return self._page().fragment()


def evaluate(
    model: Model,
    trials: Logs,
    *,
    layout: AnyLayout = "auto",
    sampled_hz: float | None = None,
    skip_first_flexure: bool = False,
    json: Path | str | None = None,
    report: Path | str | None = None,
    figures: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
    say: Say | None = None,
) -> Evaluation:
    """Compare the free run of a model over the commands of trials with the measured angle.

    A model of two axes takes logs of two axes; its errors are those of the tip and of each axis.

    Args:
        model: a fit, simulator, opened model or file.
        trials: logs, data frames or trials, resampled to the model's rate; an inverse map runs over them swapped.
        layout: layout of the logs: auto, canonical, tendon-catheter, or a mapping file *.yaml.
        sampled_hz: rate [Hz] of logs sampled evenly; stands in for a broken or missing clock.
        skip_first_flexure: count each trial only from the command's first reversal on.
        json: write hystmpc-evaluation/1 here, or hystmpc-two-axis-evaluation/1.
        report: write one page with tables and figures here, .html.
        figures: new folder for every figure of the report: SVG, PDF, and its data as CSV.
        force: replace an older file of the same kind; never one of another.
        progress: called with trials done and their number.
        say: called with each note and warning.

    Raises:
        LogError: if a log cannot be used.
        ModelError: if the model cannot be opened, its units differ, or its angle is not finite.
        ConfigError: if a file or folder may not be written.
    """
    logs, file = as_list(trials), Path(model) if isinstance(model, Path | str) else None
    inputs = [*([] if file is None else [file]), *files_read(logs, layout)]
    if json is not None:
        check_output("--json", json, (EVALUATION,), inputs, force)
    check_page(report, figures, inputs, force)
    subtitle, both = "" if file is None else str(model), of_two_axes(model)
    if both is not None:
        recorded = both_axes_of(logs, layout, 1 / both.dt_s, sampled_hz, say)
        evaluation = free_runs(both, recorded, skip_first_flexure, progress, subtitle)
        if say is not None:
            warn_outside(evaluation, "an axis", say)
    else:
        runs = opened(model)
        recorded = trials_at(logs, layout, 1 / runs.metadata.dt_s, sampled_hz, say)
        evaluation = free_runs(runs, recorded, skip_first_flexure, progress, subtitle)
        if say is not None:
            warn_outside(evaluation, _trained(runs.metadata), say)
            for line in beyond_inputs(runs, recorded):
                say(line)
    if json is not None:
        from hystmpc.models.evaluate import evaluation_json

        write_atomically(json, dumps(evaluation_json(evaluation.trials), indent=2) + "\n")
    if report is not None:
        with figures_to(figures):
            evaluation.report(report)
    return evaluation


def free_runs(
    model: LoadedModel | TwoAxisModel,
    trials: Sequence[Trial],
    skip: bool,
    progress: Progress | None = None,
    subtitle: str = "",
) -> Evaluation:
    """Free runs over trials at the model's rate."""
    from hystmpc.models.evaluate import evaluate as free_run
    from hystmpc.models.two_axes.evaluate import evaluate_two_axes
    from hystmpc.models.two_axes.model import TwoAxisModel

    runs: list[TrialEvaluation] = []
    for trial in trials:
        if isinstance(model, TwoAxisModel):
            runs.append(evaluate_two_axes(model, trial, skip))
        else:
            runs.append(free_run(model, trial, skip))
        if progress is not None:
            progress(len(runs), len(trials), "free runs")
    return Evaluation(tuple(runs), subtitle, model if isinstance(model, TwoAxisModel) else None)


def beyond_inputs(model: LoadedModel, trials: Iterable[Trial]) -> Iterator[str]:
    """Lines on measured inputs outside the range of the model's identification, whose nearest end counts there."""
    for given in model.inputs:
        for trial in trials:
            low, high = (float(end(trial.with_inputs([given.name]).inputs[given.name])) for end in (np.min, np.max))
            if low < given.lower or high > given.upper:
                seen, ends = f"{low:.4g} to {high:.4g}", f"{given.lower:.4g} to {given.upper:.4g}"
                yield f"{Path(trial.source).name}: {given.name} {seen}, identified {ends}: the nearest value counts"
                break


def warn_outside(evaluation: Evaluation, trained: str, say: Say) -> None:
    """Warn of commands outside the range of the model's identification, given in words."""
    beyond = [run for run in evaluation if run.outside > 0]
    if beyond:
        worst = max(beyond, key=lambda run: run.outside)
        say(
            f"{len(beyond)} of {len(evaluation)} trials leave the identified range of {trained}, where the model "
            f"guesses: {100 * worst.outside:.1f} % of the samples of {Path(worst.trial.source).name}"
        )


def _trained(facts: ModelMetadata) -> str:
    return f"{facts.trained_command.lower:.4g} to {facts.trained_command.upper:.4g} {facts.command_unit}"
