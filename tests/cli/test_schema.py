"""`hystmpc schema`: every kind of file has a schema, every key a meaning, and the examples fit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.cli.reference import FILES, json_schema, settings_of
from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
RUN = CliRunner()
KIND_OF = {
    "bench_device": "device",
    "bench_record": "record",
    "bench_udp": "run",
    "commission": "commission",
    "fatigue_rig": "layout",
    "investigate": "investigate",
    "rod": "simulate",
    "seal_friction": "layout",
    "simulate": "simulate",
    "simulate_builtin": "simulate",
    "simulate_imaging": "simulate",
    "sweep": "sweep",
    "tip": "tip",
    "tune": "tune",
}


def checker(kind: str) -> Any:
    """Of files of a kind, by what the command prints."""
    schema = json.loads(RUN.invoke(app, ["schema", kind]).stdout)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_every_example_has_its_kind() -> None:
    assert {path.stem for path in (ROOT / "examples").glob("*.yaml")} == set(KIND_OF)


@pytest.mark.parametrize(("name", "kind"), KIND_OF.items())
def test_examples_fit_their_schema(name: str, kind: str) -> None:
    data = read_yaml(ROOT / "examples" / f"{name}.yaml")
    assert [error.message for error in checker(kind).iter_errors(data)] == []
    assert not checker(kind).is_valid({**data, "no_such_key": 1})


@pytest.mark.parametrize("file", sorted((ROOT / "models" / "library").glob("*.yaml")), ids=lambda file: file.stem)
def test_simulators_that_ship_fit_theirs(file: Path) -> None:
    assert [error.message for error in checker("simulator").iter_errors(read_yaml(file))] == []


def descriptions(schema: dict[str, Any]) -> list[str]:
    """Keys of a schema without a description."""
    bodies = [schema, *schema.get("$defs", {}).values()]
    inner = [part for body in bodies for part in (body, *body.get("anyOf", ())) if "properties" in part]
    return [key for part in inner for key, value in part["properties"].items() if not value.get("description")]


@pytest.mark.parametrize("kind", FILES)
def test_every_key_of_a_schema_is_described(kind: str) -> None:
    assert descriptions(json_schema(settings_of(kind), kind)) == []


def test_kinds_are_listed_and_a_wrong_one_is_answered() -> None:
    listed = RUN.invoke(app, ["schema"]).stdout
    assert [kind for kind in FILES if kind not in listed] == []
    with pytest.raises(ConfigError, match="did you mean 'simulate'"):
        settings_of("simulat")


ANGLE, TIP = {"angle": "bend"}, {"tip": {"bend": "bend", "plane": "plane"}}


@pytest.mark.parametrize(("output", "valid"), [(ANGLE, True), (TIP, True), ({}, False), ({**ANGLE, **TIP}, False)])
def test_a_mapping_names_an_angle_or_a_tip(output: dict[str, object], valid: bool) -> None:
    assert checker("layout").is_valid({"command": {"signal": "u", "unit": "mm"}, **output}) == valid
