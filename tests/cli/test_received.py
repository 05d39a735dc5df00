"""A folder or a file that one was given runs nothing: no class that it names, no module that lies in it."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc
from hystmpc.bench.config import CommissionSettings, InvestigateSettings
from hystmpc.ctrl.config import GROUP, parse_controller
from hystmpc.ctrl.planner.tip_controller import TipController
from hystmpc.gap.measured_tracking import measured_runs
from hystmpc.rig.config import RunSettings, load_run
from hystmpc.rig.experiment.record import load_record
from hystmpc.rig.experiment.review import review_run
from hystmpc.sim.config import load_simulation
from hystmpc.sim.results import load_results
from hystmpc.sim.sweep.table import table_of
from hystmpc.sim.tuning.settings import TuneSettings, complete
from hystmpc.trials import from_outside
from hystmpc.trials.config import dump_yaml, load_settings, read_yaml
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.from_outside import ALLOWED, allow_python, class_named, given_by, only_reads
from hystmpc.trials.run_folder import RunFolder

from ..sim.small import SCAN, study_data
from .test_verbs import run

pytestmark = pytest.mark.slow  # seconds together

MARK = "ran.txt"  # in the working folder, where a planted module has run
PLANTED = f"open({MARK!r}, 'a').write(__name__ + '\\n')\n"
LAW = """
from hystmpc.ctrl import PidControllerSettings

class Settings(PidControllerSettings):
    kind: str = "planted"
"""
BENCH: dict[str, Any] = {
    "name": "bench",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "safe_command": 0,
    "sensor": {"lower_deg": 0, "upper_deg": 120},
    "latch_file": "latch.json",
}
SIMULATED = {"kind": "simulated", "plant": {"device": "tendon"}}
TIP = {"model": "builtin:pi", "controller": {"kind": "inverse_pid"}}
MOVE = {"kind": "point_to_point", "start_deg": 35, "targets_deg": [40], "holds_s": [0.2]}
RAMPS = {"steps": {"kind": "ramps", "start": 0, "stops": [1, 0], "holds_s": [0.1, 0.1]}}
OWN_LAW, OWN_BUS = {"python": "planted:Settings"}, {"python": "planted:Bus"}
RUN = BENCH | {"transport": SIMULATED, "controller": TIP, "reference": MOVE}
STUDY = study_data(motions={"scan": SCAN}, controllers={"own": OWN_LAW})
SEARCH = {"base": STUDY, "controller": "own", "search": {"gains.kp": {"uniform": [0.01, 0.02]}}, "trials": 3}
NAMED = {  # files that name a class: verb, settings, reader
    "run, transport": ("run", RUN | {"transport": OWN_BUS}, load_run),
    "run, law": ("run", RUN | {"controller": TIP | {"controller": OWN_LAW}}, load_run),
    "record": ("record", BENCH | {"transport": OWN_BUS, "excitations": RAMPS}, load_record),
    "commission": ("commission", BENCH | {"transport": OWN_BUS}, partial(load_settings, CommissionSettings)),
    "investigate": ("investigate", BENCH | {"transport": OWN_BUS}, partial(load_settings, InvestigateSettings)),
    "simulate": ("simulate", STUDY, load_simulation),
    "tune": ("tune", SEARCH, lambda file: complete(load_settings(TuneSettings, file), file)),
    "tip": ("", TIP | {"controller": OWN_LAW}, TipController.from_config),
}


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a module that says when it runs; nobody has said yes to it."""
    (tmp_path / "planted.py").write_text(PLANTED + LAW, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(ALLOWED, "")
    monkeypatch.delitem(sys.modules, "planted", raising=False)
    return tmp_path


def ran(lab: Path) -> list[str]:
    """The planted modules that have run."""
    return (lab / MARK).read_text().split() if (lab / MARK).exists() else []


@pytest.mark.parametrize("name", NAMED)
def test_a_class_that_a_file_names_is_refused_in_one_line(
    name: str, lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    verb, settings, load = NAMED[name]
    file = lab / "given.yaml"
    file.write_text(dump_yaml(settings), encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load(file)
    said = str(refused.value)
    assert "would run" in said
    assert str(lab / "planted.py")[-40:] in said
    assert "--allow-python" in said
    assert "\n" not in said
    if verb:
        code, _, err = run(capsys, verb, file, "--out", lab / "out")
        assert (code, "would run" in err, (lab / "out").exists()) == (2, True, False)
    assert ran(lab) == []


def test_a_refusal_is_short_however_long_the_path(tmp_path: Path, lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path / ("x" * 120) / ("y" * 120)
    deep.mkdir(parents=True)
    (deep / "planted.py").write_text(PLANTED)
    monkeypatch.chdir(deep)
    Path("own.yaml").write_text(dump_yaml(RUN | {"transport": OWN_BUS}))
    with pytest.raises(ConfigError) as refused:
        load_run("own.yaml")
    assert len(str(refused.value)) <= 300


@pytest.mark.parametrize("allowed", ["all", "planted:Settings", "other:Class planted:Settings"])
def test_a_yes_lets_it_run(allowed: str, lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, allowed)
    (lab / "given.yaml").write_text(dump_yaml(STUDY))
    assert load_simulation(lab / "given.yaml").controllers["own"].resolved().kind == "planted"  # type: ignore[attr-defined]
    assert ran(lab) == ["planted"]
    assert str(lab) not in sys.path


@pytest.mark.parametrize("allowed", ["", "planted", "planted:Other", "xplanted:Settings", "ALL", "1"])
def test_another_yes_does_not(allowed: str, lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, allowed)
    (lab / "given.yaml").write_text(dump_yaml(STUDY))
    with pytest.raises(ConfigError, match="would run"):
        load_simulation(lab / "given.yaml")
    assert ran(lab) == []


def test_a_yes_in_a_program(lab: Path) -> None:
    (lab / "given.yaml").write_text(dump_yaml(STUDY))
    allow_python("planted:Other")
    with pytest.raises(ConfigError, match="would run"):
        load_simulation(lab / "given.yaml")
    allow_python("planted:Settings")
    load_simulation(lab / "given.yaml")
    assert ran(lab) == ["planted"]


def test_a_mapping_in_a_program_names_what_is_its_own(lab: Path) -> None:
    assert parse_controller(OWN_LAW).resolved().kind == "planted"  # type: ignore[attr-defined]
    assert RunSettings.parse(RUN | {"transport": {"python": "mine:Bus"}}).transport.kind == "python"


def test_what_is_a_programs_own_does_not_open_the_gate_for_files(lab: Path) -> None:
    RunSettings.parse(RUN | {"transport": {"python": "mine:Bus"}})
    (lab / "given.yaml").write_text(dump_yaml(STUDY))
    with pytest.raises(ConfigError, match="would run"):
        load_simulation(lab / "given.yaml")
    with pytest.raises(ConfigError, match="would run"):
        RunSettings.parse(RUN | {"transport": OWN_BUS}, "given.yaml")


def test_data_within_a_files_data_are_the_files(lab: Path) -> None:
    with given_by("given.yaml"), pytest.raises(ConfigError, match="would run"):
        parse_controller(OWN_LAW)


def test_the_one_import_asks_for_itself(lab: Path) -> None:
    """However a name has come to it."""
    with pytest.raises(ConfigError, match="would run"):
        class_named("planted:Settings", "controller", GROUP, object)
    with only_reads(), pytest.raises(ConfigError, match="not imported"):
        class_named("planted:Settings", "controller", GROUP, object)
    assert ran(lab) == []


def test_a_class_finds_what_is_installed_before_what_lies_beside_it(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    (lab / "colorsys.py").write_text(PLANTED)
    (lab / "planted.py").write_text(PLANTED + "import colorsys, beside\n" + LAW)
    (lab / "beside.py").write_text(PLANTED)
    assert parse_controller(OWN_LAW).resolved()
    assert ran(lab) == ["planted", "beside"]
    del sys.modules["beside"]


def run_folder(path: Path, settings: dict[str, Any]) -> Path:
    """As `run` and `record` leave it."""
    folder = RunFolder.create(path, settings)
    t = np.arange(60) / 25
    columns = {"time_s": t, "command": t / 3, "angle_deg": 30 + t, "reference_deg": 30 + t, "sequence": np.arange(60)}
    columns |= {"predicted_deg": 30 + t, "period_s": t * 0 + 0.04, "lateness_s": t * 0, "stage_law_s": t * 0}
    texts = {"source": ["mpc"] * 60, "status": ["ok"] * 60, "faults": [""] * 60}
    folder.write_log(columns | {"missed": np.zeros(60), "disturbance_deg": t * 0} | texts)
    return path


@pytest.mark.parametrize("allowed", ["", "all"])
@pytest.mark.parametrize("name", ["run, transport", "run, law", "record", "simulate"])
def test_a_report_imports_nothing(
    name: str, allowed: str, lab: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not even what somebody has said yes to for other files."""
    monkeypatch.setenv(ALLOWED, allowed)
    if name == "simulate":
        hystmpc.simulate(STUDY | {"controllers": {"own": {"kind": "pid"}}}, lab / "given")
        for file in (lab / "given").rglob("config.yaml"):
            file.write_text(dump_yaml(read_yaml(file) | {"controllers": {"own": OWN_LAW}}))
    else:
        run_folder(lab / "given", NAMED[name][1])
    monkeypatch.chdir(lab / "given")
    (lab / "given" / "planted.py").write_text(PLANTED + LAW, encoding="utf-8")
    code, _, err = run(capsys, "report", ".")
    assert code == 0, err
    assert (lab / "given" / "report.html").exists()
    assert ran(lab / "given") == []


@pytest.mark.parametrize("read", [review_run, measured_runs, load_results])
def test_a_reader_in_a_program_imports_nothing(read: Any, lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, "all")
    folder = run_folder(lab / "given", STUDY if read is load_results else NAMED["run, law"][1])
    with suppress(LogError, ConfigError):
        read(folder)
    assert ran(lab) == []


def test_a_reader_knows_limits_and_sensor_of_a_class_that_it_does_not_import(lab: Path) -> None:
    own = OWN_LAW | {"limits": {"lower": 1, "upper": 2, "rate_per_s": 3}, "estimator": {"sensor": "none", "mine": 1}}
    with only_reads():
        settings = parse_controller(own | {"gains": {"kp": 0.1}}, "config.yaml")
        odd = parse_controller(OWN_LAW | {"limits": "mine", "estimator": 3}, "config.yaml")
    seen = settings.resolved()
    assert (seen.limits.upper, seen.estimator.sensor) == (2, "none")  # type: ignore[union-attr]
    assert odd.resolved().limits is None
    with pytest.raises(ConfigError, match="planted:Settings is not imported: a report only reads"):
        seen.law(None, None, None)  # type: ignore[arg-type]
    assert ran(lab) == []


def test_an_entry_point_of_an_installed_package_needs_no_yes(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(from_outside, "installed", lambda group: {"own": "planted:Settings"})
    (lab / "given.yaml").write_text(dump_yaml(STUDY | {"controllers": {"own": {"kind": "own"}}}))
    assert load_simulation(lab / "given.yaml").controllers["own"].resolved().kind == "planted"  # type: ignore[attr-defined]


STANDARD = ("json", "struct", "pickle", "socket", "logging", "typing", "types", "numpy", "yaml", "pydantic")


@pytest.fixture
def shadowed(lab: Path) -> Path:
    """A working folder with modules that have names of Python's and of other packages."""
    for name in STANDARD:
        (lab / f"{name}.py").write_text(PLANTED + "raise SystemExit('planted')\n")
    (lab / "bin").mkdir()
    (lab / "bin" / "program.py").write_text(
        "from hystmpc.cli.entry import main\nif __name__ == '__main__':\n    main()\n"
    )
    return lab


def program(lab: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The console script: Python looks into its folder first, and not into the working folder."""
    root = str(Path(hystmpc.__file__).parents[1])
    path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, lab / "bin" / "program.py", *arguments]
    return subprocess.run(
        [*map(str, command)],
        cwd=lab,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "PYTHONPATH": path, ALLOWED: ""},
    )


SWEEP = {"base": study_data(motions={"scan": SCAN}, controllers={"pid": {"kind": "pid"}}), "seeds": [1, 2]}
OWN_SWEEP = {"base": STUDY, "seeds": [1, 2]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "arguments"),
    [
        (RUN, ["run", "given.yaml"]),
        (BENCH | {"transport": SIMULATED, "excitations": RAMPS}, ["record", "given.yaml"]),
        (SWEEP, ["simulate", "--jobs", "2", "--sweep", "given.yaml"]),
    ],
)
def test_no_process_of_a_verb_looks_into_the_working_folder(
    settings: dict[str, Any], arguments: list[str], shadowed: Path
) -> None:
    (shadowed / "given.yaml").write_text(dump_yaml(settings))
    done = program(shadowed, *arguments, "--out", "out")
    assert done.returncode == 0, done.stderr
    assert (shadowed / "out" / "report.html").exists()
    assert ran(shadowed) == []


@pytest.mark.slow
def test_a_yes_reaches_the_workers_and_does_not_open_a_table(shadowed: Path) -> None:
    """What an allowed class imports itself comes from where it is installed."""
    (shadowed / "given.yaml").write_text(dump_yaml(OWN_SWEEP))
    done = program(shadowed, "simulate", "--jobs", "2", "--sweep", "given.yaml", "--out", "out", "--allow-python")
    assert done.returncode == 0, done.stderr
    assert "0 failed" in done.stdout
    assert set(ran(shadowed)) == {"planted"}
    identity = str(table_of(shadowed / "out", ["id"])["id"][0])
    again = program(shadowed, "simulate", "--row", "out", identity)  # a folder that one was given
    assert again.returncode == 2
    assert "would run" in again.stderr


NOTES = ["# my settings\n", '{"a": 1}', "[" * 2000, "\xff"]


@pytest.mark.parametrize("text", NOTES, ids=["text", "json", "deep", "latin"])
def test_a_file_that_a_bench_names_is_neither_replaced_nor_removed(
    text: str, lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a latch, which a stop writes and `--reset` removes; and as the log of a simulated device."""
    mine = lab / "mine.txt"
    mine.write_bytes(text.encode("latin-1"))
    (lab / "run.yaml").write_text(dump_yaml(RUN | {"latch_file": "../" + lab.name + "/mine.txt"}))
    device = {"rate_hz": 25, "command_unit": "mm", "plant": {"device": "tendon"}, "log": "mine.txt"}
    device |= {"limits": BENCH["limits"]}
    link = {"kind": "udp", "bind_port": 0}
    (lab / "device.yaml").write_text(dump_yaml(device | {"link": link}))
    for arguments in (["run", "run.yaml", "--out", "out", "--reset"], ["device", "device.yaml", "--seconds", 0.1]):
        code, _, err = run(capsys, *arguments)
        assert code == 2
        assert "mine.txt" in err
        assert "another kind of file" in err or "cannot be written" in err
    assert mine.read_bytes() == text.encode("latin-1")


def test_a_latch_that_is_one_or_empty_or_new_is_taken(lab: Path) -> None:
    (lab / "run.yaml").write_text(dump_yaml(RUN))
    for text in (None, "", '{"cause": "SIGTERM", "since": "now", "pid": 1}'):
        if text is not None:
            (lab / "latch.json").write_text(text)
        assert load_run(lab / "run.yaml").latch_file == lab / "latch.json"
