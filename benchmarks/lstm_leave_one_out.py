"""Leave one trial out: how well an LSTM, trained on all other trials, predicts a trial from its command alone.

    python benchmarks/lstm_leave_one_out.py LOG.csv ... [--preset best] [--set training.updates=4000 ...] [--folds 0 3]

Every fold trains anew, exports through the numeric gate, loads the file and runs it freely over the trial that was left
out; a backlash and a Prandtl-Ishlinskii model of ten plays are identified on the same trials beside it. With few trials
settings chosen by looking at this table are fitted to it: the numbers are then development figures, not a blind test.
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

from hystmpc.models.chain_model import ChainModel
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import Errors, RunnableModel, evaluate
from hystmpc.models.fit.identify import identify
from hystmpc.models.fit.lstm import fit_lstm
from hystmpc.models.fit.lstm_bundle import lstm_bundle
from hystmpc.models.fit.lstm_settings import LSTM_PRESETS, LstmSettings
from hystmpc.trials.csv_ import read_csv
from hystmpc.trials.resample import resample
from hystmpc.trials.trial import Trial

Build = Callable[[Sequence[Trial]], RunnableModel]
COLUMNS = ("rmse", "offset-free", "max", "rmse*", "offset-free*", "max*", "hold drift", "train s")


def figures(model: RunnableModel, trial: Trial, seconds: float) -> list[float]:
    """One row of the table; with a star: from the first reversal of the command on."""
    whole, later = (evaluate(model, trial, skip_first_flexure=skip).errors for skip in (False, True))
    drift = max(astuple(whole)[-1], astuple(later)[-1])
    return [v for e in (whole, later) for v in _three(e)] + [drift, seconds]


def _three(errors: Errors) -> tuple[float, float, float]:
    return errors.rmse_deg, errors.offset_free_rmse_deg, errors.max_abs_error_deg


def overridden(settings: LstmSettings, changes: Sequence[str]) -> LstmSettings:
    """Settings with `a.b=value` changes."""
    data = settings.model_dump()
    for change in changes:
        key, _, value = change.partition("=")
        *parents, leaf = key.split(".")
        node = data
        for parent in parents:
            node = node[parent]
        node[leaf] = yaml.safe_load(value)
    return LstmSettings.parse(data, "--set")


def lstm(settings: LstmSettings, folder: Path) -> Build:
    """Train, export and load an LSTM, with a progress bar."""

    def build(trials: Sequence[Trial]) -> RunnableModel:
        with Progress(transient=True) as bar:
            task = bar.add_task("training", total=settings.steps)
            fit = fit_lstm(trials, settings, lambda done, best: bar.update(task, completed=done))
        print(
            f"  validation {fit.validation_rmse_deg:.3f} deg at step {fit.best_step}, "
            f"training {fit.history[-1].training_rmse_deg:.3f} deg",
            flush=True,
        )
        export_onnx(lstm_bundle(fit, trials), folder / "lstm.onnx")
        return load_onnx(folder / "lstm.onnx")

    return build


def operator(kind: str) -> Build:
    """Identify an operator."""
    return lambda trials: ChainModel(identify(kind, trials, plays=10)[0])


def study(trials: Sequence[Trial], folds: Sequence[int], builds: dict[str, Build]) -> None:
    """Print one table a model."""
    for name, build in builds.items():
        rows = []
        for k in folds:
            start = time.perf_counter()
            model = build([trial for i, trial in enumerate(trials) if i != k])
            rows.append(figures(model, trials[k], time.perf_counter() - start))
        table = Table(title=f"{name}: left out, free run [deg]; * from the first reversal on")
        table.add_column("trial")
        for column in COLUMNS:
            table.add_column(column, justify="right")
        labels = [Path(trials[k].source).stem for k in folds]
        for label, row in zip([*labels, "mean"], [*rows, np.mean(rows, axis=0)], strict=True):
            table.add_row(label, *(f"{value:.2f}" for value in row))
        Console(width=140).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--rate-hz", type=float, default=25.0)
    parser.add_argument("--preset", choices=sorted(LSTM_PRESETS), default="best")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--folds", nargs="*", type=int, help="numbers of the trials to leave out; all by default")
    parser.add_argument("--without-operators", action="store_true")
    given = parser.parse_args()
    trials = [resample(read_csv(path), given.rate_hz) for path in given.logs]
    settings = overridden(LSTM_PRESETS[given.preset], given.set)
    with tempfile.TemporaryDirectory() as folder:
        builds = {} if given.without_operators else {k: operator(k) for k in ("backlash", "pi")}
        builds[f"lstm ({given.preset})"] = lstm(settings, Path(folder))
        study(trials, given.folds or range(len(trials)), builds)


if __name__ == "__main__":
    main()
