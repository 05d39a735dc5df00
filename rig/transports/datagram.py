"""The datagram: 44 bytes, little-endian, checked before anything in it is believed.

| offset | type | field |
|---|---|---|
| 0 | 4 bytes | magic `HMPC` |
| 4 | u8 | version, 1 |
| 5 | u8 | kind: 1 reading, 2 command, 3 stop, 4 hello |
| 6 | u16 | zero |
| 8 | u32 | session, chosen by the sender at its start |
| 12 | u32 | sequence |
| 16 | u64 | sender's monotonic clock [ns] |
| 24 | f64 | reading: angle; command: command; else 0 |
| 32 | f64 | reading: command that the device holds; else 0 |
| 40 | u32 | CRC-32 (zlib) of the 40 bytes before |
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

MAGIC, VERSION = b"HMPC", 1
_BODY = struct.Struct("<4sBBHIIQdd")
_CRC = struct.Struct("<I")
SIZE = _BODY.size + _CRC.size


class Kind(IntEnum):
    """What a datagram says."""

    READING = 1
    COMMAND = 2
    STOP = 3
    HELLO = 4


KINDS = {int(kind): kind for kind in Kind}


@dataclass(frozen=True, slots=True)
class Datagram:
    """The fields of one datagram; see the module."""

    kind: Kind
    session: int
    sequence: int
    stamp_ns: int
    value: float = 0.0
    held: float = 0.0


def encode(message: Datagram) -> bytes:
    """The bytes of a datagram (44,); sequence and session wrap at 2^32."""
    body = _BODY.pack(
        MAGIC,
        VERSION,
        message.kind,
        0,
        message.session & 0xFFFFFFFF,
        message.sequence & 0xFFFFFFFF,
        message.stamp_ns & 0xFFFFFFFFFFFFFFFF,
        message.value,
        message.held,
    )
    return body + _CRC.pack(zlib.crc32(body))


def decode(data: bytes) -> Datagram | str:
    """The datagram, or in a word why these bytes are none; never raises on bytes of any content or length."""
    if len(data) != SIZE:
        return "wrong size"
    body = data[: _BODY.size]
    if zlib.crc32(body) != _CRC.unpack_from(data, _BODY.size)[0]:
        return "wrong checksum"
    magic, version, kind, zero, session, sequence, stamp_ns, value, held = _BODY.unpack(body)
    if magic != MAGIC or version != VERSION or zero:
        return "wrong version"
    known = KINDS.get(kind)
    if known is None:
        return "unknown kind"
    return Datagram(known, session, sequence, stamp_ns, value, held)
