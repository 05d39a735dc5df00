"""The user's own simulator: its output counts, whatever the stand-in that says how an effect would change it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hystmpc
from hystmpc.gap.logs.preparation import prepare
from hystmpc.gap.logs.simulated import as_simulated, have_simulated, with_simulated
from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.problem import Problem
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Line
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError, GapError
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from ..models.zoo import BACKLASH, STATIC_PI
from .engine_examples import DT, moves, simulator_of, sine

STAND_INS: dict[str, Operator] = {"line": Line(11.0, 20.0), "backlash": BACKLASH, "plays": STATIC_PI}


def own_simulator(command: Vec) -> Vec:
    """Twelve joints with friction of their own before a curve, which no operator has."""
    friction = np.linspace(0.05, 0.4, 12)
    joints, angle = command[0] + friction, np.empty_like(command)
    for k, u in enumerate(command):
        joints = np.clip(joints, u - friction, u + friction)
        x = joints.mean()
        angle[k] = 12 + 9 * x + 0.9 * x**2 - 0.05 * x**3 + 2 * np.tanh(x - 3)
    return angle


def crept(command: Vec, share: float = 0.15, tau_s: float = 5.0) -> Vec:
    """Drive whose travel goes on after the command."""
    slow, travel = command[0], np.empty_like(command)
    for k, u in enumerate(command):
        travel[k] = (1 - share) * u + share * slow
        slow += DT / tau_s * (u - slow)
    return travel


def trials_of(drive: Callable[[Vec], Vec] = np.copy, noise_deg: float = 0.1, seconds: float = 40.0) -> list[Trial]:
    """A device that is the simulator behind a drive, with the simulator's output beside."""
    random, commands = np.random.default_rng(1), [sine(0.1, seconds), sine(0.3, seconds)]
    commands += [moves(seed, seconds, hold_s=4.0) for seed in (1, 2, 3, 4)]
    return [
        Trial(
            DT * np.arange(u.size),
            u,
            own_simulator(drive(u)) + noise_deg * random.standard_normal(u.size),
            source=f"trial_{k}.csv",
            channels={"simulated_deg": own_simulator(u)},
        )
        for k, u in enumerate(commands)
    ]


def without_output(trial: Trial) -> Trial:
    return replace(trial, channels={})


@pytest.mark.parametrize("name", STAND_INS)
def test_without_an_effect_the_prediction_is_the_output_of_the_simulator(name: str) -> None:
    """To the last digits, of a device that begins as the simulator does; the stand-in's error is taken off."""
    trials = trials_of(noise_deg=0.0, seconds=15.0)
    prepared = prepare(trials, simulator_of(STAND_INS[name]))
    problem = Problem(prepared.baseline)
    given = Hypothesis(problem, problem.as_given, 0.0)
    for run, trial, left in zip(prepared.everything, trials, prepared.residuals(given), strict=True):
        assert np.abs(left).max() < 1e-9 * np.ptp(trial.angle)
        assert run.name == trial.source
    assert prepared.stand_in_rmse_deg is not None
    assert prepared.stand_in_rmse_deg > 0.5
    assert prepare([without_output(t) for t in trials], simulator_of(STAND_INS[name])).stand_in_rmse_deg is None


@pytest.mark.parametrize("name", STAND_INS)
def test_a_device_that_its_simulator_follows_has_no_gap(name: str) -> None:
    found = hystmpc.diagnose(trials_of(seconds=20.0), simulator_of(STAND_INS[name]), ordered=True)
    assert (found.verdict, found.simulator) == ("none", "stand_in")
    assert found.gap.nominal_rmse_deg == pytest.approx(0.1, rel=0.1)
    assert found.as_json()["stand_in_rmse_deg"] == found.stand_in_rmse_deg


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["backlash", "pi"])
def test_creep_is_named_behind_a_stand_in_that_errs_by_six_floors(kind: str) -> None:
    trials = trials_of(crept)
    stand_in = hystmpc.fit(kind, [as_simulated(trial) for trial in trials])
    found = hystmpc.diagnose(trials, stand_in, only=("creep", "lag", "slack"), ordered=True)
    assert (found.verdict, [effect.name for effect in found.effects]) == ("named", ["creep"])
    share = found.effects[0].parameters["share"]  # of what is left at once; wrong by as much as the stand-in's slope
    assert share == pytest.approx(-0.15 / 0.85, rel=0.2)
    assert found.effects[0].parameters["tau_s"] == pytest.approx(5.0, rel=0.2)
    assert found.gap.with_effects_rmse_deg < 0.5
    assert found.stand_in_rmse_deg is not None
    assert found.stand_in_rmse_deg > 6 * found.gap.floor_rmse_deg


@pytest.mark.slow
def test_a_stand_in_is_made_where_none_is_given(tmp_path: Path) -> None:
    logs, played = tmp_path / "logs", tmp_path / "played"
    for trial in trials_of(crept, seconds=20.0):
        write_csv(without_output(trial), logs / trial.source)
        write_csv(as_simulated(trial), played / trial.source)
    found = hystmpc.diagnose(logs, simulated=played, out=tmp_path / "d", only=("creep", "lag", "slack"))
    assert [effect.name for effect in found.effects] == ["creep"]
    page = (tmp_path / "d" / "report.html").read_text(encoding="utf-8")
    assert "simulator of your own" in page
    assert "Build creep into your simulator" in page
    assert ("Let your simulator play what was recorded, too" in page) == (found.next_motion is not None)
    with pytest.raises(ConfigError, match="or a column simulated_deg in the logs"):
        hystmpc.diagnose(logs)


def test_ctrl_c_ends_a_diagnosis_that_still_fits_its_stand_in(tmp_path: Path) -> None:
    """A fit keeps what it has so far; a diagnosis by half a stand-in would be a false claim."""

    def stopped(done: float, total: float, note: str = "", /) -> None:
        if "stand-in" in note and done > 0.1 * total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hystmpc.diagnose(trials_of(seconds=12.0), out=tmp_path / "d", progress=stopped)
    assert not (tmp_path / "d").exists()


def test_output_is_read_from_a_column_or_from_files_of_the_same_names(tmp_path: Path) -> None:
    trial = trials_of(seconds=10.0)[0]
    (beside,) = read_trials(write_csv(trial, tmp_path / "logs" / "a.csv"))
    np.testing.assert_allclose(as_simulated(beside).angle, own_simulator(trial.command), atol=1e-3)
    finer = np.arange(0.0, trial.t[-1] + 0.01, 0.01)
    command = np.interp(finer, trial.t, trial.command)
    played = Trial(finer, command, np.interp(finer, trial.t, as_simulated(trial).angle))
    write_csv(played, tmp_path / "played" / "a.csv")
    (joined,) = with_simulated([without_output(beside)], tmp_path / "played", lambda file: read_trials(file)[0])
    np.testing.assert_allclose(as_simulated(joined).angle, as_simulated(trial).angle, atol=1e-3)
    (again,) = with_simulated([without_output(beside)], tmp_path / "logs", lambda file: read_trials(file)[0])
    np.testing.assert_array_equal(as_simulated(again).angle, as_simulated(beside).angle)
    assert not have_simulated([without_output(beside)])


TRIAL = trials_of(seconds=10.0)[0]
PLAYED = as_simulated(TRIAL)


@pytest.mark.parametrize(
    ("played", "message"),
    [
        (replace(PLAYED, command=0.9 * TRIAL.command), "its command differs by"),
        (PLAYED.select(0, 100), "expected all of 0 to 9.96 s"),
        (replace(PLAYED, units=Units("bar", "deg")), "bar to deg, expected mm to deg"),
    ],
    ids=["command", "shorter", "unit"],
)
def test_output_of_another_command_is_refused(played: Trial, message: str, tmp_path: Path) -> None:
    (tmp_path / TRIAL.source).touch()
    with pytest.raises(GapError, match=message) as caught:
        with_simulated([TRIAL], tmp_path, lambda file: played)
    assert len(str(caught.value)) <= 300


def test_output_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GapError, match="no such file"):
        with_simulated([TRIAL], tmp_path, lambda file: PLAYED)
    with pytest.raises(GapError, match="no column simulated_deg"):
        have_simulated([TRIAL, without_output(TRIAL)])
    holes = np.where(np.arange(len(TRIAL)) == 7, np.nan, TRIAL.angle)
    with pytest.raises(GapError, match=r"simulated_deg lacks 1 of 250 samples"):
        have_simulated([replace(TRIAL, channels={"simulated_deg": holes})])
