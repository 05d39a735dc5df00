"""Compiled code on disk that is damaged costs time and at most one line, never the start."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.kernels import numba_
from hystmpc.models.kernels.numba_ import cache_folder, generated_module, njit, only_ours

from ..conftest import ROOT

KERNEL = """
from hystmpc.models.kernels.numba_ import njit

@njit(cache=True)
def double(x):
    return 2.0 * x
"""
# A process that has loaded the compiler, and what the module of the kernel imports, forks a start of a program at every
# line that it reads: a start from nothing takes seconds. The module itself is loaded in each start, which uses a small
# kernel of it and a generated one; not as root, who may read everything.
STARTS = """
import json, logging, os, sys, tempfile
import numba
import numpy as np

os.umask(0)
logging.getLogger("hystmpc.models.kernels.compiling").setLevel(logging.ERROR)  # on a slow machine it is told
numba.njit(lambda x: 2.0 * x)(1.0)
import hystmpc.models.inverse.drive
del sys.modules["hystmpc.models.inverse.drive"]

def start():
    from hystmpc.models.inverse.drive import first_acting
    from hystmpc.models.kernels.numba_ import generated_module
    generated_module("VALUE = 1\\n")
    if os.geteuid() == 0:
        os.setuid(65534)
    plan = np.array([1.0, 2.0, 3.0])
    first_acting(np.eye(3))
    text = "@njit(cache=True)\\ndef triple(x):\\n    return 3.0 * x\\n"
    print(plan.tolist(), generated_module(text).triple(2.0), flush=True)

for line in sys.stdin:
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = os.fork()
        if child == 0:
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            try:
                start()
            except BaseException:
                sys.excepthook(*sys.exc_info())
                os._exit(1)
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        texts = [(file.seek(0), file.read().decode())[1] for file in (out, err)]
        print(json.dumps([code, *texts]), flush=True)
"""
ANSWER = "[1.0, 2.0, 3.0] 6.0\n"
POSIX = pytest.mark.skipif(os.name == "nt", reason="permissions are those of POSIX")


def truncated(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def garbage(file: Path) -> None:
    file.write_bytes(np.random.default_rng(1).bytes(file.stat().st_size))


def empty(file: Path) -> None:
    file.write_bytes(b"")


def forbidden(file: Path) -> None:
    file.chmod(0)


def a_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def a_full_folder(file: Path) -> None:
    a_folder(file)
    (file / "notes.txt").write_text("mine")


def changed_byte(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)


WAYS = [truncated, garbage, empty, forbidden, a_folder, a_full_folder, changed_byte]


@dataclass(frozen=True)
class Starts:
    """Starts of a program with one cache folder."""

    folder: Path
    process: subprocess.Popen[str]

    def another(self) -> tuple[int, str, str]:
        """Exit code, standard output and standard error."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print("start", file=self.process.stdin, flush=True)
        code, out, err = json.loads(self.process.stdout.readline())
        return code, out, err


@pytest.fixture(scope="module")
def starts() -> Iterator[Starts]:
    """A cache folder that one start has filled."""
    folder = Path(tempfile.mkdtemp(prefix="hystmpc-test-cache-"))  # not below tmp_path, which root keeps to itself
    folder.chmod(0o777)
    places = {"NUMBA_CACHE_DIR": str(folder / "numba"), "HYSTMPC_CACHE_DIR": str(folder / "generated")}
    command, pipe = [sys.executable, "-c", STARTS], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=os.environ | places) as process:
        starts = Starts(folder, process)
        try:
            assert starts.another() == (0, ANSWER, "")
            yield starts
        finally:
            process.stdin.close()  # type: ignore[union-attr]
            process.wait()
            shutil.rmtree(folder)


@POSIX
@pytest.mark.slow
@pytest.mark.parametrize("damage", [truncated, garbage, empty, forbidden, a_folder])
@pytest.mark.parametrize("first", [".nbi", ".nbc"])
def test_a_damaged_cache_does_not_stop_a_start(damage: Callable[[Path], None], first: str, starts: Starts) -> None:
    """The index of one kernel and the data of the other, then the other way round."""
    of_package, generated = (sorted(starts.folder.rglob(f"*.{name}-*.nb*")) for name in ("first_acting", "triple"))
    assert [path.suffix for path in of_package] == [path.suffix for path in generated] == [".nbc", ".nbi"], "whole"
    damage(next(path for path in of_package if path.suffix == first))
    damage(next(path for path in generated if path.suffix != first))
    code, out, err = starts.another()
    assert (code, out) == (0, ANSWER), err
    assert len(err.splitlines()) <= 1
    assert starts.another() == (0, ANSWER, "")


def small(folder: Path) -> ModuleType:
    """The kernel as a new process finds it."""
    file = folder / "small.py"
    if not file.exists():
        file.write_text(KERNEL)
    spec = importlib.util.spec_from_file_location("small", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kernel")


def files(folder: Path) -> dict[str, Path]:
    """Index and data of the kernel, whole."""
    shutil.rmtree(folder / "__pycache__", ignore_errors=True)
    assert small(folder).double(2.0) == 4.0
    found = {path.suffix: path for path in (folder / "__pycache__").glob("small.double*")}
    assert sorted(found) == [".nbc", ".nbi"]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", WAYS)
def test_damage_is_told_once_and_mended(
    damage: Callable[[Path], None], ending: str, folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    numba_._told.clear()
    damage(files(folder)[ending])
    with caplog.at_level(logging.WARNING):
        assert small(folder).double(3.0) == 6.0
        assert small(folder).double(4.0) == 8.0
    assert len(caplog.records) <= 1
    numba_._told.clear()
    mended = small(folder)
    assert mended.double(5.0) == 10.0
    if damage is not a_full_folder:  # which is not ours to remove
        assert mended.double.stats.cache_hits, "the kernel was kept again"


@pytest.mark.slow
@settings(max_examples=50)
@given(
    ending=st.sampled_from([".nbi", ".nbc"]), place=st.floats(0, 1), content=st.binary(max_size=40), cut=st.booleans()
)
def test_no_bytes_in_the_cache_make_a_kernel_fail_or_answer_wrong(
    ending: str, place: float, content: bytes, cut: bool, folder: Path
) -> None:
    """Bytes written over a file at any place, with or without what stood behind them."""
    file = files(folder)[ending]
    data = file.read_bytes()
    at = round(place * len(data))
    file.write_bytes(data[:at] + content + (b"" if cut else data[at + len(content) :]))
    assert small(folder).double(3.0) == 6.0


def test_without_a_folder_to_write_in_a_kernel_is_compiled_all_the_same(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def nowhere(function: object) -> None:
        raise RuntimeError(f"cannot cache function {function!r}: no locator available")

    numba_._told.clear()
    monkeypatch.setattr(numba_, "_Cache", nowhere)
    with caplog.at_level(logging.WARNING):
        assert njit(cache=True)(lambda x: 2.0 * x)(3.0) == 6.0
    assert ["at every start" in record.message for record in caplog.records] == [True]


@pytest.mark.parametrize("damage", [truncated, garbage, empty, a_folder, a_full_folder])
def test_a_damaged_generated_module_is_written_anew(
    damage: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HYSTMPC_CACHE_DIR", str(tmp_path))
    text = f"NAME = {damage.__name__!r}\n"
    name = generated_module(text).__name__
    damage(tmp_path / f"{name}.py")
    monkeypatch.delitem(sys.modules, name)
    assert damage.__name__ == generated_module(text).NAME


@pytest.mark.skipif(sys.platform == "win32", reason="modes are those of POSIX")
@pytest.mark.parametrize(
    ("mode", "umask", "trusted"),
    [
        (0o700, 0o022, True),
        (0o755, 0o077, True),
        (0o775, 0o002, True),
        (0o775, 0o022, False),
        (0o777, 0o022, False),
        (0o777, 0o002, False),
        (0o1777, 0o022, False),
        (0o702, 0o022, False),
        (0o777, 0o000, True),
    ],
)
def test_a_folder_that_others_may_write_in_holds_no_compiled_code(
    mode: int,
    umask: int,
    trusted: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    request: pytest.FixtureRequest,
) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)
    before = os.umask(umask)
    request.addfinalizer(lambda: os.umask(before))
    monkeypatch.setenv("HYSTMPC_CACHE_DIR", str(folder))
    assert (cache_folder() == folder) is trusted
    assert only_ours(cache_folder())
    assert only_ours(folder / "not there yet")
    numba_._told.clear()
    monkeypatch.setattr(numba_.FunctionCache, "__init__", lambda self, function: setattr(self, "_cache_path", folder))
    if not trusted:
        with caplog.at_level(logging.WARNING):
            assert njit(cache=True)(lambda x: 2.0 * x)(3.0) == 6.0
        assert ["others may write in it" in record.message for record in caplog.records] == [True]


def test_a_folder_of_another_user_holds_no_compiled_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("resource", reason="users are those of POSIX")
    found = tmp_path.stat()

    class Another:
        st_mode, st_uid, st_gid = found.st_mode, found.st_uid + 5, found.st_gid

    monkeypatch.setattr(Path, "stat", lambda self: Another)
    assert not only_ours(tmp_path)


def test_every_kernel_goes_through_the_checked_cache() -> None:
    rooms = ("trials", "models", "trajectories", "ctrl", "sim", "rig", "gap", "studies", "cli")
    texts = {path: path.read_text(encoding="utf-8") for room in rooms for path in (ROOT / room).rglob("*.py")}
    assert [str(path) for path, text in texts.items() if "from numba import njit" in text] == []


@pytest.mark.slow
def test_a_function_that_reads_several_modules_has_one_digest_in_every_process() -> None:
    """Names of a function are a set, whose order Python draws anew at every start."""
    code = (
        "from hystmpc.models.kernels.numba_ import source_digest; "
        "from hystmpc_lab.devices.kernels import bend; print(source_digest(bend))"
    )
    digests = [
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    ]
    assert len(set(digests)) == 1
