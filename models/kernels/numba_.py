"""Compiled functions: numba's `njit`, and modules of generated text. Leaves with the last of its users."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numba


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function as `numba.njit` does; nothing is kept on disk, whatever `cache` says."""
    del cache
    compiled: Callable[[Callable[..., Any]], Any] = numba.njit(**options)
    return compiled


def generated_module(source: str) -> ModuleType:
    """Import `source`, in which `njit` is known, as a module of its own; the same text gives the same module."""
    name = f"hystmpc_kernel_{hashlib.sha256(source.encode()).hexdigest()[:24]}"
    if name not in sys.modules:
        module = ModuleType(name)
        module.__dict__["njit"] = njit
        exec(compile(source, name, "exec"), module.__dict__)
        sys.modules[name] = module
    return sys.modules[name]
