"""No module imports itself through others, and the steps of the diagnosis import one way."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .source import ROOT, modules

GAP_STEPS = ("logs", "residual", "decide", "next", "report", "diagnose", "self_test")


def circles(root: Path) -> list[tuple[str, ...]]:
    """Strongly connected modules, imports inside functions and for type checkers included."""
    found = modules(root)
    names = [module.name for module in found]
    number = {name: k for k, name in enumerate(names)}
    edges = set()
    for k, module in enumerate(found):
        for _, name in module.imports():
            imported = number.get(name, number.get(name.rpartition(".")[0], k))
            edges |= {(k, imported)} if imported != k else set()
    rows, columns = np.array(sorted(edges), dtype=np.intp).reshape(-1, 2).T
    graph = coo_array((np.ones(rows.size), (rows, columns)), shape=(len(names), len(names)))
    labels = connected_components(graph, connection="strong")[1].tolist()
    groups = [tuple(sorted(n for n, own in zip(names, labels, strict=True) if own == k)) for k in set(labels)]
    return sorted(group for group in groups if len(group) > 1)


def backward_steps(root: Path) -> Iterator[str]:
    """Imports of a later step of the diagnosis by an earlier one."""
    for module in modules(root):
        for line, name in module.imports():
            if module.name.startswith("hystmpc.gap.") and name.startswith("hystmpc.gap."):
                own, other = module.name.split(".")[2], name.split(".")[2]
                if own in GAP_STEPS and other in GAP_STEPS and GAP_STEPS.index(other) > GAP_STEPS.index(own):
                    yield f"{module.where}:{line}: {own} imports {name}"


def test_no_module_imports_itself_through_others() -> None:
    assert circles(ROOT) == []


def test_the_steps_of_the_diagnosis_import_one_way() -> None:
    assert list(backward_steps(ROOT)) == []


@pytest.mark.parametrize(
    ("texts", "count"),
    [
        ({"a": "from .b import x", "b": "from .c import x", "c": "def f():\n    from .a import y"}, 1),
        ({"a": "from .b import x", "b": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from . import a"}, 1),
        ({"a": "from .b import x\nfrom .c import x", "b": "from .c import x", "c": ""}, 0),
    ],
)
def test_the_check_of_circles_itself(tmp_path: Path, texts: dict[str, str], count: int) -> None:
    (tmp_path / "trials").mkdir()
    for name, text in texts.items():
        (tmp_path / "trials" / f"{name}.py").write_text(text)
    assert len(circles(tmp_path)) == count


def test_the_check_of_steps_itself(tmp_path: Path) -> None:
    for folder in ("logs", "decide"):
        (tmp_path / "gap" / folder).mkdir(parents=True)
    (tmp_path / "gap/logs/a.py").write_text("from ..decide.b import x")
    (tmp_path / "gap/decide/b.py").write_text("from ..logs import a")
    assert len(list(backward_steps(tmp_path))) == 1


@pytest.mark.slow
def test_a_diagnosis_opens_the_report_only_when_it_is_asked_for() -> None:
    code = (
        "import sys, hystmpc.gap.diagnose\n"
        "found = [name for name in sys.modules if name == 'matplotlib' or name.startswith('hystmpc.gap.report')]\n"
        "sys.exit(' '.join(found))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""
