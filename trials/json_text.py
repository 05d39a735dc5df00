"""JSON of results: plain data, the text of a file, and hashes."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .errors import ConfigError


def plain(value: Any) -> Any:
    """Convert a value to data for JSON: NumPy numbers to plain ones, tuples to lists, non-finite numbers to null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def file_text(data: Any, indent: int = 1) -> str:
    """Text of a JSON file, which ends in a line break."""
    return json.dumps(data, indent=indent, allow_nan=False) + "\n"


def mapping_in(file: Path) -> dict[str, Any]:
    """Content of a JSON file that holds a mapping; empty for any other, a damaged or a missing file."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def canonical(data: Any, default: Callable[[Any], Any] | None = None) -> str:
    """One line of JSON with sorted keys: equal texts for equal data."""
    return json.dumps(data, sort_keys=True, default=default)


def json_hash(data: Any, default: Callable[[Any], Any] | None = None) -> str:
    """SHA-256 of the canonical JSON of data, as hexadecimal digits."""
    return text_hash(canonical(data, default))


def text_hash(text: str) -> str:
    """SHA-256 of a text, as hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a model file, as hexadecimal digits.

    Raises:
        ConfigError: if it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}), expected a model file") from None
