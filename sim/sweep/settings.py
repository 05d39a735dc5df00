"""Settings of a sweep: a closed-loop study, and what of it is varied."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from hystmpc.trials.config import Settings, load_settings, read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.yaml_ import place_in

from ..config import SimulationConfig, load_simulation, located
from .draws import DrawSettings

NotNegative = Annotated[int, Field(ge=0)]


class SweepSettings(Settings):
    """Grid points times draws times seeds, and for each every controller along every motion of the study: a row each.

    Attributes:
        base: the study; a file, or the settings themselves.
        grid: values by dotted path; a mapping names them, which long ones want.
        draw: distributions by dotted path. Draw k is the same at every grid point.
        count: draws.
        draw_seed: of the draws.
        seeds: of sensor noise and disturbances; the study's own where left out.
    """

    base: str | dict[str, Any]
    grid: dict[str, dict[str, Any]] = Field(default_factory=dict)
    draw: dict[str, DrawSettings] = Field(default_factory=dict)
    count: Annotated[int, Field(ge=1)] = 1
    draw_seed: NotNegative = 0
    seeds: tuple[NotNegative, ...] = ()

    @field_validator("grid", mode="before")
    @classmethod
    def _named(cls, grid: Any) -> Any:
        """Values by name; those of a list are named by what they are."""
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
    """A value as text: itself where it is one, JSON where it is not."""
    return value if isinstance(value, str) else json.dumps(value)


def load_sweep(path: Path | str, overrides: Iterable[str] = ()) -> SweepSettings:
    """Read a sweep; its study is read too and stands in it, every file name absolute.

    Raises:
        ConfigError: on an unreadable file, a malformed override, an unknown key or a value out of bounds.
        ModelError: on an unknown built-in model.
    """
    return with_base(load_settings(SweepSettings, path, overrides), Path(path))


def with_base(settings: SweepSettings, path: Path) -> SweepSettings:
    """The sweep with its study in it.

    Raises:
        ConfigError: if the study is wrong.
        ModelError: on an unknown built-in model.
    """
    study = study_of(settings.base, path)
    return settings.model_copy(update={"base": study.model_dump(mode="json")})


def study_of(base: str | dict[str, Any], path: Path) -> SimulationConfig:
    """The study that another settings file names or holds.

    Raises:
        ConfigError: if it cannot be read or is wrong.
        ModelError: on an unknown built-in model.
    """
    folder = path.resolve().parent
    if isinstance(base, str):
        return load_simulation(folder / base)

    def where(at: Sequence[str | int]) -> str:
        return place_in(path)(("base", *at))

    return located(SimulationConfig.parse(base, where), folder, where)


def sweep_in(folder: Path) -> SweepSettings | None:
    """The sweep of a run folder, None where it holds another kind of run.

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
