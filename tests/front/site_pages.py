"""The pages of the site as text: links, anchors, contents and sentences, without building it."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = tuple(sorted(DOCS.rglob("*.md")))

_FENCE = re.compile(r"^(`{3,}|:{3,}).*?^\1\s*$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"^```(?!\{).*?^```\s*$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#{1,6} (.+)$", re.MULTILINE)
_NAMED = re.compile(r"^\(([\w-]+)\)=$", re.MULTILINE)
_TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`[^`]*`|\[([^\]]*)\]\([^)]*\)")


@cache
def extension() -> ModuleType:
    """The site's own extension of Sphinx, `docs/extension/`."""
    place = DOCS / "extension" / "__init__.py"
    spec = importlib.util.spec_from_file_location("hystmpc_site", place, submodule_search_locations=[str(place.parent)])
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["hystmpc_site"] = module
    spec.loader.exec_module(module)
    return module


@cache
def text_of(page: Path) -> str:
    """A page as Sphinx sees it: with what is generated."""
    text = page.read_text(encoding="utf-8")
    return extension().expanded(text) if "{generated}" in text else text


def links_of(page: Path) -> list[str]:
    """Targets of all links and pictures of a page that lead to no other host."""
    found = _LINK.findall(_CODE.sub("", text_of(page)))
    return [target for target in found if not re.match(r"[a-z]+:", target)]


@cache
def anchors_of(page: Path) -> frozenset[str]:
    """Names that links to a page can end with: of its headings, as GitHub and Sphinx make them, and given ones."""
    text = _CODE.sub("", text_of(page))
    slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in _HEADING.findall(text)}
    return frozenset(slugs | set(_NAMED.findall(text)))


def contents_of(page: Path) -> Iterator[Path]:
    """Pages that the contents of a page list."""
    for block in _TOCTREE.findall(page.read_text(encoding="utf-8")):
        for line in block.splitlines():
            if line.strip() and not line.startswith((":", "gallery/")):
                yield (page.parent / f"{line.strip()}.md").resolve()


def sentences_of(page: Path) -> list[str]:
    """Sentences of the running text of a page: without code, tables, headings and pictures. A colon ends none."""
    text = _FENCE.sub("\n\n", page.read_text(encoding="utf-8"))
    lines = [line for line in text.splitlines() if not re.match(r"\s*(#|\||!\[|\([\w-]+\)=)|    +[^-*\s]", line)]
    plain = _SPAN.sub(lambda found: found[1] or "x", "\n".join(lines))
    paragraphs = re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.) ", plain)
    pieces = (piece for paragraph in paragraphs for piece in re.split(r"(?<=[.!?])\s+", " ".join(paragraph.split())))
    return [piece for piece in pieces if len(piece.split()) > 1]


def running_text(sentences: Iterable[str]) -> str:
    """Sentences as a text in which every full stop ends one: not that of 0.15 and of eq. (2)."""
    return " ".join(re.sub(r"[.!?:;]+", " ", sentence).strip() + "." for sentence in sentences)
