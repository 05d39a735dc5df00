"""The package with its engine compiled; everything else stands in pyproject.toml."""

import runpy
from pathlib import Path

_CORE = Path(__file__).resolve().parent / "core"
runpy.run_path(str(_CORE / "build.py"))["set_up"]("hystmpc", _CORE)
