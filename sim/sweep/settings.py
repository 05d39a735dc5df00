"""Settings of a sweep: a closed-loop study, its variation, and dotted paths into configurations."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import numpy as np
from pydantic import Field, WithJsonSchema, field_validator, model_validator

from hystmpc.trials.config import Count, NotNegativeInt, Settings, load_settings, place_in, read_yaml
from hystmpc.trials.errors import ConfigError, did_you_mean

from ..config import SimulationConfig, load_simulation, located
from ..two_axes.config import (
    AnyStudyConfig,
    TwoAxisSimulationConfig,
    file_of_two_axes,
    load_two_axis_simulation,
    located_plane,
    parse_study,
)

_SEVERAL = {"anyOf": [{"type": "array", "minItems": 1}, {"type": "object", "minProperties": 1}]}
_PART = re.compile(r'"([^"]+)"|([^."]+)')
_WHOLE = re.compile(r'(?:"[^"]+"|[^."]+)(?:\.(?:"[^"]+"|[^."]+))*')


class DrawSettings(Settings):
    """Block of one distribution, with exactly one of these keys.

    Attributes:
        log_uniform: lower and upper end, both positive; the logarithm is uniform.
        uniform: lower and upper end.
        integer: lowest and highest whole number, both included; equally likely.
        choice: values; equally likely.
    """

    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    integer: tuple[int, int] | None = None
    choice: tuple[Any, ...] | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _one(self) -> DrawSettings:
        given = {name: value for name in type(self).model_fields if (value := getattr(self, name)) is not None}
        if len(given) != 1:
            raise ValueError(
                f"got {', '.join(given) or 'nothing'}, expected one of uniform, log_uniform, integer, choice"
            )
        (name, value) = next(iter(given.items()))
        if name != "choice" and not value[0] < value[1]:
            raise ValueError(f"{name}: got {value[0]} to {value[1]}, expected the lower end first")
        if name == "log_uniform" and value[0] <= 0:
            raise ValueError(f"log_uniform: got a lower end of {value[0]}, expected a positive one")
        return self

    @property
    def ends(self) -> tuple[Any, ...]:
        """Return the bounds of a draw, or all values of a choice."""
        return next(v for v in (self.choice, self.uniform, self.log_uniform, self.integer) if v is not None)

    def sample(self, random: np.random.Generator) -> Any:
        """Draw one value, as plain Python."""
        if self.choice is not None:
            return self.choice[int(random.integers(len(self.choice)))]
        if self.integer is not None:
            return int(random.integers(self.integer[0], self.integer[1], endpoint=True))
        if self.log_uniform is not None:
            low, high = self.log_uniform
            return float(np.clip(math.exp(random.uniform(math.log(low), math.log(high))), low, high))
        return float(random.uniform(*self.ends))


def drawn(draws: Mapping[str, DrawSettings], seed: int, number: int) -> dict[str, Any]:
    """Return draw `number` of every path; the random numbers of a path are independent of other paths and draws."""
    generators = {path: np.random.default_rng([seed, number, crc32(path.encode())]) for path in draws}
    return {path: draw.sample(generators[path]) for path, draw in draws.items()}


class SweepSettings(Settings):
    """Settings of a sweep: a row for each grid point, draw, seed, controller and motion.

    Attributes:
        base: the study; a file, or the settings themselves.
        grid: values by dotted path; a mapping names them, which long ones want.
        draw: distributions by dotted path. Draw k is the same at every grid point.
        seeds: of sensor noise and disturbances; the study's own where left out.
        count: number of draws.
        draw_seed: of the draws.
    """

    base: str | dict[str, Any]
    grid: dict[str, Annotated[dict[str, Any], WithJsonSchema(_SEVERAL)]] = Field(default_factory=dict)
    draw: dict[str, DrawSettings] = Field(default_factory=dict)
    count: Count = 1
    draw_seed: NotNegativeInt = 0
    seeds: tuple[NotNegativeInt, ...] = ()

    @field_validator("grid", mode="before")
    @classmethod
    def _named(cls, grid: Any) -> Any:
        """Name the values of the grid; those of a list are named by their text."""
        if not isinstance(grid, dict):
            return grid
        named = {}
        for path, values in grid.items():
            if not isinstance(values, list | dict) or not values:
                raise ValueError(f"{path}: got {values!r}, expected a list of values, or a mapping of names to them")
            named[path] = values if isinstance(values, dict) else {label(value): value for value in values}
        return named

    @model_validator(mode="after")
    def _apart(self) -> SweepSettings:
        if self.count > 1 and not self.draw:
            raise ValueError(f"count: got {self.count} without anything in `draw`, expected `draw`, or `seeds`")
        if both := sorted(set(self.grid) & set(self.draw)):
            raise ValueError(f"draw: {both[0]} is in `grid` too, expected it in one of them")
        return self


def label(value: Any) -> str:
    """Text of a value: unchanged if it is a text, JSON otherwise."""
    return value if isinstance(value, str) else json.dumps(value)


def load_sweep(path: Path | str, overrides: Iterable[str] = ()) -> SweepSettings:
    """Read the settings of a sweep with its study, every file name absolute.

    Raises:
        ConfigError: on an unreadable file, a malformed override, an unknown key or a value out of bounds.
        ModelError: on an unknown built-in model.
    """
    return with_base(load_settings(SweepSettings, path, overrides), Path(path))


def with_base(settings: SweepSettings, path: Path) -> SweepSettings:
    """Return the sweep with its study included."""
    study = study_of(settings.base, path)
    return settings.model_copy(update={"base": study.model_dump(mode="json")})


def study_of(base: str | dict[str, Any], path: Path) -> AnyStudyConfig:
    """Return the study of one axis or of two that another settings file names or contains.

    Raises:
        ConfigError: if a setting is wrong.
    """
    folder = path.resolve().parent
    if isinstance(base, str):
        two = file_of_two_axes(folder / base)
        return load_two_axis_simulation(folder / base) if two else load_simulation(folder / base)

    def where(at: Sequence[str | int]) -> str:
        return place_in(path)(("base", *at))

    study = parse_study(base, where, folder)
    return located(study, folder, where) if isinstance(study, SimulationConfig) else located_plane(study, folder)


def sweep_in(folder: Path) -> SweepSettings | None:
    """Return the sweep of a run folder; None if it holds another kind of run.

    Raises:
        ConfigError: if its settings are damaged.
    """
    file = folder / "config.yaml"
    data = read_yaml(file)
    if not isinstance(data, dict) or "base" not in data or "search" in data:
        return None
    settings = SweepSettings.parse(data, str(file))
    if isinstance(settings.base, str):
        raise ConfigError(f"{file}: base: got a file, expected the settings that ran")
    return settings


def path_parts(path: str) -> tuple[str, ...]:
    """Split a dotted path into its keys; a key with dots is in double quotes.

    Raises:
        ConfigError: if it is no path.
    """
    if not _WHOLE.fullmatch(path):
        raise ConfigError(f'{path}: not a path, expected keys with dots between, such as plant.mismatch."play.width"')
    return tuple(quoted or plain for quoted, plain in _PART.findall(path))


@dataclass(frozen=True)
class PlainStudy:
    """Plain data of a study, and the same with every default: the names that a path may have.

    Of two axes the data holds what was given to the controllers alone: some of their settings that are left out follow
    from what joins the axes.
    """

    data: Any
    known: Any

    @classmethod
    def of(cls, study: AnyStudyConfig) -> PlainStudy:
        """Plain data of a study."""
        data = study.model_dump(mode="json")
        if not isinstance(study, TwoAxisSimulationConfig):
            return cls(data, data)
        whole = {name: one.model_dump(mode="json") for name, one in study.controllers.items()}
        return cls(data, {**data, "controllers": whole})

    def changed(self, path: str, value: Any) -> PlainStudy:
        """The same with one value replaced, see `changed`."""
        data = changed(self.data, path, value, self.known)
        return PlainStudy(data, data if self.known is self.data else changed(self.known, path, value))


def changed(data: Any, path: str, value: Any, known: Any = None) -> Any:
    """Return a copy of plain data with one value replaced.

    The block of the value has to exist, so that a wrong name is detected; a block that is null counts as empty.

    Args:
        known: data whose keys exist, if `data` leaves some of them out.

    Raises:
        ConfigError: if a block does not exist; names the nearest key.
    """
    return _changed(data, data if known is None else known, path_parts(path), value, path)


def value_at(data: Any, path: str) -> Any:
    """Return the value at a path.

    Raises:
        ConfigError: if there is none; names the nearest key.
    """
    for part in path_parts(path):
        data = data[_index(data, part, path)] if isinstance(data, list) else _blocks(data, part, path)[part]
    return data


def _changed(data: Any, known: Any, parts: Sequence[str], value: Any, path: str) -> Any:
    if not parts:
        return value
    first, rest = parts[0], parts[1:]
    if isinstance(known, list):
        place, rows = _index(known, first, path), data if isinstance(data, list) else known
        return [_changed(old, known[k], rest, value, path) if k == place else old for k, old in enumerate(rows)]
    if known is None and not rest:
        return {first: value}
    if not isinstance(known, dict):
        raise ConfigError(f"{path}: {first!r} would be set in the value {known!r}, expected a mapping or a list")
    held, data = _blocks(known, first, path)[first] if rest else None, data or {}
    return {**data, first: _changed(data.get(first), held, rest, value, path)}


def _blocks(data: Any, key: str, path: str) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: {key!r} would be looked up in the value {data!r}, expected a mapping or a list")
    if key not in data:
        raise ConfigError(f"{path}: no key {key!r}, {did_you_mean(key, data)}")
    return data


def _index(data: list[Any], part: str, path: str) -> int:
    if not part.isdigit() or int(part) >= len(data):
        raise ConfigError(f"{path}: got {part!r} where a list has {len(data)} entries, expected 0 to {len(data) - 1}")
    return int(part)


def place(file: Path | str | None, *keys: str) -> str:
    """Prefix `FILE, line N: ` of messages on a key in a YAML file; empty for settings without a file."""
    return "" if file is None else f"{place_in(file)(keys)}: "
