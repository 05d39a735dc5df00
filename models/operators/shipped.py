"""The operators that ship: all that the modules of this package define."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

from .operator import Operator


@cache
def shipped_operators() -> Mapping[str, type[Operator]]:
    """Operators by name: the concrete subclasses of `Operator` in the modules of this package."""
    package, folder = __name__.rpartition(".")[0], str(Path(__file__).parent)
    modules = [importlib.import_module(f"{package}.{module.name}") for module in pkgutil.iter_modules([folder])]
    module = [kind for module in modules for kind in vars(module).values() if inspect.isclass(kind)]
    kinds = [kind for kind in module if issubclass(kind, Operator) and not inspect.isabstract(kind)]
    return MappingProxyType({kind.name: kind for kind in kinds})
