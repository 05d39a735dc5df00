"""`hystmpc fit`: identify a model from recorded trials."""

from __future__ import annotations

from enum import StrEnum
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from hystmpc.models.contract.metadata import DeviceLimits, ModelMetadata, Range
from hystmpc.models.evaluate import error_sentence
from hystmpc.models.kinds.catalogue import kind_names
from hystmpc.tasks.fit import DEFAULT_RATE_HZ, Fit, part_tables
from hystmpc.tasks.fit import fit as fit_model
from hystmpc.trials.errors import ConfigError

from .bars import progress_of
from .console import out, say, table
from .evaluate import print_errors
from .options import Figures, Force, LayoutName, Logs, Page, SampledHz, SkipFirstFlexure
from .time_left import EVEN, Pace


class Direction(StrEnum):
    """Which way a model maps."""

    FORWARD = "forward"
    INVERSE = "inverse"


Test = Annotated[
    list[Path] | None,
    typer.Option("--test", metavar="LOG", help="Log or folder to score on, which the fit does not see; repeatable."),
]
Plays = Annotated[int | None, typer.Option(min=1, max=50, help="Plays of a pi (4) or drdpi (10).")]
Drive = Annotated[
    str | None,
    typer.Option(help="Drive before a network or kernel: auto, or a simulator (.yaml, builtin:NAME) that has it."),
]
Residual = Annotated[
    str | None, typer.Option(help="With auto: network of what is left, lstm or gru; kept only if it helps.")
]
HoldOut = Annotated[
    int | None, typer.Option(min=0, help="Whole trials by which a network is stopped early; else the training's.")
]
Validation = Annotated[
    list[Path] | None,
    typer.Option(metavar="LOG", help="Log or folder that only judges, in place of trials held out; repeatable."),
]
Constancy = Annotated[
    float | None, typer.Option(min=0.0, help="Weight of a network's constant-in, constant-out term; S2 has 1e-4.")
]
CommandLimits = Annotated[
    tuple[float, float] | None, typer.Option(help="Least and greatest command of the device; else those seen.")
]
CommandRate = Annotated[
    float | None, typer.Option(min=0.0, help="Greatest command change per second; else the one seen.")
]
RateHz = Annotated[
    float | None, typer.Option(help=f"Rate to which the logs are resampled [Hz]; else {DEFAULT_RATE_HZ:g}.")
]

_KINDS = ", ".join(kind_names())
# `auto` begins with its richest core, which takes longest, and ends after two of three rounds in most cases.
_PACE: dict[str, Pace] = {"auto": ((0, 0), (0.1, 0.36), (0.42, 0.45), (0.7, 0.82), (0.8, 0.95), (1, 1))}
_SEEN_PART = {"--command-limits": "the range", "--command-rate": "the rate"}


class Command(TyperCommand):
    """Refuses logs of the fit that stand on both sides of `--test LOG`: `--test a.csv b.csv` would fit b.csv."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as usual, then look at what stands right behind the log of each `--test`.

        Raises:
            ConfigError: if a log of the fit stands there and others stand elsewhere.
        """
        given = list(args)
        rest = super().parse_args(ctx, args)
        behind: list[str] = []
        for k in (k for k, word in enumerate(given) if word == "--test"):
            behind += takewhile(lambda word: not word.startswith("-"), given[k + 2 :])
        fitted = [str(log) for log in ctx.params.get("logs") or ()]
        astray = [name for name in fitted if name in map(str, map(Path, behind))]
        if astray and len(astray) < len(fitted):
            raise ConfigError(
                f"fit: {astray[0]} stands behind --test, which takes one log, and would be fitted; "
                f"write `--test {astray[0]}`, or put it before --test"
            )
        return rest


def fit(
    kind: Annotated[str, typer.Argument(help=f"Model: {_KINDS}.")],
    logs: Logs,
    path: Annotated[Path, typer.Option("--out", help="File to write: .onnx, or .yaml for an operator.")],
    layout: LayoutName = "auto",
    sampled_hz: SampledHz = None,
    rate_hz: RateHz = None,
    skip_first_flexure: SkipFirstFlexure = False,
    direction: Annotated[Direction, typer.Option(help="Command to angle, or the inverse map.")] = Direction.FORWARD,
    plays: Plays = None,
    drive: Drive = None,
    residual: Residual = None,
    training: Annotated[str | None, typer.Option(help="Settings of the training: best, paper, ...")] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="Epochs (paper) or updates (best) of a network.")] = None,
    hold_out: HoldOut = None,
    validation: Validation = None,
    constancy: Constancy = None,
    seed: Annotated[int, typer.Option(help="Seed of everything drawn at random.")] = 1,
    command_limits: CommandLimits = None,
    command_rate: CommandRate = None,
    test: Test = None,
    page: Page = None,
    figures: Figures = None,
    force: Force = False,
) -> None:
    """Identify a model; Ctrl-C keeps the best so far."""
    limits = _limits(command_limits, command_rate)
    with progress_of(f"fit {kind}", _PACE.get(kind, EVEN)) as progress:
        made = fit_model(
            kind,
            logs,
            path,
            layout=layout,
            sampled_hz=sampled_hz,
            rate_hz=rate_hz,
            skip_first_flexure=skip_first_flexure,
            inverse=direction is Direction.INVERSE,
            plays=plays,
            drive=drive,
            residual=residual,
            training=training,
            steps=epochs,
            hold_out=hold_out,
            validation=validation or (),
            constancy_weight=constancy,
            seed=seed,
            limits=limits,
            test=test or (),
            report=page,
            figures=figures,
            force=force,
            progress=progress,
            say=say,
        )
    _print_model(made, limits)
    _print_scores(made, path)
    if page is not None:
        out.print(f"report: {page}", soft_wrap=True)


def _print_scores(made: Fit, path: Path) -> None:
    for which, evaluation in made.evaluations:
        print_errors(f"{path}: free run on the trials{which}", evaluation)
    for which, evaluation in made.evaluations:
        out.print(f"{error_sentence(evaluation.trials, which)}.", soft_wrap=True, highlight=False)


def _limits(command: tuple[float, float] | None, rate: float | None) -> DeviceLimits:
    box = Range.parse({"lower": command[0], "upper": command[1]}, "--command-limits") if command else None
    return DeviceLimits(box, rate or None)


def _print_model(made: Fit, limits: DeviceLimits) -> None:
    """What each part of the device explains, the limits that the model keeps, and how it was written."""
    done, gate, units = made.identified, made.exported, made.trials[0].units
    if done.parts is not None:
        for title, columns, rows in part_tables(done.parts, units):
            out.print(table(title, columns, rows))
        for line in done.parts.advice:
            out.print(line, soft_wrap=True)
    if not made.trials[0].inverted:
        out.print(limits_line(done.bundle.metadata, limits), soft_wrap=True, highlight=False)
    exported = ""
    if gate is not None:
        error = max(gate.runtime_deg, gate.casadi_deg)
        exported = f"; exported within {error:.2g} {units.angle} of the reference over {gate.steps} steps"
    out.print(f"{done.report}{exported}", soft_wrap=True)


def limits_line(stored: ModelMetadata, given: DeviceLimits) -> str:
    """Which limits controllers of the model will keep, and whether they are those of the device or of its logs."""
    box, unit = stored.command_limits, stored.command_unit
    rate = f"at most {stored.command_rate:.4g} {unit}/s"
    text = f"limits stored in the model: {box.lower:.4g} to {box.upper:.4g} {unit}, {rate}"
    options = {"--command-limits": given.command, "--command-rate": given.rate_per_s}
    absent = [name for name, value in options.items() if value is None]
    if not absent:
        return f"{text}, as given"
    seen = "as seen in the logs" if len(absent) == len(options) else f"{_SEEN_PART[absent[0]]} as seen in the logs"
    return f"{text}, {seen}; give {' and '.join(absent)} for the device's own"
