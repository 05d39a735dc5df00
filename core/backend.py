"""Build backend: that of setuptools, which also asks for a C compiler from a wheel where the system has none."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403

_compiler = runpy.run_path(str(Path(__file__).with_name("build.py")))["compiler"]


def _with_compiler(requirements: list[str]) -> list[str]:
    return requirements if _compiler() else [*requirements, "ziglang>=0.13"]


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Requirements of setuptools, and a compiler."""
    return _with_compiler(build_meta.get_requires_for_build_wheel(config_settings))


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """Requirements of setuptools, and a compiler."""
    return _with_compiler(build_meta.get_requires_for_build_editable(config_settings))
