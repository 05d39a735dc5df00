"""Which format a log has, told by its first bytes, and by its ending where these say nothing."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

from .errors import LogError

MOST_BYTES = 1 << 30
"""Of a log, as it lies and unpacked: more is no log of one trial."""

_HEAD = 4096
_HDF5 = b"\x89HDF\r\n\x1a\n"

# First bytes -> a format with a reader of its own.
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
"""Ending -> format, where the first bytes do not tell it; every other ending is delimited text."""

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

_JSON = re.compile(r'\s*(\{\s*(["}]|\Z)|\[\s*([\[{"\d\]-]|\Z))')
_MARKUP = re.compile(r"\s*<(\?xml|!doctype|html|[a-z][\w:.-]*[\s/>])", re.IGNORECASE)


def format_of(path: Path) -> str:
    """Name of the format of a file: of `ENDINGS`, or `text` for all that has no reader of its own.

    What lies at the path is not judged: a reader says that a file is missing or cannot be read.
    """
    by_ending = ENDINGS.get(path.suffix.lower(), "text")
    try:
        if not path.is_file():  # also a pipe, from which every byte can be had only once
            return by_ending
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except (OSError, ValueError):
        return by_ending
    if head.startswith(b"PK\x03\x04"):
        return _packed(path) or by_ending
    return next((name for start, name in _READ if head.startswith(start)), by_ending)


def _packed(path: Path) -> str | None:
    """What a ZIP archive is, by the names in it."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return None
    if "xl/workbook.xml" in names:
        return "xlsx"
    return "npz" if names and all(name.endswith(".npy") for name in names) else None


def require_known(path: Path | str, data: bytes) -> None:
    """Refuse a file whose first bytes say that it is of a format that is not read.

    Raises:
        LogError: names the format and what to do.
    """
    head = data[:_HEAD]
    for start, name, remedy in _FOREIGN:
        if head.startswith(start):
            raise LogError(f"{path}: {name}, which is not read; {remedy}")
    if head.startswith(b"PK\x03\x04"):
        document = b"mimetypeapplication/vnd.oasis" in head
        name, remedy = ("OpenDocument", _CSV) if document else ("ZIP archive", "unpack it first")
        raise LogError(f"{path}: {name}, which is not read; {remedy}")


def foreign_text(text: str) -> str:
    """Name and remedy of text that is no table, `NAME, ...`; empty where it may be one."""
    head = text[:_HEAD]
    if _JSON.match(head):
        return f"JSON, which is not read; {_CSV}"
    if _MARKUP.match(head):
        return f"XML or HTML, which is not read; {_CSV}"
    return ""
