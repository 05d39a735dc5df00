"""Messages of ROS bags, without ROS: ROS 2 (a folder with metadata.yaml, or a file of it) and ROS 1 (.bag, 2.0)."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from .errors import LogError, require
from .formats import MOST_BYTES, damaged, one_line, read_bytes
from .mcap_ import open_mcap
from .messages import MessageLog, Topic, late_decoder

METADATA = "metadata.yaml"
_ROS1, _ROS2 = {"MSG": "ros1msg"}, {"MSG": "ros2msg", "IDL": "ros2idl"}  # encodings of definitions
_MAGIC = b"#ROSBAG V2.0\n"
_CHUNK = b"\x05"
_SIZE = struct.Struct("<I")


def is_bag(folder: Path) -> bool:
    """Whether a folder is a ROS 2 bag: metadata.yaml beside at least one storage file."""
    return (folder / METADATA).is_file() and any(any(folder.glob(f"*{end}*")) for end in (".db3", ".mcap"))


def open_bag(path: Path | str) -> MessageLog:
    """Read the messages of a ROS 2 bag (sqlite3 or mcap storage).

    A bag whose recorder was killed has no metadata.yaml: name the storage file itself. An mcap storage that was cut
    off gives what stands before the cut; an sqlite3 storage what the database still yields.

    Args:
        path: the bag's folder, or a storage file.

    Raises:
        LogError: if `rosbags` is not installed, or the bag cannot be read or holds no message.
    """
    place = Path(path)
    if not place.exists():
        raise LogError(f"{path}: no such file")
    require("rosbags", "logs", f"{path}: reading ROS 2 bags")
    from rosbags.rosbag2 import Reader

    log = _read(place, Reader, _ROS2)
    storage = sorted(place.glob("*.mcap")) if place.is_dir() else []
    return _recovered(str(path), storage) if log.note and storage else _not_empty(log, "ROS 2 bag")


def open_bag1(path: Path | str) -> MessageLog:
    """Read the messages of a ROS 1 bag.

    Raises:
        LogError: if `rosbags` is not installed, or the file is missing, cut off, no bag, unpacks to more than
            `MOST_BYTES`, or holds no message.
    """
    require("rosbags", "logs", f"{path}: reading ROS 1 bags")
    from rosbags.rosbag1 import Reader

    data = read_bytes(path)
    if not data.startswith(_MAGIC):
        raise LogError(f"{path}: not a ROS 1 bag of version 2.0 (starts with {data[:13]!r})")

    def bounded(place: Path) -> Any:
        _require_bounded(str(path), data)
        return Reader(place)

    return _not_empty(_read(Path(path), bounded, _ROS1), "ROS 1 bag")


def _read(path: Path, reader: Callable[[Path], Any], encodings: Mapping[str, str]) -> MessageLog:
    """Topics and messages of a bag up to its first fault, which is in the note."""
    topics: dict[str, Topic] = {}
    messages: list[tuple[str, int, bytes]] = []
    note = ""
    try:
        with reader(path) as bag:
            for connection in bag.connections:
                encoding = encodings.get(connection.msgdef.format.name, "")
                decode = late_decoder(connection.msgtype, encoding, connection.msgdef.data)
                topics[connection.topic] = Topic(connection.topic, connection.msgtype, decode)
            for connection, stamp, raw in bag.messages():
                messages.append((connection.topic, stamp, bytes(raw)))
    except LogError:
        raise
    except Exception as error:  # noqa: BLE001 - on damaged files the library raises whatever it meets
        reason = one_line(error)[:100]
        unindexed = encodings is _ROS1 and "index" in reason.lower()
        note = damaged("it was not closed: run `rosbag reindex FILE`" if unindexed else reason)
    return MessageLog(str(path), topics, messages, note)


def _not_empty(log: MessageLog, kind: str) -> MessageLog:
    if not log.messages:
        note = f" ({log.note})" if log.note else ""
        raise LogError(f"{log.path}: not a readable {kind}, or one without a message{note}")
    return log


def _recovered(path: str, storage: list[Path]) -> MessageLog:
    """The mcap files of a bag one by one, each up to where it is whole."""
    require("mcap", "logs", f"{path}: reading a damaged bag")
    logs, notes = [], []
    for file in storage:
        try:
            logs.append(open_mcap(file))
            notes.append(logs[-1].note)
        except LogError as error:
            notes.append(str(error))
    if not logs:
        raise LogError(f"{path}: not a readable ROS 2 bag ({notes[0]})")
    topics = {name: topic for log in logs for name, topic in log.topics.items()}
    messages = [message for log in logs for message in log.messages]
    return MessageLog(path, topics, messages, next((note for note in notes if note), ""))


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
        yield _header_fields(head), view[at + 4 : at + 4 + size]
        at += 4 + size


def _header_fields(head: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at + 4 <= len(head):
        length = _SIZE.unpack_from(head, at)[0]
        name, _, value = head[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields


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
