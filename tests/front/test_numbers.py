"""Numbers of the front pages come from one table, and each stands on the page that it is taken from."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from .site_pages import DOCS, ROOT, extension, text_of

README, INDEX = ROOT / "README.md", DOCS / "index.md"
FRONT = (README, INDEX)
CODE = re.compile(r"^```(?!\{).*?^```\s*$|`[^`]*`|\]\([^)]*\)|<!--.*?-->", re.MULTILINE | re.DOTALL)
DECIMAL = re.compile(r"(?<![\w.-])\d*\.\d+(?![\w.])")
OTHERS = {"3.11"}  # no measurement: the version of Python


def same(number: str) -> str:
    """A number without the zero that some pages leave out."""
    return number.removeprefix("0") if number.startswith("0.") else number


def rows() -> list[dict[str, str]]:
    return list(extension().front.settings()["rows"])


def stands(number: str, page: Path) -> bool:
    """Whether a number stands on a page, with or without the zero before its point."""
    return bool(re.search(rf"(?<![\w.])0?{re.escape(same(number))}(?!\d|\.\d)", page.read_text(encoding="utf-8")))


def test_readme_holds_the_table_as_it_is_made() -> None:
    """`python docs/extension/front.py` writes it."""
    page = README.read_text(encoding="utf-8")
    assert extension().front.with_table(page) == page


def test_the_start_page_holds_the_same_table() -> None:
    assert extension().front.text() in text_of(INDEX)


@pytest.mark.parametrize("row", rows(), ids=lambda row: row["task"])
def test_every_number_stands_on_its_page(row: dict[str, str]) -> None:
    """`1:` is the rival that a ratio is of; a bar says nothing that could be looked up."""
    page = DOCS / row["page"].partition("#")[0]
    words = f"{row['ours']} {row['beside'].removeprefix('1:')}"
    found = extension().front.numbers(words)
    assert found
    assert [number for number in found if not stands(number, page)] == []


def test_numbers_in_the_text_stand_on_their_pages() -> None:
    for name, numbers in extension().front.settings()["elsewhere"].items():
        assert [number for number in numbers if not stands(number, DOCS / name)] == []


@pytest.mark.parametrize("page", FRONT, ids=lambda page: page.name)
def test_a_front_page_has_no_number_of_its_own(page: Path) -> None:
    given = extension().front.settings()
    words = " ".join(f"{row['ours']} {row['beside']}" for row in given["rows"])
    known = {*extension().front.numbers(words), *(n for numbers in given["elsewhere"].values() for n in numbers)}
    assert set(DECIMAL.findall(CODE.sub(" ", text_of(page)))) - known - OTHERS == set()


def test_a_number_of_its_own_is_found() -> None:
    assert DECIMAL.findall(CODE.sub(" ", "On five devices 1.01 times ([x](a.md#b-2.5)), `x=0.1`.")) == ["1.01"]
    assert stands("0.07", DOCS / "results" / "studies.md")
    assert not stands("1.017", DOCS / "results" / "studies.md")
