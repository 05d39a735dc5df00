"""What a datagram has to be before anything in it is believed: each rule by its own, behind a right checksum."""

from __future__ import annotations

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.rig.transports.udp import KINDS, MAGIC, SIZE, VERSION, Datagram, Kind, decode, encode

COMMAND = Datagram(Kind.COMMAND, 7, 8, 9, 1.5)


def signed(*, magic: bytes = MAGIC, version: int = VERSION, kind: int = 2, zero: int = 0) -> bytes:
    """A datagram with another head, and the checksum that belongs to it."""
    body = struct.pack("<4sBBHIIQdd", magic, version, kind, zero, 7, 8, 9, 1.5, 0.0)
    return body + struct.pack("<I", zlib.crc32(body))


def test_the_head_is_that_of_a_command() -> None:
    assert signed() == encode(COMMAND)
    assert decode(signed()) == COMMAND


@given(st.integers(0, 255))
def test_only_this_version_is_read(version: int) -> None:
    assert decode(signed(version=version)) == (COMMAND if version == VERSION else "wrong version")


@given(st.integers(0, 255))
def test_a_kind_that_is_not_known_is_none(kind: int) -> None:
    found = decode(signed(kind=kind))
    assert found == ("unknown kind" if kind not in KINDS else Datagram(KINDS[kind], 7, 8, 9, 1.5))


@pytest.mark.parametrize("other", [{"magic": b"HMPD"}, {"zero": 1}, {"zero": 0x100}])
def test_another_magic_and_bits_without_a_meaning_are_refused(other: dict[str, int]) -> None:
    assert decode(signed(**other)) == "wrong version"  # type: ignore[arg-type]  # bytes or a number, as the key says


@given(st.binary(min_size=1, max_size=60))
def test_a_datagram_with_something_behind_it_is_refused(more: bytes) -> None:
    assert decode(encode(COMMAND) + more) == "wrong size"


@given(st.integers(0, SIZE - 1))
def test_a_datagram_that_is_cut_off_is_refused(length: int) -> None:
    assert decode(encode(COMMAND)[:length]) == "wrong size"
