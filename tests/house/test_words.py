"""One word, one meaning: the glossary's table is the law for names, and a class name is used once."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterable
from functools import cache

from .source import LAB, ROOT, Module, modules

GLOSSARY = ROOT / "docs" / "reference" / "glossary.md"
ROW = re.compile(r"^\|[^|]*\|[^|]*\| `(\w+)` \|$", re.MULTILINE)


@cache
def words_not_used() -> frozenset[str]:
    """The last column of the glossary's table of names."""
    return frozenset(ROW.findall(GLOSSARY.read_text(encoding="utf-8")))


def names(nodes: Iterable[ast.AST]) -> set[str]:
    """Identifiers of a module that hold a word which the glossary rules out; `NOT_FOUND` is a name of HTTP."""
    fields = [value for node in nodes if not isinstance(node, ast.Constant) for _, value in ast.iter_fields(node)]
    lists = [value for field in fields if isinstance(field, list) for value in field]  # of `global`
    used = {name for value in (*fields, *lists) if isinstance(value, str) for name in value.split(".")}
    return {
        name
        for name in used - {"NOT_FOUND"}
        if words_not_used() & set(re.split("_+|(?<=[a-z])(?=[A-Z])", name.lower()))
    }


def product() -> list[Module]:
    """Modules of the product."""
    return [module for module in modules() if module.room != LAB]


def test_the_glossary_rules_words_out_and_a_name_with_one_is_seen() -> None:
    assert {"found", "own", "told"} <= words_not_used()
    text = "import a.own.b\ndef best_found(known, *, told=1):\n    global last_found\n    return known.own(lost_told=1)"
    assert names(ast.walk(ast.parse(text))) == {"own", "best_found", "told", "last_found", "lost_told"}


def test_names_are_the_words_of_the_glossary() -> None:
    wrong = {m.where: sorted(names(m.nodes)) for m in product()}
    assert {where: bad for where, bad in wrong.items() if bad} == {}


def test_a_class_name_is_used_once() -> None:
    places = defaultdict(list)
    for module in product():
        for node in module.nodes:
            if isinstance(node, ast.ClassDef):
                places[node.name.lstrip("_")].append(module.where)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
