"""Signals out of MCAP files: JSON messages of any topic, and ROS 2 messages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .errors import LogError
from .extras import require
from .mcap_records_ import McapRecords
from .messages import MessageLog, Topic
from .ros_messages_ import Decoder, UnreadableError, cdr_decoder


def open_mcap(path: Path | str) -> MessageLog:
    """Read the messages of an MCAP file; one that was cut off gives what stands before the cut.

    Raises:
        LogError: if `mcap` is not installed, the file cannot be read, is no MCAP file, or holds no whole message.
    """
    require("mcap", "logs", f"{path}: reading MCAP files")
    records = McapRecords(str(path))
    kept = [(m.channel_id, m.log_time, m.data) for m in records.messages()]
    if not kept:
        raise LogError(f"{path}: no message in it{f' ({records.note})' if records.note else ''}")
    topics = {}
    for channel in records.channels.values():
        schema = records.schemas.get(channel.schema_id)
        kind = schema.name if schema is not None else channel.message_encoding
        topics[channel.topic] = Topic(channel.topic, kind, _decoder(channel.message_encoding, schema))
    names = {number: channel.topic for number, channel in records.channels.items()}
    messages = [(names[number], stamp, data) for number, stamp, data in kept]
    return MessageLog(str(path), topics, messages, records.note)


def _decoder(encoding: str, schema: Any) -> Decoder:
    """How to read the messages of a channel; decided when the first one is read."""
    if encoding == "json":
        return _json
    found: list[Decoder] = []

    def decode(raw: bytes) -> Any:
        if encoding != "cdr" or schema is None:
            raise UnreadableError(f"encoding {encoding!r}, expected json or cdr (ROS 2)")
        if not found:
            text = schema.data.decode("utf-8", errors="replace")
            found.append(cdr_decoder(schema.name, schema.encoding, text))
        return found[0](raw)

    return decode


def _json(raw: bytes) -> Any:
    try:
        return json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"not JSON ({' '.join(str(error).split())})") from None
