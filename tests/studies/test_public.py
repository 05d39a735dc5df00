"""The study of public data: what a record may be, the simulated test, and one kind from the record to the table."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.operators.oscillator import Oscillator
from hystmpc.studies.public.boucwen import (
    COLUMNS,
    PERIOD,
    PUBLISHED_SYSTEM,
    RATE_HZ,
    given_tests,
    noise_of_periods,
    read_record,
    simulated_tests,
)
from hystmpc.studies.public.run import prepare_public, run_public
from hystmpc.studies.public.settings import PublicSettings
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.trial import Trial

from ..models.running import run_chain


def written(path: Path, force: np.ndarray, displacement: np.ndarray) -> Path:
    rows = "\n".join(f"{u!r},{y!r}" for u, y in zip(force.tolist(), displacement.tolist(), strict=True))
    path.write_text(f"{','.join(COLUMNS)}\n{rows}\n")
    return path


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    force, displacement = np.random.default_rng(0).normal(size=(2, PERIOD))
    (record,) = given_tests((str(written(tmp_path / "steady.csv", force, displacement)),))
    np.testing.assert_array_equal(record.trial.command, force)
    np.testing.assert_array_equal(record.trial.angle, displacement)
    assert (record.name, record.periodic, record.simulated) == ("steady", True, False)
    assert record.trial.dt == pytest.approx(1 / RATE_HZ)
    assert (record.trial.units.command, record.trial.units.angle) == ("N", "m")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u,y\n1,2\n", "columns 'u, y', expected force_N, displacement_m"),
        ("force_N,displacement_m\n1,2,3\n4,5,6\n", "expected two numbers"),
        ("force_N,displacement_m\n1,one\n", "expected two numbers"),
        ("force_N,displacement_m\n1,nan\n2,3\n", "finite"),
    ],
)
def test_a_wrong_record_is_one_clear_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "record.csv"
    path.write_text(text)
    with pytest.raises(LogError) as error:
        read_record(path)
    assert message in str(error.value)
    assert "record.csv" in str(error.value)
    assert "\n" not in str(error.value)


def test_noise_is_what_differs_between_periods() -> None:
    rng = np.random.default_rng(0)
    force, answer = rng.normal(size=(2, PERIOD))
    noisy = np.tile(answer, 5) + 0.01 * rng.normal(size=5 * PERIOD)
    t = np.arange(noisy.size) / RATE_HZ
    assert noise_of_periods(Trial(t, np.tile(force, 5), noisy)) == pytest.approx(0.01, rel=0.02)
    assert np.isnan(noise_of_periods(Trial(t, rng.normal(size=t.size), noisy)))
    assert np.isnan(noise_of_periods(Trial(t[:PERIOD], force, answer)))


@pytest.mark.slow
def test_the_simulated_tests_are_the_published_system_and_its_forces() -> None:
    """A multisine of 5 to 150 Hz and 50 N, steady; a sweep of 40 N from rest; straight lines at 750 Hz come near."""
    steady, sweep = simulated_tests(3, quick=True)
    assert len(steady.trial) == PERIOD
    assert np.std(steady.trial.command) == pytest.approx(50.0, rel=1e-6)
    power = np.abs(np.fft.rfft(steady.trial.command))
    frequency = np.fft.rfftfreq(PERIOD, 1 / RATE_HZ)
    assert power[(frequency < 4.9) | (frequency > 150.1)].max() < 1e-6 * power.max()
    assert np.std(sweep.trial.command) == pytest.approx(40.0, rel=0.01)
    assert abs(sweep.trial.angle[0]) < 1e-7
    device = Chain(Oscillator(*PUBLISHED_SYSTEM, hold=3, steps=4))
    again = run_chain(device, np.tile(steady.trial.command, 2), dt=1 / RATE_HZ)[PERIOD:]
    assert np.std(again - steady.trial.angle) < 4e-3 * np.std(steady.trial.angle)
    other = simulated_tests(4, quick=True)[0]
    assert np.std(other.trial.command - steady.trial.command) > 50.0


def test_settings_name_what_is_wrong() -> None:
    with pytest.raises(ConfigError, match="expected a data set"):
        PublicSettings.of(dataset="boucwen", data=None)
    with pytest.raises(ConfigError, match="did you mean 'boucwen'"):
        PublicSettings.of(dataset="bouc_wen", data="x.csv")


@pytest.mark.slow
def test_one_kind_from_the_record_to_the_table(tmp_path: Path) -> None:
    steady = simulated_tests(5, quick=True)[0].trial
    data = written(tmp_path / "record.csv", np.tile(steady.command, 2), np.tile(steady.angle, 2))
    test = written(tmp_path / "steady.csv", steady.command, steady.angle)
    settings = PublicSettings.of(dataset="boucwen", data=data, test=[test], kinds=("oscillator",))
    folder = tmp_path / "study"
    outcome = run_public(prepare_public(settings, folder))
    assert not outcome.failed
    (result,) = outcome.done
    assert result.rmse["steady"] < 5e-6
    assert result.parameters["oscillator.mass"] == pytest.approx(2.0, rel=0.01)
    rows = list(csv.DictReader((folder / "tables" / "errors.csv").open()))
    assert rows[0]["model"] == "oscillator"
    assert {row["from"] for row in rows} == {"ours", "published"}
    assert "given" in (folder / "report.html").read_text().lower()
    assert prepare_public(settings, folder).costs == {}  # nothing is done twice
