"""Format of a log file, by its first bytes or its extension; reading of its bytes, and of its text in any encoding."""

from __future__ import annotations

import codecs
import math
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import LogError
from .types import Vec

MOST_BYTES = 1 << 30
"""Greatest size of a log, packed or unpacked; a log of one trial is smaller."""

_HEAD = 4096
_HDF5 = b"\x89HDF\r\n\x1a\n"

# First bytes -> a format with a special reader.
_READ = (
    (b"\x89MCAP0\r\n", "mcap"),
    (b"#ROSBAG V", "rosbag1"),
    (b"TDSm", "tdms"),
    (b"\x93NUMPY", "npy"),
    (b"MATLAB 5.0 MAT-file", "mat"),
    (b"MATLAB 7.3 MAT-file", "mat"),
)

ENDINGS = {
    ".mcap": "mcap",
    ".db3": "rosbag2",
    ".bag": "rosbag1",
    ".mat": "mat",
    ".npz": "npz",
    ".npy": "npy",
    ".tdms": "tdms",
    ".xlsx": "xlsx",
    ".xlsm": "xlsx",
    ".lvm": "text",
}
"""Formats by file ending, if the first bytes do not identify them; all other endings are delimited text."""

_CSV = "export the table as CSV: a header row, one row a sample"
_IMAGE = "expected a log; no curve is read out of an image"

# First bytes -> name and remedy of a format without a reader.
_FOREIGN = (
    (b"SQLite format 3\x00", "SQLite database", "a ROS 2 bag has the ending .db3; of any other, " + _CSV),
    (b"PAR1", "Parquet", "write it as CSV: pandas.read_parquet(FILE).to_csv('log.csv', index=False)"),
    (b"ARROW1", "Feather (Arrow)", "write it as CSV: pandas.read_feather(FILE).to_csv('log.csv', index=False)"),
    (_HDF5, "HDF5", "write its arrays as CSV, or with numpy.savez('log.npz', time_s=..., command=..., angle_deg=...)"),
    (b"ULog\x01\x12\x35", "ULog of PX4", "convert it: ulog2csv FILE"),
    (b"\xa3\x95\x80\x80", "DataFlash log of ArduPilot", "convert it: mavlogdump.py --format csv FILE"),
    (b"MDF     ", "ASAM MDF", "convert it: asammdf.MDF(FILE).export('csv')"),
    (b"UnFinMF ", "ASAM MDF, not closed", "close it in the recorder, then convert it to CSV"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "old Excel (.xls)", "save it as .xlsx or CSV"),
    (b"%PDF", "PDF", "expected the log that it was made of, as CSV"),
    (b"\x1f\x8b", "gzip", "unpack it first: gunzip FILE"),
    (b"BZh", "bzip2", "unpack it first: bunzip2 FILE"),
    (b"\xfd7zXZ\x00", "xz", "unpack it first: unxz FILE"),
    (b"\x28\xb5\x2f\xfd", "zstd", "unpack it first: unzstd FILE"),
    (b"7z\xbc\xaf\x27\x1c", "7-Zip", "unpack it first"),
    (b"Rar!\x1a\x07", "RAR", "unpack it first"),
    (b"\x89PNG\r\n\x1a\n", "PNG image", _IMAGE),
    (b"\xff\xd8\xff", "JPEG image", _IMAGE),
    (b"GIF8", "GIF image", _IMAGE),
    (b"II*\x00", "TIFF image", _IMAGE),
    (b"MM\x00*", "TIFF image", _IMAGE),
    (b"RIFF", "RIFF (sound or video)", _CSV),
    (b"\x7fELF", "a program", "expected a log"),
    (b"\x80\x04\x95", "Python pickle", "pickles can run code and are not read; write CSV or numpy.savez"),
    (b"\x80\x05\x95", "Python pickle", "pickles can run code and are not read; write CSV or numpy.savez"),
)

_YAML = (".yaml", ".yml")
_JSON = re.compile(r'\s*(\{\s*(["}]|\Z)|\[\s*([\[{"\d\]-]|\Z))')
_MARKUP = re.compile(r"\s*<(\?xml|!doctype|html|[a-z][\w:.-]*[\s/>])", re.IGNORECASE)


def format_of(path: Path) -> str:
    """Name of the format of a file: one of `ENDINGS`, or `text` for all formats without a special reader."""
    by_ending = ENDINGS.get(path.suffix.lower(), "text")
    try:
        if not path.is_file():  # also a pipe, whose bytes can be read only once
            return by_ending
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except (OSError, ValueError):
        return by_ending
    if head.startswith(b"PK\x03\x04"):
        return _packed(path) or by_ending
    return next((name for start, name in _READ if head.startswith(start)), by_ending)


def is_bag(folder: Path) -> bool:
    """Whether a folder is a ROS 2 bag: metadata.yaml and at least one storage file."""
    return (folder / "metadata.yaml").is_file() and any(any(folder.glob(f"*{end}*")) for end in (".db3", ".mcap"))


def _packed(path: Path) -> str | None:
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return None
    if "xl/workbook.xml" in names:
        return "xlsx"
    return "npz" if names and all(name.endswith(".npy") for name in names) else None


def require_known(path: Path | str, data: bytes) -> None:
    """Refuse a file whose first bytes show an unsupported format.

    Raises:
        LogError: names the format and the remedy.
    """
    head = data[:_HEAD]
    for start, name, remedy in _FOREIGN:
        if head.startswith(start):
            raise LogError(f"{path}: {name}, which is not read; {remedy}")
    if head.startswith(b"PK\x03\x04"):
        document = b"mimetypeapplication/vnd.oasis" in head
        name, remedy = ("OpenDocument", _CSV) if document else ("ZIP archive", "unpack it first")
        raise LogError(f"{path}: {name}, which is not read; {remedy}")


_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # begins like the mark of UTF-16
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_TAIL = "\x00\x1a"  # what a power cut leaves behind the last row, and the end mark of DOS
_BLOCK = 1 << 22
_SAMPLE = 4096
_MANY, _FEW = 0.4, 0.02  # shares of zero bytes: text of western letters in UTF-16 has every second one


def read_lines(path: Path | str) -> list[str]:
    """Read the lines of a text file with any byte order mark and line ends, in UTF-8, UTF-16 or another encoding.

    Raises:
        LogError: if the path is missing, a folder, unreadable, empty, or of a format that is no delimited text.
    """
    data = read_bytes(path)
    require_known(path, data)
    if Path(path).suffix.lower() in _YAML:
        raise LogError(f"{path}: YAML, which is not read; expected a log, a simulator as --sim, a mapping as --layout")
    text = _decoded(path, data)
    if not text.strip():
        raise LogError(f"{path}: empty file, expected a header row and at least two rows of numbers")
    for form, name in ((_JSON, "JSON"), (_MARKUP, "XML or HTML")):
        if form.match(text[:_HEAD]):
            raise LogError(f"{path}: {name}, which is not read; {_CSV}")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def read_bytes(path: Path | str, count: int | None = None, bounded: bool = True) -> bytes:
    """Read all bytes of a file, or its first `count`; only with `bounded` are more than `MOST_BYTES` refused.

    Raises:
        LogError: if the path is missing, a folder or unreadable, or holds more than `MOST_BYTES`.
    """
    blocks, left = [], float(MOST_BYTES) if bounded else math.inf
    try:
        with Path(path).open("rb") as file:
            if count is not None:
                return file.read(count)
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


def one_line(error: Exception) -> str:
    """Text of an error on one line, or its type if the text is empty."""
    return " ".join(str(error).split()) or type(error).__name__


def damaged(reason: str) -> str:
    """Note on a log that was read only up to a fault."""
    return f"cut off or damaged: {reason}; what stands before is read"


@contextmanager
def reading(path: Path | str, what: str) -> Iterator[None]:
    """Context for reading a file by a third-party library, which may raise any exception on a damaged file.

    Raises:
        LogError: for any exception of the library; names the file and its expected format.
    """
    try:
        yield
    except LogError:
        raise
    except Exception as error:  # noqa: BLE001 - see above
        raise LogError(f"{path}: not a readable {what}, or cut off ({one_line(error)[:100]})") from None


def seconds_since_first(dates: NDArray[Any]) -> Vec:
    """Dates (T,) of numpy as seconds since the first one; not-a-number for a missing date."""
    return np.asarray((dates - dates[:1]) / np.timedelta64(1, "s"), dtype=np.float64)


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
        control = f"{place} {ord(bad.group()):#04x} at offset {bad.start()}"
        raise LogError(f"{path}: binary ({control}), expected delimited text")
    if wide:
        return text
    with suppress(UnicodeDecodeError):
        return text.encode("latin-1").decode("utf-8-sig")
    return text  # of older lab software; every byte has a meaning in Latin-1


def _unmarked(data: bytes) -> str:
    sample = data[:_SAMPLE]
    half = max(1, len(sample) // 2)
    even, odd = sample[::2].count(0) / half, sample[1::2].count(0) / half
    if odd > _MANY and even < _FEW:
        return "utf-16-le"
    return "utf-16-be" if even > _MANY and odd < _FEW else "utf-8"
