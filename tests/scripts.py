"""Programs beside the package, as modules: `lab/benchmarks/` is no package, and its files import one another."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

from .conftest import ROOT

FOLDER = ROOT / "lab" / "benchmarks"


def script(name: str) -> ModuleType:
    """The module `lab/benchmarks/NAME.py`; the same one for everybody."""
    if name in sys.modules:
        return sys.modules[name]
    specification = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    if str(FOLDER) not in sys.path:
        sys.path.append(str(FOLDER))
    specification.loader.exec_module(module)
    return module
