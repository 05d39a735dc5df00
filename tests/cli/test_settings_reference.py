"""Settings explained: types, units, bounds, defaults and meanings in words, and a schema that says the same."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import jsonschema
import pytest
from pydantic import Field, ValidationError

from hystmpc.cli.reference import json_schema, meanings_of, reachable, summary_of
from hystmpc.trials.config import Settings

from ..front.site_pages import extension


class Inner(Settings):
    """An inner block.

    Attributes:
        width_mm: of the play [mm].
    """

    kind: Literal["inner"] = "inner"
    width_mm: Annotated[float, Field(gt=0)]


class Base(Settings):
    """Not shown.

    Attributes:
        gain_deg_per_mm, offset_deg: of the line
            that is fitted.
        seed: of the base.
    """

    offset_deg: float = 0.0
    seed: int = 0


class Outer(Base):
    """An outer block,
    in two lines.

    More of it.

    Attributes:
        seed: of the random numbers.
        parts: the inner blocks.
        by_name: the same by name.
        either: one or none.
        file: where it is.
        range_s: least and greatest time.

    Raises:
        ValueError: never.
    """

    parts: tuple[Inner, ...] = Field(min_length=1)
    by_name: dict[Annotated[str, Field(max_length=3)], Inner] = Field(default_factory=dict)
    either: Inner | None = None
    file: Path | None = None
    range_s: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]] = (1.0, 2.5)
    on: bool = True


@pytest.fixture
def keys() -> dict[str, Any]:
    return {key.name: key for key in extension().keys.keys_of(Outer)}


def test_meanings_are_those_of_the_nearest_class() -> None:
    meanings = meanings_of(Outer)
    assert meanings["seed"] == "of the random numbers."
    assert meanings["offset_deg"] == "of the line that is fitted."
    assert "ValueError" not in meanings
    assert summary_of(Outer) == "An outer block, in two lines."


def test_keys_in_words(keys: dict[str, Any]) -> None:
    assert (keys["parts"].accepts, keys["parts"].default, keys["parts"].bounds) == (
        "list of block",
        None,
        "at least 1 long",
    )
    assert (keys["by_name"].accepts, keys["by_name"].bounds) == ("mapping of name to block", "")
    assert (keys["either"].accepts, keys["either"].default) == ("block or null", "null")
    assert (keys["file"].accepts, keys["on"].accepts, keys["on"].default) == ("file or null", "true or false", "true")
    assert (keys["range_s"].accepts, keys["range_s"].default) == ("list of number, number", "[1, 2.5]")
    assert (keys["range_s"].unit, keys["range_s"].bounds) == ("s", "at least 0")
    assert keys["offset_deg"].unit == "deg"
    assert keys["parts"].blocks == keys["by_name"].blocks == keys["either"].blocks == (Inner,)


def test_the_key_that_tells_kinds_apart_stands_first() -> None:
    first, width = extension().keys.keys_of(Inner)
    assert (first.name, first.accepts) == ("kind", "`inner`")
    assert first.meaning
    assert (width.unit, width.bounds) == ("mm", "above 0")


def test_blocks_are_found_once() -> None:
    assert reachable(Outer) == (Outer, Inner)
    assert reachable(Inner | Outer) == (Inner, Outer)


@pytest.mark.parametrize(
    "data",
    [
        {"parts": [{"width_mm": 1.0}]},
        {"parts": []},
        {"parts": [{"width_mm": 0.0}]},
        {"parts": [{"width_mm": 1.0}], "range_s": [0.0, -1.0]},
        {"parts": [{"width_mm": 1.0}], "other": 1},
        {"parts": [{"width_mm": "1"}]},
        {"parts": [{"width_mm": 1.0}], "either": {"kind": "other", "width_mm": 1.0}},
        {},
    ],
)
def test_the_schema_allows_what_the_settings_allow(data: dict[str, Any]) -> None:
    allowed = True
    try:
        Outer.model_validate(data)
    except ValidationError:
        allowed = False
    checker = jsonschema.Draft202012Validator(json_schema(Outer, "outer"))
    assert checker.is_valid(data) is allowed


def test_the_schema_tells_the_meanings() -> None:
    schema = json_schema(Outer, "outer")
    assert schema["title"] == "outer"
    assert schema["properties"]["seed"]["description"] == "of the random numbers."
    assert schema["$defs"]["Inner"]["description"] == "An inner block."
