"""One row of a sweep; runs in a worker process, which keeps opened models between rows."""

from __future__ import annotations

import json
import platform
import time
from functools import lru_cache
from typing import Any

from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.json_text import canonical

from ..config import SimulationConfig
from ..jobs.runner import attempt
from ..results import TrackingMetrics, result_of
from ..study import prepare
from .plan import Hashes, SweepRow

# Columns of every row besides the factors, in the order of the table.
ROW_COLUMNS = ("id", "status", "message", "controller", "motion", "draw", "seed")
RESULT_COLUMNS = (
    "rmse_deg",
    "max_abs_deg",
    "hold_error_deg",
    "hold_command_range",
    "command_travel",
    "limit_violations",
    "ladder",
)
COST_COLUMNS = ("samples", "step_mean_s", "step_p99_s", "wall_s", "cpu_s", "host", "files", "settings")
_KEPT = 4  # models a process keeps ready


def run_row(row: SweepRow) -> dict[str, Any]:
    """One row of the table; an error becomes a row that says so.

    Raises:
        KeyboardInterrupt: if the user ended it; half a run is no result.
    """
    busy = time.process_time()
    made = attempt(lambda: _figures(row))
    return {
        **dict.fromkeys((*RESULT_COLUMNS, "samples", "step_mean_s", "step_p99_s")),
        **(made.value or {}),
        "status": "failed" if made.value is None else "done",
        "message": made.error,
        "id": row.id,
        "controller": row.controller,
        "motion": row.motion,
        "draw": row.draw,
        "seed": row.seed,
        **row.factors,
        "wall_s": made.seconds,
        "cpu_s": time.process_time() - busy,
        "host": platform.node(),
        "files": json.dumps(row.files),
        "settings": row.settings,
    }


def _figures(row: SweepRow) -> dict[str, Any]:
    if Hashes().of(row.config()) != row.files:
        raise ConfigError("a model file has changed since the row was planned")
    metrics, samples = run_settings(row.config())
    return {"samples": samples} | metrics_columns(metrics)


def run_settings(config: SimulationConfig) -> tuple[TrackingMetrics, int]:
    """Metrics and samples of a study with one controller and one motion.

    Raises:
        HystmpcError: what `prepare` raises.
    """
    study = prepare(config, shared_knowledge(config))
    ((motion, _),) = study.motions.items()
    ((name, settings),) = study.config.controllers.items()
    run = study.run(settings, motion)
    return result_of(study.config, motion, name, run).metrics, len(run.true_deg)


def shared_knowledge(config: SimulationConfig) -> ControllerModel:
    """Opened models, once a process for each model, inverse and lag.

    Raises:
        HystmpcError: what `controller_model` raises.
    """
    return _kept_knowledge(config.model, config.inverse, config.actuator_lag_s, Hashes().of_models(config))


@lru_cache(maxsize=_KEPT)
def _kept_knowledge(model: str, inverse: str | None, actuator_lag_s: float, files: tuple[str, ...]) -> ControllerModel:
    del files  # of the key: a file that has changed is opened again
    return controller_model(model, inverse, actuator_lag_s)


def metrics_columns(metrics: TrackingMetrics) -> dict[str, Any]:
    """Metrics as columns: all that a repetition gives again to the last bit, and the times of a step."""
    columns = {name: getattr(metrics, name) for name in RESULT_COLUMNS if name != "ladder"}
    times = {"step_mean_s": metrics.step_mean_s, "step_p99_s": metrics.step_p99_s}
    return columns | times | {"ladder": canonical(metrics.ladder)}
