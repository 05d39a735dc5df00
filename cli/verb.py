"""Subcommands from the functions of `tasks`: parameters become arguments and options, their `Args:` text the help."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, final

import typer
from typer.core import TyperCommand

from .bars import EVEN, Pace, progress_of
from .console import say

Task = Callable[..., Any]
Options = Mapping[str, Any]

LOGS: Options = {"metavar": "LOG", "help": "Recorded trials (csv, xlsx, mat, ROS bag, ...) or folders of them."}
SIM: Options = {"help": "Simulator: .yaml of `fit`, an exported .onnx model, or builtin:NAME."}
REQUIRED: Options = {"default": Parameter.empty}
OPTIONAL: Options = {"default": None}

_FILES, _TEXTS = list[Path], list[str]
_TYPES: Mapping[str, Any] = {
    "bool": bool,
    "int": int,
    "float": float,
    "str": str,
    "AnyLayout": str,
    "Logs": _FILES,
    "Iterable[Path | str]": _FILES,
    "Iterable[str]": _TEXTS,
    "Sequence[str]": _TEXTS,
}
"""Types of options by the annotations of the tasks; all other annotations are files."""

_FLAGS = {"out": "--out", "overrides": "--set", "simulator": "--sim"}
_INJECTED = ("progress", "say", "show")
_SECTION = r"^{}:\n((?:[ ]{{4}}.*\n?|\n(?=[ ]{{4}}))+)"
_ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*(?:\n {5,}.*)*)", re.MULTILINE)


def entries_of(docstring: str | None, section: str) -> dict[str, str]:
    """Entries of a docstring section such as `Args` or `Attributes`, by name."""
    matched = re.search(_SECTION.format(section), inspect.cleandoc(docstring or "") + "\n", re.MULTILINE)
    entries = _ENTRY.finditer(matched[1] if matched else "")
    return {name: " ".join(entry[2].split()) for entry in entries for name in entry[1].split(", ")}


@final
class Call:
    """Call of a subcommand; its attributes are the command-line arguments, () for an empty list."""

    def __init__(self, tasks: tuple[Task, ...], given: Mapping[str, Any]) -> None:
        self._tasks, self._given = tasks, given

    def __getattr__(self, name: str) -> Any:
        if name not in self._given:
            raise AttributeError(f"no argument {name!r}, expected one of: {', '.join(self._given)}")
        return self._given[name]

    def run(self, title: str, k: int = 0, *, pace: Pace = EVEN, kept: str = "", after: float = 0.0, **more: Any) -> Any:
        """Run the k-th task of the subcommand, show its progress, and return its result.

        Args:
            title, pace, kept, after: see `progress_of`.
            more: arguments in place of those from the command line.
        """
        with progress_of(title, pace, kept, after) as progress:
            arguments = {"progress": progress, "say": say, **self._given, **more}
            names = inspect.signature(self._tasks[k]).parameters
            return self._tasks[k](**{name: arguments[name] for name in names if arguments.get(name, ()) != ()})


@final
@dataclass(frozen=True)
class Verb:
    """Subcommand (verb) whose arguments and options are the parameters of tasks."""

    tasks: tuple[str, ...]  # MODULE:NAME in `hystmpc.tasks`; a common parameter is that of the first
    shows: Callable[..., None]  # runs a task and prints its result; may add options, and its docstring is help as well
    differs: Mapping[str, Options | None]  # changes to the options made by `_parameter`; None for no option
    cls: type[TyperCommand] | None = None

    def callback(self) -> Callable[..., None]:
        """Function that typer calls, with the signature that typer reads."""
        tasks = tuple(_task(name) for name in self.tasks)
        parameters: dict[str, Parameter] = {}
        for task in tasks:
            meanings = entries_of(task.__doc__, "Args")
            for name, parameter in inspect.signature(task).parameters.items():
                differs = self.differs.get(name, {})
                if differs is not None and name not in (*parameters, *_INJECTED):
                    parameters[name] = _parameter(parameter, **{"help": meanings.get(name, ""), **differs})
        further = list(inspect.signature(self.shows, eval_str=True).parameters.values())[1:]
        further_options = [parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in further]

        def call(**values: Any) -> None:
            rest = {parameter.name: values.pop(parameter.name) for parameter in further_options}
            given = {name: value or () if name in lists else value for name, value in values.items()}
            self.shows(Call(tasks, given), **rest)

        lists = [name for name, parameter in parameters.items() if "list[" in str(parameter.annotation)]
        call.__signature__ = inspect.Signature([*parameters.values(), *further_options])  # type: ignore[attr-defined]
        return call


def verb(
    *tasks: str, cls: type[TyperCommand] | None = None, **differs: Options | None
) -> Callable[[Callable[..., None]], Verb]:
    """Decorate a function that runs a task and prints its result; see `Verb`."""
    return lambda shows: Verb(tasks, shows, differs, cls)


def _task(place: str) -> Task:
    module, _, name = place.partition(":")
    task: Task = getattr(import_module(f"hystmpc.tasks.{module}"), name)
    return task


def _parameter(parameter: Parameter, *, flag: str = "", kind: Any = None, help: str, **more: Any) -> Parameter:
    """Parameter of the command: an option if it is a keyword or has a `flag`, otherwise an argument."""
    kind = kind or _TYPES.get(parameter.annotation.removesuffix(" | None"), Path)
    flag = flag or _FLAGS.get(parameter.name, "")
    if not flag and parameter.kind is Parameter.KEYWORD_ONLY:
        flag = f"--{parameter.name.replace('_', '-')}"
    default = more.pop("default", None if parameter.default == () else parameter.default)
    meaning = f"{help[:1].upper()}{help[1:]}"
    if flag.startswith("--"):
        meaning = f"{meaning.rstrip('.')}; repeatable." if kind in (_FILES, _TEXTS) else meaning
        info: Any = typer.Option(flag, help=meaning, **more)
    else:
        info = typer.Argument(help=meaning, **{"metavar": parameter.name.upper(), **more})
    annotation = Annotated[kind | None if default is None else kind, info]  # type: ignore[valid-type]
    return Parameter(parameter.name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
