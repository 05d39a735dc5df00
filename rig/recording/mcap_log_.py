"""Samples as messages of log.mcap, with schemas that Foxglove and PlotJuggler plot."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import IO, Any, cast, final

from mcap.writer import Writer

from .csv_log import GrowingFile, one_line, stage_column
from .sample import TAKEN, Sample

TIP, TIMING, EVENTS = "/tip", "/timing", "/events"
_INFO, _WARNING, _ERROR = 2, 3, 4  # levels of foxglove.Log
_CHUNK_BYTES = 1 << 22  # a chunk ends with a flush, long before this


@final
class McapLog:
    """Writes log.mcap: `/tip` (time, command, angles) and `/timing` of every sample, `/events` on changes.

    Messages are stamped with the wall clock of the first sample plus the monotonic time since then, so that a clock
    that jumps does not tear the plot; the wall clock itself is the publish time.

    Args:
        command: name of the command's field, such as `command_mm`.

    Raises:
        OSError: if the file cannot be made.
    """

    def __init__(self, path: Path, command: str) -> None:
        self._file = GrowingFile(path)
        self._command = command
        self._writer = Writer(cast(IO[bytes], self._file), chunk_size=_CHUNK_BYTES)
        self._writer.start(profile="", library="hystmpc")
        tip = ("time_s", command, "angle_deg", TAKEN, "reference_deg", "predicted_deg")
        self._tip = self._channel(TIP, "hystmpc.Tip", {name: ["number", "null"] for name in tip})
        timing = {"period_s": ["number", "null"], "lateness_s": ["number", "null"], "missed": ["boolean"]}
        self._timing = self._channel(TIMING, "hystmpc.Timing", timing)
        self._events = self._channel(EVENTS, "foxglove.Log", _LOG_FIELDS)
        self._start_ns: int | None = None
        self._before: tuple[str, tuple[str, ...]] | None = None

    def add(self, sample: Sample) -> None:
        """Collect the messages of one sample."""
        elapsed = round(1e9 * sample.t_s)
        if self._start_ns is None:
            self._start_ns = max(int(sample.wall_ns) - elapsed, 0)
        stamp = max(self._start_ns + elapsed, 0)
        self._put(self._tip, stamp, sample, {name: _number(x) for name, x in sample.motion(self._command).items()})
        timing: dict[str, Any] = {
            "period_s": _number(sample.period_s),
            "lateness_s": _number(sample.lateness_s),
            "missed": bool(sample.missed),
        }
        timing |= {stage_column(name): _number(spent) for name, spent in sample.stages_s}
        self._put(self._timing, stamp, sample, timing)
        now = sample.source, tuple(sample.faults)
        if now != self._before or sample.missed:
            self._before = now
            self._put(self._events, stamp, sample, _event(sample, stamp))

    def flush(self) -> None:
        """End the chunk and put it on the disk.

        Raises:
            OSError: if the disk is full or fails.
        """
        self._writer.flush()
        self._file.commit()

    def close(self) -> None:
        """Write the summary and end the file.

        Raises:
            OSError: if the disk is full or fails.
        """
        try:
            self._writer.finish()
            self._file.commit()
        finally:
            self._file.close()

    def _channel(self, topic: str, name: str, fields: dict[str, Any]) -> int:
        properties = {field: kind if isinstance(kind, dict) else {"type": kind} for field, kind in fields.items()}
        text = json.dumps({"title": name, "type": "object", "properties": properties})
        schema = self._writer.register_schema(name, "jsonschema", text.encode())
        return self._writer.register_channel(topic, "json", schema)

    def _put(self, channel: int, stamp: int, sample: Sample, message: dict[str, Any]) -> None:
        data = json.dumps(message, allow_nan=False).encode()
        publish = min(max(int(sample.wall_ns), 0), (1 << 64) - 1)
        self._writer.add_message(channel, stamp, data, publish, int(sample.sequence) & 0xFFFFFFFF)


_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_LOG_FIELDS = {
    "timestamp": _TIME,
    "level": ["integer"],
    "message": ["string"],
    "name": ["string"],
    "file": ["string"],
    "line": ["integer"],
    "faults": {"type": "array", "items": {"type": "string"}},
}


def _event(sample: Sample, stamp: int) -> dict[str, Any]:
    """A line of Foxglove's log panel."""
    text = ": ".join(part for part in (one_line(sample.source), one_line(sample.status)) if part)
    faults = [one_line(fault) for fault in sample.faults]
    parts = [text, f"faults: {', '.join(faults)}" if faults else "", "deadline missed" if sample.missed else ""]
    level = _ERROR if sample.source == "stop" else _WARNING if faults or sample.missed else _INFO
    return {
        "timestamp": {"sec": stamp // 1_000_000_000, "nsec": stamp % 1_000_000_000},
        "level": level,
        "message": "; ".join(part for part in parts if part),
        "name": "hystmpc",
        "file": "",
        "line": 0,
        "faults": faults,
    }


def _number(value: float) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None
