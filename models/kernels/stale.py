"""Compiled code on disk that is older than what it was compiled from."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Iterator
from pathlib import Path

PACKAGE = "hystmpc"
ROOT = Path(__file__).resolve().parents[2]


def drop_stale_kernels(root: Path = ROOT) -> list[Path]:
    """Delete what numba has cached beside the package's files and would use although an imported file has changed.

    The key of numba's cache is the time and size of a function's own file: a kernel that calls another file's kernel,
    or reads its constants, would go on with the old one for ever. Here it goes if one of those files, directly or
    through others, is younger. numba compiles anew what its index names and the disk lacks. Generated modules need
    none of this: their names are hashes.

    Args:
        root: Folder of the rooms, `hystmpc` itself.

    Returns:
        The files that are gone.
    """
    changed: dict[Path, float] = {}
    dropped = []
    for compiled in _compiled(root):
        source = compiled.parent.parent / f"{compiled.name.partition('.')[0]}.py"
        if source not in changed:
            times = (file.stat().st_mtime for file in _compiled_in(root, source))
            changed[source] = max(times, default=float("inf"))
        try:
            if compiled.stat().st_mtime < changed[source]:
                compiled.unlink()
                dropped.append(compiled)
        except OSError:  # another process was faster, or the folder is not ours to write in
            continue
    return dropped


def _compiled(root: Path) -> Iterator[Path]:
    for room in sorted(init.parent for init in root.glob("*/__init__.py")):
        yield from sorted(room.rglob("__pycache__/*.nbc"))


def _compiled_in(root: Path, source: Path) -> set[Path]:
    """The file and those whose kernels or constants end up in its machine code; nothing if it is gone."""
    found: set[Path] = set()
    waiting = {source} if source.exists() else set()
    while waiting:
        file = waiting.pop()
        found.add(file)
        waiting |= {imported for imported in _imports(root, file) if imported not in found}
    return found


def _imports(root: Path, file: Path) -> Iterator[Path]:
    """Files of the package from which a file takes a constant, or anything if they use numba too."""
    package = ".".join((PACKAGE, *file.relative_to(root).parent.parts))
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom):
            continue
        base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
        for alias in node.names:
            for name in (base, f"{base}.{alias.name}"):
                path = root.joinpath(*name.split(".")[1:]).with_suffix(".py")
                if name.startswith(f"{PACKAGE}.") and path.is_file() and (alias.name.isupper() or _uses_numba(path)):
                    yield path


def _uses_numba(file: Path) -> bool:
    return "numba" in file.read_text(encoding="utf-8")
