"""The site: every page is in its contents, every link leads somewhere, the text is easy to read, it builds."""

from __future__ import annotations

import statistics
from pathlib import Path

import pytest

from .site_pages import (
    DOCS,
    PAGES,
    ROOT,
    anchors_of,
    contents_of,
    extension,
    links_of,
    running_text,
    sentences_of,
    text_of,
)

READ = tuple(page for page in (ROOT / "README.md", *PAGES) if sentences_of(page))
LONGEST, MEDIAN = 35, 18  # words of a sentence
EASE = 45  # Flesch reading ease; 60 to 70 is plain English


def faults(page: Path) -> list[str]:
    """Links of a page that lead to no file, or to no heading of one."""
    found = []
    for link in links_of(page):
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists() and target.parent != DOCS / "reference" / "drawn":
            found.append(f"{link}: no such file")
        elif anchor and target.suffix == ".md" and anchor not in anchors_of(target):
            found.append(f"{link}: no such heading")
    return found


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    assert faults(page) == []


def test_a_link_that_leads_nowhere_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A b\n\n[x](#a-b) [y](#c) [z](gone.md) [w](https://example.org)\n\n```sh\n[v](code.md)\n```\n")
    assert faults(page) == ["#c: no such heading", "gone.md: no such file"]


def test_every_page_is_in_the_contents_once() -> None:
    listed = [page for index in PAGES for page in contents_of(index)]
    assert sorted(listed) == sorted(page for page in PAGES if page != DOCS / "index.md")


def test_generated_pages_hold_every_public_name_key_verb_and_effect() -> None:
    import hystmpc
    from hystmpc.cli.main import VERBS
    from hystmpc.models import EFFECTS

    reference = {page.stem: text_of(page) for page in PAGES if page.parent.name == "reference"}
    public = set(hystmpc.__all__) - {"__version__"}
    assert [name for name in public if f":: hystmpc.{name}\n" not in reference["api"]] == []
    assert [verb for verb in VERBS if f"`hystmpc {verb}`" not in reference["commands"]] == []
    assert [name for name in EFFECTS if f"### `{name}`" not in reference["effects"]] == []
    keys = ("kind: sampled", "kind: raster", "kind: scan_triangle", "kind: random_point_to_point", "kind: sampling_mpc")
    assert [key for key in keys if f"`{key}`" not in reference["configuration"]] == []


@pytest.mark.parametrize("page", READ, ids=lambda page: str(page.relative_to(ROOT)))
def test_sentences_are_short(page: Path) -> None:
    words = {sentence: len(sentence.split()) for sentence in sentences_of(page)}
    assert [sentence for sentence, count in words.items() if count > LONGEST] == []
    assert statistics.median(words.values()) <= MEDIAN


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_no_running_text_is_lost_as_a_comment(page: Path) -> None:
    """A line that begins with the sign of per cent does not show on the site."""
    assert [line for line in page.read_text(encoding="utf-8").splitlines() if line.lstrip().startswith("%")] == []


def test_a_sentence_goes_on_behind_a_colon_and_a_decimal_point(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Not this\n\nThe lag: 0.15 s of `code`. Next\none.\n\n| not this. |\n")
    assert sentences_of(page) == ["The lag: 0.15 s of x.", "Next one."]
    assert running_text(sentences_of(page)).count(".") == len(sentences_of(page))


@pytest.mark.slow
def test_the_whole_site_is_easy_to_read() -> None:
    textstat = pytest.importorskip("textstat")
    sentences = [sentence for page in PAGES for sentence in sentences_of(page)]
    assert statistics.median(len(sentence.split()) for sentence in sentences) <= MEDIAN
    assert textstat.flesch_reading_ease(running_text(sentences)) >= EASE
    hard = "Identification necessitates considerable experimental sophistication."
    assert textstat.flesch_reading_ease(hard) < EASE


def test_a_page_that_asks_a_host_is_found(tmp_path: Path) -> None:
    """`make docs` ends with this check over the whole site."""
    asking = extension().asking
    (tmp_path / "own.html").write_text('<script src="_static/a.js"></script><a href="https://example.org">there</a>')
    assert asking(tmp_path) == []
    for tag in ('<script async src="https://example.org/a.js">', '<link href="//example.org/a.css">'):
        (tmp_path / "asks.html").write_text(tag)
        assert asking(tmp_path) == ["asks.html"]
