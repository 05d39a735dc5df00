"""A file ends where its idea ends, and a function does one thing: bounds beyond which that is hardly so."""

from __future__ import annotations

import ast

from .source import LAB, ROOMS, ROOT, Function, functions, modules

FILE_LINES = 600
FUNCTION_LINES = 60  # without the docstring


def length(node: Function) -> int:
    """Lines from `def` to the end, the docstring left out."""
    lines = (node.end_lineno or node.lineno) - node.lineno + 1
    first = node.body[0]
    if ast.get_docstring(node, clean=False) is not None:
        lines -= (first.end_lineno or first.lineno) - first.lineno + 1
    return lines


def test_files_are_short() -> None:
    files = [path for folder in (*ROOMS, LAB, "tests", "examples", "ros2") for path in (ROOT / folder).rglob("*.py")]
    sizes = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert {path: size for path, size in sizes.items() if size > FILE_LINES} == {}


def test_functions_are_short() -> None:
    sizes = {f"{m.where}: {node.name}": length(node) for m in modules() for node in functions(m.nodes)}
    assert {name: size for name, size in sizes.items() if size > FUNCTION_LINES} == {}


def test_a_docstring_does_not_count() -> None:
    tree = ast.parse('def f():\n    """One\n\n    two.\n    """\n    a = 1\n    return a\n')
    (node,) = functions(ast.walk(tree))
    assert length(node) == 3
