"""MCAP logs and ROS bags, without ROS: reading of their messages, and writing of a run as JSON messages."""

from __future__ import annotations

import bz2
import importlib.util
import json
import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import LogError, require
from .formats import MOST_BYTES, damaged, one_line, read_bytes
from .messages import Decoder, MessageLog, Topic, UnreadableError, late_decoder

TOPIC = "/hystmpc/log"


def available() -> bool:
    """Whether the `mcap` package (extra `logs`) is installed."""
    return importlib.util.find_spec("mcap") is not None


def format_mcap(
    columns: Mapping[str, Sequence[str] | NDArray[np.generic]], t: NDArray[np.float64], start_ns: int
) -> bytes:
    """Format columns as an MCAP file with one JSON message per sample; not-a-number becomes null.

    Args:
        columns: numbers or texts, each of length T.
        t: time of each sample since the start of the run [s], (T,).
        start_ns: start of the run [ns since 1970].
    """
    from mcap.writer import Writer

    values = {k: c.tolist() if isinstance(c, np.ndarray) else list(c) for k, c in columns.items()}
    out = BytesIO()
    writer = Writer(out)
    writer.start(profile="", library="hystmpc")
    kinds = {name: ["number", "null"] if isinstance(c, np.ndarray) else ["string"] for name, c in columns.items()}
    fields = {"type": "object", "properties": {name: {"type": kind} for name, kind in kinds.items()}}
    schema = writer.register_schema("hystmpc.Sample", "jsonschema", json.dumps(fields).encode())
    channel = writer.register_channel(TOPIC, "json", schema)
    stamps = (start_ns + np.rint(1e9 * t).astype(np.int64)).tolist()
    for k, stamp in enumerate(stamps):
        row = {name: column[k] for name, column in values.items()}
        message = {name: None if isinstance(v, float) and not math.isfinite(v) else v for name, v in row.items()}
        writer.add_message(channel, stamp, json.dumps(message, allow_nan=False).encode(), stamp, k)
    writer.finish()
    return out.getvalue()


MAGIC = b"\x89MCAP0\r\n"
_PREFIX = struct.Struct("<BQ")
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 2, 3, 4, 5, 6, 15


class _DamagedError(Exception):
    """Error on damage after which the rest of a file is unreliable."""


@dataclass
class McapRecords:
    """Messages of one file in the order in which they were written."""

    path: str
    schemas: dict[int, Any] = field(default_factory=dict)  # by id, as read so far
    channels: dict[int, Any] = field(default_factory=dict)
    note: str = ""  # reason for an end of reading before the end of the file; empty otherwise
    left: int = field(default_factory=lambda: MOST_BYTES)  # bytes that may still be unpacked

    def messages(self) -> Iterator[Any]:
        """Iterate over every complete message (`mcap.records.Message`), with its channel in `channels`.

        Raises:
            LogError: if the file cannot be read or is no MCAP file.
        """
        data = read_bytes(self.path, bounded=False)
        if not data.startswith(MAGIC):
            raise LogError(f"{self.path}: not an MCAP file (starts with {data[:8]!r}, expected {MAGIC!r})")
        try:
            yield from self._walk(data, len(MAGIC), top=True)
        except _DamagedError as error:
            self.note = damaged(str(error))

    def _walk(self, data: bytes, at: int, top: bool) -> Iterator[Any]:
        """Records of the file, or of one chunk, up to the end of the data section."""
        ended = not top
        while at < len(data):
            if at + _PREFIX.size > len(data):
                raise _DamagedError(f"byte {at} of {len(data)}")
            opcode, length = _PREFIX.unpack_from(data, at)
            start = at + _PREFIX.size
            body = data[start : start + length]
            if opcode == _CHUNK and top:
                yield from self._chunk(body, whole=len(body) == length)
            if len(body) < length or opcode == 0:
                raise _DamagedError(f"byte {at} of {len(data)}")
            if opcode in (_SCHEMA, _CHANNEL, _MESSAGE):
                yield from self._record(opcode, body)
            if top and opcode in (_DATA_END, _FOOTER):
                ended = True
                break
            at = start + length
        if not ended:
            raise _DamagedError(f"it ends without a summary at byte {len(data)}")

    def _record(self, opcode: int, body: bytes) -> Iterator[Any]:
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError
        from mcap.records import Channel, Message, Schema

        stream = ReadDataStream(BytesIO(body))
        try:
            if opcode == _SCHEMA:
                schema = Schema.read(stream)
                self.schemas[schema.id] = schema
            elif opcode == _CHANNEL:
                channel = Channel.read(stream)
                self.channels[channel.id] = channel
            else:
                message = Message.read(stream, len(body))
                if message.channel_id not in self.channels:
                    raise _DamagedError(f"message of channel {message.channel_id}, which was not announced")
                yield message
        except (McapError, struct.error, ValueError) as error:
            raise _DamagedError(f"record that cannot be read ({error or type(error).__name__})") from None

    def _chunk(self, body: bytes, whole: bool) -> Iterator[Any]:
        """Messages of a chunk; of an incomplete chunk only uncompressed ones."""
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError
        from mcap.records import Chunk

        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            records = _unpacked(chunk, self.left) if whole or chunk.compression == "" else b""
        except (McapError, struct.error, ValueError, OverflowError) as error:
            raise _DamagedError(f"chunk that cannot be read ({error or type(error).__name__})") from None
        self.left -= len(records) if chunk.compression else 0
        if whole and chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc:
            raise _DamagedError("chunk whose checksum is wrong")
        yield from self._walk(records, 0, top=False)


def _unpacked(chunk: Any, most: int) -> bytes:
    """Unpack the records of a chunk within its declared size; a ValueError holds the reason of a failure."""
    if chunk.compression == "":
        return chunk.data
    size = chunk.uncompressed_size
    if size > most:
        raise ValueError(f"more than {MOST_BYTES} bytes unpacked")
    if chunk.compression == "zstd":
        import zstandard

        try:
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
                return _whole(stream.read(size + 1), size)
        except zstandard.ZstdError as error:
            raise ValueError(str(error)) from None
    if chunk.compression == "lz4":
        import lz4.frame

        try:
            return _whole(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1), size)
        except RuntimeError as error:
            raise ValueError(str(error)) from None
    raise ValueError(f"compression {chunk.compression!r}")


def _whole(unpacked: bytes, size: int) -> bytes:
    if len(unpacked) != size:
        raise ValueError(f"unpacks to other than its {size} bytes")
    return unpacked


def open_mcap(path: Path | str) -> MessageLog:
    """Read the messages of an MCAP file, of an incomplete file up to its end.

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
        topics[channel.topic] = Topic(kind, _decoder(channel.message_encoding, schema))
    names = {number: channel.topic for number, channel in records.channels.items()}
    messages = [(names[number], stamp, data) for number, stamp, data in kept]
    return MessageLog(str(path), topics, messages, records.note)


def _decoder(encoding: str, schema: Any) -> Decoder:
    if encoding == "json":
        return _parse_json
    if encoding == "cdr" and schema is not None:
        return late_decoder(schema.name, schema.encoding, schema.data.decode("utf-8", errors="replace"))

    def refuse(_: bytes) -> Any:
        raise UnreadableError(f"encoding {encoding!r}, expected json or cdr (ROS 2)")

    return refuse


def _parse_json(raw: bytes) -> Any:
    try:
        return json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"not JSON ({one_line(error)})") from None


_ROS1, _ROS2 = {"MSG": "ros1msg"}, {"MSG": "ros2msg", "IDL": "ros2idl"}  # encodings of definitions
_MAGIC = b"#ROSBAG V2.0\n"
_BAG_CHUNK = b"\x05"
_SIZE = struct.Struct("<I")


def open_bag(path: Path | str) -> MessageLog:
    """Read the messages of a ROS 2 bag (sqlite3 or mcap storage).

    A bag whose recorder was killed has no metadata.yaml: name the storage file itself. An incomplete mcap storage is
    read up to its end, an sqlite3 storage as far as the database allows.

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
    """Topics and messages of a bag up to its first fault, which becomes the note."""
    topics: dict[str, Topic] = {}
    messages: list[tuple[str, int, bytes]] = []
    note = ""
    try:
        with reader(path) as bag:
            for connection in bag.connections:
                encoding = encodings.get(connection.msgdef.format.name, "")
                decode = late_decoder(connection.msgtype, encoding, connection.msgdef.data)
                topics[connection.topic] = Topic(connection.msgtype, decode)
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
    """Messages of the mcap files of a bag, each read up to its first fault."""
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
    """Refuse a bag whose unpacked chunks exceed the size limit of a log, before the library unpacks any."""
    left = MOST_BYTES
    for fields, content in _records(data):
        if fields.get(b"op") == _BAG_CHUNK:
            left -= _unpacked_size(fields.get(b"compression", b"none"), content, left)
            if left < 0:
                raise LogError(f"{path}: unpacks to more than {MOST_BYTES} bytes, expected a log")


def _records(data: bytes) -> Iterator[tuple[dict[bytes, bytes], memoryview]]:
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
    """Unpacked size of a chunk [bytes]; any number above `most` if it is larger than that."""
    if compression == b"none":
        return 0  # not compressed
    if compression == b"bz2":
        return len(bz2.BZ2Decompressor().decompress(content, most + 1))
    if compression == b"lz4":
        import lz4.frame

        return len(lz4.frame.LZ4FrameDecompressor().decompress(content, most + 1))
    raise ValueError(f"compression {compression[:20]!r}")
