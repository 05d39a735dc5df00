"""Whatever is public says what it does and which of the package's own errors it raises."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import pytest

from hystmpc.trials import errors

from .source import Function, Module, modules

ERRORS = {
    name for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, errors.HystmpcError)
}
CONSTRUCTORS = ("__init__", "__post_init__")


@dataclass(frozen=True)
class Definition:
    """A function, method or class with the class around it."""

    module: Module
    node: Function | ast.ClassDef
    owner: ast.ClassDef | None

    def __str__(self) -> str:
        name = f"{self.owner.name}.{self.node.name}" if self.owner else self.node.name
        return f"{self.module.where}:{self.node.lineno}: {name}"


def definitions(module: Module, body: list[ast.stmt], owner: ast.ClassDef | None = None) -> Iterator[Definition]:
    """Public names of a module and of its public classes, constructors included; no overloads and setters."""
    for node in body:
        if not isinstance(node, Function | ast.ClassDef):
            continue
        repeated = any(ast.unparse(d).endswith(("overload", ".setter")) for d in node.decorator_list)
        if repeated or (node.name.startswith("_") and node.name not in CONSTRUCTORS):
            continue
        yield Definition(module, node, owner)
        if isinstance(node, ast.ClassDef):
            yield from definitions(module, node.body, node)


@cache
def public() -> tuple[Definition, ...]:
    """Everything public of the package."""
    return tuple(definition for module in modules() for definition in definitions(module, module.tree.body))


@cache
def classes() -> dict[str, ast.ClassDef]:
    """The public classes by name; of the laboratory's only those whose name no class of the package has."""
    return {d.node.name: d.node for d in reversed(public()) if isinstance(d.node, ast.ClassDef)}


def docstring(definition: Definition) -> str:
    """Own docstring, else that of the method which it implements; for a constructor also that of its class."""
    node, owner = definition.node, definition.owner
    own = ast.get_docstring(node) or ""
    if owner is None or isinstance(node, ast.ClassDef):
        return own
    if node.name in CONSTRUCTORS:
        return own + (ast.get_docstring(owner) or "")
    return own or inherited(owner, node.name)


def inherited(owner: ast.ClassDef, method: str) -> str:
    """Docstring of `method` in the package's classes that `owner` is derived from."""
    for expression in owner.bases:
        base = classes().get(ast.unparse(expression).partition("[")[0].rpartition(".")[2])
        if base is None:
            continue
        for node in base.body:
            if isinstance(node, Function) and node.name == method and (text := ast.get_docstring(node)):
                return text
        if text := inherited(base, method):
            return text
    return ""


def raised(node: Function) -> set[str]:
    """The package's own errors that a function raises itself."""
    thrown = [n.exc for n in ast.walk(node) if isinstance(n, ast.Raise) and n.exc is not None]
    names = {ast.unparse(e.func if isinstance(e, ast.Call) else e).rpartition(".")[2] for e in thrown}
    return names & ERRORS


@pytest.mark.slow
def test_everything_public_has_a_docstring() -> None:
    assert [str(d) for d in public() if d.node.name not in CONSTRUCTORS and not docstring(d)] == []


@pytest.mark.slow
def test_errors_raised_are_documented() -> None:
    offenders = []
    for definition in public():
        if isinstance(definition.node, Function) and (thrown := raised(definition.node)):
            section = docstring(definition).partition("Raises:")[2]
            missing = sorted(name for name in thrown if name not in section)
            offenders += [f"{definition}: no `Raises: {', '.join(missing)}`"] if missing else []
    assert offenders == []
