"""README, docs and docstrings name only files and modules that exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from .source import LAB, ROOMS, ROOT

_ROOM = "|".join(ROOMS)
# A path in back quotes or in a table: `gap/report/page.py`, `lab/blind/`.
FILE = re.compile(rf"(?<![\w/.-])(?:{_ROOM}|lab|tests|examples|docs|ros2)/[\w/.-]*\w(?:\.(?:py|yaml|md)\b|/(?=`))")
MODULE = re.compile(rf"(?<![\w.])hystmpc(?:\.(?:{_ROOM}))(?:\.\w+)*")


def pages() -> tuple[Path, ...]:
    """README, docs, examples and the package's source; the changelog tells of the past."""
    front = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md")]
    prose = [*front, *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "ros2").rglob("*.md"))]
    code = [path for room in (*ROOMS, LAB, "examples") for path in sorted((ROOT / room).rglob("*.py"))]
    return (*prose, *code)


def missing_files(path: Path, text: str) -> Iterator[str]:
    """Paths that stand in the text and lead nowhere."""
    for name in sorted({match.group() for match in FILE.finditer(text)}):
        if not (ROOT / name).exists():
            yield f"{path.relative_to(ROOT)}: {name}"


def missing_modules(path: Path, text: str) -> Iterator[str]:
    """Dotted names whose module is no module of the package; the last part may be a name in it."""
    for name in sorted({match.group() for match in MODULE.finditer(text)}):
        rooms = name.split(".")[1:]
        candidates = [rooms] if len(rooms) == 1 else [rooms, rooms[:-1], rooms[:-2]]
        places = [ROOT.joinpath(*parts) for parts in candidates if parts]
        if not any(place.is_dir() or place.with_suffix(".py").is_file() for place in places):
            yield f"{path.relative_to(ROOT)}: {name}"


def test_files_that_are_named_exist() -> None:
    offenders = [line for page in pages() for line in missing_files(page, page.read_text(encoding="utf-8"))]
    assert offenders == []


def test_modules_that_are_named_exist() -> None:
    offenders = [line for page in pages() for line in missing_modules(page, page.read_text(encoding="utf-8"))]
    assert offenders == []


def test_the_checks_themselves() -> None:
    assert list(missing_files(ROOT / "README.md", "see `gap/no_such.py` and `ctrl/`")) == ["README.md: gap/no_such.py"]
    assert list(
        missing_modules(ROOT / "README.md", "hystmpc.no_room, hystmpc.gap.a.b.c, hystmpc.trials.trial.Trial")
    ) == ["README.md: hystmpc.gap.a.b.c"]
