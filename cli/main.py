"""Program `hystmpc`: its subcommands, each imported at its call, and its end by errors and Ctrl-C."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.metadata import version
from types import MappingProxyType, SimpleNamespace
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.from_outside import installed, object_named

from .interrupt import end_imports

UNUSABLE = 2

VERBS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "check": ("models:check", "Check logs: can they be used, and what is in them."),
        "fit": ("models:fit", "Identify a model from recorded trials."),
        "evaluate": ("models:evaluate", "Compare a model's free run with recorded trials."),
        "export": ("models:export", "Export a simulator as a stateful ONNX step."),
        "export-c": ("models:export_c", "Export a predictive controller as C99."),
        "export-fmu": ("models:export_fmu", "Export a simulator with its effects as an FMU."),
        "diagnose": ("diagnose:diagnose", "Diagnose the gap between a simulator and its device."),
        "analyse": ("analyse:analyse", "Predict margins and limit cycles of controllers before the device moves."),
        "simulate": ("simulate:simulate", "Simulate the closed loop; write a run folder and its report."),
        "tune": ("simulate:tune", "Search the settings of a controller on simulated plants."),
        "commission": ("device:commission", "From a device to a verified controller, in five minutes of device time."),
        "investigate": (
            "device:investigate",
            "Record and diagnose, round by round, until a simulator's gap has a name.",
        ),
        "run": ("device:run", "Track a reference on a device."),
        "record": ("device:record", "Record identification trials on a device."),
        "device": ("device:device", "Serve a simulated device over UDP or DDS."),
        "report": ("models:report", "Write report.html of a run folder again."),
        "new": ("reference:new", "Write a class of yours to fill in, with its contract tests."),
        "schema": ("reference:schema", "Print the JSON schema of a configuration file, for editors."),
        "effects": ("reference:effects", "List the effects that can be put into any simulator."),
        "demo": ("simulate:demo", "Track two motions with every controller on a simulated device."),
    }
)
"""Subcommands: MODULE:NAME of their functions in this package, and their lines in `hystmpc --help`."""

GROUP = "hystmpc.verbs"
"""Entry point group of further subcommands; each value is MODULE:NAME of a mapping in the form of `VERBS`."""

_LABORATORY = "Studies and benchmarks are verbs of hystmpc-lab: pip install ./lab, or 'hystmpc[papers]'."

_PLAIN: Any = {"rich_markup_mode": None, "pretty_exceptions_enable": False}
_HELP = {"help_option_names": ["-h", "--help"]}  # verbs inherit it


def _nothing() -> None:
    pass


@cache
def verbs_of_others() -> Mapping[str, tuple[str, str]]:
    """Subcommands of installed packages, see `GROUP`; a subcommand of hystmpc itself cannot be replaced.

    Raises:
        ConfigError: if a package's mapping cannot be imported.
    """
    verbs: dict[str, tuple[str, str]] = {}
    for name in installed(GROUP).values():
        verbs |= object_named(name, "verbs", GROUP, lambda kept: isinstance(kept, Mapping), "mapping of verbs")
    return {name: verb for name, verb in verbs.items() if name not in VERBS}


def _lines() -> dict[str, str]:
    return {name: line for name, (_, line) in {**VERBS, **verbs_of_others()}.items()}


class Verbs(TyperGroup):
    """Group of the subcommands, which imports only the module of the called subcommand."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names in the order of `VERBS`, then those of installed packages."""
        del ctx
        return list(_lines())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a subcommand by name, None for an unknown one."""
        if cmd_name not in VERBS and cmd_name not in verbs_of_others():
            return None
        builtin = cmd_name in VERBS
        module, _, name = (VERBS if builtin else verbs_of_others())[cmd_name][0].partition(":")
        verb = getattr(import_module(f".{module}" if builtin else module, __package__), name)
        group = typer.Typer(add_completion=False, **_PLAIN)
        group.callback()(_nothing)  # a group, however many verbs it has
        if isinstance(verb, typer.Typer):
            group.add_typer(verb, name=cmd_name)
        elif builtin:
            words = str(inspect.getdoc(getattr(verb, "shows", verb))).partition("\n\nRaises:")[0]
            callback = verb.callback() if hasattr(verb, "shows") else verb
            group.command(cmd_name, cls=getattr(verb, "cls", None), help=f"{VERBS[cmd_name][1]}\n\n{words}")(callback)
        else:
            group.command(cmd_name)(verb)
        return typer.main.get_command(group).get_command(ctx, cmd_name)  # type: ignore[attr-defined]  # it is a group

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a help line for each subcommand, without importing any of them."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(_lines().items()))

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Subcommands and options that begin with `incomplete`, without importing any subcommand."""
        verbs = [
            SimpleNamespace(type="plain", value=name, help=line)
            for name, line in _lines().items()
            if name.startswith(incomplete)
        ]
        return [*verbs, *super(TyperGroup, self).shell_complete(ctx, incomplete)]

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the called subcommand; for an unknown name raise an error with the nearest."""
        if args and args[0] not in VERBS and args[0] not in _lines() and not args[0].startswith("-"):
            near = get_close_matches(args[0], _lines(), n=1)
            hint = f" Did you mean {near[0]!r}?" if near else f" {_LABORATORY}"
            ctx.fail(f"No such command {args[0]!r}.{hint}")
        return super().resolve_command(ctx, args)


app = typer.Typer(cls=Verbs, name="hystmpc", no_args_is_help=True, context_settings=_HELP, **_PLAIN)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"hystmpc {version('hystmpc')}")
        raise typer.Exit


@app.callback()
def hystmpc(
    context: typer.Context,
    show_version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and end.")
    ] = False,
) -> None:
    """Identify actuators with hysteresis, control them, and diagnose where a simulator and its device differ."""
    del show_version  # its callback has been called
    from .bars import SCREEN

    end_imports()
    context.call_on_close(SCREEN.stop)


def main() -> None:
    """Run the program; one line on standard error and exit code 2 for unusable input, 130 after Ctrl-C."""
    try:
        app()
    except HystmpcError as error:
        _end(str(error))
    except OSError as error:  # a full disk, a file that may not be read: a fault of the machine, not of the program
        _end(f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error))


def _end(text: str) -> NoReturn:
    from .console import say

    say(f"error: {' '.join(text.split())}", style="red")
    sys.exit(UNUSABLE)
