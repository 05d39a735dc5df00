"""A verb and its function do the same: equal files on equal input, and the same line where they refuse."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc
from hystmpc.models.simulator import save_simulator
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.types import Vec

from ..bench.small_commission import BENCH, make_quick
from ..bench.small_investigate import bench
from ..cli.test_verbs import run
from ..models.zoo import CHAINS, simulator
from ..sim.small import SCAN, study_data

Call = Callable[[], object]
STUDY = study_data(motions={"scan": SCAN}, controllers={"pid": {"kind": "pid"}})
SWEEP = {"base": STUDY, "draw": {"plant.lag_s": {"uniform": [0.0, 0.1]}}, "count": 1}
FEW = {"plants": {"count": 1, "seed": 1}, "held_out": {"count": 1, "seed": 2}, "trials": 1}
TUNE = {"base": STUDY, "draw": SWEEP["draw"]} | FEW
TIP = {"model": "builtin:pi", "controller": {"kind": "linearised_mpc"}}


def play(command: Vec, width: float) -> Vec:
    """Backlash: what follows the command with a gap of `width` to either side."""
    out, slider = np.empty_like(command), command[0] + width
    for k, u in enumerate(command):
        slider = out[k] = min(max(slider, u - width), u + width)
    return out


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of every kind that a task reads."""
    folder = tmp_path_factory.mktemp("inputs")
    t, rng = np.arange(0, 12, 0.04), np.random.default_rng(3)
    for k, hz in enumerate((0.2, 0.3, 0.25)):
        command = (3 - 0.4 * k) * (1 - np.cos(2 * np.pi * hz * t))
        angle = 20 + 9 * play(command, 0.3) + rng.normal(0, 0.1, t.size)
        hystmpc.write_csv(hystmpc.Trial(t, command, angle), folder / f"trial_{k}.csv")
    hystmpc.write_csv(hystmpc.Trial(1000 * t, command, angle), folder / "milliseconds.csv")
    expected = {"separation_deg": np.ones(t.size)}
    hystmpc.write_csv(hystmpc.Trial(t, command, angle, channels=expected), folder / "next_motion.csv")
    save_simulator(simulator(CHAINS["backlash"]), folder / "sim.yaml")
    data = {"study": STUDY, "sweep": SWEEP, "tune": TUNE, "tip": TIP, "pid": {"kind": "pid"}, "commission": BENCH}
    data["investigate"] = bench() | {"latch_file": "latch.json"}
    for name, content in data.items():
        (folder / f"{name}.yaml").write_text(dump_yaml(content), encoding="utf-8")
    (folder / "notes.json").write_text('{"mine": true}')
    (folder / "taken").mkdir()
    (folder / "taken" / "thesis.tex").write_text("years of work")
    return folder


LOGS = [f"trial_{k}.csv" for k in range(3)]
# name: words of the verb, and the function on the same input; in a folder with the inputs
SAME: dict[str, tuple[str, Call]] = {
    "check": ("check trial_0.csv --sim sim.yaml", lambda: hystmpc.check("trial_0.csv", simulator="sim.yaml")),
    "fit": (
        "fit backlash trial_0.csv trial_1.csv --test trial_2.csv --out m.yaml --report page.html",
        lambda: hystmpc.fit("backlash", LOGS[:2], "m.yaml", test=LOGS[2:], report="page.html"),
    ),
    "fit to ONNX": (
        "fit pi trial_0.csv --out m.onnx --plays 3 --direction inverse --skip-first-flexure --rate-hz 20 --seed 2",
        lambda: hystmpc.fit(
            "pi", LOGS[0], "m.onnx", plays=3, inverse=True, skip_first_flexure=True, rate_hz=20.0, seed=2
        ),
    ),
    "evaluate": (
        "evaluate sim.yaml trial_0.csv --json e.json --report page.html",
        lambda: hystmpc.evaluate("sim.yaml", LOGS[0], json="e.json", report="page.html"),
    ),
    "export": ("export sim.yaml --out m.onnx", lambda: hystmpc.export("sim.yaml", "m.onnx")),
    "export-c": ("export-c tip.yaml --out c --float32", lambda: hystmpc.export_c("tip.yaml", "c", single=True)),
    "export-fmu": ("export-fmu study.yaml --out d.fmu", lambda: hystmpc.export_fmu("study.yaml", "d.fmu")),
    "diagnose": (
        "diagnose trial_0.csv trial_1.csv trial_2.csv --sim sim.yaml --out d --only lag --only delay --ordered",
        lambda: hystmpc.diagnose(LOGS, "sim.yaml", "d", only=("lag", "delay"), ordered=True),
    ),
    "analyse": ("analyse tip.yaml --out a", lambda: hystmpc.analyse("tip.yaml", "a")),
    "simulate": (
        "simulate study.yaml --out run --set plant.lag_s=0.05 --controller second=pid.yaml",
        lambda: hystmpc.simulate(
            "study.yaml", "run", overrides=["plant.lag_s=0.05"], controllers={"second": "pid.yaml"}
        ),
    ),
    "sweep": ("simulate --sweep sweep.yaml --out s --jobs 1", lambda: hystmpc.sweep("sweep.yaml", "s")),
    "tune": ("tune tune.yaml --out t --jobs 1", lambda: hystmpc.tune("tune.yaml", "t")),
    "report": ("report run", lambda: hystmpc.report("run")),
    "commission": (
        "commission commission.yaml --logs trial_0.csv --logs trial_1.csv --logs trial_2.csv --out c",
        lambda: hystmpc.commission("commission.yaml", "c", logs=LOGS),
    ),
}
SLOW = {"diagnose", "simulate", "sweep", "tune", "report", "commission", "export-fmu", "fit", "fit to ONNX", "evaluate"}
EXTRAS = {"tune": "optuna"}
REFUSED: tuple[tuple[str, Call], ...] = (
    ("analyse trial_0.csv", lambda: hystmpc.analyse("trial_0.csv")),
    ("analyse sweep.yaml", lambda: hystmpc.analyse("sweep.yaml")),
    ("analyse tip.yaml --command 99", lambda: hystmpc.analyse("tip.yaml", command=99.0)),
    ("check missing.csv", lambda: hystmpc.check("missing.csv")),
    ("check trial_0.csv --sim trial_0.csv", lambda: hystmpc.check(LOGS[0], simulator=LOGS[0])),
    ("fit pj trial_0.csv --out m.yaml", lambda: hystmpc.fit("pj", LOGS[0], "m.yaml")),
    ("fit pi missing.csv --out m.yaml", lambda: hystmpc.fit("pi", "missing.csv", "m.yaml")),
    ("fit pi trial_0.csv --out m.txt", lambda: hystmpc.fit("pi", LOGS[0], "m.txt")),
    ("fit pi trial_0.csv --out sim.yaml", lambda: hystmpc.fit("pi", LOGS[0], "sim.yaml")),
    ("fit pi trial_0.csv --out pid.yaml --force", lambda: hystmpc.fit("pi", LOGS[0], "pid.yaml", force=True)),
    ("fit pi trial_0.csv --out m.yaml --training b", lambda: hystmpc.fit("pi", LOGS[0], "m.yaml", training="b")),
    ("fit pi trial_0.csv --out m.yaml --layout tendon", lambda: hystmpc.fit("pi", LOGS[0], "m.yaml", layout="tendon")),
    ("fit pi trial_0.csv --out m.yaml --rate-hz 99", lambda: hystmpc.fit("pi", LOGS[0], "m.yaml", rate_hz=99.0)),
    ("fit pi next_motion.csv --out m.yaml", lambda: hystmpc.fit("pi", "next_motion.csv", "m.yaml")),
    ("fit pi milliseconds.csv --out m.yaml", lambda: hystmpc.fit("pi", "milliseconds.csv", "m.yaml")),
    (
        "fit pi trial_0.csv --test trial_0.csv --out m.yaml",
        lambda: hystmpc.fit("pi", LOGS[0], "m.yaml", test=LOGS[0]),
    ),
    (
        "fit pi trial_0.csv --out m.yaml --figures f",
        lambda: hystmpc.fit("pi", LOGS[0], "m.yaml", figures="f"),
    ),
    ("fit auto trial_0.csv --out m.yaml --drive auto", lambda: hystmpc.fit("auto", LOGS[0], "m.yaml", drive="auto")),
    ("evaluate m.pkl trial_0.csv", lambda: hystmpc.evaluate("m.pkl", LOGS[0])),
    ("evaluate sim.yaml next_motion.csv", lambda: hystmpc.evaluate("sim.yaml", "next_motion.csv")),
    (
        "evaluate sim.yaml trial_0.csv --json notes.json --force",
        lambda: hystmpc.evaluate("sim.yaml", LOGS[0], json="notes.json", force=True),
    ),
    (
        "evaluate sim.yaml trial_0.csv --report trial_0.csv",
        lambda: hystmpc.evaluate("sim.yaml", LOGS[0], report=LOGS[0]),
    ),
    ("export sim.yaml --out sim.yaml", lambda: hystmpc.export("sim.yaml", "sim.yaml")),
    ("export absent.yaml --out m.onnx", lambda: hystmpc.export("absent.yaml", "m.onnx")),
    ("export builtin:pj --out m.onnx", lambda: hystmpc.export("builtin:pj", "m.onnx")),
    ("export-c absent.yaml --out c", lambda: hystmpc.export_c("absent.yaml", "c")),
    ("export-c tip.yaml --out notes.json", lambda: hystmpc.export_c("tip.yaml", "notes.json")),
    ("export-fmu trial_0.csv --out d.fmu", lambda: hystmpc.export_fmu("trial_0.csv", "d.fmu")),
    ("export-fmu sim.yaml --out d.zip", lambda: hystmpc.export_fmu("sim.yaml", "d.zip")),
    ("diagnose trial_0.csv --sim s.pkl --out d", lambda: hystmpc.diagnose(LOGS[0], "s.pkl", "d")),
    ("diagnose trial_0.csv --sim sim.yaml --out taken", lambda: hystmpc.diagnose(LOGS[0], "sim.yaml", "taken")),
    (
        "diagnose trial_0.csv next_motion.csv --sim sim.yaml --out d",
        lambda: hystmpc.diagnose([LOGS[0], "next_motion.csv"], "sim.yaml", "d"),
    ),
    (
        "diagnose trial_0.csv --sim sim.yaml --out d --only lagg",
        lambda: hystmpc.diagnose(LOGS[0], "sim.yaml", "d", only=["lagg"]),
    ),
    (
        "diagnose trial_0.csv --sim sim.yaml --out d --figures taken",
        lambda: hystmpc.diagnose(LOGS[0], "sim.yaml", "d", figures="taken"),
    ),
    ("simulate absent.yaml --out run", lambda: hystmpc.simulate("absent.yaml", "run")),
    ("simulate study.yaml --out taken", lambda: hystmpc.simulate("study.yaml", "taken")),
    (
        "simulate study.yaml --out run --set plant.lagg=1",
        lambda: hystmpc.simulate("study.yaml", "run", overrides=["plant.lagg=1"]),
    ),
    (
        "simulate study.yaml --out run --controller a=study.yaml",
        lambda: hystmpc.simulate("study.yaml", "run", controllers={"a": "study.yaml"}),
    ),
    ("simulate --sweep study.yaml --out s", lambda: hystmpc.sweep("study.yaml", "s", jobs=None)),
    ("simulate --sweep sweep.yaml --out s --jobs 0", lambda: hystmpc.sweep("sweep.yaml", "s", jobs=0)),
    (
        "simulate --sweep sweep.yaml --out s --cluster here",
        lambda: hystmpc.sweep("sweep.yaml", "s", jobs=None, cluster="here"),
    ),
    ("simulate --row taken 01", lambda: hystmpc.reproduce("taken", "01")),
    ("tune study.yaml --out t", lambda: hystmpc.tune("study.yaml", "t", jobs=None)),
    ("tune tune.yaml --out taken", lambda: hystmpc.tune("tune.yaml", "taken", jobs=None)),
    ("report taken", lambda: hystmpc.report("taken")),
    ("commission --out c", lambda: hystmpc.commission(None, "c")),
    ("commission commission.yaml", lambda: hystmpc.commission("commission.yaml", None)),
    (
        "commission --out c --logs trial_0.csv --set rate_hz=50",
        lambda: hystmpc.commission(None, "c", logs=LOGS[:1], overrides=["rate_hz=50"]),
    ),
    ("commission commission.yaml --out taken", lambda: hystmpc.commission("commission.yaml", "taken")),
    ("investigate investigate.yaml", lambda: hystmpc.investigate("investigate.yaml", None)),
    (
        "investigate investigate.yaml --out i --minutes 31",
        lambda: hystmpc.investigate("investigate.yaml", "i", minutes=31.0),
    ),
    (
        "investigate investigate.yaml --out i --model none.yaml",
        lambda: hystmpc.investigate("investigate.yaml", "i", model="none.yaml"),
    ),
)


@pytest.fixture
def still_clocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every step takes no time: how fast something was computed stands in logs and reports."""
    for clock in ("time.perf_counter", "time.process_time", "hystmpc.ctrl.guarded.perf_counter"):
        monkeypatch.setattr(clock, lambda: 0.0)
    make_quick(monkeypatch)


def in_copy(inputs: Path, folder: Path, patch: pytest.MonkeyPatch) -> Path:
    """The inputs once more, as the present folder."""
    shutil.copytree(inputs, folder)
    patch.chdir(folder)
    return folder


def files(folder: Path) -> dict[str, Any]:
    """Content of every file, without what tells when, where and how fast it was made."""
    return {str(p.relative_to(folder)): content(p) for p in sorted(folder.rglob("*")) if p.is_file()}


def content(path: Path) -> Any:
    data = path.read_bytes()
    if path.suffix in WITH_TIMES or path.name in WITH_TIMES:
        return None
    if path.suffix not in (".json", ".yaml", ".html", ".csv"):
        return data
    text = data.decode()
    if path.name == "meta.json":
        return {k: v for k, v in json.loads(text).items() if k not in ("start", "command_line")}
    return TIME.sub("TIME", text)


WITH_TIMES = (".mcap", "search.db")
"""Files whose other form, log.csv, trials.csv or the report, is compared."""
TIME = re.compile(r"20\d\d-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?( UTC)?")


@pytest.mark.usefixtures("still_clocks")
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in SAME])
def test_a_verb_and_its_function_leave_the_same_files(
    name: str, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if name in EXTRAS:
        pytest.importorskip(EXTRAS[name], reason="is an extra")
    words, call = SAME[name]
    if name == "report":  # of one run: two take different times
        inputs = in_copy(inputs, tmp_path / "simulated", monkeypatch)
        hystmpc.simulate("study.yaml", "run")
    folder = in_copy(inputs, tmp_path / "work", monkeypatch)
    code, _, err = run(capsys, *words.split())
    assert code == 0, err
    left = files(folder)
    shutil.rmtree(folder)
    in_copy(inputs, folder, monkeypatch)
    call()
    right = files(folder)
    assert set(left) == set(right)
    assert [file for file in left if left[file] != right[file]] == []
    assert (set(left) == set(files(inputs))) == (name in ("check", "report"))


@pytest.mark.parametrize(("words", "call"), REFUSED, ids=[words for words, _ in REFUSED])
def test_a_verb_and_its_function_refuse_in_the_same_line(
    words: str,
    call: Call,
    inputs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = in_copy(inputs, tmp_path / "work", monkeypatch)
    before = files(folder)
    code, _, err = run(capsys, *words.split())
    assert code == 2, err
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    with pytest.raises(hystmpc.HystmpcError) as refused:
        call()
    assert line == f"error: {' '.join(str(refused.value).split())}"
    assert files(folder) == before, "nothing may stay behind"
