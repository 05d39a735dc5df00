"""Generated kernel modules on disk, so that numba compiles each only once a machine."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType

import numba
import platformdirs

from hystmpc.trials.files import write_atomically

_HEADER = "from hystmpc.models.kernels.numba_ import njit\n\n\n"


def cache_folder() -> Path:
    """Folder of generated kernels: HYSTMPC_CACHE_DIR, else the user's cache, else a temporary folder."""
    chosen = os.environ.get("HYSTMPC_CACHE_DIR")
    folder = Path(chosen) if chosen else Path(platformdirs.user_cache_dir("hystmpc")) / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    return _temporary()


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
