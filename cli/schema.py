"""`hystmpc schema`: the JSON schema of a kind of configuration file, for editors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Annotated, Any

import typer

from hystmpc.trials.errors import ConfigError, did_you_mean

from .console import out
from .settings_reference import json_schema

FILES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "simulate": ("hystmpc.sim.config:SimulationConfig", "a study of `hystmpc simulate`"),
        "sweep": ("hystmpc.sim.sweep.settings:SweepSettings", "many studies, of `hystmpc simulate --sweep`"),
        "tune": ("hystmpc.sim.tuning.settings:TuneSettings", "a search of `hystmpc tune`"),
        "tip": ("hystmpc.ctrl.planner.settings:TipSettings", "a `TipController`"),
        "controller": ("hystmpc.ctrl.config:ControllerSettings", "one controller, of `hystmpc simulate --controller`"),
        "run": ("hystmpc.rig.config:RunSettings", "an experiment of `hystmpc run`"),
        "record": ("hystmpc.rig.experiment.record:RecordSettings", "recordings of `hystmpc record`"),
        "commission": ("hystmpc.bench.config:CommissionSettings", "a device of `hystmpc commission`"),
        "investigate": ("hystmpc.bench.config:InvestigateSettings", "a device of `hystmpc investigate`"),
        "device": ("hystmpc.rig.device:DeviceSettings", "a simulated device of `hystmpc device`"),
        "layout": ("hystmpc.trials.layouts:LogMapping", "a layout of logs, of `--layout FILE.yaml`"),
        "simulator": ("hystmpc.models.simulator:SimulatorFile", "a simulator that `hystmpc fit` writes"),
    }
)
"""Kinds of file: where their settings are defined, and what the file is."""


def settings_of(kind: str) -> Any:
    """The class of settings, or the union of such, of a kind of file.

    Raises:
        ConfigError: if there is no such kind; names the nearest.
    """
    if kind not in FILES:
        raise ConfigError(f"schema {kind}: unknown kind of file, {did_you_mean(kind, FILES)}")
    module, name = FILES[kind][0].split(":")
    return getattr(import_module(module), name)


def schema(
    kind: Annotated[str | None, typer.Argument(help="Kind of file; left out, the kinds are listed.")] = None,
) -> None:
    """Print the JSON schema of a kind of configuration file.

    An editor checks and completes a file whose schema it knows.
    """
    if kind is None:
        for name, (_, what) in FILES.items():
            out.print(f"{name:12} {what}", soft_wrap=True)
        return
    typer.echo(json.dumps(json_schema(settings_of(kind), f"hystmpc: {FILES[kind][1]}"), indent=1))
