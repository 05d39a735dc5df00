"""The mutation harness: its list does not rot, it mutates a copy and nothing else, and it can tell."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from ..conftest import ROOT
from ..scripts import script

mutants = script("mutants")
MUTANTS = mutants.MUTANTS


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: f"{m.file}: {m.name}")
def test_every_mutant_applies_and_its_tests_are_there(mutant: Any) -> None:
    """The old text stands in the file exactly once, and what comes instead is Python, in a file of Python."""
    text = mutants.mutated(mutant, (ROOT / mutant.file).read_text(encoding="utf-8"))
    if mutant.file.endswith(".py"):
        compile(text, mutant.file, "exec")
    assert mutant.tests
    assert [test for test in mutant.tests if not (ROOT / test).exists()] == []


def test_every_mutant_has_a_name_and_a_change_of_its_own() -> None:
    assert [name for name, count in Counter(m.name for m in MUTANTS).items() if count > 1] == []
    assert [c for c, count in Counter((m.file, m.old, m.new) for m in MUTANTS).items() if count > 1] == []


@pytest.mark.parametrize("old", ["this stands nowhere", "def "])
def test_text_that_is_not_found_once_is_an_error(old: str) -> None:
    rotten = mutants.Mutant("rotten", "ctrl/command.py", old, "x", ("tests/ctrl/test_limits.py",))
    with pytest.raises(mutants.NotApplicableError, match="expected it once"):
        mutants.mutated(rotten, (ROOT / rotten.file).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return mutants.Copy(tmp_path_factory.mktemp("copy"), 120.0)


@pytest.mark.slow
def test_the_copy_has_every_file_that_is_mutated_and_its_tests(copy: Any) -> None:
    named = {file for mutant in MUTANTS for file in (mutant.file, *mutant.tests)}
    assert sorted(file for file in named if not (copy.root / file).exists()) == []


@pytest.mark.slow
def test_a_mutant_is_killed_in_a_copy_and_one_that_changes_nothing_survives(copy: Any) -> None:
    """Were the original imported, the first one would survive; could nothing survive, the second would be killed."""
    file, tests = "ctrl/command.py", ("tests/ctrl/test_limits.py",)
    before = (ROOT / file).read_bytes()
    wrong = mutants.Mutant("no clip", file, "return min(max(u if", "return 0.0 * min(max(u if", tests)
    found = copy.judged(wrong)
    assert (found.verdict, "test_limits.py::" in found.by) == ("killed", True)
    harmless = mutants.Mutant("words", file, "import annotations\n", "import annotations  # words\n", tests)
    assert copy.judged(harmless).verdict == "survived"
    assert (ROOT / file).read_bytes() == before == (copy.root / file).read_bytes()


@pytest.mark.slow
def test_tests_that_hang_kill_the_mutant_and_say_so(copy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(copy, "timeout_s", 3.0)
    endless = mutants.Mutant(
        "endless",
        "ctrl/command.py",
        "import math\n",
        "import math\nimport time\ntime.sleep(600)\n",
        ("tests/ctrl/test_limits.py",),
    )
    found = copy.judged(endless)
    assert (found.verdict, found.by) == ("killed", "timeout after 3 s")
