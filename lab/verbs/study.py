"""`hystmpc study`: every model of a paper trained, tested and set beside what the paper prints."""

from __future__ import annotations

import os
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hystmpc.cli.console import errors
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_resumable

from ..papers.settings import STAGES, StudySettings
from .study_commission import commission
from .study_control import control, rates
from .study_identify import identify
from .study_jobs import completed, ended
from .study_kinds import kinds as kinds_over_devices
from .study_public import public


class Name(StrEnum):
    """The studies there are."""

    S1 = "s1"
    S2 = "s2"
    REAL = "real"
    KINDS = "kinds"
    CONTROL = "control"
    IDENTIFY = "identify"
    COMMISSION = "commission"
    PUBLIC = "public"


_OTHERS = {
    Name.CONTROL: control,
    Name.IDENTIFY: identify,
    Name.COMMISSION: commission,
    Name.PUBLIC: public,
    Name.KINDS: kinds_over_devices,
}
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
    loop_rates: Annotated[
        str | None, typer.Option("--rates", help="Of `control`, `identify` and `commission` [Hz], such as 25,250.")
    ] = None,
    plants: Annotated[str | None, typer.Option(help="Of `control`, separated by commas; else all.")] = None,
    controllers: Annotated[str | None, typer.Option(help="Of `control`, separated by commas; else all.")] = None,
    motions: Annotated[str | None, typer.Option(help="Of `control`, separated by commas; else all.")] = None,
    devices: Annotated[
        int | None, typer.Option(min=1, help="Of `identify` and `commission`: how many are drawn; else 60.")
    ] = None,
    kind: Annotated[str | None, typer.Option(help="Of `identify`: kind of model, see `fit`; else auto.")] = None,
    drive: Annotated[str | None, typer.Option(help="Of `identify`: auto for an identified drive before it.")] = None,
    data: Annotated[Path | None, typer.Option(help="Of `public`: file or folder to fit. Of `kinds`: devices.")] = None,
    test: Annotated[list[Path] | None, typer.Option(help="Of `public`: further test file, repeatable.")] = None,
) -> None:
    """Do all jobs of a study and write its report.

    Ctrl-C keeps what is done.
    """
    workers = jobs or os.cpu_count() or 1
    loop = {"rates_hz": rates(loop_rates), "plants": _names(plants), "controllers": _names(controllers)}
    loop["motions"] = _names(motions)
    modelling = {"kinds": kinds, "presets": presets, "directions": directions, "stages": stages}
    drawn = {"devices": devices, "kind": kind, "drive": drive, "rates_hz": loop["rates_hz"]}
    benches = {"devices": devices, "rates_hz": loop["rates_hz"], "diagnose": diagnose}
    benchmark = {"dataset": dataset, "data": data, "test": test, "kinds": _names(kinds)}
    own: dict[Name, Mapping[str, object]] = {Name.CONTROL: loop, Name.IDENTIFY: drawn, Name.COMMISSION: benches}
    compared = {"data": data, "kinds": _names(kinds), "presets": _names(presets)}
    own |= {Name.PUBLIC: benchmark, Name.KINDS: compared}
    _check_options(name, {"logs": logs, "epochs-scale": epochs_scale, **modelling}, own)
    if name in _OTHERS:
        _OTHERS[name]({**own[name], "seed": seed, "quick": quick}, folder, workers)
        return
    settings = StudySettings.for_study(
        name.value,
        logs=[str(log) for log in logs or []],
        layout=layout,
        rate_hz=rate_hz,
        seed=seed,
        epochs_scale=epochs_scale,
        quick=quick,
        **{option: _names(text) for option, text in modelling.items()},
    )
    _run(settings, folder, workers)


def _check_options(name: Name, modelling: Mapping[str, object], others: Mapping[Name, Mapping[str, object]]) -> None:
    """Refuse options that a study has no use for."""
    own = others.get(name, modelling)
    for options in (modelling, *others.values()):
        for option, value in options.items():
            if option not in own and value not in (None, (), []):
                raise ConfigError(f"study {name.value}: got --{option.removesuffix('_hz')}, which it has no use for")


def _run(settings: StudySettings, folder: Path, workers: int) -> None:
    """Say how long it will take, do it, and say what failed."""
    from ..papers.run import prepare, run_study  # kept out of the way of the other verbs' start

    require_resumable(folder)
    if settings.left_out:
        errors.print(f"not in the catalogue, left out: {', '.join(settings.left_out)}", style="yellow")
    errors.print("making the trials and timing a few steps of every model ...")
    study = prepare(settings, folder)
    ended(completed(study.ready, settings.study, workers, lambda progress: run_study(study, workers, progress)), folder)


def _names(text: str | None) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())
