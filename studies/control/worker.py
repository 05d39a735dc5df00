"""Doing one job of the benchmark; runs in a process of its own."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from hystmpc.trials.errors import HystmpcError

from .job import ControlJob, fingerprint
from .loop import run_along, tune
from .models import save_backlash, save_network
from .plants import PLANTS
from .result import ControlResult, save
from .settings import ControlSettings


def do_control_job(job: ControlJob, settings: ControlSettings, folder: Path) -> ControlResult:
    """Do one job and write its result; an error becomes a failed result.

    Raises:
        KeyboardInterrupt: if the user ended it; nothing is written then.
    """
    start, mark = time.perf_counter(), fingerprint(job, settings, folder)
    try:
        message, figures, ladder = _done(job, settings, folder)
    except HystmpcError as error:
        result = _failed(job, mark, str(error), start)
    except Exception as error:  # noqa: BLE001  # one controller's defect must not cost the others hours
        result = _failed(job, mark, f"{type(error).__name__}: {error}", start)
    else:
        result = ControlResult(job, mark, "done", message, time.perf_counter() - start, figures, ladder)
    save(folder, result)
    return result


def _done(
    job: ControlJob, settings: ControlSettings, folder: Path
) -> tuple[str, Mapping[str, float], Mapping[str, int]]:
    if job.stage == "run":
        figures, ladder = run_along(job, settings, folder)
        return "", figures, ladder
    if job.stage != "fit":
        message, errors = tune(job, settings, folder)
        return message, errors, {}
    plant, seed = PLANTS[job.plant].nominal(), settings.seed
    if job.subject == "backlash":
        files = save_backlash(plant, folder, settings.rates_hz, seed, settings.quick)
        return f"wrote {', '.join(file.name for file in files)}", {}, {}
    report = save_network(plant, job.subject, folder, settings.network_updates, seed, settings.quick)
    return report, {}, {}


def _failed(job: ControlJob, mark: str, message: str, start: float) -> ControlResult:
    return ControlResult(job, mark, "failed", " ".join(message.split()), time.perf_counter() - start)
