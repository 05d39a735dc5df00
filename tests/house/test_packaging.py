"""What pyproject.toml lists is what lies in the folders; an editable install would not notice."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from .source import LAB, ROOMS, ROOT, modules

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = sorted({module.path.parent for module in modules()})
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


@pytest.mark.parametrize("project", [ROOT, ROOT / LAB], ids=["hystmpc", "hystmpc-lab"])
def test_packages_listed_are_the_folders_with_code(project: Path) -> None:
    """Two distributions, which share no folder."""
    settings = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    (package,) = settings["package-dir"]
    of_lab = {folder for folder in FOLDERS if folder == ROOT / LAB or ROOT / LAB in folder.parents}
    folders = of_lab if project != ROOT else {*FOLDERS} - of_lab
    assert sorted(settings["packages"]) == sorted(".".join((package, *f.relative_to(project).parts)) for f in folders)


def test_the_laboratory_is_installed_with_the_product_for_development_only() -> None:
    """The product asks for it in an extra alone; its verbs reach the program by an entry point."""
    needed = PYPROJECT["project"]["dependencies"]
    assert [line for line in needed if line.startswith("hystmpc")] == []
    assert PYPROJECT["project"]["optional-dependencies"]["papers"] == ["hystmpc-lab"]
    laboratory = tomllib.loads((ROOT / LAB / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert laboratory["requires-python"] == PYPROJECT["project"]["requires-python"]
    assert laboratory["entry-points"]["hystmpc.verbs"] == {"lab": "hystmpc_lab.verbs:VERBS"}


def test_every_package_is_initialised_and_typed() -> None:
    missing = [folder / name for folder in FOLDERS for name in ("__init__.py", "py.typed")]
    assert [str(path.relative_to(ROOT)) for path in missing if not path.is_file()] == []


def test_the_tools_look_at_every_room() -> None:
    tool = PYPROJECT["tool"]
    front = [path.name for path in ROOT.glob("*.py") if path.name != "setup.py"]
    assert set(tool["pyright"]["include"]) == {*ROOMS, LAB, *front}
    assert set(tool["ruff"]["lint"]["flake8-tidy-imports"]["banned-api"]) == {*ROOMS, LAB}
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.findall(r"^ROOMS := (.*)$", makefile, re.MULTILINE) == [" ".join(ROOMS)]


def test_every_dependency_is_pinned() -> None:
    laboratory = tomllib.loads((ROOT / LAB / "pyproject.toml").read_text(encoding="utf-8"))
    projects = PYPROJECT["project"], laboratory["project"]
    wanted = [line for one in projects for line in sum(one["optional-dependencies"].values(), one["dependencies"])]
    names = {re.split(r"[\[<>=;~! ]", line)[0].lower() for line in wanted} - {"hystmpc", "hystmpc-lab"}
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line.partition("==") for line in lines if line and not line.startswith("#")]
    # Exact, no local version like +cpu; a beta where there is nothing else.
    assert [pin for pin in pins if not re.fullmatch(r"[0-9.]+(?:(?:a|b|rc)[0-9]+)?", pin[2])] == []
    assert names - {name for name, _, _ in pins} == set()


def test_the_citation_names_this_package_and_both_papers() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {key: cited[key] for key in ("title", "license")} == {
        "title": f"hystmpc: {_first_lower(PYPROJECT['project']['description'])}",
        "license": PYPROJECT["project"]["license"].partition(" AND ")[0],  # its own; that of bundled headers follows
    }
    sources = (ROOT / "docs" / "reference" / "sources.md").read_text(encoding="utf-8")
    papers = [paper.get("doi") or paper["url"] for paper in cited["references"]]
    assert len(papers) == 2
    assert [paper for paper in papers if paper not in sources] == []


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.stem)
def test_issue_forms_ask_for_something(form: Path) -> None:
    asked = yaml.safe_load(form.read_text(encoding="utf-8"))
    assert asked["name"]
    assert asked["description"]
    kinds = [part["type"] for part in asked["body"]]
    assert set(kinds) <= {"markdown", "textarea", "input"}
    assert any(part.get("validations", {}).get("required") for part in asked["body"])


def _first_lower(text: str) -> str:
    return text[0].lower() + text[1:]


@pytest.mark.slow
def test_the_suite_is_collected_in_the_other_import_mode_too() -> None:
    """It runs in `importlib`; equal file names in two folders break the other where a folder is no package."""
    assert "--import-mode=importlib" in PYPROJECT["tool"]["pytest"]["ini_options"]["addopts"]
    tests = ROOT / "tests"
    assert [file for file in tests.rglob("test_*.py") if not (file.parent / "__init__.py").exists()] == []
    alike = [tests / "house" / "test_docs.py", tests / "front" / "test_docs.py", tests / "trajectories"]
    command = [sys.executable, "-m", "pytest", "--collect-only", "-qq", "--import-mode=prepend", *map(str, alike)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
