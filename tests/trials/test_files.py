"""Files are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hystmpc.trials.files import write_atomically


def test_text_and_bytes_arrive_in_a_new_folder(tmp_path: Path) -> None:
    path = write_atomically(tmp_path / "a" / "b.txt", "1 µm\n")
    assert path.read_bytes() == "1 µm\n".encode()
    assert write_atomically(path, b"\x00\xff").read_bytes() == b"\x00\xff"
    assert [file.name for file in path.parent.iterdir()] == ["b.txt"]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        write_atomically(tmp_path / "taken", "text")
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX systems")
def test_the_file_is_as_readable_as_any_other(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.touch()
    assert write_atomically(tmp_path / "new", "x").stat().st_mode == plain.stat().st_mode
