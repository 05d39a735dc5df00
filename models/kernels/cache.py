"""Generated kernel modules on disk, so that numba compiles each only once a machine."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import numba
import platformdirs

from hystmpc.trials.files import write_atomically


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
    return Path(tempfile.mkdtemp(prefix="hystmpc-kernels-"))


def generated_module(source: str) -> ModuleType:
    """Import `source` as a module of its own; the same text gives the same module.

    The file's name is the hash of the text: numba's own cache looks at the file only, so a changed text must be a
    changed file.
    """
    digest = hashlib.sha256(f"{numba.__version__}\n{source}".encode()).hexdigest()[:24]
    name = f"hystmpc_kernel_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    path = cache_folder() / f"{name}.py"
    if not path.exists() or path.read_text(encoding="utf-8") != source:
        write_atomically(path, source)
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path}: cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[name] = module
    return module
