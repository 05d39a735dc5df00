"""The whole messages of an MCAP file, read front to back, so that a file that was cut off gives what it holds."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from .errors import LogError

MAGIC = b"\x89MCAP0\r\n"
_PREFIX = struct.Struct("<BQ")
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 1, 2, 3, 4, 5, 6, 15
_MOST_BYTES = 1 << 30  # of one chunk, unpacked: a damaged length must not fill the memory
_ID = struct.Struct("<H")


class _DamagedError(Exception):
    """The rest of the file cannot be trusted."""


@dataclass
class McapRecords:
    """Messages of one file in the order in which they were written.

    Attributes:
        path: the file.
        schemas, channels: by their ids, as far as they have been met.
        note: why reading ended before the end of the file; empty if it did not.
    """

    path: str
    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    note: str = ""

    def messages(self) -> Iterator[Any]:
        """Every whole message; `mcap.records.Message`, its channel in `channels`.

        Raises:
            LogError: if the file cannot be read or is no MCAP file.
        """
        data = self._bytes()
        try:
            yield from self._walk(data, len(MAGIC), top=True)
        except _DamagedError as error:
            self.note = f"cut off or damaged: {error}; what stands before is read"

    def _bytes(self) -> bytes:
        try:
            data = Path(self.path).read_bytes()
        except FileNotFoundError:
            raise LogError(f"{self.path}: no such file") from None
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read ({error.strerror})") from None
        if not data.startswith(MAGIC):
            raise LogError(f"{self.path}: not an MCAP file (starts with {data[:8]!r}, expected {MAGIC!r})")
        return data

    def _walk(self, data: bytes, at: int, top: bool) -> Iterator[Any]:
        """Records of the file, or of one chunk; what follows the data section is not looked at."""
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
        """Messages of a chunk; of one that is cut off, what lies in it uncompressed."""
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError
        from mcap.records import Chunk

        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            records = _unpacked(chunk) if whole or chunk.compression == "" else b""
        except (McapError, struct.error, ValueError, OverflowError) as error:
            raise _DamagedError(f"chunk that cannot be read ({error or type(error).__name__})") from None
        if whole and chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc:
            raise _DamagedError("chunk whose checksum is wrong")
        yield from self._walk(records, 0, top=False)


def _unpacked(chunk: Any) -> bytes:
    if chunk.compression == "":
        return chunk.data
    if chunk.uncompressed_size > _MOST_BYTES:
        raise ValueError(f"{chunk.uncompressed_size} bytes unpacked")
    if chunk.compression == "zstd":
        import zstandard

        try:
            return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
        except zstandard.ZstdError as error:
            raise ValueError(str(error)) from None
    if chunk.compression == "lz4":
        import lz4.frame

        try:
            return lz4.frame.decompress(chunk.data)
        except RuntimeError as error:
            raise ValueError(str(error)) from None
    raise ValueError(f"compression {chunk.compression!r}")
