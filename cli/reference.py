"""Reference commands: `schema` of configuration files, `effects` of the library, `new` templates of classes."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from hystmpc.trials.errors import ConfigError, did_you_mean

from .console import line, out
from .verb import entries_of

if TYPE_CHECKING:
    from hystmpc.trials.config import Settings

FILES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "simulate": ("hystmpc.sim.config:SimulationConfig", "a study of `hystmpc simulate`"),
        "simulate-two-axes": (
            "hystmpc.sim.two_axes.config:TwoAxisSimulationConfig",
            "a study of two axes, of `hystmpc simulate`",
        ),
        "sweep": ("hystmpc.sim.sweep.settings:SweepSettings", "many studies, of `hystmpc simulate --sweep`"),
        "tune": ("hystmpc.sim.tuning.settings:TuneSettings", "a search of `hystmpc tune`"),
        "tip": ("hystmpc.ctrl.planner.settings:TipSettings", "a `TipController`"),
        "controller": ("hystmpc.ctrl.config:ControllerSettings", "one controller, of `hystmpc simulate --controller`"),
        "run": ("hystmpc.rig.config:RunSettings", "an experiment of `hystmpc run`"),
        "run-two-axes": ("hystmpc.rig.plane_config:PlaneRunSettings", "an experiment of two axes, of `hystmpc run`"),
        "record": ("hystmpc.rig.experiment.record:RecordSettings", "recordings of `hystmpc record`"),
        "record-two-axes": (
            "hystmpc.rig.experiment.record:PlaneRecordSettings",
            "recordings of two axes, of `hystmpc record`",
        ),
        "commission": ("hystmpc.bench.config:CommissionSettings", "a device of `hystmpc commission`"),
        "commission-two-axes": (
            "hystmpc.bench.config:PlaneCommissionSettings",
            "a device of two axes, of `hystmpc commission`",
        ),
        "investigate": ("hystmpc.bench.config:InvestigateSettings", "a device of `hystmpc investigate`"),
        "investigate-two-axes": (
            "hystmpc.bench.config:PlaneInvestigateSettings",
            "a device of two axes, of `hystmpc investigate`",
        ),
        "device": ("hystmpc.rig.device:DeviceSettings", "a simulated device of `hystmpc device`"),
        "device-two-axes": (
            "hystmpc.rig.device:PlaneDeviceSettings",
            "a simulated device of two axes, of `hystmpc device`",
        ),
        "layout": ("hystmpc.trials.layouts:LogMapping", "a layout of logs, of `--layout FILE.yaml`"),
        "simulator": ("hystmpc.models.simulator:SimulatorFile", "a simulator that `hystmpc fit` writes"),
    }
)
"""Kinds of file: location of their settings, and a description."""

TELLS = "says which block this is."
"""Meaning of a key that only distinguishes kinds of blocks."""


def schema(
    kind: Annotated[str | None, typer.Argument(help="Kind of file; left out, the kinds are listed.")] = None,
) -> None:
    """Editors use the schema to check and complete a configuration file."""
    if kind is not None:
        typer.echo(json.dumps(json_schema(settings_of(kind), f"hystmpc: {FILES[kind][1]}"), indent=1))
        return
    for name, (_, what) in FILES.items():
        line(f"{name:17} {what}")


def effects(
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder for a picture of each effect and one HTML page; new or empty.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the library as JSON.")] = False,
) -> None:
    """Each effect is listed with equation, parameters, units, bounds and sides."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from hystmpc.models.effects.catalogue import EFFECTS
    from hystmpc.models.effects.place import library_data, parameter_lines
    from hystmpc.trials.run_folder import require_vacant

    if folder is not None:
        from hystmpc.models.effects.pictures import write_pictures

        require_vacant(folder)
        page = write_pictures(folder)
        if not as_json:
            line(f"pictures and page: {page}")
    if as_json:
        typer.echo(json.dumps(library_data(), indent=1))
    elif folder is None:
        grid = Table(box=SIMPLE_HEAD, pad_edge=False)
        grid.add_column("effect and sides", no_wrap=True)
        grid.add_column("equation; parameters with unit, bounds, neutral value", overflow="fold")
        for effect in EFFECTS.values():
            lines = "\n".join((effect.equation, *(f"  {text}" for text in parameter_lines(effect))))
            grid.add_row(f"{effect.name}\n  {', '.join(effect.sides)}", lines, end_section=True)
        out.print(grid)


def new(
    kind: Annotated[str, typer.Argument(help="Kind of class: transport, effect or controller.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New or empty folder.")],
) -> None:
    """The folder contains the class, contract tests that pass unchanged, and a file to try the class."""
    from hystmpc.testing.templates import write_template

    for file in write_template(kind, folder):
        line(str(file))
    line(f"next: cd {folder} && pytest")


def settings_of(kind: str) -> Any:
    """Class of settings, or union of such classes, of a kind of file.

    Raises:
        ConfigError: if there is no such kind; names the nearest.
    """
    if kind not in FILES:
        raise ConfigError(f"schema {kind}: unknown kind of file, {did_you_mean(kind, FILES)}")
    module, name = FILES[kind][0].split(":")
    return getattr(import_module(module), name)


def json_schema(annotation: Any, title: str) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a file: pydantic's schema, with the meaning of every key as description."""
    from pydantic import TypeAdapter

    schema: dict[str, Any] = TypeAdapter(annotation).json_schema()
    bodies: dict[str, Any] = schema.get("$defs", {})
    for block in reachable(annotation):
        long = f"{block.__module__}.{block.__qualname__}".replace(".", "__")  # pydantic's, where a name stands for two
        body = mapping_in(bodies.get(block.__name__) or bodies.get(long) or schema)
        body["description"] = summary_of(block)
        meanings = meanings_of(block)
        for name, key in body["properties"].items():
            key["description"] = meanings.get(name) or (TELLS if "const" in key else "")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": title}


def mapping_in(body: dict[str, Any]) -> dict[str, Any]:
    """Part of a schema that describes a mapping of keys."""
    return next(part for part in (body, *body.get("anyOf", ())) if "properties" in part)


def summary_of(kind: type[Settings]) -> str:
    """Summary of a block of settings: its docstring before `Attributes:`."""
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ")


def meanings_of(kind: type[Settings]) -> Mapping[str, str]:
    """Meaning of each key by name: the entries of `Attributes:` of the class, then of its bases."""
    bases = reversed(kind.__mro__)
    return {name: text for base in bases for name, text in entries_of(base.__doc__, "Attributes").items()}


def blocks_in(annotation: Any) -> Iterator[type[Settings]]:
    """Classes of settings in an annotation, including those in containers and unions."""
    from hystmpc.trials.config import Settings

    if isinstance(annotation, type) and issubclass(annotation, Settings):
        yield annotation
    for part in get_args(annotation):
        yield from blocks_in(part)


def reachable(annotation: Any) -> tuple[type[Settings], ...]:
    """All blocks that a file can contain, each once, outer ones first."""
    blocks: dict[type[Settings], None] = {}
    waiting = list(blocks_in(annotation))
    while waiting:
        block = waiting.pop(0)
        if block not in blocks:
            block.model_rebuild()  # a field may name a class that its module defines later
            blocks[block] = None
            waiting = [*(b for field in block.model_fields.values() for b in blocks_in(field.annotation)), *waiting]
    return tuple(blocks)
