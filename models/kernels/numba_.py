"""Compiled functions: numba's `njit` with a checked cache that is keyed by content, and generated modules."""

from __future__ import annotations

import glob
import hashlib
import logging
import os
import pickle
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, final

import llvmlite  # type: ignore[import-untyped]
import numba
import numpy as np
import platformdirs
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

from hystmpc.trials.files import write_atomically

from .compiling import PROCESS

_logger = logging.getLogger(__name__)
_told: list[str] = []  # the line that this process has logged, if any


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as `numba.njit` does; a damaged cache costs time and one line of warning, never the start.

    Args:
        cache: keep the compiled code on disk; where numba finds no folder that it may write in, it is not kept.
        options: of `numba.njit`.
    """

    def compiled(function: Any) -> Any:
        dispatcher: Any = numba.njit(**options)(function)
        function.file_hash = _file_hash(function)  # now: the file may change before the function is compiled
        stored = False
        if cache:
            try:
                dispatcher._cache = _Cache(function)  # numba's `enable_caching` sets the same, with its own class
                stored = dispatcher._cache.stored
            except (OSError, RuntimeError) as error:
                _tell(f"compiled code is not kept, it is compiled at every start ({_cause(error)})")
        PROCESS.defined(*_told_as(function), stored)
        return dispatcher

    return compiled


def _told_as(function: Any) -> tuple[int, str, int]:
    """What is told of a function: who it is, its file and the size of its byte code."""
    return id(function), function.__code__.co_filename, len(function.__code__.co_code)


@final
class _Listener(event.Listener):
    """Tells what numba compiles, its own functions included; what it finds on disk is told by `_Cache`."""

    def on_start(self, event: Any) -> None:
        """A function is going to be compiled."""
        PROCESS.begins(*_told_as(event.data["dispatcher"].py_func))

    def on_end(self, event: Any) -> None:
        """It is compiled, or could not be."""
        del event
        PROCESS.ends()


event.register("numba:compile", _Listener())


class _File(IndexDataCacheFile):
    """Index and data files of one function; the data carry the digest of their source and a check sum.

    Changed machine code would run, and another process may write the files of another source at any time.
    """

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        super()._save_data(name, (self._source_stamp, hashlib.sha256(content).digest(), content))

    def _load_data(self, name: str) -> Any:
        source, digest, content = super()._load_data(name)
        if source != self._source_stamp:
            raise FileNotFoundError(name)  # numba takes it for a file that was removed
        if hashlib.sha256(content).digest() != digest:
            raise ValueError(f"{name}: check sum differs")
        return pickle.loads(content)


@final
class _Cache(FunctionCache):
    """The cache of one function on disk, keyed by content; what cannot be read or written is removed."""

    _cache_file: Any

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        if not only_ours(Path(self._cache_path)):
            raise RuntimeError(f"{self._cache_path}: others may write in it")
        self._base = self._impl.filename_base
        del self._cache_file  # made at the first use, when all that the function calls is defined

    def __getattr__(self, name: str) -> Any:
        if name != "_cache_file":
            raise AttributeError(name)
        self._cache_file = _File(self._cache_path, self._base, source_digest(self._py_func))
        return self._cache_file

    @property
    def stored(self) -> bool:
        """Whether compiled code of the function was written after the function's file."""
        with suppress(OSError):
            written = (Path(self._cache_path) / f"{self._base}.nbi").stat().st_mtime
            return written >= Path(self._py_func.__code__.co_filename).stat().st_mtime
        return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for a signature; None where there is none, or none that can be used."""
        try:
            found = super().load_overload(sig, target_context)
            if found is not None:
                PROCESS.loaded(*_told_as(self._py_func))
            return found
        except Exception as error:  # noqa: BLE001  # damaged bytes raise whatever they happen to spell
            self._remove()
            _tell(f"{self._cache_path}: compiled code is damaged and is compiled anew ({_cause(error)})")
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep compiled code for the next start; where that fails twice it is not kept."""
        try:
            super().save_overload(sig, data)
        except Exception:  # noqa: BLE001  # the code is there and runs: nothing in the way of keeping it may stop that
            self._remove()
        else:
            return
        try:
            super().save_overload(sig, data)
        except Exception as error:  # noqa: BLE001
            _tell(f"{self._cache_path}: compiled code is not kept, it is compiled at every start ({_cause(error)})")

    def _remove(self) -> None:
        """Remove the function's files, and empty folders in their place; another process then compiles anew too."""
        for path in Path(self._cache_path).glob(f"{glob.escape(self._base)}.*"):
            with suppress(OSError):
                path.rmdir() if path.is_dir() else path.unlink()


def source_digest(function: Callable[..., Any]) -> str:
    """Digest of what the machine code of `function` is made from.

    The file of the function, the numbers that it reads, the functions that it calls, and theirs in turn; numba itself
    looks at the time and size of the function's own file alone. Its version and the processor are in its own key.
    """
    found, seen = hashlib.sha256(llvmlite.__version__.encode()), set()
    waiting: list[Any] = [function]
    while waiting:
        value = waiting.pop()
        if id(value) not in seen:
            seen.add(id(value))
            content, further = _content(getattr(value, "py_func", value))  # the function behind a compiled one
            found.update(content)
            waiting += further
    return found.hexdigest()


def _content(value: Any) -> tuple[bytes, list[Any]]:
    """What stands for a function or a global of one, and the values that it reads in turn."""
    if isinstance(value, FunctionType):
        names, scopes = _names(value.__code__), [value.__globals__]
        modules = [
            part for part in (value.__globals__.get(name) for name in sorted(names)) if isinstance(part, ModuleType)
        ]
        scopes += [vars(module) for module in modules if module.__name__.startswith("hystmpc")]
        read = [scope[name] for scope in scopes for name in sorted(names & scope.keys())]
        return getattr(value, "file_hash", None) or _file_hash(value), read
    if isinstance(value, tuple):
        return b"", list(value)
    if isinstance(value, np.ndarray):
        return value.tobytes(), []
    if isinstance(value, bool | int | float | complex | str | np.generic):
        return repr(value).encode(), []
    return getattr(value, "__name__", type(value).__name__).encode(), []


def _names(code: CodeType) -> set[str]:
    """Names that a function reads from its module, those inside its comprehensions included."""
    return set(code.co_names).union(*(_names(part) for part in code.co_consts if isinstance(part, CodeType)))


def _file_hash(function: Any) -> bytes:
    """Hash of the file of a function; of its byte code where there is no file."""
    code = function.__code__
    try:
        return hashlib.sha256(Path(code.co_filename).read_bytes()).digest()
    except OSError:
        return hashlib.sha256(code.co_code).digest()


def _tell(text: str) -> None:
    """Log a line, the first of a process only: a damaged folder holds hundreds of files."""
    if not _told:
        _told.append(text)
        _logger.warning("%s", text)


def _cause(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


_HEADER = "from hystmpc.models.kernels.numba_ import njit\n\n\n"


def cache_folder() -> Path:
    """Folder of generated kernels: HYSTMPC_CACHE_DIR, else the user's cache; a new one where others may write in it."""
    chosen = os.environ.get("HYSTMPC_CACHE_DIR")
    folder = Path(chosen) if chosen else Path(platformdirs.user_cache_dir("hystmpc")) / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK) and only_ours(folder):
            return folder
    except OSError:
        pass
    return _temporary()


def only_ours(folder: Path) -> bool:
    """Whether nobody but the administrator and this user writes in a folder, and whom this user's umask lets write.

    Compiled code is loaded from where it lies: who can write there decides what runs. A folder that is not there yet
    will be made by this user.
    """
    if sys.platform == "win32":
        return True  # the user's folders are the user's own there; a mode says nothing
    try:
        found = folder.stat()
    except FileNotFoundError:
        return True
    umask = os.umask(0o077)
    os.umask(umask)
    return found.st_uid in (os.getuid(), 0) and not found.st_mode & umask & (stat.S_IWGRP | stat.S_IWOTH)


def generated_module(source: str) -> ModuleType:
    """Import `source`, in which `njit` is known, as a module of its own; the same text gives the same module.

    The file's name is the hash of the text: numba's own cache looks at the file only, so a changed text must be a
    changed file. Python's byte code of it is not kept: a damaged file of that would end the program.
    """
    text = _HEADER + source
    digest = hashlib.sha256(f"{numba.__version__}\n{text}".encode()).hexdigest()[:24]
    name = f"hystmpc_kernel_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    path = _written(cache_folder() / f"{name}.py", text)
    module = ModuleType(name)
    module.__file__ = str(path)
    exec(compile(text, str(path), "exec"), module.__dict__)
    sys.modules[name] = module
    return module


def _written(path: Path, text: str) -> Path:
    """The file with this text, in a temporary folder where it cannot be written."""
    with suppress(OSError, UnicodeDecodeError):
        if path.read_text(encoding="utf-8") == text:
            return path
    with suppress(OSError):
        path.rmdir()  # an empty folder in the file's place
    try:
        return write_atomically(path, text)
    except OSError:
        return write_atomically(_temporary() / path.name, text)


@cache
def _temporary() -> Path:
    return Path(tempfile.mkdtemp(prefix="hystmpc-kernels-"))
