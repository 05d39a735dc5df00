"""A release: one version everywhere, from the tags; a recipe that follows pyproject.toml; equal bytes; the matrix."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from ..scripts import script
from .source import ROOT

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
RECIPE = yaml.safe_load((ROOT / "conda" / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
OF_CONDA = {"matplotlib": "matplotlib-base"}  # the same package without a window toolkit
dist, matrix = script("dist"), script("matrix")


def written_version() -> str:
    """The version that stands in pyproject.toml for what has no tag, without its `.dev0`."""
    return PYPROJECT["tool"]["setuptools_scm"]["fallback_version"].removesuffix(".dev0")


def specified(line: str) -> tuple[str, str]:
    """Name and bound of a requirement, spaces left out."""
    name, bound = re.fullmatch(r"([\w-]+)\s*(.*)", line).groups()  # type: ignore[union-attr]
    return OF_CONDA.get(name, name), bound


def test_one_version_stands_everywhere() -> None:
    newest = re.search(r"^## \[(.*?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert newest is not None
    assert {newest[1], cited["version"], RECIPE["context"]["version"]} == {written_version()}


def test_the_recipe_asks_for_what_pyproject_asks_for() -> None:
    project, needs = PYPROJECT["project"], RECIPE["requirements"]
    python = ("python", project["requires-python"])
    assert sorted(map(specified, needs["run"])) == sorted([python, *map(specified, project["dependencies"])])
    built_with = map(specified, PYPROJECT["build-system"]["requires"])
    assert sorted(map(specified, needs["host"])) == sorted([python, ("pip", ""), *built_with])
    (entry,) = RECIPE["build"]["python"]["entry_points"]
    assert dict([entry.split(" = ")]) == project["scripts"]
    assert RECIPE["about"]["summary"] == project["description"]
    assert RECIPE["about"]["license"] == project["license"]


def said_by_git(folder: Path, *command: str) -> str:
    """What a command prints in a folder, whatever the user's own git is set to."""
    author = {f"GIT_{who}_{what}": "a@b.c" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    settings = {**os.environ, **author, "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CEILING_DIRECTORIES": str(folder.parent)}
    done = subprocess.run(command, cwd=folder, env=settings, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def version_of(folder: Path) -> str:
    """The version that a build in this folder gets."""
    return said_by_git(folder, sys.executable, "-m", "setuptools_scm")


def archive(repository: Path, folder: Path) -> Path:
    """The tree of the last commit without its history, as a download of it."""
    folder.mkdir()
    packed = repository.parent / f"{folder.name}.tar"
    said_by_git(repository, "git", "archive", "--output", str(packed), "HEAD")
    with tarfile.open(packed) as tar:
        tar.extractall(folder, filter="data")
    return folder


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_the_version_is_the_tags_with_and_without_a_history(tmp_path: Path) -> None:
    repository = tmp_path / "repository"
    repository.mkdir()
    for name in ("pyproject.toml", ".git_archival.txt", ".gitattributes"):
        shutil.copy(ROOT / name, repository / name)
    assert version_of(repository) == f"{written_version()}.dev0"  # a folder without git
    for command in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "-m", "all"]):
        said_by_git(repository, "git", *command)
    commit = said_by_git(repository, "git", "rev-parse", "--short", "HEAD")
    untagged = re.fullmatch(r"(.*)\.dev1\+g(\w+)", version_of(repository))
    assert untagged is not None
    assert untagged[1] == written_version()
    assert untagged[2].startswith(commit)
    assert version_of(archive(repository, tmp_path / "untagged")) == f"{written_version()}.dev0"
    said_by_git(repository, "git", "tag", "v7.8.9")
    assert version_of(repository) == "7.8.9"
    assert version_of(archive(repository, tmp_path / "tagged")) == "7.8.9"


@given(st.permutations(["p", "p/a.py", "p/b.py"]), st.integers(0, 2**31), st.sampled_from([0o022, 0o077]))
def test_an_sdist_packed_again_depends_on_its_files_alone(order: list[str], time: int, mask: int) -> None:
    def packed(names: list[str], time: int, mask: int) -> bytes:
        stream = io.BytesIO()
        with tarfile.open(fileobj=stream, mode="w:gz") as tar:
            for name in names:
                member = tarfile.TarInfo(name)
                member.mtime, member.uname, member.uid = time, f"user{time}", time % 1000
                member.type = tarfile.REGTYPE if "." in name else tarfile.DIRTYPE
                member.mode = (0o666 if "." in name else 0o777) & ~mask
                member.size = len(name) if "." in name else 0
                tar.addfile(member, io.BytesIO(name.encode()))
        return stream.getvalue()

    made = dist.repacked(packed(order, time, mask), 1_700_000_000)
    assert made == dist.repacked(packed(sorted(order), 0, 0o022), 1_700_000_000)
    with tarfile.open(fileobj=io.BytesIO(made)) as tar:
        assert tar.extractfile("p/a.py").read() == b"p/a.py"  # type: ignore[union-attr]
        assert tar.getmember("p/a.py").mtime == 1_700_000_000
    assert made != dist.repacked(packed(order[:-1], time, mask), 1_700_000_000)


@pytest.mark.parametrize(
    ("offered", "taken"),
    [
        ("numpy==2.0.0\ntorch==2.13.0+cpu\n", "torch==2.13.0+cpu"),
        ("nvidia-cublas==13.1\ntorch==2.13.0\n", matrix.NO_TORCH),
        ("torch==2.13.0\ntriton==3.5\n", matrix.NO_TORCH),
    ],
)
def test_both_sets_have_the_torch_for_processors_or_none(
    monkeypatch: pytest.MonkeyPatch, offered: str, taken: str
) -> None:
    asked = []

    def requirements(python: str, resolution: str, override: str) -> str:
        asked.append((resolution, override))
        return offered

    monkeypatch.setattr(matrix, "requirements", requirements)
    matrix.resolved("python3", "lowest-direct")
    pin = re.search(r"^torch==.*$", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
    assert pin is not None
    assert asked == [("highest", pin[0]), ("lowest-direct", taken)]


JUNIT = """<testsuites><testsuite tests="9" failures="{failures}" errors="{errors}" skipped="2" time="61.4"
timestamp="2026-11-23T18:00:00"><testcase classname="a" name="b"><failure/></testcase></testsuite></testsuites>"""


@pytest.mark.parametrize(
    ("failures", "errors", "green", "text"),
    [
        (0, 0, True, "7 passed, 0 failed, 2 skipped, 61 s"),
        (1, 0, False, "6 passed, 1 failed"),
        (0, 7, False, "0 passed"),
    ],
)
def test_a_cell_of_the_matrix_says_what_its_tests_said(
    tmp_path: Path, failures: int, errors: int, green: bool, text: str
) -> None:
    assert matrix.outcome(tmp_path) is None
    (tmp_path / "junit.xml").write_text(JUNIT.format(failures=failures, errors=errors))
    (tmp_path / "requirements.txt").write_text("torch==2.13.0+cpu\n")
    found = matrix.outcome(tmp_path)
    assert found.green is green
    assert str(found).startswith(text)
    (tmp_path / "requirements.txt").write_text("numpy==2.0.0\n")
    assert "no torch" in str(matrix.outcome(tmp_path))
    assert list(matrix.failures(tmp_path)) == ["a::b"]


def test_the_matrix_has_the_interpreters_that_are_promised(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    versions = matrix.versions_supported()
    assert f">={versions[0]}" == PYPROJECT["project"]["requires-python"]
    own = "{}.{}".format(*sys.version_info[:2])
    assert own not in versions or matrix.interpreter(own) is not None
    assert matrix.interpreter("3.99") is None
    monkeypatch.setattr(matrix, "FOLDER", tmp_path)
    rows = [
        [cell.strip() for cell in row.split("|")[1:-1]] for row in matrix.table(versions, versions[1:]).splitlines()
    ]
    assert rows[0] == ["Python", *matrix.SETS, "of"]
    absent = "no such interpreter here"
    assert rows[2:] == [[versions[0], "not run", "not run", ""], *([v, absent, absent, ""] for v in versions[1:])]
