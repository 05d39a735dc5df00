"""Replay: the user's simulator plays the commands behind the named effects, and says how far the gap shrinks in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.gap.logs.simulated import as_simulated, with_output
from hystmpc.gap.replay import Replays
from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.baseline import baseline_of
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.runs import command_range, runs_of
from hystmpc.models.operators.dynamics import Lag
from hystmpc.trials.csv_files import format_table, write_csv
from hystmpc.trials.errors import GapError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.zoo import STATIC_PI
from .engine_examples import DT, simulator_of
from .test_simulated import crept, own_simulator, trials_of, without_output

ONLY = ("creep", "lag", "slack")


class Joints:
    """The example's own simulator as an object."""

    def run(self, command: Vec, dt: float) -> Vec:
        del dt
        return own_simulator(command)


def lagged(command: Vec, tau_s: float = 0.15) -> Vec:
    """Drive behind a lag; each command is held over its sample."""
    drive, travel = command[0], np.empty_like(command)
    for k, u in enumerate(command):
        drive += (u - drive) * (1 - np.exp(-DT / tau_s))
        travel[k] = drive
    return travel


@cache
def stand_in() -> hystmpc.Fit:
    """Plays that differ from the simulator by ten floors."""
    return hystmpc.fit("pi", [as_simulated(trial) for trial in trials_of(seconds=30.0)])


def diagnosed(trials: Sequence[Trial], **more: Any) -> Diagnosis:
    return hystmpc.diagnose(trials, stand_in(), only=ONLY, ordered=True, **more)


def play(folder: Path, out: Path, gain: float = 1.0) -> None:
    """The user's part: his simulator plays each file of a folder."""
    for file in folder.glob("*.csv"):
        columns = np.genfromtxt(file, delimiter=",", names=True)
        output = gain * own_simulator(columns["command"])
        table = {"time_s": columns["time_s"], "command": columns["command"], "simulated_deg": output}
        out.mkdir(exist_ok=True)
        (out / file.name).write_text(format_table(table), encoding="utf-8")


def test_the_command_behind_effects_is_what_the_nominal_chain_gets() -> None:
    """The nominal chain on it gives what the whole chain gives on the recorded command."""
    trials = [as_simulated(trial) for trial in trials_of(seconds=15.0)]
    chain = simulator_of(STATIC_PI).chain
    baseline, runs = baseline_of(chain, command_range(trials)), runs_of(trials)
    lag = next(c for c in candidates(Scale.of(runs), ()) if c.label == "lag/held commands")
    joined, alone = Problem(baseline, [lag]), Problem(baseline)
    q = joined.start(baseline.nominal, [(0.2,)])
    for run in runs:
        behind = joined.filtered(q, run)
        np.testing.assert_array_equal(alone.filtered(alone.as_given, run), run.command)
        np.testing.assert_allclose(behind[:3], run.command[:3], atol=0.5 * np.ptp(run.command))
        there = replace(run, command=behind)
        np.testing.assert_allclose(alone.angles(alone.as_given, there), joined.angles(q, run), atol=1e-9)
    assert isinstance(lag.operators[0], Lag)


@pytest.mark.slow
@pytest.mark.parametrize("drive", [crept, lagged], ids=["creep", "lag"])
def test_a_called_simulator_confirms_the_effect_alone(drive: Callable[[Vec], Vec]) -> None:
    """The confirmed share is the said one, and the simulator alone on the replayed commands is at the floor."""
    trials = [without_output(trial) for trial in trials_of(drive)]
    found = hystmpc.diagnose(trials, Joints(), only=ONLY, ordered=True)
    (effect,) = found.effects
    assert effect.name == {"crept": "creep", "lagged": "lag"}[drive.__name__]
    confirmed = found.confirmed[effect.name]
    assert confirmed.closed_share == pytest.approx(effect.closed_share, abs=0.1)
    assert confirmed.ci90[0] < confirmed.closed_share < confirmed.ci90[1]
    assert found.confirmed_rmse_deg is not None
    assert found.confirmed_rmse_deg < 0.2 * found.gap.retuned_rmse_deg
    assert found.as_json()["confirmed"][effect.name]["closed_share"] == confirmed.closed_share


@pytest.mark.slow
def test_files_that_the_user_plays_confirm_as_well(tmp_path: Path) -> None:
    """From files to confirmation; a simulator that answers otherwise does not confirm."""
    trials, out = trials_of(lagged), tmp_path / "d"
    found = diagnosed(trials, out=out)
    assert [effect.name for effect in found.effects] == ["lag"]
    assert sorted(found.replay) == sorted(file.name for file in (out / "replay").iterdir())
    assert len(found.replay) == len(found.gap.final_trials)
    assert "--confirm" in (out / "report.html").read_text(encoding="utf-8")
    logs = {Path(trial.source).stem: trial for trial in trials}
    for name in found.replay:  # what the simulator alone gives is the device's angle
        command = np.genfromtxt(out / "replay" / name, delimiter=",", names=True)["command"]
        error = own_simulator(command) - logs[name.split(".")[0]].angle
        assert np.sqrt(np.mean(error**2)) < 0.3 * found.gap.nominal_rmse_deg
    play(out / "replay", tmp_path / "played")
    again = diagnosed(trials, out=out, confirm=tmp_path / "played")
    assert again.confirmed_rmse_deg is not None
    assert again.confirmed_rmse_deg < again.gap.with_effects_rmse_deg
    assert again.confirmed["lag"].closed_share > 0.9
    assert "Your simulator has played" in (out / "report.html").read_text(encoding="utf-8")
    play(out / "replay", tmp_path / "other", gain=0.5)
    other = diagnosed(trials, confirm=tmp_path / "other")
    assert other.confirmed["lag"].closed_share < 0.5


@pytest.mark.slow
def test_what_the_user_has_played_is_never_replaced(tmp_path: Path) -> None:
    trials, out = trials_of(lagged), tmp_path / "d"
    diagnosed(trials, out=out)
    play(out / "replay", out / "replay")
    (out / "replay" / "notes.csv").write_text("time_s,simulated_deg\n0,1\n")
    before = {file.name: file.read_bytes() for file in (out / "replay").iterdir()}
    diagnosed(trials, out=out)
    again = diagnosed(trials, out=out, confirm=out / "replay")
    assert {file.name: file.read_bytes() for file in (out / "replay").iterdir()} == before
    assert again.confirmed["lag"].closed_share > 0.9
    wrong = again.replay[0]
    write_csv(with_output(trials[0], np.zeros(len(trials[0]))), out / "replay" / wrong)
    with pytest.raises(GapError, match=r"its command differs by .* mm RMS from that of"):
        diagnosed(trials, confirm=out / "replay")


def test_a_diagnosis_without_an_effect_on_the_command_has_nothing_to_replay(tmp_path: Path) -> None:
    found = diagnosed(trials_of(seconds=20.0), out=tmp_path / "d")
    assert (found.verdict, found.replay, dict(found.confirmed)) == ("none", (), {})
    assert not (tmp_path / "d" / "replay").exists()


@pytest.mark.slow
def test_effects_that_no_replay_tests_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hystmpc.gap.replay.replays_of", lambda findings: Replays({}, (), ()))
    found = diagnosed(trials_of(lagged), confirm=tmp_path)
    assert found.effects
    assert any("No replay confirms" in note for note in found.notes)
