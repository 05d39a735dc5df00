"""`hystmpc fit`: identify a model from recorded trials."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.metadata import Range
from hystmpc.models.evaluate import evaluate
from hystmpc.models.fit.identify import DeviceLimits, identify
from hystmpc.models.fit.lstm import fit_lstm
from hystmpc.models.fit.lstm_bundle import lstm_bundle
from hystmpc.models.fit.lstm_settings import LSTM_PRESETS, LstmSettings, WindowTraining
from hystmpc.models.fit.operators import OperatorFitSettings
from hystmpc.models.load import load_model
from hystmpc.models.simulator import save_simulator
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.trial import Trial

from .console import bar, errors, out
from .evaluate import errors_table
from .options import Layout, Logs, SkipFirstFlexure, trials_at


class Kind(StrEnum):
    """What can be identified."""

    BACKLASH = "backlash"
    PI = "pi"
    LSTM = "lstm"


def fit(
    kind: Annotated[Kind, typer.Argument(help="Model: 4-parameter backlash, Prandtl-Ishlinskii, or LSTM.")],
    logs: Logs,
    path: Annotated[Path, typer.Option("--out", help="File to write: .yaml for backlash and pi, .onnx for lstm.")],
    preset: Layout = "auto",
    rate_hz: Annotated[float, typer.Option(help="Rate to which the logs are resampled [Hz].")] = 25.0,
    skip_first_flexure: SkipFirstFlexure = False,
    plays: Annotated[int, typer.Option(min=1, max=50, help="Plays of a pi.")] = 4,
    training: Annotated[str, typer.Option(help=f"How an lstm is trained: {', '.join(LSTM_PRESETS)}.")] = "best",
    epochs: Annotated[int | None, typer.Option(min=1, help="Epochs (paper) or updates (best) of an lstm.")] = None,
    hold_out: Annotated[
        int | None, typer.Option(min=0, help="Whole trials by which an lstm is stopped early; else the preset's.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything drawn at random.")] = 1,
    command_limits: Annotated[
        tuple[float, float] | None, typer.Option(help="Least and greatest command of the device; else those seen.")
    ] = None,
    command_rate: Annotated[
        float | None, typer.Option(min=0.0, help="Greatest command change per second; else the one seen.")
    ] = None,
) -> None:
    """Identify a model; Ctrl-C keeps the best so far."""
    _check_ending(kind, path)
    trials = trials_at(logs, preset, rate_hz)
    box = (
        Range.parse(dict(zip(("lower", "upper"), command_limits, strict=True)), "--command-limits")
        if command_limits
        else None
    )
    limits = DeviceLimits(box, command_rate or None)
    if kind is Kind.LSTM:
        _fit_network(trials, _lstm_settings(training, epochs, hold_out, seed, skip_first_flexure), limits, path)
    else:
        _fit_operator(kind, trials, OperatorFitSettings(skip_first_flexure, seed=seed), plays, limits, path)
    model = load_model(path)
    title = f"{path}: free run on the trials it was identified from"
    out.print(errors_table(title, [evaluate(model, trial, skip_first_flexure) for trial in trials]))


def _fit_operator(
    kind: Kind, trials: list[Trial], settings: OperatorFitSettings, plays: int, limits: DeviceLimits, path: Path
) -> None:
    with bar(f"fit {kind}") as show:
        simulator, result = identify(
            kind, trials, settings, plays, limits, lambda done, rmse: show(done, f"best {rmse:.4f} deg")
        )
        show(result.evaluations, f"best {result.rmse_deg:.4f} deg", total=result.evaluations)
    if result.interrupted:
        errors.print("interrupted: the best so far is kept", style="yellow")
    save_simulator(simulator, path)


def _fit_network(trials: list[Trial], settings: LstmSettings, limits: DeviceLimits, path: Path) -> None:
    with bar("fit lstm", settings.steps) as show:
        show(0, "first check")
        result = fit_lstm(trials, settings, lambda done, rmse: show(done, f"best {rmse:.3f} deg"))
    if result.interrupted:
        errors.print("interrupted: the best so far is kept", style="yellow")
    gate = export_onnx(lstm_bundle(result, trials, limits), path)
    judges = ", ".join(Path(source).name for source in result.held_out) or "the training trials"
    out.print(
        f"weights of step {result.best_step} of {settings.steps}, judged by {judges} "
        f"({result.validation_rmse_deg:.3f} deg); exported within {max(gate.runtime_deg, gate.casadi_deg):.2g} deg of "
        f"the reference over {gate.steps} steps"
    )


def _lstm_settings(
    training: str, epochs: int | None, hold_out: int | None, seed: int, skip_first_flexure: bool
) -> LstmSettings:
    if training not in LSTM_PRESETS:
        raise ConfigError(f"--training {training}: {did_you_mean(training, LSTM_PRESETS)}")
    chosen = LSTM_PRESETS[training]
    way = chosen.training
    if epochs is not None:
        way = way.model_copy(update={"epochs" if isinstance(way, WindowTraining) else "updates": epochs})
    weight = 0.0 if skip_first_flexure else chosen.first_flexure_weight
    changes = {"seed": seed, "training": way, "first_flexure_weight": weight}
    if hold_out is not None:
        changes["validation_trials"] = hold_out
    return chosen.model_copy(update=changes)


def _check_ending(kind: Kind, path: Path) -> None:
    """Refuse a wrong ending before hours of training, not after."""
    wanted = (".onnx",) if kind is Kind.LSTM else (".yaml", ".yml")
    if path.suffix.lower() not in wanted:
        raise ConfigError(f"--out {path}: expected a file ending in {' or '.join(wanted)} for {kind}")
    if path.is_dir():
        raise ConfigError(f"--out {path}: is a folder, expected a file")
