"""A log that one was given reads no other file, needs no other code, and does not fill the memory."""

from __future__ import annotations

import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

pytest.importorskip("h5py", reason="h5py (extra `logs`) is not installed")
pytest.importorskip("mcap", reason="mcap (extra `logs`) is not installed")

import h5py

from hystmpc.trials import arrays, formats, mat_, mcap_, xlsx_
from hystmpc.trials.arrays import open_npz, open_tdms
from hystmpc.trials.errors import LogError
from hystmpc.trials.mat_ import open_mat
from hystmpc.trials.mcap_ import open_bag1, open_mcap
from hystmpc.trials.read import read_log
from hystmpc.trials.xlsx_ import open_xlsx

from .written_ways import WAYS, archive

N = 100
SECRET = np.arange(1.0, N + 1)


@pytest.fixture
def given(tmp_path: Path) -> Path:
    """A folder with two files that no log may read: raw numbers, and an HDF5 file."""
    (tmp_path / "secret.bin").write_bytes(SECRET.tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = SECRET
        file.create_group("g")["x"] = SECRET
    return tmp_path


def external_storage(file: Any, there: Path) -> None:
    file.create_dataset("x", (N,), "f8", external=[(str(there / "secret.bin"), 0, 8 * N)])


def external_storage_beside(file: Any, there: Path) -> None:
    del there
    file.create_dataset("x", (N,), "f8", external=[("secret.bin", 0, 8 * N)])


def external_link(file: Any, there: Path) -> None:
    file["x"] = h5py.ExternalLink(str(there / "other.h5"), "/x")


def external_group(file: Any, there: Path) -> None:
    file.create_group("deep")["g"] = h5py.ExternalLink(str(there / "other.h5"), "/g")


def soft_link_through_another_file(file: Any, there: Path) -> None:
    file.create_group("#refs#")["out"] = h5py.ExternalLink(str(there / "other.h5"), "/")
    file["x"] = h5py.SoftLink("/#refs#/out/x")


def virtual(file: Any, there: Path) -> None:
    layout = h5py.VirtualLayout((N,), "f8")
    layout[:] = h5py.VirtualSource(str(there / "other.h5"), "x", (N,))
    file.create_virtual_dataset("x", layout)


def cell_in_another_file(file: Any, there: Path) -> None:
    hidden = file.create_dataset("#refs#/a", (N,), "f8", external=[(str(there / "secret.bin"), 0, 8 * N)])
    cell = file.create_dataset("cell", (1,), dtype=h5py.ref_dtype)
    cell[0] = hidden.ref


def empty_but_huge(file: Any, there: Path) -> None:
    del there
    file.create_dataset("x", (1 << 40,), "f8", chunks=(1 << 16,))


def huge_chunk(file: Any, there: Path) -> None:
    del there
    file.create_dataset("x", (10,), "f8", chunks=(1 << 28,), maxshape=(None,), compression="gzip")


def many_references(file: Any, there: Path) -> None:
    del there
    file.create_dataset("x", (1 << 20,), h5py.ref_dtype, chunks=(1 << 16,))


HDF5: dict[Callable[[Any, Path], None], str] = {
    external_storage: "lie in another file",
    external_storage_beside: "lie in another file",
    external_link: "is a link out of the file",
    external_group: "is a link out of the file",
    soft_link_through_another_file: "is a link out of the file",
    virtual: "lie in another file",
    cell_in_another_file: "lie in another file",
    empty_but_huge: "unpacks to more than",
    huge_chunk: "unpacks to more than",
    many_references: "more than 20000 objects",
}


def hdf5(path: Path, fill: Callable[[Any, Path], None]) -> Path:
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = SECRET
        fill(file, path.parent)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize("fill", HDF5, ids=lambda fill: fill.__name__)
def test_a_matlab_file_reads_nothing_but_itself(fill: Callable[[Any, Path], None], given: Path) -> None:
    path = hdf5(given / "log.mat", fill)
    refused(lambda: open_mat(path), HDF5[fill])


def refused(read: Callable[[], object], expected: str) -> None:
    """In one line, and without much memory."""
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match=expected) as error:
            read()
        assert tracemalloc.get_traced_memory()[1] < 100_000_000
    finally:
        tracemalloc.stop()
    assert "\n" not in str(error.value)
    assert len(str(error.value)) <= 300


def test_what_many_variables_unpack_to_counts_together(given: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mat_, "MOST_BYTES", 10_000)

    def filled(count: int) -> Callable[[Any, Path], None]:
        return lambda file, there: [file.create_dataset(f"x{k}", (N,), "f8") for k in range(count)] and None

    assert len(open_mat(hdf5(given / "some.mat", filled(11))).names()) == 12
    refused(lambda: open_mat(hdf5(given / "more.mat", filled(12))), "unpacks to more than 10000 bytes")


def test_a_filter_that_is_looked_for_on_the_machine_is_refused(given: Path) -> None:
    def packed(file: Any, there: Path) -> None:
        del there
        made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        made.set_chunk((N,))
        made.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))  # zstd, a plugin
        space = h5py.h5s.create_simple((N,))
        h5py.h5d.create(file.id, b"x", h5py.h5t.NATIVE_DOUBLE, space, made)

    refused(lambda: open_mat(hdf5(given / "log.mat", packed)), "is packed by filter 32015")


def test_links_within_the_file_are_followed(given: Path) -> None:
    def linked(file: Any, there: Path) -> None:
        del there
        file.create_group("g")["up"] = h5py.SoftLink("/t")
        file["soft"] = h5py.SoftLink("g/up")
        file["hard"] = file["t"]

    found = open_mat(hdf5(given / "log.mat", linked))
    assert set(found.names()) == {"t", "soft", "hard", "g.up"}
    np.testing.assert_array_equal(found.variables["soft"], SECRET)


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def matrix(holds: int, dims: tuple[int, ...], rest: bytes) -> bytes:
    flags = element(6, struct.pack("<II", holds, 0))
    return element(14, flags + element(5, struct.pack(f"<{len(dims)}i", *dims)) + element(1, b"x") + rest)


def version_5(path: Path, *parts: bytes, packed: bool = True) -> Path:
    elements = b"".join(
        struct.pack("<II", 15, len(content)) + content for content in (zlib.compress(part) for part in parts)
    )
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + (elements if packed else b"".join(parts)))
    return path


def nested(depth: int) -> bytes:
    inner = matrix(6, (1, 1), element(9, struct.pack("<d", 1.0)))
    for _ in range(depth):
        inner = matrix(1, (1, 1), inner)
    return inner


@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (matrix(1, (1 << 24, 1), b""), "cells in"),
        (matrix(2, (1 << 14, 1 << 10), element(5, struct.pack("<i", 8)) + element(1, b"")), "cells in"),
        (matrix(1, (1, 1), matrix(1, (1 << 24, 1), b"")), "cells in"),
        (nested(5000), "within one another"),
    ],
)
def test_cells_that_a_file_has_no_room_for_are_refused(
    made: bytes, expected: str, packed: bool, tmp_path: Path
) -> None:
    refused(lambda: open_mat(version_5(tmp_path / "log.mat", made, packed=packed)), expected)


@pytest.mark.filterwarnings("ignore:Duplicate variable name")
def test_a_packed_file_that_fills_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mat_, "MOST_BYTES", 1_000_000)
    parts = [matrix(6, (10_000, 1), element(9, bytes(80_000))) for _ in range(12)]
    assert open_mat(version_5(tmp_path / "some.mat", *parts))
    refused(lambda: open_mat(version_5(tmp_path / "more.mat", *parts, *parts)), "unpacks to more than 1000000 bytes")
    deep = matrix(1, (1, 1), matrix(6, (200_000, 1), element(9, bytes(1_600_000))))
    refused(lambda: open_mat(version_5(tmp_path / "deep.mat", deep)), "unpacks to more than 1000000 bytes")


def test_what_matlab_and_scipy_write_is_within_the_bounds(tmp_path: Path) -> None:
    data = {"a": {"b": [SECRET, {"c": "text"}]}, "cells": np.array([SECRET, "x"], dtype=object), "m": np.eye(50)}
    for packed in (False, True):
        savemat(tmp_path / "log.mat", data, do_compression=packed)
        assert "m[3]" in open_mat(tmp_path / "log.mat").names()


@pytest.mark.parametrize("how", ["zstd", "lz4"])
def test_chunks_that_fill_the_memory_end_a_log(how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of all chunks together; and one that unpacks to more than it says."""
    from mcap.writer import CompressionType, Writer

    monkeypatch.setattr(mcap_, "MOST_BYTES", 60_000)
    out = BytesIO()
    writer = Writer(out, compression=CompressionType[how.upper()], chunk_size=20_000)
    writer.start()
    channel = writer.register_channel("t", "json", writer.register_schema("s", "jsonschema", b"{}"))
    for k in range(40):
        writer.add_message(channel, k, b'{"x": 1' + b" " * 5000 + b"}", k)
    writer.finish()
    (tmp_path / "log.mcap").write_bytes(out.getvalue())
    log = open_mcap(tmp_path / "log.mcap")
    assert "more than" in log.note
    assert 0 < len(log.messages) < 20


@pytest.mark.parametrize("how", ["zstd", "lz4"])
@pytest.mark.parametrize("size", [10, 999, 1001, 2000])
def test_a_chunk_has_the_bytes_that_it_says(how: str, size: int) -> None:
    class Chunk:
        compression, uncompressed_size = how, size

        def __init__(self) -> None:
            import lz4.frame
            import zstandard

            plain = bytes(1000)
            self.data = zstandard.compress(plain) if how == "zstd" else lz4.frame.compress(plain)

    with pytest.raises(ValueError, match=f"other than its {size} bytes"):
        mcap_._unpacked(Chunk(), 1 << 20)


def test_a_workbook_that_fills_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openpyxl")
    packed = workbook(tmp_path / "log.xlsx", {"xl/media/image1.png": bytes(3_000_000)})
    assert packed.stat().st_size < 100_000
    assert len(open_xlsx(packed).numbers["time_s"]) == 3
    monkeypatch.setattr(xlsx_, "MOST_BYTES", 2_000_000)
    refused(lambda: open_xlsx(packed), r"unpacks to \d+ bytes in \d+ parts")


def test_a_row_far_down_a_sheet_takes_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openpyxl")
    far = b'<row r="999999999999"><c r="A999999999999"><v>1</v></c></row></sheetData>'
    path = workbook(tmp_path / "log.xlsx", {}, lambda sheet: sheet.replace(b"</sheetData>", far))
    rows: list[object] = []
    texts = xlsx_._texts
    monkeypatch.setattr(xlsx_, "_texts", lambda row: rows.append(row) or texts(row))
    assert len(open_xlsx(path).numbers["time_s"]) == 3
    assert len(rows) < 20_000


ENTITIES = b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_workbook_with_entities_is_refused(encoding: str, tmp_path: Path) -> None:
    """Entities can read other files, and grow beyond all bounds."""
    pytest.importorskip("openpyxl")

    def change(sheet: bytes) -> bytes:
        head, found, rest = sheet.partition(b"<worksheet")
        text = (head + b"<!-- " + b" " * 3_000_000 + b"-->" + ENTITIES + found + rest).decode()
        return text.encode(encoding)

    expected = "defines entities" if encoding == "utf-8" else "not in UTF-8"
    refused(lambda: open_xlsx(workbook(tmp_path / "log.xlsx", {}, change)), expected)


def workbook(path: Path, more: Mapping[str, bytes], change: Callable[[bytes], bytes] = lambda sheet: sheet) -> Path:
    """A sheet of three rows, with further parts, and the XML of its cells changed."""
    from openpyxl import Workbook

    book = Workbook()
    for row in [["time_s", "command", "angle_deg"], [0, 1, 2], [1, 2, 3], [2, 3, 4]]:
        book.active.append(row)
    book.save(path)
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    parts["xl/worksheets/sheet1.xml"] = change(parts["xl/worksheets/sheet1.xml"])
    return archive(path, parts | more)


def test_pickles_in_a_file_of_numpy_are_not_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", time_s=SECRET, command=np.array([{}, object], dtype=object), angle_deg=SECRET)
    with pytest.raises(LogError, match="'command' is an array of pickled objects, which can run code"):
        read_log(tmp_path / "log.npz")
    np.save(tmp_path / "log.npy", np.array([{}], dtype=object))
    with pytest.raises(LogError, match="pickled objects, which can run code"):
        read_log(tmp_path / "log.npy")


def numpy_header(shape: tuple[int, ...]) -> bytes:
    out = BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return out.getvalue()


@pytest.mark.parametrize("shape", [(1 << 24,), (1 << 40,), (1 << 20, 1 << 20), (-3,), (1 << 62, 4)])
@pytest.mark.parametrize("packed", [True, False])
def test_an_array_that_a_file_has_no_room_for_is_refused(shape: tuple[int, ...], packed: bool, tmp_path: Path) -> None:
    content = numpy_header(shape) + bytes(80)
    path = tmp_path / "log.npy"
    path.write_bytes(content)
    if packed:
        path = archive(tmp_path / "log.npz", {"time_s.npy": content})
    refused(lambda: open_npz(path), "an array of")


def test_arrays_that_fill_the_memory_together_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arrays, "MOST_BYTES", 1_000_000)
    np.savez_compressed(tmp_path / "log.npz", **{f"x{k}": np.zeros(30_000) for k in range(5)})
    refused(lambda: open_npz(tmp_path / "log.npz"), "unpacks to more than 1000000 bytes")


@pytest.mark.parametrize("how", ["bz2", "lz4"])
def test_a_bag_whose_chunks_fill_the_memory_is_refused(
    how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rosbags")
    import bz2

    import lz4.frame

    monkeypatch.setattr(mcap_, "MOST_BYTES", 1_000_000)
    content = (bz2.compress if how == "bz2" else lz4.frame.compress)(bytes(5_000_000))
    fields = [b"op=\x05", b"compression=" + how.encode(), b"size=" + struct.pack("<I", 10)]
    head = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    record = struct.pack("<I", len(head)) + head + struct.pack("<I", len(content)) + content
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0\n" + record)
    refused(lambda: open_bag1(tmp_path / "log.bag"), "unpacks to more than 1000000 bytes")


def test_a_tdms_file_reads_no_index_beside_it_and_holds_what_it_says(tmp_path: Path) -> None:
    pytest.importorskip("nptdms")
    path = WAYS["TDMS"](tmp_path, SECRET, SECRET, SECRET)
    (tmp_path / "log.tdms_index").write_bytes(b"TDSh" + bytes(200))
    before = open_tdms(path).names()
    assert len(before) == 3
    content = path.read_bytes()
    count = struct.pack("<IQ", 1, SECRET.size)  # one dimension, so many samples
    path.write_bytes(content.replace(count, struct.pack("<IQ", 1, 1 << 50)))
    tracemalloc.start()
    try:
        log = open_tdms(path)  # what stands in it is read, since a file that was cut off looks the same
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    assert "cut off or damaged" in log.note
    assert all(log.series([name], "log")[0].values.size <= len(content) for name in log.names())


def test_the_bounds_are_those_of_the_page() -> None:
    assert mcap_.MOST_BYTES == mat_.MOST_BYTES == formats.MOST_BYTES == 1 << 30
    assert xlsx_.MOST_BYTES == 1 << 28


def test_a_bag_of_many_topics_may_be_larger_than_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not packed takes no more memory than it says; other formats hold one log and are bounded as they lie."""
    columns = {"time_s": np.arange(9.0), "command": np.arange(9.0), "angle_deg": np.arange(9.0)}
    (tmp_path / "log.mcap").write_bytes(mcap_.format_mcap(columns, np.arange(9.0), 0))
    np.savez(tmp_path / "log.npz", **columns)
    monkeypatch.setattr(formats, "MOST_BYTES", 100)
    assert "angle_deg" in " ".join(open_mcap(tmp_path / "log.mcap").names())
    with pytest.raises(LogError, match="more than 100 bytes"):
        formats.read_bytes(tmp_path / "log.npz")
