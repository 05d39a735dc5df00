"""The how-to on fits: every command can be pasted as it stands, and its errors are those that are printed."""

from __future__ import annotations

import glob
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from hystmpc.cli.main import app

from ..cli.test_verbs import run
from .site_pages import DOCS

PAGE = (DOCS / "howto" / "fit.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| `(\w+)` \| ([\d.]+) deg \| ([\d.]+) deg \|$", re.MULTILINE)
GIVEN = ("logs", "map.yaml", "trial_05.csv", "trial_06.csv")  # of the section on a user's own layout


def commands() -> list[list[str]]:
    """The words of every command of the page, in their order."""
    return [shlex.split(line) for block in BLOCK.findall(PAGE) for line in block.splitlines()]


def context(words: list[str]) -> tuple[Any, list[str]]:
    """The context of a command with its parameters, as the command line reads them."""
    command: Any = typer.main.get_command(app)
    outer = command.make_context("hystmpc", list(words), resilient_parsing=True)
    while hasattr(command, "get_command"):
        command, words = command.get_command(outer, words[0]), words[1:]
    return command.make_context("verb", list(words)), words


def test_nothing_has_to_be_filled_in() -> None:
    assert len(commands()) >= 12
    assert [words for words in commands() if words[0] != "hystmpc" or {"$", "#"} & set("".join(words))] == []


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_the_command_line_takes_it(words: list[str]) -> None:
    context(words[1:])


def places(value: object) -> Iterator[str]:
    if isinstance(value, Path):
        yield str(value)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from places(item)


def test_every_file_was_made_by_a_command_before() -> None:
    """What stands behind an option of output is made; all else has been made before, or is given."""
    made, missing = set(GIVEN), list[str]()
    for words in commands():
        outputs = {words[k + 1] for k, word in enumerate(words) if word in ("--out", "--report", "--json")}
        found, _ = context(words[1:])
        for name in places(list(found.params.values())):
            folder = name.partition("/")[0]
            if name not in outputs and not {name, folder} & made:
                missing.append(name)
        made |= outputs
    assert missing == []


@pytest.mark.slow
def test_the_errors_are_those_that_are_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`auto` takes longest and is left to whoever writes the page."""
    monkeypatch.chdir(tmp_path)
    rows = {kind: errors for kind, *errors in ROW.findall(PAGE)}
    assert rows.keys() == {words[2] for words in commands() if words[1] == "fit" and "--test" in words} - {"mapped"}
    for words in commands():
        quick = words[1:3] == ["data", "make"] or words[1] == "check" or (words[1] == "fit" and words[2] != "auto")
        if not quick or "map.yaml" in words:
            continue
        arguments = [name for word in words[1:] for name in (sorted(glob.glob(word)) if "*" in word else [word])]
        code, said, err = run(capsys, *arguments)
        assert code == 0, err
        if words[1] == "fit" and words[2] in rows:
            mean = next(line.split() for line in reversed(said.splitlines()) if line.split()[:1] == ["mean"])
            assert [mean[1], mean[3]] == rows[words[2]]
            assert words[2] == "pi" or "limits stored in the model: 0 to 6 mm, at most 12 mm/s, as given" in said
