"""No file names a folder that exists on one machine only."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from .source import ROOT

# Not after a letter, a digit or a dot: a part of a web address or of a relative path is none of a machine.
MACHINE = re.compile(rb"(?<![\w.])/(?:work|home|root|Users)/")


def test_no_file_names_a_folder_of_one_machine() -> None:
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout: which files belong to the project is not known")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    files = [ROOT / name for name in names if name and (ROOT / name).is_file()]
    assert [str(path.relative_to(ROOT)) for path in files if MACHINE.search(path.read_bytes())] == []


def test_the_pattern_itself() -> None:
    folder = b"/".join([b"", b"home", b"me", b"data"])
    assert MACHINE.search(b"see " + folder)
    assert not MACHINE.search(b"https://example.org" + folder)
