"""A closed-loop run as the columns of its log, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hystmpc.ctrl.loop import LoopLog
from hystmpc.trials.errors import LogError
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.types import Vec

from .closed_loop import ClosedLoopRun

Column = Vec | tuple[str, ...]

_STAGE = "stage_"
_LOOP = {
    "time_s": "time_s",
    "angle_deg": "measured_deg",
    "reference_deg": "reference_deg",
    "predicted_deg": "predicted_deg",
    "disturbance_deg": "disturbance_deg",
}
_TRUE = "true_angle_deg"


def log_columns(run: ClosedLoopRun) -> dict[str, Sequence[str] | Vec]:
    """Columns (N,) of `log.csv`; every angle belongs to the end of its sample, the command to all of it."""
    log = run.log
    numbers = {column: getattr(log, field) for column, field in _LOOP.items()}
    stages = {f"{_STAGE}{name.replace(' ', '_')}_s": seconds for name, seconds in log.stage_s.items()}
    command = {f"command_{run.unit}": log.command}
    return {**command, **numbers, _TRUE: run.true_deg, **stages, "source": log.source, "status": log.status}


def run_from(columns: Mapping[str, Column], rest_command: float, where: str) -> ClosedLoopRun:
    """The run whose log this is.

    Args:
        columns: of `log.csv`.
        rest_command: the command that the plant held before.
        where: file, for messages.

    Raises:
        LogError: if a column is missing.
    """
    wanted = (*_LOOP, _TRUE, "source", "status")
    gone = CANONICAL.missing(list(columns)) + [name for name in wanted if name not in columns]
    if gone:
        raise LogError(f"{where}: lacks {', '.join(gone)}, expected the log of a simulation; got {', '.join(columns)}")
    command = CANONICAL.command_column(list(columns))
    numbers = {field: _numbers(columns[column]) for column, field in _LOOP.items()}
    stages = {
        name.removeprefix(_STAGE).removesuffix("_s").replace("_", " "): _numbers(values)
        for name, values in columns.items()
        if name.startswith(_STAGE)
    }
    source, status = (tuple(str(text) for text in columns[name]) for name in ("source", "status"))
    log = LoopLog(
        **numbers,
        command=_numbers(columns[command]),
        source=source,
        status=status,
        stage_s=stages,
        interrupted=False,
    )
    # The first sample ends one sample time after the start.
    return ClosedLoopRun(log, _numbers(columns[_TRUE]), rest_command, float(log.time_s[0]), CANONICAL.command[command])


def _numbers(column: Column) -> Vec:
    return np.asarray(column, dtype=np.float64)
