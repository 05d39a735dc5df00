"""Text of a log, whatever encoding and line ends it was written with."""

from __future__ import annotations

import codecs
import re
from contextlib import suppress
from pathlib import Path

from .errors import LogError
from .formats import MOST_BYTES, foreign_text, require_known

_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # begins as the mark of UTF-16 does
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_TAIL = "\x00\x1a"  # what a power cut leaves behind the last row, and the end mark of DOS
_BLOCK = 1 << 22
_SAMPLE = 4096
_MANY, _FEW = 0.4, 0.02  # shares of zero bytes: text of western letters in UTF-16 has every second one


def read_lines(path: Path | str) -> list[str]:
    """Text of a file, line by line; byte order marks, UTF-16, CRLF and a missing last newline make no difference.

    Raises:
        LogError: if the path is missing, a folder, unreadable, empty, or of a format that is no delimited text.
    """
    data = read_bytes(path)
    require_known(path, data)
    text = _decoded(path, data)
    if not text.strip():
        raise LogError(f"{path}: empty file, expected a header row and at least two rows of numbers")
    if foreign := foreign_text(text):
        raise LogError(f"{path}: {foreign}")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def read_bytes(path: Path | str) -> bytes:
    """All bytes of a file.

    Raises:
        LogError: if the path is missing, a folder or unreadable, or holds more than `MOST_BYTES`.
    """
    blocks, left = [], MOST_BYTES
    try:
        with Path(path).open("rb") as file:
            while left >= 0 and (block := file.read(_BLOCK)):  # as much at once as there is, not as there might be
                blocks.append(block)
                left -= len(block)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise LogError(f"{path}: is a folder, expected a file") from None
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if left < 0:
        raise LogError(f"{path}: more than {MOST_BYTES} bytes, expected a log of one trial")
    return b"".join(blocks)


def _decoded(path: Path | str, data: bytes) -> str:
    mark, encoding = next(((m, e) for m, e in _MARKS if data.startswith(m)), (b"", _unmarked(data)))
    wide = {"utf-16": 2, "utf-32": 4}.get(encoding[:6], 0)
    if wide:
        body = data[len(mark) :]
        try:
            text = body[: len(body) // wide * wide].decode(encoding)  # without a character that was cut off
        except UnicodeDecodeError:
            raise LogError(f"{path}: binary (no {encoding.upper()} text), expected delimited text") from None
        text, place = text.rstrip(_TAIL), "character"
    else:
        text, place = data.rstrip(_TAIL.encode()).decode("latin-1"), "byte"
    if bad := _CONTROL.search(text):
        found = f"{place} {ord(bad.group()):#04x} at offset {bad.start()}"
        raise LogError(f"{path}: binary ({found}), expected delimited text")
    if wide:
        return text
    with suppress(UnicodeDecodeError):
        return text.encode("latin-1").decode("utf-8-sig")
    return text  # of older lab software; every byte has a meaning in Latin-1


def _unmarked(data: bytes) -> str:
    """Encoding of text without a byte order mark."""
    sample = data[:_SAMPLE]
    half = max(1, len(sample) // 2)
    even, odd = sample[::2].count(0) / half, sample[1::2].count(0) / half
    if odd > _MANY and even < _FEW:
        return "utf-16-le"
    return "utf-16-be" if even > _MANY and odd < _FEW else "utf-8"
