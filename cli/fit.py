"""`hystmpc fit`: identify a model from recorded trials."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.evaluate import evaluate
from hystmpc.models.identify.auto import AutoFit
from hystmpc.models.kinds.catalogue import KINDS, chosen_kind
from hystmpc.models.kinds.kind import FitRequest, ModelKind
from hystmpc.models.load import load_model
from hystmpc.models.simulator import save_simulator
from hystmpc.trials.trial import Trial, Units

from .console import bar, errors, out, table
from .evaluate import errors_table
from .options import (
    MODEL,
    SIMULATOR,
    Force,
    Layout,
    Logs,
    SampledHz,
    SkipFirstFlexure,
    check_output,
    files_read,
    trials_at,
)


class Direction(StrEnum):
    """Which way a model maps."""

    FORWARD = "forward"
    INVERSE = "inverse"


_PARTS = ("part", "form", "without it", "with it")
_KINDS = ", ".join(kind.name for kind in KINDS)


def fit(
    kind: Annotated[str, typer.Argument(help=f"Model: {_KINDS}.")],
    logs: Logs,
    path: Annotated[Path, typer.Option("--out", help="File to write: .onnx, or .yaml for an operator.")],
    preset: Layout = "auto",
    sampled_hz: SampledHz = None,
    rate_hz: Annotated[float, typer.Option(help="Rate to which the logs are resampled [Hz].")] = 25.0,
    skip_first_flexure: SkipFirstFlexure = False,
    direction: Annotated[Direction, typer.Option(help="Command to angle, or the inverse map.")] = Direction.FORWARD,
    plays: Annotated[int | None, typer.Option(min=1, max=50, help="Plays of a pi (4) or drdpi (10).")] = None,
    drive: Annotated[
        str | None,
        typer.Option(help="Drive before a network or kernel: auto, or a simulator (.yaml, builtin:NAME) that has it."),
    ] = None,
    residual: Annotated[
        str | None, typer.Option(help="With auto: network of what is left, lstm or gru; kept only if it helps.")
    ] = None,
    training: Annotated[str | None, typer.Option(help="Preset of the training: best, paper, ...")] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="Epochs (paper) or updates (best) of a network.")] = None,
    hold_out: Annotated[
        int | None, typer.Option(min=0, help="Whole trials by which a network is stopped early; else the preset's.")
    ] = None,
    constancy: Annotated[
        float | None, typer.Option(min=0.0, help="Weight of a network's constant-in, constant-out term; S2 has 1e-4.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything drawn at random.")] = 1,
    command_limits: Annotated[
        tuple[float, float] | None, typer.Option(help="Least and greatest command of the device; else those seen.")
    ] = None,
    command_rate: Annotated[
        float | None, typer.Option(min=0.0, help="Greatest command change per second; else the one seen.")
    ] = None,
    force: Force = False,
) -> None:
    """Identify a model; Ctrl-C keeps the best so far."""
    chosen = chosen_kind(kind, drive, residual)
    kinds = (MODEL, SIMULATOR) if chosen.readable else (MODEL,)
    check_output("--out", path, kinds, files_read(logs, preset), force, of=chosen.name)
    request = FitRequest(
        preset=training or chosen.usual_preset(direction is Direction.INVERSE),
        seed=seed,
        steps=epochs,
        hold_out=hold_out,
        constancy_weight=constancy,
        plays=plays,
        skip_first_flexure=skip_first_flexure,
        limits=_limits(command_limits, command_rate),
    )
    chosen.check([], request)
    trials = trials_at(logs, preset, rate_hz, sampled_hz)
    _identify(chosen, [t.swapped() for t in trials] if direction is Direction.INVERSE else trials, request, path)
    model = load_model(path)
    title = f"{path}: free run on the trials it was identified from"
    out.print(errors_table(title, [evaluate(model, trial, skip_first_flexure) for trial in trials]))


def _limits(command: tuple[float, float] | None, rate: float | None) -> DeviceLimits:
    box = Range.parse({"lower": command[0], "upper": command[1]}, "--command-limits") if command else None
    return DeviceLimits(box, rate or None)


def _identify(kind: ModelKind, trials: list[Trial], request: FitRequest, path: Path) -> None:
    kind.check(trials, request)
    unit, steps = trials[0].units.angle, kind.steps(request)
    seconds = kind.estimate(trials, request)
    if seconds is not None:
        errors.print(f"{kind.name}, preset {request.preset}: about {_duration(seconds)} on this machine")
    with bar(f"fit {kind.name}", steps) as show:
        show(0, "first look")
        found = kind.fit(trials, request, lambda done, rmse: show(done, f"best {rmse:.4g} {unit}"))
        if steps is None:
            done, best = found.history[-1]
            show(done, f"best {best:.4g} {unit}", total=done)
    if found.interrupted:
        errors.print("interrupted: the best so far is kept", style="yellow")
    if found.parts is not None:
        _print_parts(found.parts, trials[0].units)
    if found.simulator is not None and path.suffix.lower() in SIMULATOR.endings:
        save_simulator(found.simulator, path)
        out.print(found.report, soft_wrap=True)
        return
    gate = export_onnx(found.bundle, path)
    out.print(
        f"{found.report}; exported within {max(gate.runtime_deg, gate.casadi_deg):.2g} {unit} of the reference "
        f"over {gate.steps} steps",
        soft_wrap=True,
    )


def _print_parts(found: AutoFit, units: Units) -> None:
    """What each part bought, its numbers, and what the logs do not determine."""
    if found.rows:
        rows = [(r.part, r.form, _figure(r.without_deg), _figure(r.with_deg)) for r in found.rows]
        out.print(table(f"what each part buys, RMSE on trials left out, in {units.angle}", _PARTS, rows))
    numbers = [
        (f"{r.owner} {r.name}", f"{r.value:.4g}", f"{r.ci90[0]:.4g} to {r.ci90[1]:.4g}", units.named(r.unit))
        for r in found.parameters
    ]
    if numbers:
        out.print(
            table("identified numbers, with intervals of 90 %", ("parameter", "value", "interval", "unit"), numbers)
        )
    for line in found.advice:
        out.print(line, soft_wrap=True)


def _figure(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "-"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
