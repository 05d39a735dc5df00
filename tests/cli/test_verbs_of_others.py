"""Verbs that installed packages add to the program, as the laboratory does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from hystmpc.cli.main import GROUP, VERBS, verbs_of_others

from .test_verbs import run as called

Run = Callable[..., tuple[int, str]]

VERB = '''
def greet(name: str) -> None:
    """Greet somebody."""
    print(f"good day, {name}")

VERBS = {"greet": ("greeting:greet", "Greet somebody."), "check": ("greeting:greet", "Not this one.")}
NUMBER = 3
'''


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> EntryPoint:
    """An installed package with a verb of its own and one whose name is taken."""
    (tmp_path / "greeting.py").write_text(VERB)
    monkeypatch.syspath_prepend(str(tmp_path))
    entry = EntryPoint("greeting", "greeting:VERBS", GROUP)
    use(entry, monkeypatch)
    return entry


def use(entry: EntryPoint, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this be the only entry point that is installed."""
    monkeypatch.setattr(
        "hystmpc.trials.from_outside.entry_points", lambda group: EntryPoints([entry]).select(group=group)
    )
    verbs_of_others.cache_clear()


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Calls the program; exit code and all that it printed."""

    def call(*arguments: str) -> tuple[int, str]:
        code, printed, said = called(capsys, *arguments)
        return code, printed + said

    return call


@pytest.fixture(autouse=True)
def _forgotten_afterwards() -> Iterator[None]:
    yield
    verbs_of_others.cache_clear()


@pytest.mark.usefixtures("installed")
def test_a_verb_of_an_installed_package_is_listed_and_called(run: Run) -> None:
    code, text = run("--help")
    assert code == 0
    assert "Greet somebody." in text
    assert run("greet", "catheter") == (0, "good day, catheter\n")


@pytest.mark.usefixtures("installed")
def test_no_verb_of_hystmpc_is_replaced(run: Run) -> None:
    assert set(verbs_of_others()) == {"greet"}
    assert VERBS["check"][1] in " ".join(run("--help")[1].split())


@pytest.mark.usefixtures("installed")
def test_an_unknown_verb_is_answered_with_the_nearest_of_all(run: Run) -> None:
    code, text = run("gret")
    assert code == 2
    assert "Did you mean 'greet'?" in text


def test_what_is_no_mapping_is_refused_in_a_line(
    installed: EntryPoint, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    use(EntryPoint(installed.name, "greeting:NUMBER", GROUP), monkeypatch)
    code, text = run("greet", "catheter")
    assert code != 0
    assert "no mapping of verbs 'NUMBER'" in text


def test_without_the_laboratory_its_verbs_are_where_they_can_be_had(monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    use(EntryPoint("none", "none:NONE", "another.group"), monkeypatch)
    code, text = run("bench")
    assert code == 2
    assert "verbs of hystmpc-lab: pip install ./lab" in " ".join(text.split())
