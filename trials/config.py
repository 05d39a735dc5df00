"""One configuration: YAML, validated by pydantic, unknown keys answered with the nearest right name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Self, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from .errors import ConfigError, did_you_mean
from .yaml_lines import Location, MisplacedError, place_in


class Settings(BaseModel):
    """Base of every configuration block: frozen, no unknown keys, units in the key names.

    Raises:
        ConfigError: through `parse`; pydantic's ValidationError if built directly.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for key in data:
                if key not in cls.model_fields:
                    raise MisplacedError(f"unknown key {key!r}, {did_you_mean(str(key), cls.model_fields)}", (key,))
        return data

    @classmethod
    def parse(cls, data: Any, where: str | Callable[[Location], str] = "<memory>") -> Self:
        """Validate plain data.

        Args:
            data: mappings, lists and scalars.
            where: the source's name, or a function that tells it for the keys and indices of an entry.

        Raises:
            ConfigError: one line with the first offending key, what was got and what was expected.
        """
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            first = error.errors()[0]
            path = ".".join(str(p) for p in first["loc"]) or "top level"
            more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
            text = str(first["msg"]).removeprefix("Value error, ")
            got = "" if isinstance(first["input"], dict) else f", got {first['input']!r}"
            inner = getattr(first.get("ctx", {}).get("error"), "at", ())
            place = where if isinstance(where, str) else where((*first["loc"], *inner))
            raise ConfigError(f"{place}: {path}: {text}{got}{more}") from None


S = TypeVar("S", bound=Settings)


def read_yaml(path: Path | str) -> Any:
    """Read plain data from a YAML file.

    Raises:
        ConfigError: if the file cannot be read or is not YAML; names file, line and column.
    """
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: cannot be read ({reason}), expected a YAML file") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1} column {mark.column + 1}" if mark else ""
        raise ConfigError(f"{path}{place}: not YAML ({getattr(error, 'problem', error)})") from None


def load_settings(kind: type[S], path: Path | str, overrides: Iterable[str] = ()) -> S:
    """Read `path`, apply `a.b=3` overrides and validate as `kind`.

    Raises:
        ConfigError: on an unreadable file, a malformed override, an unknown key or a value out of bounds; names file
            and line, or the override, of the first offending key.
    """
    data, changes = read_yaml(path), tuple(overrides)
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: got {type(data).__name__}, expected a mapping of settings")
    for text in changes:
        _override(data, text)
    return kind.parse(data, place_in(path, changes))


def _override(data: dict[str, Any], text: str) -> None:
    """Set `a.b=3` in nested mappings, in place."""
    key, separator, value = text.partition("=")
    if not separator or not key:
        raise ConfigError(f"--set {text}: expected KEY.KEY=VALUE")
    *parents, leaf = key.split(".")
    node = data
    for name in parents:
        node = node.setdefault(name, {})
        if not isinstance(node, dict):
            raise ConfigError(f"--set {text}: {name!r} is a value, expected a mapping")
    try:
        node[leaf] = yaml.safe_load(value)
    except yaml.YAMLError:
        raise ConfigError(f"--set {text}: {value!r} is not a YAML value") from None


def dump_yaml(data: Any) -> str:
    """Return plain data as YAML in the order given."""
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
