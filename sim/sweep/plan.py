"""Rows of a sweep: settings and identity of each run, and its execution in a worker process."""

from __future__ import annotations

import itertools
import json
import platform
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from hystmpc.models.load import model_path
from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.json_text import canonical, file_hash, json_hash

from ..config import SimulationConfig
from ..jobs import attempt
from ..plants.device import plant_hash
from ..results import Result, TrackingMetrics, result_of
from ..study import prepare
from ..two_axes.config import AnyStudyConfig, TwoAxisSimulationConfig, parse_study, says_two_axes
from ..two_axes.study import AnyStudy, prepare_two_axes
from .settings import PlainStudy, SweepSettings, drawn, label, path_parts, place

_KNOWLEDGE = ("model", "inverse", "actuator_lag_s")  # costly to open, so that they vary slowest
_ID_DIGITS = 16


@dataclass(frozen=True)
class SweepRow:
    """Row of a sweep: one closed-loop run."""

    id: str  # hash of settings and model files, 16 hexadecimal digits
    controller: str
    motion: str
    factors: Mapping[str, Any]  # varied settings by path: names of grid values, values of draws
    draw: int
    seed: int
    settings: str  # the study with this controller and motion alone, as JSON
    files: tuple[str, ...]  # SHA-256 of plant, model and inverse

    def config(self) -> AnyStudyConfig:
        """Settings of the run."""
        return parse_study(json.loads(self.settings), f"row {self.id}")


def file_hashes(config: AnyStudyConfig, known: dict[str, str] | None = None) -> tuple[str, ...]:
    """SHA-256 of plant, model and inverse; `known` caches those of files by name."""
    known = {} if known is None else known

    def of(name: str) -> str:
        if name not in known:
            known[name] = file_hash(model_path(name))
        return known[name]

    if isinstance(config, TwoAxisSimulationConfig):
        return of(config.plant.simulator), of(config.model)
    simulator = config.plant.simulator
    plant = plant_hash(config.plant) if simulator is None else of(simulator)
    return (plant, *(of(name) for name in (config.model, config.inverse) if name is not None))


@dataclass(frozen=True)
class SweepPlan:
    """Generator of all rows of a sweep."""

    settings: SweepSettings
    source: Path | None = None

    @cached_property
    def grid(self) -> tuple[dict[str, tuple[str, Any]], ...]:
        """Grid points: name and value by path; settings that are costly to change vary slowest."""
        paths = sorted(self.settings.grid, key=lambda path: path_parts(path)[0] not in _KNOWLEDGE)
        values = [list(self.settings.grid[path].items()) for path in paths]
        return tuple(dict(zip(paths, point, strict=True)) for point in itertools.product(*values))

    def rows(self) -> Iterator[SweepRow]:
        """Rows of the plan, without duplicates."""
        settings, seen = self.settings, set()
        hashes: dict[str, str] = {}
        for point in self.grid:
            at_point = self._at(point)
            for number in range(settings.count):
                values = drawn(settings.draw, settings.draw_seed, number)
                config = self._study(self._with(at_point, values, "draw"))
                factors = self._factors({path: name for path, (name, _) in point.items()} | values)
                for seed in settings.seeds or (config.seed,):
                    for row in _rows(config.model_copy(update={"seed": seed, "tuned": ()}), factors, number, hashes):
                        if row.id not in seen:
                            seen.add(row.id)
                            yield row

    def check(self) -> int:
        """Return the number of rows, duplicates included, after a check of every grid point and every end of a draw.

        Raises:
            ConfigError: if a path or value does not fit the study; names the line.
        """
        total = 0
        for point in self.grid:
            at_point = self._at(point)
            values = drawn(self.settings.draw, self.settings.draw_seed, 0)
            study = self._study(self._with(at_point, values, "draw"))
            for path, draw in self.settings.draw.items():
                for end in draw.ends:
                    self._study(self._with(at_point, {**values, path: end}, "draw"), "draw", path)
            runs = len(study.controllers) * len(study.motions)
            total += runs * self.settings.count * max(1, len(self.settings.seeds))
        return total

    def columns(self) -> dict[str, str]:
        """Column type of every factor: `number`, or `text` for names and all other values."""
        grid = {path: _kind(values.values(), values) for path, values in self.settings.grid.items()}
        return grid | {path: _kind(draw.ends) for path, draw in self.settings.draw.items()}

    def _factors(self, values: Mapping[str, Any]) -> dict[str, Any]:
        kinds = self.columns()
        return {path: float(v) if kinds[path] == "number" else label(v) for path, v in values.items()}

    @cached_property
    def axes(self) -> int:
        """Number of axes of the study."""
        return 2 if says_two_axes(self.settings.base, Path()) else 1

    @cached_property
    def _base(self) -> PlainStudy:
        return PlainStudy.of(self._study(PlainStudy(self.settings.base, self.settings.base)))

    def _at(self, point: Mapping[str, tuple[str, Any]]) -> PlainStudy:
        """Study at a grid point, with defaults for missing keys of blocks among the values."""
        plain = self._with(self._base, {path: value for path, (_, value) in point.items()}, "grid")
        return PlainStudy.of(self._study(plain)) if point else plain

    def _with(self, plain: PlainStudy, values: Mapping[str, Any], block: str) -> PlainStudy:
        for path, value in values.items():
            try:
                plain = plain.changed(path, value)
            except ConfigError as error:
                raise ConfigError(f"{place(self.source, block, path)}{block}: {error}") from None
        return plain

    def _study(self, plain: PlainStudy, *where: str) -> AnyStudyConfig:
        """Study of plain data; an error names the keys `where`, else those that the error reports."""
        study = parse_study(plain.data, lambda at: self._located(where or self._blamed([str(part) for part in at])))
        if study.tune_pid is not None:  # a search per row would cost hundreds of runs
            raise ConfigError(f"{self._located(('base',))}: tune_pid is for `simulate` alone, expected none")
        return study

    def _located(self, keys: Sequence[str]) -> str:
        return f"{place(self.source, *keys)}{'.'.join(keys)}"

    def _blamed(self, at: Sequence[str]) -> tuple[str, ...]:
        """Sweep entry responsible for an error: the one with the longest path to the setting."""
        longest: tuple[int, tuple[str, ...]] = (0, ("base", *at))
        for block, paths in (("grid", self.settings.grid), ("draw", self.settings.draw)):
            for path in paths:
                parts, left = path_parts(path), iter(at)
                if len(parts) > longest[0] and all(part in left for part in parts):
                    longest = len(parts), (block, path)
        return longest[1]


def _rows(
    config: AnyStudyConfig, factors: Mapping[str, Any], number: int, hashes: dict[str, str]
) -> Iterator[SweepRow]:
    files = file_hashes(config, hashes)
    for motion in config.motions:
        for controller in config.controllers:
            text = canonical(config.narrowed(controller, motion).model_dump(mode="json"))
            identity = json_hash([text, list(files)])[:_ID_DIGITS]
            yield SweepRow(identity, controller, motion, factors, number, config.seed, text, files)


def _kind(values: Iterable[Any], names: Iterable[str] | None = None) -> str:
    """Column type: `number` if all values are numbers without other names, else `text`."""
    values = list(values)
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return "number" if numbers and (names is None or list(names) == [label(value) for value in values]) else "text"


# Columns of every row besides the factors, in the order of the table.
ROW_COLUMNS = ("id", "status", "message", "controller", "motion", "draw", "seed")
RESULT_COLUMNS = tuple(f.name for f in fields(TrackingMetrics) if not f.name.startswith("step_"))
AXIS_COLUMNS = ("rmse_x_deg", "rmse_y_deg")
"""Errors of the axes of two, behind that of the tip in their plane."""
COST_COLUMNS = ("samples", "step_mean_s", "step_p99_s", "wall_s", "cpu_s", "host", "files", "settings")
_KEPT = 4  # models that a process caches


def run_row(row: SweepRow) -> dict[str, Any]:
    """Run one row and return its table entries; an error becomes a row with its message."""
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
    if file_hashes(row.config()) != row.files:
        raise ConfigError("a model file has changed since the row was planned")
    result = run_settings(row.config())
    return {"samples": len(result.run.true_deg)} | metrics_columns(result)


def run_settings(config: AnyStudyConfig) -> Result:
    """Run a study with one controller and one motion."""
    study = prepared(config)
    ((motion, _),) = study.motions.items()
    ((name, settings),) = study.config.controllers.items()
    return result_of(study.config, motion, name, study.run(settings, motion))


def prepared(config: AnyStudyConfig) -> AnyStudy:
    """Open a study of one axis or of two, see `prepare` and `prepare_two_axes`; opened models are cached."""
    if isinstance(config, TwoAxisSimulationConfig):
        return prepare_two_axes(config)
    return prepare(config, shared_knowledge(config))


def result_columns(axes: int) -> tuple[str, ...]:
    """Names of the figures of a run of one axis or of two, in order."""
    first, *rest = RESULT_COLUMNS
    return (first, *(AXIS_COLUMNS if axes > 1 else ()), *rest)


def shared_knowledge(config: SimulationConfig) -> ControllerModel:
    """Return the opened models, cached per process for each model, inverse and lag."""
    return _kept_knowledge(config.model, config.inverse, config.actuator_lag_s, file_hashes(config)[1:])


@lru_cache(maxsize=_KEPT)
def _kept_knowledge(model: str, inverse: str | None, actuator_lag_s: float, files: tuple[str, ...]) -> ControllerModel:
    del files  # of the key: a file that has changed is opened again
    return controller_model(model, inverse, actuator_lag_s)


def metrics_columns(result: Result) -> dict[str, Any]:
    """Return the metrics of a run as columns: those that a repetition reproduces bitwise, and the step times."""
    metrics, axes = result.metrics, dict(zip(AXIS_COLUMNS, result.run.axis_rmse_deg, strict=False))
    columns = {name: getattr(metrics, name) for name in RESULT_COLUMNS if name != "ladder"}
    times = {"step_mean_s": metrics.step_mean_s, "step_p99_s": metrics.step_p99_s}
    return columns | axes | times | {"ladder": canonical(metrics.ladder)}
