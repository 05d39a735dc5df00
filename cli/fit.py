"""`hystmpc fit`: identify a model from recorded trials."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.metadata import DeviceLimits, ModelMetadata, Range
from hystmpc.models.evaluate import RANGE_SLACK, error_sentence
from hystmpc.models.identify.auto import AutoFit
from hystmpc.models.identify.uncertainty import ParameterRow
from hystmpc.models.kernels.compiling import about
from hystmpc.models.kinds.catalogue import KINDS, chosen_kind
from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
from hystmpc.models.kinds.worth import identified
from hystmpc.models.load import load_model
from hystmpc.models.simulator import save_simulator
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import figures_to
from hystmpc.trials.read import expand_logs
from hystmpc.trials.trial import SlowLogError, Trial, Units

from .bars import bar
from .console import errors, out, table
from .evaluate import errors_table, free_runs, say_starts, warn_outside
from .options import (
    MODEL,
    SIMULATOR,
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
from .time_left import EVEN, Pace


class Direction(StrEnum):
    """Which way a model maps."""

    FORWARD = "forward"
    INVERSE = "inverse"


Test = Annotated[
    list[Path] | None,
    typer.Option("--test", metavar="LOG", help="Log or folder to score on, which the fit does not see; repeatable."),
]

DEFAULT_RATE_HZ = 25.0
RateHz = Annotated[
    float | None, typer.Option(help=f"Rate to which the logs are resampled [Hz]; else {DEFAULT_RATE_HZ:g}.")
]

_PARTS = ("part", "form", "without it", "with it")
_KINDS = ", ".join(kind.name for kind in KINDS)


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
    preset: Layout = "auto",
    sampled_hz: SampledHz = None,
    rate_hz: RateHz = None,
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
    test: Test = None,
    page: Page = None,
    figures: Figures = None,
    force: Force = False,
) -> None:
    """Identify a model; Ctrl-C keeps the best so far."""
    chosen = chosen_kind(kind, drive, residual)
    kinds = (MODEL, SIMULATOR) if chosen.readable else (MODEL,)
    seen = files_read(logs, preset)
    unseen = _unseen(test or [], seen)
    check_output("--out", path, kinds, [*seen, *unseen], force, of=chosen.name)
    check_page(page, figures, [*seen, *unseen], force)
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
    trials = _at_rate(logs, preset, rate_hz, sampled_hz)
    held = _at_rate(unseen, preset, rate_hz, sampled_hz) if unseen else []
    _warn_of_limits([*trials, *held], request.limits.command)
    swapped = direction is Direction.INVERSE
    found = _identify(chosen, [t.swapped() for t in trials] if swapped else trials, request, path)
    _score(found, path, {_SEEN: trials, _UNSEEN: held}, skip_first_flexure, page, figures)


def _at_rate(logs: Sequence[Path], preset: str, rate_hz: float | None, sampled_hz: float | None) -> list[Trial]:
    """The logs at the rate of `--rate-hz`; a log that is too slow for a rate that nobody gave is told which to give.

    Raises:
        LogError: see `trials_at`.
    """
    if rate_hz is not None:
        return trials_at(logs, preset, rate_hz, sampled_hz)
    try:
        return trials_at(logs, preset, DEFAULT_RATE_HZ, sampled_hz)
    except SlowLogError as error:
        default = f"the default of {DEFAULT_RATE_HZ:g} Hz"
        raise SlowLogError(error.source, error.log_hz, default, f"; add `--rate-hz {error.log_hz:.4g}`") from None


_SEEN, _UNSEEN = " that it was identified from", " that the fit did not see"


def _score(
    found: Identified, path: Path, sets: Mapping[str, list[Trial]], skip: bool, page: Path | None, figures: Path | None
) -> None:
    """Print, and draw where asked for, how well the model follows each set of trials; the last one counts most."""
    model = load_model(path)
    results = {which: free_runs(model, trials, skip) for which, trials in sets.items() if trials}
    for which, runs in results.items():
        out.print(errors_table(f"{path}: free run on the trials{which}", runs))
        say_starts(runs)
        warn_outside(runs, model.metadata)
    for which, runs in results.items():
        out.print(f"{error_sentence(runs, which)}.", soft_wrap=True, highlight=False)
    if page is not None:
        from hystmpc.models.evaluation_report import evaluation_report  # matplotlib takes a second to import
        from hystmpc.trials.report import Paragraph, Piece, Table

        more: list[Piece] = [Paragraph(found.report)]
        if found.parts is not None:
            units = model.metadata.command_unit, model.metadata.angle_unit
            more += [Table(columns, rows, title) for title, columns, rows in _part_tables(found.parts, Units(*units))]
            more += [Paragraph(line) for line in found.parts.advice]
        with bar("report"), figures_to(figures):
            report = evaluation_report(f"Fit of {path.name}", model.metadata.kind, list(results.items())[::-1], more)
            written = report.save(page)
        out.print(f"report: {written}", soft_wrap=True)


def _unseen(test: Sequence[Path], seen: Sequence[Path]) -> list[Path]:
    """The logs of `--test`.

    Raises:
        ConfigError: on one that the fit sees.
    """
    logs, known = expand_logs(test) if test else [], {log.resolve() for log in seen}
    for log in logs:
        if log.resolve() in known:
            raise ConfigError(f"--test {log}: is one of the logs of the fit, expected logs that it does not see")
    return logs


def _warn_of_limits(trials: Sequence[Trial], limits: Range | None) -> None:
    """One line on standard error where the logs' commands go beyond the limits that the model is to have."""
    if limits is None:
        return
    low, high = min(float(t.command.min()) for t in trials), max(float(t.command.max()) for t in trials)
    slack = RANGE_SLACK * (limits.upper - limits.lower)
    if low < limits.lower - slack or high > limits.upper + slack:
        unit = trials[0].units.command
        errors.print(
            f"warning: the logs' commands go from {low:.4g} to {high:.4g} {unit}, beyond --command-limits "
            f"{limits.lower:g} {limits.upper:g}: the device took more than controllers of this model will send",
            style="yellow",
            soft_wrap=True,
            highlight=False,
        )


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


# `auto` begins with its richest core, which takes longest, and ends after two of three rounds in most cases.
_PACE: dict[str, Pace] = {"auto": ((0, 0), (0.1, 0.36), (0.42, 0.45), (0.7, 0.82), (0.8, 0.95), (1, 1))}
_SEEN_PART = {"--command-limits": "the range", "--command-rate": "the rate"}


def _limits(command: tuple[float, float] | None, rate: float | None) -> DeviceLimits:
    box = Range.parse({"lower": command[0], "upper": command[1]}, "--command-limits") if command else None
    return DeviceLimits(box, rate or None)


def _identify(kind: ModelKind, trials: list[Trial], request: FitRequest, path: Path) -> Identified:
    kind.check(trials, request)
    unit, steps = trials[0].units.angle, kind.steps(request)
    seconds = kind.estimate(trials, request)
    if seconds is not None:
        errors.print(f"{kind.name}, preset {request.preset}: about {about(seconds)} on this machine")
    with bar(f"fit {kind.name}", steps, _PACE.get(kind.name, EVEN)) as show:
        show(0, "first look")
        found = identified(kind, trials, request, lambda done, rmse: show(done, f"best {rmse:.4g} {unit}"))
        if steps is None:
            done, best = found.history[-1]
            show(done, f"best {best:.4g} {unit}", total=done)
    if found.interrupted:
        errors.print("interrupted: the best so far is kept", style="yellow")
    if found.parts is not None:
        for title, columns, rows in _part_tables(found.parts, trials[0].units):
            out.print(table(title, columns, rows))
        for line in found.parts.advice:
            out.print(line, soft_wrap=True)
    if not trials[0].inverted:
        out.print(limits_line(found.bundle.metadata, request.limits), soft_wrap=True, highlight=False)
    if found.simulator is not None and path.suffix.lower() in SIMULATOR.endings:
        save_simulator(found.simulator, path)
        out.print(found.report, soft_wrap=True)
        return found
    with bar("compare and export"):
        gate = export_onnx(found.bundle, path)
    out.print(
        f"{found.report}; exported within {max(gate.runtime_deg, gate.casadi_deg):.2g} {unit} of the reference "
        f"over {gate.steps} steps",
        soft_wrap=True,
    )
    return found


def _part_tables(found: AutoFit, units: Units) -> Iterator[tuple[str, Sequence[str], Sequence[Sequence[str]]]]:
    """Title, columns and rows of what each part bought, and of its numbers."""
    if found.rows:
        rows = [(r.part, r.form, _figure(r.without_deg), _figure(r.with_deg)) for r in found.rows]
        yield f"what each part buys, RMSE on trials left out, in {units.angle}", _PARTS, rows
    numbers = [(f"{r.owner} {r.name}", f"{r.value:.4g}", _interval(r), units.named(r.unit)) for r in found.parameters]
    if numbers:
        yield "identified numbers, with intervals of 90 %", ("parameter", "value", "interval", "unit"), numbers


def _interval(row: ParameterRow) -> str:
    """The interval, one-sided of a number at the end of what was searched."""
    low, high = row.ci90
    if row.at_bound and math.isinf(high):
        return f"{low:.4g} or more"
    return f"{high:.4g} or less" if row.at_bound else f"{low:.4g} to {high:.4g}"


def _figure(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "-"
