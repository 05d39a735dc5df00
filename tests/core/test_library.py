"""The engine's library: of the C files beside it, or compiled again; arrays are looked at before C gets them."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest

from hystmpc.core import build, library
from hystmpc.core.library import EngineError, compiled, engine

HEADER = "HYSTMPC_API double answer(const double *x, int count);\n"
CODE = """#define HYSTMPC_API __attribute__((visibility("default")))
#include "answer.h"
HYSTMPC_API const char *hystmpc_digest(void);
const char *hystmpc_digest(void) {{ return HYSTMPC_DIGEST; }}
double answer(const double *x, int count) {{ return {factor} * x[count - 1]; }}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """C files of a small library of one level."""
    monkeypatch.setattr(build, "LEVELS", {"plain": ()})
    (tmp_path / "answer.h").write_text(HEADER, encoding="utf-8")
    (tmp_path / "answer.c").write_text(CODE.format(factor=2), encoding="utf-8")
    forget()
    return tmp_path


def forget() -> None:
    """As in a new process: what is known of the files is read again."""
    compiled.cache_clear()
    library._digest.cache_clear()


def test_a_changed_file_is_compiled_again(folder: Path) -> None:
    x = np.array([1.0, 3.0])
    assert compiled(folder).answer(x, 2) == 6.0
    made = (folder / build.file_name("plain")).stat()
    forget()
    assert compiled(folder).answer(x, 2) == 6.0
    assert (folder / build.file_name("plain")).stat().st_mtime_ns == made.st_mtime_ns  # the one that was there
    (folder / "answer.c").write_text(CODE.format(factor=5), encoding="utf-8")
    forget()
    compiled(folder)  # this process keeps the library that it has loaded; the next one loads the new file
    assert build.digest(folder).encode() in (folder / build.file_name("plain")).read_bytes()
    forget()


def test_a_stale_library_is_never_loaded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled(folder)
    (folder / "answer.c").write_text(CODE.format(factor=5), encoding="utf-8")
    monkeypatch.setattr(build, "compiler", lambda: None)
    forget()
    with pytest.raises(EngineError, match="got no C compiler, expected one of") as refused:
        compiled(folder)
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)
    forget()


def test_an_error_of_the_compiler_is_one_line(folder: Path) -> None:
    (folder / "answer.c").write_text("int broken(\n", encoding="utf-8")
    with pytest.raises(EngineError, match="error") as refused:
        compiled(folder)
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)
    forget()


@pytest.mark.parametrize(
    "array",
    [np.eye(3, dtype=np.float32), np.eye(3, dtype=int), np.eye(6)[:, ::2], np.eye(3).astype(">f8")],
    ids=["single", "whole numbers", "strided", "other byte order"],
)
def test_an_array_that_c_would_misread_is_refused(array: np.ndarray) -> None:
    with pytest.raises(Exception, match="expected contiguous float64"):
        engine().first_acting(array, 3)


def test_an_array_that_may_not_be_written_is_read() -> None:
    array = np.eye(3, k=-1)
    array.flags.writeable = False
    assert engine().first_acting(array, 3) == 1


def test_ctrl_c_while_an_argument_is_converted_is_no_error_of_the_argument() -> None:
    class Interrupted:
        @property
        def dtype(self) -> np.dtype[np.float64]:
            signal.raise_signal(signal.SIGINT)
            return np.dtype(float)

    with pytest.raises(KeyboardInterrupt):
        engine().first_acting(Interrupted(), 3)
