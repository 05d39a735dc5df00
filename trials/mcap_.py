"""Logs as MCAP: one channel of JSON messages with a JSON schema, readable by common robotics viewers."""

from __future__ import annotations

import importlib.util
import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

TOPIC = "/hystmpc/log"


def available() -> bool:
    """Whether the `mcap` package (extra `logs`) is installed."""
    return importlib.util.find_spec("mcap") is not None


def format_mcap(
    columns: Mapping[str, Sequence[str] | NDArray[np.generic]], t: NDArray[np.float64], start_ns: int
) -> bytes:
    """One message per sample, holding all columns; not-a-number becomes null, which JSON has.

    Args:
        columns: numbers or texts, each of length T.
        t: time of each sample since the start of the run [s], (T,).
        start_ns: start of the run [ns since 1970].
    """
    from mcap.writer import Writer

    values = {k: c.tolist() if isinstance(c, np.ndarray) else list(c) for k, c in columns.items()}
    out = io.BytesIO()
    writer = Writer(out)
    writer.start(profile="", library="hystmpc")
    schema = writer.register_schema("hystmpc.Sample", "jsonschema", json.dumps(_schema(columns)).encode())
    channel = writer.register_channel(TOPIC, "json", schema)
    stamps = (start_ns + np.rint(1e9 * t).astype(np.int64)).tolist()
    for k, stamp in enumerate(stamps):
        message = {name: _json(column[k]) for name, column in values.items()}
        writer.add_message(channel, stamp, json.dumps(message, allow_nan=False).encode(), stamp, k)
    writer.finish()
    return out.getvalue()


def _json(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _schema(columns: Mapping[str, Any]) -> dict[str, Any]:
    kinds = {name: ["number", "null"] if isinstance(c, np.ndarray) else ["string"] for name, c in columns.items()}
    return {"type": "object", "properties": {name: {"type": kind} for name, kind in kinds.items()}}
