"""Imports run one way through the rooms, and torch stays where its extra is expected."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from .source import LAB, ROOMS, ROOT, TIERS, Module, modules

TIER = {room: number for number, tier in enumerate(TIERS) for room in tier}
# What may be such an import, in one line or in several: only these files are parsed.
OF_A_ROOM = re.compile(rf"\bfrom\s+(?:{'|'.join(ROOMS)})\b|\bimport\b(?:[^\n]|\\\n)*?(?<![.\w])(?:{'|'.join(ROOMS)})\b")


def wrong_way(root: Path) -> Iterator[str]:
    """Imports of a room that does not lie in an earlier tier."""
    for module in modules(root):
        for line, name in module.imports():
            package, _, rest = name.partition(".")
            room = LAB if package == "hystmpc_lab" else rest.partition(".")[0]
            room = room if room in TIER else "front"  # what `import hystmpc` offers
            if package in ("hystmpc", "hystmpc_lab") and room != module.room and TIER[room] >= TIER[module.room]:
                yield f"{module.where}:{line}: {module.room} imports {name}"


def may_need_torch(module: Module) -> bool:
    """Training, the definitions of networks, and the benchmark's rival that runs on torch."""
    networks = module.name.startswith(("hystmpc.models.networks.", "hystmpc_lab.rivals.", "hystmpc_lab.performance."))
    return (networks and module.name.endswith("_")) or module.name.startswith("hystmpc.models.train.")


def test_imports_run_one_way() -> None:
    assert list(wrong_way(ROOT)) == []


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("trials/a.py", "import hystmpc.models.model", 1),
        ("trajectories/a.py", "def f():\n    from hystmpc.ctrl.loop import g", 1),
        ("rig/a.py", "from hystmpc import sim", 1),
        ("models/train/a.py", "from ...ctrl import limits", 1),
        ("gap/__init__.py", "from ..cli import main", 1),
        ("gap/a.py", "from hystmpc import fit", 1),
        ("__init__.py", "from hystmpc.cli import main", 1),
        ("cli/a.py", "from hystmpc_lab import blind", 1),
        ("lab/blind/a.py", "from hystmpc.gap import diagnose\nfrom hystmpc_lab.x import y", 0),
        ("__init__.py", "from hystmpc.tasks.fit import fit", 0),
        ("cli/a.py", "from hystmpc.tasks.fit import fit", 0),
        ("sim/a.py", "from hystmpc.ctrl import limits\nimport numpy", 0),
        ("models/train/a.py", "from ..model import Model\nfrom . import starts", 0),
        ("cli/a.py", "from hystmpc import gap, rig, trials", 0),
    ],
)
def test_the_check_itself(tmp_path: Path, file: str, text: str, expected: int) -> None:
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text(text)
    assert len(list(wrong_way(tmp_path))) == expected


def test_a_room_imports_itself_relatively() -> None:
    """One spelling; by the other a type checker takes a class for two. Templates are compiled outside any package."""
    offenders = [
        f"{module.where}:{node.lineno}"
        for module in modules()
        if not module.where.endswith("_loops.py")
        for node in module.nodes
        if isinstance(node, ast.ImportFrom) and node.level == 0
        if f"{node.module}.".startswith("hystmpc_lab." if module.room == LAB else f"hystmpc.{module.room}.")
    ]
    assert offenders == []


@pytest.mark.slow
def test_no_room_is_imported_as_a_top_level_package() -> None:
    """It would work in a checkout and fail for everybody who has installed a wheel."""
    files = [path for folder in (*ROOMS, LAB, "tests", "examples") for path in (ROOT / folder).rglob("*.py")]
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    offenders = []
    for path in (path for path, text in texts.items() if OF_A_ROOM.search(text)):
        for node in ast.walk(ast.parse(texts[path])):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            offenders += [f"{path.relative_to(ROOT)}: {name}" for name in names if name.partition(".")[0] in ROOMS]
    assert offenders == []


def test_torch_is_imported_by_training_only() -> None:
    offenders = [
        f"{module.where}:{line}: {name}"
        for module in modules()
        if not may_need_torch(module)
        for line, name in module.imports()
        if name.partition(".")[0] == "torch"
    ]
    assert offenders == []


@pytest.mark.slow
def test_a_bench_starts_without_what_takes_a_second_to_import() -> None:
    """Device, run, recording and its process; a report is written after the run, and a fit takes what it needs."""
    names = ("bench.device", "rig.device", "rig.run", "rig.experiment.experiment", "rig.recording.recorder_process")
    code = "import sys, " + ", ".join(f"hystmpc.{name}" for name in names)
    code += "\nsys.exit(' '.join(name for name in sys.argv[1:] if name in sys.modules))"
    slow = ("scipy.signal", "scipy.optimize", "scipy.stats", "matplotlib", "torch")
    done = subprocess.run([sys.executable, "-c", code, *slow], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""


@pytest.mark.slow
def test_importing_the_package_does_not_load_torch() -> None:
    names = [module.name for module in modules() if not may_need_torch(module)]
    code = (
        "import importlib, sys\n"
        "for name in sys.argv[1:]:\n"
        "    importlib.import_module(name)\n"
        "    if 'torch' in sys.modules: sys.exit(f'{name} loads torch')\n"
    )
    done = subprocess.run([sys.executable, "-c", code, *names], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
