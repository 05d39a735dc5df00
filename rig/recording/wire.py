"""Samples on a pipe between two processes of one run: a length, then plain tuples."""

from __future__ import annotations

import marshal
import struct
from collections.abc import Iterable, Iterator
from typing import BinaryIO

from ..sample import Sample

_LENGTH = struct.Struct("<I")


def pack(samples: Iterable[Sample]) -> bytes:
    """One block of samples.

    `marshal` is the fastest way to bytes that the interpreter has; the reader is the same interpreter, started by the
    writer, so its limits (one version, trusted data) are none here.

    Raises:
        ValueError, TypeError, AttributeError: on a sample whose fields are of other types than `Sample` says.
    """
    body = marshal.dumps([_plain(sample) for sample in samples])
    return _LENGTH.pack(len(body)) + body


def unpack(pipe: BinaryIO) -> Iterator[list[Sample]]:
    """Blocks of samples until the other side has closed the pipe or died; a block cut off by that is left out."""
    while len(head := pipe.read(_LENGTH.size)) == _LENGTH.size:
        length = _LENGTH.unpack(head)[0]
        body = pipe.read(length)
        if len(body) < length:
            return
        yield [Sample(*fields) for fields in marshal.loads(body)]


def _plain(s: Sample) -> tuple[object, ...]:
    """The fields in order, as types that `marshal` knows: a controller may hand over numpy's."""
    return (
        float(s.t_s),
        int(s.wall_ns),
        float(s.reference_deg),
        float(s.measured_deg),
        float(s.command),
        str(s.source),
        str(s.status),
        float(s.predicted_deg),
        tuple((str(name), float(spent)) for name, spent in s.stages_s),
        float(s.period_s),
        float(s.lateness_s),
        bool(s.missed),
        tuple(map(str, s.faults)),
        int(s.sequence),
    )
