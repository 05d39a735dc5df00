"""Every variable of the environment that the package reads or sets stands on one page."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib import import_module

from ..house.source import Module, modules
from .site_pages import DOCS

PAGE = DOCS / "reference" / "environment.md"
NAME = re.compile(r"[A-Z][A-Z0-9_]+")


def variables(module: Module) -> Iterator[str]:
    """Names in every statement of a module that asks or changes the environment; constants count as their value."""
    if not re.search(r"environ|getenv", module.path.read_text(encoding="utf-8")):
        return
    for node in module.nodes:
        if not isinstance(node, ast.stmt) or isinstance(node, ast.FunctionDef | ast.ClassDef | ast.With | ast.If):
            continue
        if "os.environ" in ast.unparse(node) or "getenv" in ast.unparse(node):
            yield from names(node, module)
    for node in module.nodes:
        if isinstance(node, ast.If) and "os.environ" in ast.unparse(node.test):
            yield from names(node.test, module)


def names(node: ast.AST, module: Module) -> Iterator[str]:
    for part in ast.walk(node):
        value: object = None
        if isinstance(part, ast.Constant):
            value = part.value
        elif isinstance(part, ast.Name) and NAME.fullmatch(part.id):
            value = getattr(import_module(module.name), part.id)
        for text in value if isinstance(value, tuple) else (value,):
            if isinstance(text, str) and NAME.fullmatch(text):
                yield text


def test_every_variable_is_documented_and_no_other() -> None:
    read = {name for module in modules() for name in variables(module)}
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    documented = {name for row in rows for name in re.findall(r"`([A-Z][A-Z0-9_]+)`", row.split("|")[1])}
    assert {"HYSTMPC_ALLOW_PYTHON", "CC"} <= read
    assert read == documented
