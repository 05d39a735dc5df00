"""Fast tests for each interpreter and dependency set, with one table of passed, failed and seconds.

    python lab/benchmarks/matrix.py [--python 3.11 3.12] [--set lowest] [--keep] [--table]

`pinned` has the versions of constraints.txt, `lowest` the lowest that pyproject.toml allows for every dependency that
it names (uv's `lowest-direct`). A cell is resolved, installed into its own venv and tested; the venv is then removed.
`--table` only prints the table of the last runs. torch is that of constraints.txt in both sets. It is left out
where only a build for GPUs is offered, of several GB. Wheels only. Exit code 1 if the tests of a cell failed.
"""

from __future__ import annotations

import glob
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from kit import asked

ROOT = Path(__file__).resolve().parents[2]
OURS = {"hystmpc": ".", "hystmpc-lab": "./lab"}
FOLDER = ROOT / ".matrix"
SETS = {"pinned": "highest", "lowest": "lowest-direct"}
UV = Path(sysconfig.get_path("scripts"), "uv")
# As `make test-fast`: tests start many programs, so that compiled bytecode is kept whatever the shell says.
SETTINGS = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")} | {"PYTHONDONTWRITEBYTECODE": ""}
_GPU = re.compile(r"^(?:nvidia-|triton)", re.MULTILINE)
_TORCH = re.compile(r"^torch==.*$", re.MULTILINE)
NO_TORCH = "torch; python_version < '3'"  # an override that no interpreter meets


@dataclass(frozen=True)
class Outcome:
    """Test result of one cell."""

    passed: int
    failed: int
    skipped: int
    seconds: float
    torch: bool
    day: str

    @property
    def green(self) -> bool:
        """Whether at least one test passed and none failed."""
        return self.passed > 0 and self.failed == 0

    def __str__(self) -> str:
        torch = "" if self.torch else ", no torch"
        return f"{self.passed:,} passed, {self.failed} failed, {self.skipped} skipped{torch}, {self.seconds:.0f} s"


def versions_supported() -> list[str]:
    """Interpreter versions in the classifiers of pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = (re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", line) for line in project["classifiers"])
    return [match.group(1) for match in found if match]


def interpreter(version: str) -> str | None:
    """Path of a Python of this version that runs, from PATH, else from pyenv's folder."""
    pyenv = os.environ.get("PYENV_ROOT", os.path.expanduser("~/.pyenv"))
    name = f"python{version}"
    for path in (shutil.which(name), *sorted(glob.glob(f"{pyenv}/versions/{version}.*/bin/{name}"))):
        if path is not None:  # one of pyenv's stand-ins is on PATH and runs nothing
            code = "import sys; print('%d.%d' % sys.version_info[:2])"
            done = subprocess.run([path, "-c", code], capture_output=True, text=True, check=False)
            if done.stdout.strip() == version:
                return path
    return None


def uv(*arguments: object, **environment: str) -> str:
    """Run uv with the folder of wheels, since uv reads no setting of pip."""
    links = {"UV_FIND_LINKS": os.environ["PIP_FIND_LINKS"]} if "PIP_FIND_LINKS" in os.environ else {}
    settings = {**links, **os.environ, **environment}
    return subprocess.run(
        [UV, *map(str, arguments)], cwd=ROOT, env=settings, stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def requirements(python: str, resolution: str, override: str) -> str:
    """Exact versions of both packages, their extras and tools; torch as given by `override`.

    The two packages themselves, of which each asks for the other, come from the checkout.
    """
    over = FOLDER / "override.txt"
    over.write_text("\n".join([override, *(f"{name} ; python_version < '3'" for name in OURS), ""]), encoding="utf-8")
    pins = ["--constraint", "constraints.txt"] if resolution == "highest" else []
    return uv(
        *("pip", "compile", "--quiet", "--no-header", "--no-annotate", "--all-extras", "--only-binary", ":all:"),
        *(
            "--python",
            python,
            "--resolution",
            resolution,
            "--override",
            over,
            *pins,
            *(Path(folder, "pyproject.toml") for folder in OURS.values()),
        ),
    )


def resolved(python: str, resolution: str) -> str:
    """Result of `requirements` with the torch of constraints.txt, or without torch if it brings GPU libraries."""
    pin = _TORCH.findall((ROOT / "constraints.txt").read_text(encoding="utf-8"))[0]
    text = requirements(python, "highest", pin)
    exact = NO_TORCH if _GPU.search(text) else _TORCH.findall(text)[0]  # with the local version, as +cpu
    return requirements(python, resolution, exact)


def run_cell(python: str, name: str, resolution: str, keep: bool) -> None:
    """Test one cell; requirements.txt and the tests' junit.xml stay in its folder."""
    folder = FOLDER / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    wanted = folder / "requirements.txt"
    wanted.write_text(resolved(python, resolution), encoding="utf-8")
    venv = folder / "venv"
    uv("venv", "--quiet", "--python", python, venv)
    target = {"VIRTUAL_ENV": str(venv)}
    uv("pip", "install", "--quiet", "--compile-bytecode", "--no-deps", "--only-binary", ":all:", "-r", wanted, **target)
    for checkout in OURS.values():
        uv("pip", "install", "--quiet", "--no-deps", "--editable", checkout, **target)
    command = [venv / "bin" / "python", "-m", "pytest", "-n", "auto", "--dist", "worksteal", "-m", "not slow"]
    with (folder / "pytest.log").open("w", encoding="utf-8") as log:
        subprocess.run(
            [*command, f"--junitxml={folder / 'junit.xml'}"],
            cwd=ROOT,
            env={**os.environ, **SETTINGS},
            stdout=log,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    if not keep:
        shutil.rmtree(venv)


def outcome(folder: Path) -> Outcome | None:
    """Result of the cell's last run, None without one."""
    report = folder / "junit.xml"
    if not report.is_file():
        return None
    suite = next(ET.parse(report).getroot().iter("testsuite"))
    every, failures, errors, skipped = (int(suite.get(k, "0")) for k in ("tests", "failures", "errors", "skipped"))
    failed = failures + errors
    torch = _TORCH.search((folder / "requirements.txt").read_text(encoding="utf-8")) is not None
    return Outcome(
        every - failed - skipped, failed, skipped, float(suite.get("time", "0")), torch, suite.get("timestamp", "")[:10]
    )


def table(versions: Sequence[str], missing: Sequence[str]) -> str:
    """Table in Markdown, readable in a terminal: a row for an interpreter, a column for a set."""
    rows = [("Python", *SETS, "of")]
    for version in versions:
        cells = [outcome(FOLDER / f"{version}-{name}") for name in SETS]
        empty = "no such interpreter here" if version in missing else "not run"
        days = sorted({cell.day for cell in cells if cell})
        rows.append((version, *(str(cell or empty) for cell in cells), ", ".join(days)))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["| " + " | ".join(text.ljust(w) for text, w in zip(row, widths, strict=True)) + " |" for row in rows]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def failures(folder: Path) -> Iterator[str]:
    """Failed tests of a cell, one line each."""
    report = folder / "junit.xml"
    for case in ET.parse(report).getroot().iter("testcase") if report.is_file() else ():
        if any(case.find(kind) is not None for kind in ("failure", "error")):
            yield f"{case.get('classname')}::{case.get('name')}"


def main() -> int:
    """Run the selected cells, then print the table."""
    versions = versions_supported()
    wanted = asked(
        __doc__,
        python={"nargs": "+", "choices": versions, "default": versions, "metavar": "3.X"},
        set={"nargs": "+", "choices": SETS, "default": list(SETS), "dest": "sets"},
        keep=(False, "leave the venvs under .matrix/"),
        table=(False, "run nothing: print the table of the last runs"),
    )
    pythons = {version: interpreter(version) for version in versions}
    missing = [version for version, path in pythons.items() if path is None]
    if missing:
        print(f"No Python {', '.join(missing)} is on PATH or in pyenv's folder: left out.", file=sys.stderr)
    FOLDER.mkdir(exist_ok=True)
    red = []
    for version in () if wanted.table else wanted.python:
        for name in wanted.sets if pythons[version] else ():
            cell = f"{version}-{name}"
            print(f"{cell} ...", file=sys.stderr, flush=True)
            run_cell(str(pythons[version]), cell, SETS[name], wanted.keep)
            found = outcome(FOLDER / cell)
            red += [] if found and found.green else [cell]
            print(f"{cell}: {found or 'no test ran'}", *failures(FOLDER / cell), sep="\n  ", file=sys.stderr)
    print(table(versions, missing))
    if red:
        print(f"Not green: {', '.join(red)}; see .matrix/CELL/pytest.log.", file=sys.stderr)
    return 1 if red else 0


if __name__ == "__main__":
    sys.exit(main())
