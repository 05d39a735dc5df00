"""The package's source as syntax trees: what the rules of the house are checked on."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# A room imports itself and the tiers before its own; rooms of one tier do not know each other. The front door, the
# files at the root, counts as one.
TIERS = (
    ("core",),
    ("trials",),
    ("models",),
    ("trajectories",),
    ("ctrl",),
    ("codegen",),
    ("sim", "rig"),
    ("gap", "testing"),
    ("bench",),
    ("tasks",),
    ("front",),
    ("cli",),
    ("lab",),
)
LAB = "lab"
"""Folder of a distribution of its own, the package `hystmpc_lab`, which knows every room and which no room knows."""
ROOMS = tuple(room for tier in TIERS for room in tier if room not in ("front", LAB))
SCRIPTS = ROOT / LAB / "benchmarks"
"""Programs that are no modules."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """One file of one room under `root`."""

    root: Path
    path: Path

    @property
    def where(self) -> str:
        """The file as messages name it."""
        return self.path.relative_to(self.root).as_posix()

    @property
    def name(self) -> str:
        """Dotted name, `hystmpc.models.train` for models/train/__init__.py."""
        parts = self.path.relative_to(self.root).with_suffix("").parts
        package, parts = ("hystmpc_lab", parts[1:]) if parts[0] == LAB else ("hystmpc", parts)
        return ".".join((package, *(p for p in parts if p != "__init__")))

    @property
    def room(self) -> str:
        """Folder at the root that holds the file, `front` for a file at the root itself."""
        parts = self.path.relative_to(self.root).parts
        return parts[0] if len(parts) > 1 else "front"

    @cached_property
    def tree(self) -> ast.Module:
        """The file, parsed."""
        return ast.parse(self.path.read_text(encoding="utf-8"), str(self.path))

    @cached_property
    def nodes(self) -> tuple[ast.AST, ...]:
        """All of the tree, in no special order."""
        return tuple(ast.walk(self.tree))

    def imports(self) -> Iterator[tuple[int, str]]:
        """Line and absolute dotted name of every import, those inside functions included."""
        package = self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]
        for node in self.nodes:
            if isinstance(node, ast.Import):
                yield from ((node.lineno, alias.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
                yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)


def modules(root: Path = ROOT) -> tuple[Module, ...]:
    """Every module of the front door, of every room and of the laboratory."""
    return _parsed_once(root)


@lru_cache
def _parsed_once(root: Path) -> tuple[Module, ...]:
    rooms = [path for room in (*ROOMS, LAB) for path in sorted((root / room).rglob("*.py"))]
    builds = (root / "setup.py", root / LAB / "setup.py")  # no part of a package
    found = [path for path in (*sorted(root.glob("*.py")), *rooms) if path not in builds]
    return tuple(Module(root, path) for path in found if SCRIPTS not in path.parents)


def functions(nodes: Iterable[ast.AST]) -> Iterator[Function]:
    """Every function and method among the nodes, nested and private ones included."""
    return (node for node in nodes if isinstance(node, Function))
