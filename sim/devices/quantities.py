"""Parameters of simulated devices: dataclass fields that carry unit, bounds and meaning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, field, fields
from typing import Any

from hystmpc.trials.errors import ConfigError


def quantity(default: float, unit: str, lower: float, upper: float, meaning: str) -> Any:
    """A dataclass field with a default, a unit, inclusive bounds and a line on what it is."""
    return field(default=default, metadata={"unit": unit, "bounds": (lower, upper), "meaning": meaning})


def check_quantities(block: Any) -> None:
    """Compare every `quantity` of a dataclass with its bounds.

    Raises:
        ConfigError: naming the block, the parameter, the value and the bounds.
    """
    for f in fields(block):
        if "bounds" in f.metadata:
            value, (lower, upper) = getattr(block, f.name), f.metadata["bounds"]
            if not (math.isfinite(value) and lower <= value <= upper):
                raise ConfigError(
                    f"{type(block).__name__}.{f.name}: got {value} {f.metadata['unit']}, "
                    f"expected {lower:g} to {upper:g} {f.metadata['unit']}"
                )


def to_plain(block: Any) -> dict[str, Any]:
    """A (nested) dataclass as plain data for YAML: numbers, texts, lists and mappings."""
    return {name: _plain(value) for name, value in asdict(block).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, tuple | list) else value
