"""Leave one trial out: how well a model, identified on all other trials, predicts a trial from its command alone.

    python lab/benchmarks/leave_one_out.py LOG.csv ... [--kinds backlash lstm hb2] [--training best] [--folds 0 3]
                                       [--inverse] [--skip-first-flexure] [--set training.updates=4000 ...]

Every fold identifies anew, exports through the numeric gate, loads the file and runs it freely over the trial that was
left out. With few trials settings chosen by looking at this table are fitted to it: the numbers are then development
figures, not a blind test.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np
import yaml
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from hystmpc.models.contract.export import ExportBundle, export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import Errors, evaluate
from hystmpc.models.kinds.catalogue import kind_named, kind_names
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.kinds.networks import NetworkKind
from hystmpc.models.model import LoadedModel
from hystmpc.models.networks.settings import NetworkSettings
from hystmpc.models.train.networks import fit_network, network_bundle
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, resample

Fit = Callable[[Sequence[Trial]], ExportBundle]
COLUMNS = ("rmse", "offset-free", "max", "rmse*", "offset-free*", "max*", "hold drift*", "train s")


def figures(model: LoadedModel, trial: Trial, seconds: float) -> list[float]:
    """One row of the table; with a star: from the first reversal of the command on."""
    whole, later = (evaluate(model, trial, skip_first_flexure=skip).errors for skip in (False, True))
    return [v for e in (whole, later) for v in _three(e)] + [astuple(later)[-1], seconds]


def _three(errors: Errors) -> tuple[float, float, float]:
    return errors.rmse_deg, errors.offset_free_rmse_deg, errors.max_abs_error_deg


def overridden(settings: NetworkSettings, changes: Sequence[str]) -> NetworkSettings:
    """Settings with `a.b=value` changes."""
    data = settings.model_dump()
    for change in changes:
        key, _, value = change.partition("=")
        *parents, leaf = key.split(".")
        node = data
        for parent in parents:
            node = node[parent]
        node[leaf] = yaml.safe_load(value)
    return NetworkSettings.parse(data, "--set")


def network(settings: NetworkSettings) -> Fit:
    """Training of a network, with a progress bar."""

    def fit(trials: Sequence[Trial]) -> ExportBundle:
        with Progress(transient=True) as bar:
            task = bar.add_task("training", total=settings.steps)
            found = fit_network(trials, settings, lambda done, best: bar.update(task, completed=done))
        print(
            f"  {settings.kind}: validation {found.validation_rmse_deg:.3f} at step {found.best_step}, "
            f"training {found.history[-1].training_rmse_deg:.3f}",
            flush=True,
        )
        return network_bundle(found, trials)

    return fit


def of_kind(name: str, training: str, changes: Sequence[str], skip: bool) -> Fit:
    """How a kind is identified, the first flexure skipped or not; trainings of networks may be changed."""
    kind = kind_named(name)
    chosen = training if training in kind.trainings else kind.trainings[0]
    if isinstance(kind, NetworkKind):
        weight = ["first_flexure_weight=0.0"] if skip else []
        return network(overridden(kind.settings[chosen], [*weight, *changes]))
    asked = FitRequest(training=chosen, plays=10, skip_first_flexure=skip)
    return lambda trials: kind.fit(trials, asked).bundle


def study(trials: Sequence[Trial], folds: Sequence[int], fits: dict[str, Fit], folder: Path) -> None:
    """Print one table a model."""
    unit = trials[0].units.angle
    for name, fit in fits.items():
        rows = []
        for k in folds:
            start = time.perf_counter()
            bundle = fit([trial for i, trial in enumerate(trials) if i != k])
            seconds = time.perf_counter() - start
            export_onnx(bundle, folder / "model.onnx")
            rows.append(figures(load_onnx(folder / "model.onnx"), trials[k], seconds))
        table = Table(title=f"{name}: left out, free run in {unit}; * from the first reversal on")
        table.add_column("trial")
        for column in COLUMNS:
            table.add_column(column, justify="right")
        labels = [Path(trials[k].source).stem for k in folds]
        for label, row in zip([*labels, "mean"], [*rows, np.mean(rows, axis=0)], strict=True):
            table.add_row(label, *(f"{value:.3f}" for value in row))
        Console(width=140).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--rate-hz", type=float, default=25.0)
    parser.add_argument("--layout", default="auto", help="layout of the logs")
    parser.add_argument("--kinds", nargs="+", default=["backlash", "pi", "lstm"], choices=kind_names())
    parser.add_argument("--training", default="best")
    parser.add_argument("--inverse", action="store_true", help="angle to command")
    parser.add_argument("--skip-first-flexure", action="store_true", help="fit each trial from its first reversal on")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--folds", nargs="*", type=int, help="numbers of the trials to leave out; all by default")
    given = parser.parse_args()
    trials = [resample(trial, given.rate_hz) for trial in read_trials(given.logs, given.layout)]
    if given.inverse:
        trials = [trial.swapped() for trial in trials]
    skip = given.skip_first_flexure
    fits = {f"{kind} ({given.training})": of_kind(kind, given.training, given.set, skip) for kind in given.kinds}
    with tempfile.TemporaryDirectory() as folder:
        study(trials, given.folds or range(len(trials)), fits, Path(folder))


if __name__ == "__main__":
    main()
