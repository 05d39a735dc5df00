"""Verb `hystmpc study`: the jobs of one of the studies, its bars, and its failures."""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from hystmpc.cli.bars import bar
from hystmpc.cli.console import INTERRUPTED, errors, out, table
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import require_writable
from hystmpc.trials.run_folder import require_resumable

from ..papers.settings import STAGES

if TYPE_CHECKING:
    from ..page import StudyTable
    from ..study import BegunStudy, Outcome, Study


class Name(StrEnum):
    """Names of the studies."""

    S1 = "s1"
    S2 = "s2"
    REAL = "real"
    KINDS = "kinds"
    CONTROL = "control"
    IDENTIFY = "identify"
    AUTO = "auto"
    COMMISSION = "commission"
    PUBLIC = "public"


_PAPERS = (Name.S1, Name.S2, Name.REAL)
_OPTIONS: Mapping[Name, tuple[str, ...]] = MappingProxyType(
    {
        **dict.fromkeys(_PAPERS, ("logs", "epochs_scale", "kinds", "presets", "directions", "stages")),
        Name.KINDS: ("data", "kinds", "presets"),
        Name.CONTROL: ("rates_hz", "plants", "controllers", "motions"),
        Name.IDENTIFY: ("devices", "families", "kind", "drive", "rates_hz"),
        Name.AUTO: ("devices", "families", "kinds", "orders", "rates_hz"),
        Name.COMMISSION: ("devices", "families", "rates_hz", "diagnose"),
        Name.PUBLIC: ("dataset", "data", "test", "kinds"),
    }
)
"""Options of each study, beside those of all."""

_STAGES = "; ".join(f"{name}: {', '.join(stages)}" for name, stages in STAGES.items())


def study(
    name: Annotated[Name, typer.Argument(help="Papers, recorded logs, closed loop, drawn devices, public data.")],
    folder: Annotated[Path, typer.Option("--out", help="Run folder; an unfinished study in it goes on.")],
    dataset: Annotated[str | None, typer.Argument(help="Of `public`: boucwen, seals, rig.")] = None,
    logs: Annotated[list[Path] | None, typer.Option(help="Logs or folders of *.csv, for `real`; repeatable.")] = None,
    layout: Annotated[str, typer.Option("--layout", help="Layout of the logs.")] = "auto",
    rate_hz: Annotated[float, typer.Option(min=0.1, help="Rate to which logs are resampled [Hz].")] = 25.0,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes, one thread each; else one a core.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of simulated data and training.")] = 1,
    kinds: Annotated[str | None, typer.Option(help="Kinds of model, separated by commas; else the paper's.")] = None,
    presets: Annotated[str | None, typer.Option(help="Presets of the training, such as paper,best.")] = None,
    directions: Annotated[str | None, typer.Option(help="forward,inverse or one of them.")] = None,
    stages: Annotated[str | None, typer.Option(help=f"Parts of the study. {_STAGES}.")] = None,
    epochs_scale: Annotated[
        float | None, typer.Option(min=0.001, max=10.0, help="Share of the papers' epochs; s2 has 0.08, the others 1.")
    ] = None,
    diagnose: Annotated[
        bool | None, typer.Option("--diagnose/--no-diagnose", help="Of `commission`: whether models are diagnosed.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Only prove that everything runs.")] = False,
    loop_rates: Annotated[str | None, typer.Option("--rates", help="Rates done [Hz], such as 25,250.")] = None,
    plants: Annotated[str | None, typer.Option(help="Of `control`, separated by commas; else all.")] = None,
    controllers: Annotated[str | None, typer.Option(help="Of `control`, separated by commas; else all.")] = None,
    motions: Annotated[str | None, typer.Option(help="Of `control`, separated by commas; else all.")] = None,
    devices: Annotated[int | None, typer.Option(min=1, help="How many are drawn; else 60.")] = None,
    families: Annotated[str | None, typer.Option(help="Cores drawn, such as rod,joints,stribeck.")] = None,
    orders: Annotated[int | None, typer.Option(min=1, help="Of `auto`: orders of the logs that are tried.")] = None,
    kind: Annotated[str | None, typer.Option(help="Of `identify`: kind of model, see `fit`; else auto.")] = None,
    drive: Annotated[str | None, typer.Option(help="Of `identify`: auto for an identified drive before it.")] = None,
    data: Annotated[Path | None, typer.Option(help="Of `public`: file or folder to fit. Of `kinds`: devices.")] = None,
    test: Annotated[list[Path] | None, typer.Option(help="Of `public`: further test file, repeatable.")] = None,
) -> None:
    """Do all jobs of a study and write its report. Ctrl-C keeps what is done."""
    workers = jobs or os.cpu_count() or 1
    given: dict[str, Any] = {"logs": [str(log) for log in logs or []], "epochs_scale": epochs_scale, "drive": drive}
    given |= {"kinds": _names(kinds), "presets": _names(presets), "directions": _names(directions)}
    given |= {"stages": _names(stages), "rates_hz": _rates(loop_rates), "plants": _names(plants), "orders": orders}
    given |= {"controllers": _names(controllers), "motions": _names(motions), "devices": devices, "kind": kind}
    given |= {"families": _names(families), "diagnose": diagnose, "dataset": dataset, "data": data, "test": test}
    changes = _used(name, given) | {"seed": seed, "quick": quick}
    if name == Name.KINDS:
        _over_devices(changes, folder, workers)
        return
    if name in _PAPERS:
        changes |= {"layout": layout, "rate_hz": rate_hz}
    chosen = _listed(name)
    settings = chosen.settings(**changes)
    require_resumable(folder)
    if name in _PAPERS:
        if settings.left_out:
            errors.print(f"not in the catalogue, left out: {', '.join(settings.left_out)}", style="yellow")
        errors.print("making the trials and timing a few steps of every model ...")
    outcome = _completed(chosen.begin(settings, folder), name.value, workers)
    if chosen.summary is not None:
        _show(chosen.summary(outcome), chosen.digits)
    done = len(outcome.results) - len(outcome.failed)
    out.print(f"{done} jobs done, {len(outcome.failed)} failed; report: {folder / 'report.html'}")


def _used(name: Name, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a study; `ConfigError` on one without an effect."""
    for option, value in given.items():
        if option not in _OPTIONS[name] and value not in (None, (), []):
            unused = option.removesuffix("_hz").replace("_", "-")
            raise ConfigError(f"study {name.value}: got --{unused}, which it has no use for")
    return {option: given[option] for option in _OPTIONS[name]}


def _listed(name: str) -> Study[Any, Any, Any]:
    """Study of that name, imported on demand, since its libraries are slow to load."""
    if name in _PAPERS:
        return cast("Study[Any, Any, Any]", import_module("hystmpc_lab.papers.study").STUDIES[name])
    return cast("Study[Any, Any, Any]", import_module(f"hystmpc_lab.{name}.study").STUDY)


def _completed(begun: BegunStudy[Any, Any, Any], name: str, workers: int) -> Outcome[Any, Any]:
    """Execute the open jobs of a study with a progress bar, and report failures; Ctrl-C exits with code 130."""
    minutes = begun.minutes(workers)
    errors.print(f"{len(begun.costs)} of {len(begun.jobs)} jobs to do on {workers} cores: about {minutes} min")
    try:
        with bar(f"study {name}", sum(begun.costs.values())) as show:
            outcome = begun.finish(workers, lambda done, total, note="": show(done, note, total=total))
    except KeyboardInterrupt:
        kept = f"finished jobs are kept in {begun.folder.path}, the same command goes on"
        errors.print(f"interrupted: {kept}", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    for failed in outcome.failed:
        errors.print(f"failed: {failed.job.key}: {failed.message}", style="red", highlight=False)
    return cast("Outcome[Any, Any]", outcome)


def _over_devices(changes: dict[str, Any], folder: Path, workers: int) -> None:
    """Execute the study on the logs of each device in a separate folder, then write the tables over all devices."""
    from ..papers.real import device_settings, kinds_report

    file = changes.pop("data")
    if file is None:
        raise ConfigError("study kinds: got no --data, expected a YAML file of devices and their logs")
    require_writable(folder)
    settings = device_settings(file, **changes)
    for name in settings:
        require_resumable(folder / name)
    outcomes: dict[str, Any] = {}
    for name, of_device in settings.items():
        errors.print(f"{name}: timing a few steps of every kind ...")
        outcomes[name] = _completed(_listed(Name.REAL).begin(of_device, folder / name), name, workers)
    page, tables = kinds_report(outcomes)
    for one in tables:
        one.save(folder)
        _show(one, 3)
    page.save(folder / "report.html")
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True)


def _show(one: StudyTable, digits: int) -> None:
    rows = [[f"{cell:.{digits}g}" if isinstance(cell, float) else str(cell) for cell in row] for row in one.rows]
    out.print(table(one.caption, one.columns, rows))


def _rates(text: str | None) -> tuple[float, ...]:
    numbers = []
    for part in _names(text):
        try:
            numbers.append(float(part))
        except ValueError:
            raise ConfigError(f"--rates: got {part!r}, expected numbers such as 25,250") from None
    return tuple(numbers)


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())
