"""Simulators of the user that can be called: objects, classes that a file names, and FMUs."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hystmpc
from hystmpc.codegen.fmu import FmuVersion
from hystmpc.gap.logs.simulated import SIMULATED, as_simulated
from hystmpc.gap.user_simulator import names_user_simulator, open_simulator, played
from hystmpc.models.load import library_file, load_simulator
from hystmpc.sim import SimulatedPlant
from hystmpc.trials.errors import ConfigError, HystmpcError
from hystmpc.trials.from_outside import ALLOWED
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..codegen.compiled import EXAMPLES
from .engine_examples import DT, moves, sine

CLASSES = """
import numpy as np

class Gain:
    def __init__(self, deg_per_mm=10.0):
        self.gain = deg_per_mm

    def run(self, command, dt):
        return self.gain * command + dt

class Still: pass

class Unmade(Gain):
    def __init__(self): raise OSError("no licence server\\nasked three times")

class Broken(Gain):
    def run(self, command, dt): raise RuntimeError("step 7\\ndiverged" + 500 * "!")

class Ends(Gain):
    def run(self, command, dt): raise SystemExit(3)

class Short(Gain):
    def run(self, command, dt): return command[1:]

class Holes(Gain):
    def run(self, command, dt): return np.where(command > 5.0, np.nan, command)
"""
MODULE = "simulators_of_a_test"
MOTIONS = {"t0.csv": sine(0.2, 6.0), "t1.csv": moves(1, 6.0)}
TRIALS = [Trial(DT * np.arange(u.size), u, 0 * u, source=name) for name, u in MOTIONS.items()]


@pytest.fixture
def tip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """File that names the class `Gain` of a module of the working folder; its import is allowed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(ALLOWED, "all")
    (tmp_path / f"{MODULE}.py").write_text(CLASSES)
    yield named(tmp_path / "tip.yaml", "Gain")
    sys.modules.pop(MODULE, None)


def named(file: Path, kind: str, more: str = "") -> Path:
    file.write_text(f"simulator:\n  python: {MODULE}:{kind}\n{more}")
    return file


def outputs(trials: list[Trial]) -> Vec:
    return np.concatenate([as_simulated(trial).angle for trial in trials])


class Gain:
    """The class of the file, as an object of this program."""

    def run(self, command: Vec, dt: float, /) -> Vec:
        return 12.0 * command + dt


def test_an_object_a_file_in_turn_and_in_processes_are_the_same(tip: Path) -> None:
    named(tip, "Gain", "  deg_per_mm: 12.0\n")
    wanted = np.concatenate([12.0 * trial.command + DT for trial in TRIALS])
    for simulator, jobs in ((Gain(), 1), (tip, 1), (tip, 2)):
        np.testing.assert_allclose(outputs(played(simulator, TRIALS, jobs)), wanted, rtol=1e-12)


def test_a_file_that_was_edited_is_read_again(tip: Path) -> None:
    before = outputs(played(tip, TRIALS))
    after = outputs(played(named(tip, "Gain", "  deg_per_mm: 20.0\n"), TRIALS))
    np.testing.assert_allclose(after - DT, 2 * (before - DT), atol=1e-9)


def test_output_replaces_an_older_column_and_is_at_the_samples_of_the_log() -> None:
    uneven = DT * np.arange(100) + 0.1 * DT * np.sin(np.arange(100))
    trial = Trial(uneven, uneven, 0 * uneven, channels={"simulated_deg": 0 * uneven, "force_N": uneven})
    (found,) = played(Gain(), [trial])
    assert set(found.channels) == {SIMULATED, "force_N"}
    wanted = 12.0 * uneven + trial.dt
    np.testing.assert_allclose(as_simulated(found).angle[:-1], wanted[:-1], atol=1e-9)  # the clock of `run` ends first


def test_only_fmus_and_files_that_name_a_class_are_own_simulators(tip: Path) -> None:
    model = library_file("pi")
    assert names_user_simulator(tip)
    assert names_user_simulator(Path("a.FMU"))
    assert not names_user_simulator(model)
    assert not names_user_simulator(Path("builtin:pi"))


def test_a_class_of_a_file_is_not_imported_without_a_yes(tip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ALLOWED)
    with pytest.raises(ConfigError, match=r"tip\.yaml: simulator: .*would run .*--allow-python") as caught:
        hystmpc.diagnose(TRIALS, tip)
    assert MODULE not in sys.modules
    assert len(str(caught.value)) <= 300


REFUSED = {
    "argument": ("Gain", "  deg_per_m: 1.0\n", r"tip\.yaml: simulator .*deg_per_m.*did you mean 'deg_per_mm'"),
    "no run": ("Still", "", r"tip\.yaml: simulator .*got a class without `run`, expected run\(command, dt\)"),
    "no class": ("Gian", "", r"tip\.yaml: simulator .*no class 'Gian'"),
    "not made": ("Unmade", "", r"tip\.yaml: .*cannot be made \(OSError: no licence server asked three times\)"),
    "raises": ("Broken", "", r"t0\.csv: the simulator's run ended with RuntimeError: step 7 diverged!"),
    "ends": ("Ends", "", r"t0\.csv: the simulator's run ended with SystemExit: 3"),
    "shape": ("Short", "", r"t0\.csv: .* gave \(149,\) .*expected one number for each of 150 commands"),
    "not finite": ("Holes", "", r"t0\.csv: .* gave \(150,\) with \d+ not finite"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_simulator_is_refused_in_one_line(case: str, tip: Path) -> None:
    kind, more, message = REFUSED[case]
    with pytest.raises(HystmpcError, match=message) as caught:
        hystmpc.diagnose(TRIALS, named(tip, kind, more), jobs=1)
    assert len(str(caught.value)) <= 300
    assert "\n" not in str(caught.value)


def test_an_error_in_a_process_is_the_same(tip: Path) -> None:
    with pytest.raises(HystmpcError, match="the simulator's run ended with RuntimeError: step 7 diverged!"):
        played(named(tip, "Broken"), TRIALS, jobs=2)


def test_the_steps_of_playing_and_of_the_stand_in_are_of_a_hundred() -> None:
    """As those of the diagnosis: the command line adds the steps of the report to them."""
    totals = set()

    def stopped(done: float, total: float, note: str = "", /) -> None:
        totals.add(total)
        if "stand-in" in note:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hystmpc.diagnose(TRIALS, Gain(), progress=stopped)
    assert totals == {100.0}


def test_a_simulator_that_runs_needs_no_folder_of_its_output(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected no --simulated and no --confirm"):
        hystmpc.diagnose(TRIALS, Gain(), simulated=tmp_path)


@pytest.mark.slow
def test_a_lag_of_a_device_in_mujoco_is_named_and_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind the lag the simulator itself does what the device does."""
    pytest.importorskip("mujoco", reason="mujoco is a tool of development")
    monkeypatch.syspath_prepend(EXAMPLES / "mujoco_tip")
    from tip import Tip  # type: ignore[import-not-found]
    from tip_devices import DT_S, angles_deg, commands_mm  # type: ignore[import-not-found]

    trials = [
        Trial(DT_S * np.arange(u.size), u, angle, source=f"trial_{k}.csv")
        for k, (u, angle) in enumerate(zip(commands_mm(), angles_deg("lag"), strict=True))
    ]
    found = hystmpc.diagnose(trials, Tip(), only=("creep", "lag", "slack"), ordered=True)
    assert (found.verdict, [effect.name for effect in found.effects]) == ("named", ["lag"])
    assert found.effects[0].parameters["tau_s"] == pytest.approx(0.15, rel=0.1)
    assert found.confirmed["lag"].closed_share == pytest.approx(found.effects[0].closed_share, abs=0.1)
    assert found.confirmed_rmse_deg == pytest.approx(found.gap.floor_rmse_deg, rel=0.5)


def fmu_of(plant: SimulatedPlant, path: Path, version: FmuVersion) -> Path:
    pytest.importorskip("fmpy", reason="fmpy is a tool of development")
    from ..codegen.importer import written

    return written(plant, path, version)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_fmu_of_a_simulator_is_its_free_run(version: FmuVersion, tmp_path: Path) -> None:
    """From its rest on; steps that it refuses end the run, which fmpy would repeat for ever."""
    plant = SimulatedPlant(load_simulator(library_file("pi")))
    fmu = fmu_of(plant, tmp_path / "tip.fmu", version)
    from ..codegen.importer import by_python

    trial = replace(TRIALS[1], command=TRIALS[1].command + plant.rest_command)
    (found,) = played(fmu, [trial])
    np.testing.assert_allclose(as_simulated(found).angle, by_python(plant, trial.command)[1:], atol=1e-9)
    with pytest.raises(HystmpcError, match=r"tip\.fmu: ends after 0 s .*got 0\.02 s, expected a whole multiple"):
        open_simulator(fmu).run(trial.command, 0.02)


def test_an_fmu_with_several_outputs_is_refused(tmp_path: Path) -> None:
    fmu = fmu_of(SimulatedPlant(load_simulator(library_file("pi"))), tmp_path / "one.fmu", "3.0")
    with zipfile.ZipFile(fmu) as one, zipfile.ZipFile(tmp_path / "two.fmu", "w") as two:
        text = one.read("modelDescription.xml").decode()
        variable = next(line for line in text.splitlines() if 'causality="output"' in line)
        another = variable.replace('name="angle"', 'name="force"').replace('valueReference="2"', 'valueReference="3"')
        text = text.replace(variable, f"{variable}\n{another}")
        for what in ("Output", "InitialUnknown"):
            of_both = "".join(f'<{what} valueReference="{number}" />' for number in (2, 3))
            text = text.replace(f'<{what} valueReference="2" dependencies="" />', of_both)
        two.writestr("modelDescription.xml", text)
    with pytest.raises(HystmpcError, match=r"two\.fmu: got 2 outputs \(angle, force\), expected one output"):
        hystmpc.diagnose(TRIALS, tmp_path / "two.fmu")


def test_a_file_that_is_no_fmu_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("fmpy", reason="fmpy is a tool of development")
    (tmp_path / "tip.fmu").write_text("not a zip")
    with pytest.raises(ConfigError, match=r"tip\.fmu: not usable as an FMU"):
        hystmpc.diagnose(TRIALS, tmp_path / "tip.fmu")
