"""A whole tuning in a resumable run folder: search, check on held-out plants, controller, report."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.csv_files import format_table
from hystmpc.trials.errors import ConfigError, FitError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import RunFolder, alone_in, resumed_folder
from hystmpc.trials.types import Progress, parts

from ..jobs.backend import Backend
from ..jobs.runner import run_jobs
from .objective import SearchTrial, Ticket, TicketOutcome, Tuning, held_out
from .report import tuning_report
from .settings import TuneSettings

_REPORT_RUNS = 4  # runs of a plant that take as long as the report
_WAIT_S = 3.0  # until trials that another process does are asked for again


def run_tuning(
    settings: TuneSettings,
    out: Path | str,
    backend: Backend,
    storage: str | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Search, check, and leave controller.yaml, study.yaml, trials.csv, held_out.csv and report.html in `out`.

    Args:
        settings: complete, as `load_tuning` gives them.
        out: a new or empty folder, or one of a tuning, whose trials are kept; one for each machine.
        storage: of the search, as Optuna names it, such as `postgresql://...`; several machines that name the same one
            share the trials. A file in `out` where left out.

    Raises:
        ConfigError: if the folder holds something else, the storage cannot be opened, workers die again and again, or
            optuna is not installed.
        FitError: if no trial came to an end.
        KeyboardInterrupt: if the user ended it; finished trials are kept.
    """
    backend.check()
    if storage is not None:
        _optuna().open_search(storage, f"hystmpc-{settings.fingerprint}")  # before anything is written
    folder = _folder(Path(out), settings)
    runs = settings.trials * settings.plants.count, 2 * settings.held_out.count, _REPORT_RUNS
    searching, checking, reporting = parts(progress, runs)
    with alone_in(folder.path):
        url = storage or f"sqlite:///{(folder.path / 'search.db').resolve()}"
        trials, failed = search(settings, backend, url, searching)
        done = [trial for trial in trials if trial.state == "done"]
        if not done:
            reason = failed[0].message if failed else "all were pruned"
            raise FitError(f"{folder.path}: no trial came to an end ({reason})")
        best = min(done, key=lambda trial: (trial.value, trial.slot))
        check = held_out(settings, dict(best.values), backend, checking)
        found = Tuning(settings, trials, best, check, failed)
        reporting(0, 1, "writing the report")
        _write(folder, found)
        reporting(1, 1, "writing the report")
    return found


def search(
    settings: TuneSettings, backend: Backend, storage: str, progress: Progress | None = None
) -> tuple[tuple[SearchTrial, ...], tuple[TicketOutcome, ...]]:
    """Do the trials that are not done yet; those that others do are waited for.

    Raises:
        ConfigError: if the storage cannot be opened, or optuna is not installed.
    """
    optuna_ = _optuna()
    name = f"hystmpc-{settings.fingerprint}"
    optuna_.open_search(storage, name)  # made before the workers meet
    slots: Sequence[int] = range(settings.trials)
    failed: list[TicketOutcome] = []
    ended = 0
    while slots:
        later = []
        tickets = [Ticket(slot, storage, name, settings) for slot in slots]
        for outcome in run_jobs(optuna_.run_ticket, tickets, backend):
            if outcome.state == "elsewhere":
                later.append(outcome.slot)
                continue
            ended += 1
            failed += [outcome] if outcome.state == "failed" else []
            if progress:
                progress(ended, settings.trials, f"trial {outcome.slot} {outcome.state}")
        slots = sorted(later)
        if slots:
            time.sleep(_WAIT_S)
    return tuple(t for t in optuna_.trials_of(storage, name) if t.slot < settings.trials), tuple(failed)


def _optuna() -> Any:
    """The module that needs Optuna.

    Raises:
        ConfigError: if it is not installed.
    """
    try:
        from . import optuna_
    except ModuleNotFoundError as error:
        raise ConfigError(f"tune: {error.name} is not installed: pip install 'hystmpc[tune]'") from None
    return optuna_


def _folder(path: Path, settings: TuneSettings) -> RunFolder:
    """A new run folder, or the one that a tuning left."""

    def refusal(before: Any) -> str:
        if not isinstance(before, dict) or "search" not in before:
            return "holds another kind of run, expected a new folder or that of a tuning"
        changed = _changed(TuneSettings.parse(before, str(path / "config.yaml")), settings)
        if not changed:
            return ""
        allowed = "only trials and held_out may change"
        return f"holds a tuning with other {', '.join(changed)}, expected a new folder; {allowed}"

    return resumed_folder(path, settings.model_dump(mode="json", exclude_none=True), settings.seed, refusal)


def _changed(before: TuneSettings, now: TuneSettings) -> list[str]:
    """Settings by which one search differs from another, so that its trials are of no use to it."""
    if before.fingerprint == now.fingerprint:
        return []
    old, new = before.model_dump(mode="json"), now.model_dump(mode="json")
    return [name for name in new if name not in ("trials", "held_out") and old[name] != new[name]]


def _write(folder: RunFolder, found: Tuning) -> None:
    settings, check = found.settings, found.check
    tuned = settings.with_values(dict(found.best.values))
    head = f"# Tuned by hystmpc over {settings.plants.count} plants: trial {found.best.slot} of {settings.trials}.\n"
    write_atomically(folder.path / "controller.yaml", head + dump_yaml(tuned.model_dump(mode="json")))
    study = settings.study.model_copy(update={"controllers": {"given": settings.given, "tuned": tuned}})
    write_atomically(folder.path / "study.yaml", dump_yaml(study.model_dump(mode="json")))
    paths = list(settings.search)
    columns: dict[str, Any] = {
        "slot": np.array([trial.slot for trial in found.trials]),
        "state": tuple(trial.state for trial in found.trials),
        "objective_deg": np.array([trial.value for trial in found.trials]),
        "error_deg": np.array([trial.error_deg for trial in found.trials]),
        "travel": np.array([trial.travel for trial in found.trials]),
        "plants": np.array([trial.plants for trial in found.trials]),
        **{path: tuple(str(trial.values[path]) for trial in found.trials) for path in paths},
    }
    write_atomically(folder.path / "trials.csv", format_table(columns))
    write_atomically(folder.path / "held_out.csv", format_table(check.columns()))
    folder.write_report(tuning_report(found, folder.meta))
