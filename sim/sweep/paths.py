"""Dotted paths into a configuration: `plant.lag_s`, `plant.effects.0.parameters.tau_s`, `plant.mismatch."a.b"`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.yaml_ import place_in

_PART = re.compile(r'"([^"]+)"|([^."]+)')
_WHOLE = re.compile(r'(?:"[^"]+"|[^."]+)(?:\.(?:"[^"]+"|[^."]+))*')


def path_parts(path: str) -> tuple[str, ...]:
    """Keys of a dotted path; a key with dots in it stands in double quotes.

    Raises:
        ConfigError: if it is no path.
    """
    if not _WHOLE.fullmatch(path):
        raise ConfigError(f'{path}: not a path, expected keys with dots between, such as plant.mismatch."play.width"')
    return tuple(quoted or plain for quoted, plain in _PART.findall(path))


def changed(data: Any, path: str, value: Any) -> Any:
    """A copy of plain data with one value in another's place; the given data stays as it is.

    The block that holds the value has to be there, so that a wrong name is found; whether it takes the key is for the
    settings to say. A block that is null counts as empty.

    Raises:
        ConfigError: if a block is not there; names the nearest key.
    """
    return _changed(data, path_parts(path), value, path)


def value_at(data: Any, path: str) -> Any:
    """The value at a path.

    Raises:
        ConfigError: if there is none; names the nearest key.
    """
    for part in path_parts(path):
        data = data[_index(data, part, path)] if isinstance(data, list) else _blocks(data, part, path)[part]
    return data


def _changed(data: Any, parts: Sequence[str], value: Any, path: str) -> Any:
    if not parts:
        return value
    first, rest = parts[0], parts[1:]
    if isinstance(data, list):
        place = _index(data, first, path)
        return [_changed(old, rest, value, path) if k == place else old for k, old in enumerate(data)]
    if data is None and not rest:
        return {first: value}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: {first!r} would be set in the value {data!r}, expected a mapping or a list")
    held = _blocks(data, first, path)[first] if rest else None
    return {**data, first: _changed(held, rest, value, path)}


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
    """`FILE, line N: ` of a key in a YAML file, to begin a message with; less where the file does not tell.

    Args:
        file: that was read, None for settings that came from none.
        keys: mapping keys from the top level down.
    """
    return "" if file is None else f"{place_in(file)(keys)}: "
