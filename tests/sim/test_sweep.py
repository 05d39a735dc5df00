"""What a sweep varies, which rows that gives, and a table that neither loses nor doubles one."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
import time
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.sim.sweep.plan import SweepPlan, SweepRow
from hystmpc.sim.sweep.settings import (
    DrawSettings,
    SweepSettings,
    changed,
    drawn,
    load_sweep,
    path_parts,
    value_at,
    with_base,
)
from hystmpc.sim.sweep.table import RunTable, table_of
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError, LogError

from .small import study_data

pytestmark = pytest.mark.slow

MISMATCH = 'plant.mismatch."prandtl_ishlinskii.alpha"'
DRAW = {"plant.lag_s": {"uniform": [0.0, 0.1]}, MISMATCH: {"log_uniform": [0.8, 1.25]}}


def plan(**changes: Any) -> SweepPlan:
    """A sweep over the small study: two controllers, one motion."""
    return SweepPlan(with_base(SweepSettings.parse({"base": study_data()} | changes), Path("sweep.yaml")))


def rows(**changes: Any) -> list[SweepRow]:
    return list(plan(**changes).rows())


@pytest.mark.parametrize(
    ("path", "parts"),
    [
        ("seed", ("seed",)),
        ("plant.effects.0.parameters.tau_s", ("plant", "effects", "0", "parameters", "tau_s")),
        (MISMATCH, ("plant", "mismatch", "prandtl_ishlinskii.alpha")),
    ],
)
def test_a_path_is_split_at_its_dots(path: str, parts: tuple[str, ...]) -> None:
    assert path_parts(path) == parts


@pytest.mark.parametrize("path", ["", ".", "a.", ".a", "a..b", 'a"b', '"a.b'])
def test_what_is_no_path_is_refused(path: str) -> None:
    with pytest.raises(ConfigError, match="not a path"):
        path_parts(path)


keys = st.text("abc", min_size=1, max_size=2)
blocks = st.recursive(
    st.integers(), lambda inner: st.dictionaries(keys, inner, min_size=1) | st.lists(inner, min_size=1), max_leaves=8
)


@given(data=st.data(), block=blocks.filter(lambda b: not isinstance(b, int)), value=st.integers())
def test_a_change_is_found_again_and_touches_nothing_else(data: st.DataObject, block: Any, value: int) -> None:
    parts, node = [], block
    while not isinstance(node, int):
        part = data.draw(st.sampled_from(range(len(node)) if isinstance(node, list) else sorted(node)))
        parts.append(str(part))
        node = node[part]
    path, before = ".".join(parts), deepcopy(block)
    assert value_at(changed(block, path, value), path) == value
    assert block == before
    assert changed(changed(block, path, value), path, node) == block


@given(seed=st.integers(0, 2**31), number=st.integers(0, 10**6))
def test_draws_keep_their_ends_and_do_not_depend_on_each_other(seed: int, number: int) -> None:
    ranges: dict[str, Any] = {
        "a": {"uniform": [-1.0, 2.0]},
        "b": {"log_uniform": [1e-3, 1e3]},
        "c": {"integer": [3, 5]},
        "d": {"choice": ["x", None, 2.5]},
    }
    draws = {name: DrawSettings.parse(one) for name, one in ranges.items()}
    found = drawn(draws, seed, number)
    assert -1.0 <= found["a"] <= 2.0
    assert 1e-3 <= found["b"] <= 1e3
    assert found["c"] in (3, 4, 5)
    assert found["d"] in ("x", None, 2.5)
    assert drawn({"b": draws["b"]}, seed, number) == {"b": found["b"]}


def test_rows_are_the_product_and_draws_are_the_same_at_every_grid_point() -> None:
    changes = {"grid": {"actuator_lag_s": [0, 0.08]}, "draw": DRAW, "count": 3, "seeds": [4, 5]}
    found = rows(**changes)
    assert len(found) == plan(**changes).check() == 2 * 3 * 2 * 2
    assert len({row.id for row in found}) == len(found)
    lags = {(row.draw, row.factors["plant.lag_s"]) for row in found}
    assert len(lags) == 3
    for row in found:
        config = row.config()
        assert config.plant.lag_s == row.factors["plant.lag_s"]
        assert config.actuator_lag_s == row.factors["actuator_lag_s"]
        assert config.seed == row.seed
        assert list(config.controllers) == [row.controller]
        assert list(config.motions) == [row.motion]


def test_an_id_is_that_of_what_is_run_and_of_nothing_else() -> None:
    few, more = rows(draw=DRAW, count=2), rows(draw=DRAW, count=4, seeds=[0, 1])
    assert {row.id for row in few} < {row.id for row in more}
    other = study_data()
    other["plant"] = {**other["plant"], "noise_deg": 0.1}
    assert not {row.id for row in few} & {row.id for row in rows(base=other, draw=DRAW, count=2)}


def test_equal_rows_are_one() -> None:
    assert len(rows(grid={"plant.lag_s": {"none": 0, "zero": 0.0}})) == 2


def test_named_values_stand_in_the_table_by_their_names() -> None:
    motions = {"short": study_data()["motions"]}
    swept = plan(grid={"motions": motions, "plant.lag_s": [0, 0.1]})
    assert swept.columns() == {"motions": "text", "plant.lag_s": "number"}
    assert {row.factors["motions"] for row in swept.rows()} == {"short"}
    assert {row.factors["plant.lag_s"] for row in swept.rows()} == {0.0, 0.1}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gird": {}}, "unknown key 'gird'.*did you mean 'grid'"),
        ({"grid": {"plant.lag": [0]}}, r"line \d+: .*unknown key 'lag'.*did you mean 'lag_s'"),
        ({"grid": {"plnat.lag_s": [0]}}, r"line \d+: .*no key 'plnat'.*did you mean 'plant'"),
        ({"grid": {"controllers.mcp.horizon": [5]}}, r"line \d+: .*no key 'mcp'.*did you mean 'mpc'"),
        ({"grid": {"plant.lag_s": []}}, "plant.lag_s.*expected a list of values"),
        ({"grid": {"plant.lag_s": [-1]}}, "lag_s.*greater than or equal to 0"),
        ({"draw": {"plant.lag_s": {"uniform": [-0.1, 0.1]}}}, r"line \d+: draw.plant.lag_s.*greater than or equal"),
        ({"draw": {"plant.lag_s": {"unifrom": [0, 1]}}}, "unknown key 'unifrom'.*did you mean 'uniform'"),
        ({"draw": {"plant.lag_s": {"uniform": [1, 0]}}}, "lower end first"),
        ({"draw": {"plant.lag_s": {"log_uniform": [0, 1]}}}, "expected a positive one"),
        ({"draw": {"plant.lag_s": {}}}, "expected one of uniform"),
        ({"count": 3}, "count: got 3 without anything in `draw`"),
        ({"grid": {"plant.lag_s": [0]}, "draw": {"plant.lag_s": {"uniform": [0, 1]}}}, "in `grid` too"),
        ({"base": study_data(tune_pid={"evaluations": 20})}, "tune_pid"),
        ({"base": "nowhere.yaml"}, r"nowhere\.yaml: cannot be read"),
    ],
)
def test_wrong_settings_are_one_line(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    file = tmp_path / "sweep.yaml"
    file.write_text(dump_yaml({"base": study_data()} | changes), encoding="utf-8")
    with pytest.raises(ConfigError, match=message) as error:
        SweepPlan(load_sweep(file), file).check()
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_the_study_may_stand_in_a_file_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text(dump_yaml(study_data()), encoding="utf-8")
    (tmp_path / "sweep.yaml").write_text(dump_yaml({"base": "study.yaml", "draw": DRAW}), encoding="utf-8")
    found = load_sweep(tmp_path / "sweep.yaml", ["count=2"])
    assert {row.id for row in SweepPlan(found).rows()} == {row.id for row in rows(draw=DRAW, count=2)}


def record(identity: str, status: str = "done", value: float | None = 0.1, count: int = 1) -> dict[str, Any]:
    return {"id": identity, "status": status, "value": value, "count": count}


def taken(folder: Path, *records: dict[str, Any]) -> RunTable:
    """A table after one more run of a process."""
    table = RunTable(folder)
    for one in records:
        table.add(one)
    table.flush()
    return table


def values_of(folder: Path) -> dict[str, Any]:
    """The column `value` by id."""
    table = table_of(folder, ["id", "value"])
    return dict(zip(table["id"], table["value"], strict=True))


def test_rows_come_back_to_the_last_bit(tmp_path: Path) -> None:
    values = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, math.nan, -0.0]
    taken(tmp_path, *(record(f"r{k}", value=value) for k, value in enumerate(values)))
    table = table_of(tmp_path, ["id", "value", "count", "more"])
    assert [np.float64(v).tobytes() for v in table["value"]] == [np.float64(v).tobytes() for v in values]
    assert table["id"] == [f"r{k}" for k in range(len(values))]
    assert list(table["count"]) == [1] * len(values)
    assert table["more"] == [None] * len(values)


def test_the_copy_for_reading_has_the_numbers_as_they_are_and_every_column(tmp_path: Path) -> None:
    table = taken(tmp_path, record("a", value=1 / 3), record("b", value=math.nan) | {"more": "x, y"})
    path = table.copy(["id", "value", "settings"])
    assert path == tmp_path / "runs.csv"
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [
        ["id", "value", "status", "count", "more"],
        ["a", repr(1 / 3), "done", "1", ""],
        ["b", "", "done", "1", "x, y"],
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["runs.csv", "runs.db"]


def test_a_table_without_rows_has_no_copy(tmp_path: Path) -> None:
    assert RunTable(tmp_path).copy(["id"]) is None
    assert table_of(tmp_path / "nowhere", ["id"]) == {"id": []}


def test_of_a_row_done_again_the_last_that_was_done_counts(tmp_path: Path) -> None:
    taken(tmp_path, record("a", "failed", None), record("b", value=1.0), record("c", value=3.0))
    taken(tmp_path, record("a", value=2.0), record("b", "failed", None), record("c", value=4.0))
    assert RunTable(tmp_path).done() == {"a", "b", "c"}
    assert values_of(tmp_path) == {"a": 2.0, "b": 1.0, "c": 4.0}


def test_a_damaged_table_is_named(tmp_path: Path) -> None:
    taken(tmp_path, record("a"))
    (tmp_path / "runs.db").write_bytes(b"x" * 5000)
    for read in (RunTable, lambda folder: table_of(folder, ["id"])):
        with pytest.raises(LogError, match=r"runs\.db: not a table of runs .*remove it"):
            read(tmp_path)


@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_however_a_run_is_cut_every_row_is_there_once(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder, ids = tmp_path_factory.mktemp("cut"), [f"{k:02d}" for k in range(12)]
    for _ in range(data.draw(st.integers(1, 4))):
        table = RunTable(folder)
        open_rows = [identity for identity in ids if identity not in table.done()]
        for identity in open_rows[: data.draw(st.integers(0, len(open_rows)))]:
            table.add(record(identity))  # what has not been written by now is lost with the process
        if data.draw(st.booleans()):
            table.copy(["id"])
    table = RunTable(folder)
    for identity in ids:
        if identity not in table.done():
            table.add(record(identity))
    assert table.copy(["id"])
    assert sorted(map(str, table_of(folder, ["id"])["id"])) == ids


WRITER = """
import sys
from pathlib import Path
from hystmpc.sim.sweep.table import RunTable
table = RunTable(Path(sys.argv[1]))
print("ready", flush=True)
for k in range(int(sys.argv[3])):
    table.add({"id": f"{sys.argv[2]}{k:05d}", "status": "done", "settings": "x" * 5000, "value": float(k)})
    table.flush()
    print(k, flush=True)
"""


def writer(folder: Path, name: str, count: int) -> subprocess.Popen[str]:
    """A process that writes rows and says of each that it is written."""
    return subprocess.Popen([sys.executable, "-c", WRITER, folder, name, str(count)], stdout=subprocess.PIPE, text=True)


@pytest.mark.parametrize("wait_s", [0.01, 0.03, 0.1])
def test_what_was_written_before_a_kill_is_there_and_whole(wait_s: float, tmp_path: Path) -> None:
    with writer(tmp_path, "a", 10**5) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(wait_s)
        process.kill()
        said = [int(line) for line in process.stdout.read().splitlines() if line]
    table = table_of(tmp_path, ["id", "value", "settings"])
    assert len(said) <= len(table["id"]) <= len(said) + 1
    assert table["id"] == [f"a{k:05d}" for k in range(len(table["id"]))]
    assert set(table["settings"]) <= {"x" * 5000}
    taken(tmp_path, record("b"))
    assert "b" in RunTable(tmp_path).done()


def test_several_processes_write_into_one_table(tmp_path: Path) -> None:
    processes = [writer(tmp_path, name, 20) for name in "abc"]
    assert [process.communicate()[0].split()[-1] for process in processes] == ["19"] * 3
    assert sorted(map(str, table_of(tmp_path, ["id"])["id"])) == [f"{name}{k:05d}" for name in "abc" for k in range(20)]


def test_settings_of_a_row_are_json() -> None:
    (row, *_) = rows()
    assert json.loads(row.settings)["model"] == "builtin:pi"
