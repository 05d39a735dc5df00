"""Signals out of ROS 1 bags (.bag, version 2.0), without ROS."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Iterator
from pathlib import Path

from .errors import LogError, require
from .formats import MOST_BYTES
from .messages import MessageLog, Topic, late_decoder, one_line
from .text_ import read_bytes

_MAGIC = b"#ROSBAG V2.0\n"
_CHUNK = b"\x05"
_SIZE = struct.Struct("<I")
_NOT_INDEXED = "it was not closed: run `rosbag reindex FILE`"


def open_bag1(path: Path | str) -> MessageLog:
    """Read the messages of a ROS 1 bag.

    Raises:
        LogError: if `rosbags` is not installed, or the file is missing, cut off, no bag, unpacks to more than
            `MOST_BYTES`, or holds no message.
    """
    require("rosbags", "logs", f"{path}: reading ROS 1 bags")
    data = read_bytes(path)
    if not data.startswith(_MAGIC):
        raise LogError(f"{path}: not a ROS 1 bag of version 2.0 (starts with {data[:13]!r})")
    topics: dict[str, Topic] = {}
    messages: list[tuple[str, int, bytes]] = []
    note = ""
    try:
        _require_bounded(str(path), data)
        _read(Path(path), topics, messages)
    except LogError:
        raise
    except Exception as error:  # noqa: BLE001 - on damaged files the library raises whatever it meets
        reason = one_line(error)[:100]
        note = (
            f"cut off or damaged: {_NOT_INDEXED if 'index' in reason.lower() else reason}; what stands before is read"
        )
    if not messages:
        raise LogError(f"{path}: not a readable ROS 1 bag, or one without a message{f' ({note})' if note else ''}")
    return MessageLog(str(path), topics, messages, note)


def _read(path: Path, topics: dict[str, Topic], messages: list[tuple[str, int, bytes]]) -> None:
    """Fill in topics and messages; what was read before a fault stays."""
    from rosbags.rosbag1 import Reader

    with Reader(path) as reader:
        for connection in reader.connections:
            decode = late_decoder(connection.msgtype, "ros1msg", connection.msgdef.data)
            topics[connection.topic] = Topic(connection.topic, connection.msgtype, decode)
        for connection, stamp, raw in reader.messages():
            messages.append((connection.topic, stamp, bytes(raw)))


def _require_bounded(path: str, data: bytes) -> None:
    """Refuse a bag whose chunks unpack to more than a log holds, before the library unpacks any."""
    left = MOST_BYTES
    for fields, content in _records(data):
        if fields.get(b"op") == _CHUNK:
            left -= _unpacked_size(fields.get(b"compression", b"none"), content, left)
            if left < 0:
                raise LogError(f"{path}: unpacks to more than {MOST_BYTES} bytes, expected a log")


def _records(data: bytes) -> Iterator[tuple[dict[bytes, bytes], memoryview]]:
    """Header fields and content of every whole record."""
    at, view = len(_MAGIC), memoryview(data)
    while at + 4 <= len(data):
        length = _SIZE.unpack_from(data, at)[0]
        head = data[at + 4 : at + 4 + length]
        at += 4 + length
        if at + 4 > len(data):
            return
        size = _SIZE.unpack_from(data, at)[0]
        yield _fields(head), view[at + 4 : at + 4 + size]
        at += 4 + size


def _fields(head: bytes) -> dict[bytes, bytes]:
    found, at = {}, 0
    while at + 4 <= len(head):
        length = _SIZE.unpack_from(head, at)[0]
        name, _, value = head[at + 4 : at + 4 + length].partition(b"=")
        found[name] = value
        at += 4 + length
    return found


def _unpacked_size(compression: bytes, content: memoryview, most: int) -> int:
    """Bytes of a chunk, unpacked; more than `most` where it has more."""
    if compression == b"none":
        return 0  # as large as it lies
    if compression == b"bz2":
        return len(bz2.BZ2Decompressor().decompress(content, most + 1))
    if compression == b"lz4":
        import lz4.frame

        return len(lz4.frame.LZ4FrameDecompressor().decompress(content, most + 1))
    raise ValueError(f"compression {compression[:20]!r}")
