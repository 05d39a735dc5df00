"""Strict YAML: no key twice, only decimal numbers, bounded depth, size and aliases; each error one line."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import Field

from hystmpc.cli.main import main
from hystmpc.trials.config import (
    LARGEST_FILE,
    Settings,
    YamlError,
    dump_yaml,
    line_of,
    load_settings,
    parse_yaml,
    read_yaml,
)
from hystmpc.trials.errors import ConfigError


class Inner(Settings):
    gain: float = 1.0


class Numbers(Settings):
    """A number of every shape that settings have."""

    one: float = 0.0
    maybe: float | None = None
    count: int = Field(1, ge=0)
    row: tuple[float, ...] = ()
    pair: tuple[int, float] = (0, 0.0)
    named: dict[str, tuple[float, float]] = Field(default_factory=dict)
    fact: dict[str, str | float | int | bool] = Field(default_factory=dict)
    name: str = ""
    live: bool = False
    inner: Inner = Inner()


def load(text: str, folder: Path) -> Numbers:
    file = folder / "settings.yaml"
    file.write_text(text)
    return load_settings(Numbers, file)


def refusal(text: str, folder: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(text, folder)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 1000
    return line


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (
            "one: 1\none: 60\n",
            "line 2 column 1: not usable YAML (key 'one' stands twice in one block, first on line 1",
        ),
        ("inner:\n  gain: 1\n\n  gain: 2\n", "line 4 column 3: not usable YAML (key 'gain' stands twice"),
        ("named: {a: [1, 2], a: [3, 4]}\n", "line 1 column 20: not usable YAML (key 'a' stands twice"),
        ('one: 1\n"one": 2\n', "key 'one' stands twice"),
    ],
)
def test_a_key_that_stands_twice_is_refused_with_its_line(text: str, part: str, tmp_path: Path) -> None:
    assert part in refusal(text, tmp_path)


def test_an_override_with_a_key_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "settings.yaml").write_text("one: 1\n")
    with pytest.raises(ConfigError, match=r"--set inner=.*key 'gain' stands twice") as caught:
        load_settings(Numbers, tmp_path / "settings.yaml", ["inner={gain: 1, gain: 60}"])
    assert "\n" not in str(caught.value)


TRAPS = ["yes", "on", "true", "False", "y", "010", "-017", "0x10", "0o17", "0b11", "1:30", "1:30.5", "1_000", "'3'"]


@pytest.mark.parametrize("written", TRAPS)
@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("one: {}", "line 1: one"),
        ("maybe: {}", "line 1: maybe"),
        ("count: {}", "line 1: count"),
        ("row: [1, {}]", "line 1: row.1"),
        ("pair: [1, {}]", "line 1: pair.1"),
        ("named:\n  a: [1, 2]\n  b: [{}, 2]", "line 3: named.b.0"),
        ("inner:\n  gain: {}", "line 2: inner.gain"),
    ],
)
def test_what_is_no_decimal_number_is_refused_where_one_is_expected(
    text: str, place: str, written: str, tmp_path: Path
) -> None:
    line = refusal(text.format(written), tmp_path)
    assert place in line
    assert "expected a valid number" in line


@pytest.mark.parametrize("written", TRAPS)
def test_an_override_gets_the_same_rules(written: str, tmp_path: Path) -> None:
    (tmp_path / "settings.yaml").write_text("one: 1\n")
    with pytest.raises(ConfigError, match=r"--set inner\.gain=.*: inner\.gain: expected a valid number"):
        load_settings(Numbers, tmp_path / "settings.yaml", [f"inner.gain={written}"])


def test_settings_built_in_python_get_the_same_rule() -> None:
    for value in (True, "3"):
        with pytest.raises(ValueError, match="expected a valid number"):
            Numbers(one=value)  # type: ignore[arg-type]  # what the test is about
    assert Numbers(one=3, row=(1, 2.5), fact={"deep": True, "name": "010", "n": 3}).fact["deep"] is True


def test_text_stays_text(tmp_path: Path) -> None:
    for written in ("on", "no", "010", "1:30", "2026-13-45", "2026-01-02", "0x10"):
        assert load(f"name: {written}\n", tmp_path).name == written
    assert load("live: true\n", tmp_path).live is True


@pytest.mark.parametrize(
    ("written", "number"),
    [("12", 12), ("-0.5", -0.5), ("+1", 1), (".5", 0.5), ("2.", 2.0), ("1e-3", 1e-3), ("1.5E+2", 150.0), ("0", 0)],
)
def test_decimal_numbers_are_read(written: str, number: float, tmp_path: Path) -> None:
    assert load(f"one: {written}\n", tmp_path).one == number


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats(allow_nan=False) | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=12,
)


@given(plain)
@example({"\x85": "a\u2028"})
@example({"a": ["1e3", "010", "yes", "true", "1:30", "~", "", "<<", "2026-01-02", "0o7", ".inf", "1e-05"]})
def test_what_is_written_is_read_back_the_same(data: Any) -> None:
    text = dump_yaml(data)
    assert parse_yaml(text) == data
    assert yaml.safe_load(text) == data


@given(st.integers() | st.floats(allow_nan=False, allow_infinity=False))
def test_every_number_that_json_writes_is_that_number(number: float) -> None:
    assert parse_yaml(repr(number)) == number


@given(st.from_regex(r"[-+0-9.eE_:xob]{1,8}", fullmatch=True))
def test_a_scalar_is_the_decimal_number_that_it_shows_or_text(written: str) -> None:
    try:
        found = parse_yaml(written)
    except YamlError:
        return  # such as `-:`, a block
    if isinstance(found, int | float):
        assert found == float(written)


BILLION_LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 12)
)
HOSTILE = {
    "flow lists": ("[" * 20_000, "nested deeper than 100 levels"),
    "flow maps": ("{a: " * 20_000, "nested deeper than 100 levels"),
    "block lists": ("- " * 20_000, "nested deeper than 100 levels"),
    "closed lists": ("one: " + "[" * 20_000 + "]" * 20_000, "nested deeper than 100 levels"),
    "alias bomb": (BILLION_LAUGHS, "each alias counted with all that it stands for"),
    "alias of itself": ("one: &a [*a]\n", "alias *a inside its own block"),
    "digits": ("one: " + "7" * 100_000, "line 1 column 6: not usable YAML (got an integer of 100000 characters"),
    "tagged date": ("name: !!timestamp 2026-13-45\n", "could not determine a constructor"),
    "tagged octal": ("one: !!int 010\n", "got '010', expected a decimal integer"),
    "date": ("one: 2026-13-45\n", "expected a valid number, got '2026-13-45'"),
    "object": ("name: !!python/object/apply:os.getcwd []\n", "could not determine a constructor"),
    "control character": ("name: \x00\n", "special characters are not allowed"),
    "block as a key": ("? [1]\n: 2\n", "unhashable key"),
    "two documents": ("one: 1\n---\none: 2\n", "expected a single document in the stream, but found another"),
    "long text": ("one: " + "x" * 100_000, "expected a valid number, got 'xxx"),
    "long list": ("one: [" + "1, " * 10_000 + "]", "valid number"),
    "line break in a key": ('"a\\nb": 1\n', "unknown key"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_text_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    text, part = HOSTILE[name]
    assert part in refusal(text, tmp_path)
    line_of(text, ("one",))  # looks for places in the same texts, and must not fail either


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_the_program_ends_with_2_and_one_line(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(HOSTILE[name][0])
    before, sys.argv = sys.argv, ["hystmpc", "simulate", str(file), "--out", str(tmp_path / "run")]
    try:
        with pytest.raises(SystemExit) as end:
            main()
    finally:
        sys.argv = before
    said = capsys.readouterr().err.splitlines()
    error = [line for line in said if not line.startswith("simulate: ")]  # progress, on a slow machine
    assert end.value.code == 2
    assert len(error) == 1
    assert error[0].startswith(f"error: {file}")


def test_a_file_beyond_the_largest_size_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "large.yaml"
    file.write_text("a: 1\n#" + "x" * LARGEST_FILE)
    with pytest.raises(ConfigError, match=r"large\.yaml: larger than 4000000 bytes"):
        read_yaml(file)
    if sys.platform == "linux":
        with pytest.raises(ConfigError, match="larger than"):
            read_yaml("/dev/zero")


def test_ordinary_aliases_and_merged_keys_are_read() -> None:
    data = parse_yaml("base: &b {x: 1, y: 2}\none: {<<: *b, x: 3}\ntwo: *b\n")
    assert data == {"base": {"x": 1, "y": 2}, "one": {"x": 3, "y": 2}, "two": {"x": 1, "y": 2}}


def test_absurd_numbers_handed_over_in_python_are_one_line_too() -> None:
    for value in (10**5000, math.inf, [10**5000]):
        with pytest.raises(ConfigError) as caught:
            Numbers.parse({"one": value})
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 300
