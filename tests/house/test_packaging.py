"""What pyproject.toml lists is what lies in the folders; an editable install would not notice."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib

import pytest

from .source import ROOMS, ROOT, modules

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = sorted({module.path.parent for module in modules()})


def test_packages_listed_are_the_folders_with_code() -> None:
    found = {".".join(("hystmpc", *folder.relative_to(ROOT).parts)) for folder in FOLDERS}
    listed = PYPROJECT["tool"]["setuptools"]["packages"]
    assert sorted(listed) == sorted(found)


def test_every_package_is_initialised_and_typed() -> None:
    missing = [folder / name for folder in FOLDERS for name in ("__init__.py", "py.typed")]
    assert [str(path.relative_to(ROOT)) for path in missing if not path.is_file()] == []


def test_the_tools_look_at_every_room() -> None:
    tool = PYPROJECT["tool"]
    front = [path.name for path in ROOT.glob("*.py")]
    assert set(tool["pyright"]["include"]) == {*ROOMS, *front}
    assert set(tool["ruff"]["lint"]["flake8-tidy-imports"]["banned-api"]) == set(ROOMS)
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.findall(r"^ROOMS := (.*)$", makefile, re.MULTILINE) == [" ".join(ROOMS)]


def test_every_dependency_is_pinned() -> None:
    project = PYPROJECT["project"]
    wanted = sum(project["optional-dependencies"].values(), project["dependencies"])
    names = {re.split(r"[\[<>=;~! ]", line)[0].lower() for line in wanted}
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line.partition("==") for line in lines if line and not line.startswith("#")]
    # Exact, no local version like +cpu; a beta where there is nothing else.
    assert [pin for pin in pins if not re.fullmatch(r"[0-9.]+(?:(?:a|b|rc)[0-9]+)?", pin[2])] == []
    assert names - {name for name, _, _ in pins} == set()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["importlib", "prepend"])
def test_the_suite_is_collected_in_both_import_modes(mode: str) -> None:
    """Equal file names in two folders, or a test that leans on sys.path, break one of them."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-qq", f"--import-mode={mode}", "tests"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
