"""Subcommands on logs and models: `check`, `fit`, `evaluate`, `export`, `export-c`, `export-fmu`, `report`."""

from __future__ import annotations

import hashlib
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand

from hystmpc.trials.errors import ConfigError

from .bars import EVEN, Pace
from .console import line, out, table
from .verb import LOGS, REQUIRED, SIM, Call, verb

if TYPE_CHECKING:
    from hystmpc.codegen import ControllerExport, FmuExport
    from hystmpc.models.contract.export import EquivalenceReport
    from hystmpc.models.contract.metadata import DeviceLimits, ModelMetadata
    from hystmpc.tasks.check import LogsCheck
    from hystmpc.tasks.evaluate import Evaluation
    from hystmpc.tasks.fit import Fit
    from hystmpc.tasks.fit_both import FitOfBothAxes
    from hystmpc.trials.findings import CheckReport

_COLOURS = {"ok": "green", "note": "cyan", "warning": "yellow", "error": "red"}
# `auto` begins with its richest core, which takes longest, and ends after two of three rounds in most cases.
_PACE: dict[str, Pace] = {"auto": ((0, 0), (0.1, 0.36), (0.42, 0.45), (0.7, 0.82), (0.8, 0.95), (1, 1))}
_SEEN_PART = {"--command-limits": "the range", "--command-rate": "the rate"}
_NO_COMPILER = "sources only: no C compiler was found for this machine"


@verb("check:check", logs=LOGS, simulator=SIM)
def check(call: Call) -> None:
    """The check covers time base, jitter, gaps, duplicates, NaN, units, sign, segments, first flexure.

    Exit code 1 if a log cannot be used. With --sim also the smallest detectable size of each effect in `diagnose`, from
    the commands alone.
    """
    checked: LogsCheck = call.run("check", show=_print_findings)
    if checked.worst == "error":
        raise typer.Exit(1)
    if checked.detectable is not None:
        from hystmpc.gap.report.words import DETECTABLE_COLUMNS, detectable_rows, detectable_sentence

        line(detectable_sentence(checked.detectable))
        if checked.detectable.effects:
            out.print(table("These logs would show", DETECTABLE_COLUMNS, detectable_rows(checked.detectable)))


def _print_findings(report: CheckReport) -> None:
    grid = Table(title=f"{report.source} ({report.layout})", title_justify="left", show_header=False)
    for finding in report.findings:
        severity = Text(str(finding.severity), style=_COLOURS[finding.severity])
        grid.add_row(severity, finding.topic, finding.message)
    out.print(grid)


class FitCommand(TyperCommand):
    """Parser of `fit`, which refuses logs on both sides of `--test LOG`: `--test a.csv b.csv` would fit b.csv."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments, then check the argument after the log of each `--test`.

        Raises:
            ConfigError: if it is a log of the fit and there are others elsewhere.
        """
        given = list(args)
        rest = super().parse_args(ctx, args)
        behind: list[str] = []
        for k in (k for k, word in enumerate(given) if word == "--test"):
            behind += takewhile(lambda word: not word.startswith("-"), given[k + 2 :])
        fitted = [str(log) for log in ctx.params.get("trials") or ()]
        astray = [name for name in fitted if name in map(str, map(Path, behind))]
        if astray and len(astray) < len(fitted):
            raise ConfigError(
                f"fit: {astray[0]} stands behind --test, which takes one log, and would be fitted; "
                f"write `--test {astray[0]}`, or put it before --test"
            )
        return rest


@verb(
    "fit:fit",
    cls=FitCommand,
    trials=LOGS,
    out=REQUIRED,
    inverse=None,
    plays={"min": 1, "max": 50},
    drive={"kind": str},
    steps={"flag": "--epochs", "min": 1},
    inputs={"flag": "--input", "metavar": "NAME"},
    hold_out={"min": 0},
    validation={"metavar": "LOG"},
    constancy_weight={"flag": "--constancy", "min": 0.0},
    test={"metavar": "LOG"},
    limits=None,
)
def fit(
    call: Call,
    direction: Annotated[
        Literal["forward", "inverse"], typer.Option(help="Command to angle, or the inverse map.")
    ] = "forward",
    command_limits: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Least and greatest command of the device; those in the logs where left out."),
    ] = None,
    command_rate: Annotated[
        float | None,
        typer.Option(min=0.0, help="Greatest command change per second; the one in the logs where left out."),
    ] = None,
) -> None:
    """Ctrl-C ends the search; the best model so far is written."""
    from hystmpc.models.contract.metadata import DeviceLimits, Range
    from hystmpc.models.evaluate import error_sentence
    from hystmpc.tasks.fit_both import FitOfBothAxes

    ends = dict(zip(("lower", "upper"), command_limits or (), strict=False))
    limits = DeviceLimits(Range.parse(ends, "--command-limits") if ends else None, command_rate or None)
    made: Fit | FitOfBothAxes = call.run(
        f"fit {call.kind}", pace=_PACE.get(call.kind, EVEN), inverse=direction == "inverse", limits=limits
    )
    if isinstance(made, FitOfBothAxes):
        _print_both(made)
    else:
        _print_model(made, limits)
    for which, evaluation in made.evaluations:
        _print_errors(f"{call.out}: free run on the trials{which}", evaluation)
    for which, evaluation in made.evaluations:
        line(f"{error_sentence(evaluation.trials, which)}.")
    _print_page(call)


def _print_model(made: Fit, limits: DeviceLimits) -> None:
    from hystmpc.tasks.fit import part_tables

    done, gate, units = made.identified, made.exported, made.trials[0].units
    if done.parts is not None:
        for title, columns, rows in part_tables(done.parts, units):
            out.print(table(title, columns, rows))
        for advice in done.parts.advice:
            line(advice)
    if not made.trials[0].inverted:
        line(limits_line(done.bundle.metadata, limits))
    exported = ""
    if gate is not None:
        error = max(gate.runtime_deg, gate.casadi_deg)
        exported = f"; exported within {error:.2g} {units.angle} of the reference over {gate.steps} steps"
    line(f"{done.report}{exported}")


def _print_both(made: FitOfBothAxes) -> None:
    fit, model = made.identified, made.model
    rows = [[name, f"{error:.3g}", "kept" if name == fit.joint else ""] for name, error in fit.errors.items()]
    out.print(table("What joins both axes", ("joint", "parts left out [deg]", ""), rows))
    for name, axis in zip("xy", model.axes, strict=True):
        line(f"axis {name}: {' + '.join(operator.name for operator in axis.chain.operators)}")
    line(f"mix {model.matrix.round(4).tolist()}, frame {model.turn.round(4).tolist()}")
    line(made.report)


def limits_line(stored: ModelMetadata, given: DeviceLimits) -> str:
    """Sentence on the limits that controllers of the model respect, and their origin: device or logs."""
    box, unit = stored.command_limits, stored.command_unit
    rate = f"at most {stored.command_rate:.4g} {unit}/s"
    text = f"limits stored in the model: {box.lower:.4g} to {box.upper:.4g} {unit}, {rate}"
    options = {"--command-limits": given.command, "--command-rate": given.rate_per_s}
    absent = [name for name, value in options.items() if value is None]
    if not absent:
        return f"{text}, as given"
    seen = "as seen in the logs" if len(absent) == len(options) else f"{_SEEN_PART[absent[0]]} as seen in the logs"
    return f"{text}, {seen}; give {' and '.join(absent)} for the device's own"


@verb(
    "evaluate:evaluate",
    model={"help": "A simulator or model of two axes (.yaml), exported model (.onnx) or builtin:NAME."},
    trials=LOGS,
)
def evaluate(call: Call) -> None:
    """The free run starts at the measured angle and uses the command alone.

    An inverse map runs from the angle to the command.
    """
    from hystmpc.models.evaluate import error_sentence

    evaluation: Evaluation = call.run("evaluate")
    later = ", from the first reversal on" if call.skip_first_flexure else ""
    _print_errors(f"{call.model}: free run{later}", evaluation)
    line(f"{error_sentence(evaluation.trials)}.")
    _print_page(call)


def _print_errors(title: str, evaluation: Evaluation) -> None:
    from hystmpc.models.evaluate import error_table, start_sentences

    runs = evaluation.trials
    out.print(table(f"{title}, in {runs[0].trial.units.angle}", *error_table(runs), last_apart=True))
    for sentence in start_sentences(runs):
        line(f"{sentence}.")


def _print_page(call: Call) -> None:
    if call.report is not None:
        line(f"report: {call.report}")


@verb(
    "export:export",
    model={"metavar": "SIMULATOR", "help": "A simulator or model of two axes (.yaml of `fit`), or builtin:NAME."},
)
def export(call: Call) -> None:
    """The step is compared with its reference in onnxruntime and CasADi before it is written."""
    gate: EquivalenceReport = call.run("compare and export")
    line(
        f"{call.out}: {gate.steps} steps within {max(gate.runtime_deg, gate.casadi_deg):.2g} deg of the reference "
        f"(onnxruntime {gate.runtime_deg:.2g}, CasADi {gate.casadi_deg:.2g}), Jacobians within {gate.jacobian:.2g}; "
        f"sha256 {hashlib.sha256(Path(call.out).read_bytes()).hexdigest()[:12]}"
    )


@verb(
    "export:export_c",
    settings={"metavar": "TIP", "help": "Settings of a controller, as a planner gives them."},
    out={"metavar": "DIR"},
    single={"flag": "--float32"},
)
def export_c(call: Call) -> None:
    """The export is one file and its header, without heap or further libraries.

    Its commands are those of the Python controller.
    """
    made: ControllerExport = call.run("export")
    inexact = f" (last digits vary: {', '.join(made.inexact)})" if made.inexact else ""
    of_two = f"two axes, {made.commands} commands, " if made.axes > 1 else ""
    line(
        f"{call.out / 'hystmpc.c'}, {call.out / 'hystmpc.h'}: {of_two}a step every {made.sample_s:g} s, "
        f"{made.reference_samples} samples of reference, {'float' if call.single else 'double'}; {made.memory_bytes} "
        f"bytes, of which {made.remembered_bytes} are remembered; calls {', '.join(made.functions)} of "
        f"<math.h>{inexact}"
    )


_PLANT = {"flag": "SIM", "metavar": "SIM", "help": "A simulator (.yaml, builtin:NAME), or the file of a study."}


@verb("export:export_fmu", simulator=_PLANT, fmi={"kind": Literal["2.0", "3.0"]}, platforms={"flag": "--platform"})
def export_fmu(call: Call) -> None:
    """The input of the co-simulation FMU is the command, its output the true angle without sensor noise.

    The FMU holds its C sources, and a binary if a compiler is available: CC, cc, or the package ziglang.
    """
    made: FmuExport = call.run("export")
    facts = made.described
    binaries = f"binaries {', '.join(made.platforms)}" if made.platforms else _NO_COMPILER
    calls = f"; calls {', '.join(made.functions)} of <math.h>" if made.functions else ""
    left_out = f"; left out: {', '.join(made.left_out)}" if made.left_out else ""
    line(
        f"{call.out}: FMI {call.fmi}, co-simulation, a step every {facts.sample_s:g} s, {facts.signals}; "
        f"{binaries}{calls}{left_out}"
    )


@verb("report:report")
def report(call: Call) -> None:
    """For an experiment the report recommends the next step: none, `fit` or `diagnose`.

    With an earlier run it says how far the tracking error fell, and with a diagnosis how far it was expected to fall on
    this reference.
    """
    written = call.run("report")
    for text in written.lines:
        line(text)
    line(f"report: {written.path}")
