"""The study of public data: what a record may be, the simulated test, and one kind from the record to the table."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from hystmpc.models.chain import Chain
from hystmpc.models.operators.oscillator import Oscillator
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.layouts import load_mapping
from hystmpc.trials.trial import Trial
from hystmpc_lab.public import boucwen
from hystmpc_lab.public.boucwen import (
    COLUMNS,
    PERIOD,
    PUBLISHED_SYSTEM,
    RATE_HZ,
    given_tests,
    noise_of_periods,
    read_record,
    simulated_tests,
)
from hystmpc_lab.public.logs import RIG_LAYOUT, SEAL_LAYOUT, RigData, SealData
from hystmpc_lab.public.records import PublicSettings, withheld_end
from hystmpc_lab.public.study import STUDY

from ..models.running import run_chain

SIZES = (("multisine", PERIOD), ("sinesweep", 1000))


def written(path: Path, force: np.ndarray, displacement: np.ndarray) -> Path:
    rows = "\n".join(f"{u!r},{y!r}" for u, y in zip(force.tolist(), displacement.tolist(), strict=True))
    path.write_text(f"{','.join(COLUMNS)}\n{rows}\n")
    return path


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    force, displacement = np.random.default_rng(0).normal(size=(2, PERIOD))
    (record,) = given_tests((str(written(tmp_path / "steady.csv", force, displacement)),))
    np.testing.assert_array_equal(record.trial.command, force)
    np.testing.assert_array_equal(record.trial.angle, displacement)
    assert (record.name, record.periodic, record.simulated, record.start) == ("steady, given", True, False, 0.0)
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


def test_official_records_of_matlab_are_paired_by_their_names_over_files(tmp_path: Path) -> None:
    """The official files hold one signal each; a file with all four is the same."""
    rng = np.random.default_rng(1)
    signals = {f"{letter}val_{name}": rng.normal(size=size) for name, size in SIZES for letter in "uy"}
    apart = [tmp_path / f"{name}.mat" for name in signals]
    for path, (name, values) in zip(apart, signals.items(), strict=True):
        savemat(path, {name: values[None]})  # a row, as there
    savemat(tmp_path / "all.mat", {name: values[:, None] for name, values in signals.items()})
    for files in (apart, [tmp_path / "all.mat"]):
        records = given_tests(tuple(map(str, files)))
        assert [(r.name, r.periodic) for r in records] == [("multisine, given", True), ("sinesweep, given", False)]
        for record, (name, _) in zip(records, SIZES, strict=True):
            np.testing.assert_array_equal(record.trial.command, signals[f"uval_{name}"])
            np.testing.assert_array_equal(record.trial.angle, signals[f"yval_{name}"])
            assert record.trial.dt == pytest.approx(1 / RATE_HZ)
    with pytest.raises(LogError, match="uval_multisine without yval_multisine"):
        given_tests((str(apart[0]),))
    savemat(tmp_path / "other.mat", {"u": np.ones(5)})
    with pytest.raises(LogError, match=r"no variable uval_.* available: u"):
        given_tests((str(tmp_path / "other.mat"),))


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


@given(st.lists(st.integers(2, 400), min_size=1, max_size=4), st.floats(0.1, 0.9))
def test_what_is_seen_is_not_scored_and_no_sample_is_lost(lengths: list[int], share: float) -> None:
    ends = np.cumsum(lengths).tolist()
    parts = [Trial(k := np.arange(end - size, end) / 25, k, k) for size, end in zip(lengths, ends, strict=True)]
    seen, left = withheld_end(parts, share, "end")
    fitted = np.concatenate([trial.t for trial in seen]) if seen else np.zeros(0)
    scored = np.concatenate([record.trial.t[record.first :] for record in left])
    assert fitted.size == 0 or fitted.max() < scored.min()
    whole = [record for record in left if fitted.size == 0 or record.trial.t[0] > fitted.max()]
    in_motion = sum(record.first for record in whole)  # of a part of which nothing was seen, 5 s
    assert in_motion <= 125 * len(whole)
    assert fitted.size + scored.size + in_motion >= ends[-1] - 1  # a part of a single sample is no trial
    assert len({record.name for record in left}) == len(left)


def seal_file(folder: Path, seal: str, pressure: float, rng: np.random.Generator) -> Path:
    """Ten strokes of a seal whose friction is 2 N + 1 N/bar, with an offset of its own."""
    t = np.arange(6000) / 100
    u = 20 * (1 - np.cos(2 * np.pi * t / 6))
    force = (2 + pressure) * np.tanh(10 * np.gradient(u, t)) + 0.05 * u + rng.normal(0, 0.05, t.size) + 3 * pressure
    path = folder / f"{seal}_{pressure:g}bar.tsv"
    columns = [1000 * t, *np.zeros((3, t.size)), u, np.full(t.size, pressure), force]
    np.savetxt(path, np.column_stack(columns), delimiter="\t")
    return path


@pytest.fixture
def ring(tmp_path: Path) -> PublicSettings:
    """A seal at three pressures."""
    rng = np.random.default_rng(2)
    for pressure in (1.0, 3.0, 7.0):
        seal_file(tmp_path, "ring", pressure, rng)
    return PublicSettings.of(dataset="seals", data=tmp_path, kinds=("maxwell_slip",))


def test_a_withheld_pressure_is_divided_by_what_a_line_through_the_friction_of_the_others_has(
    ring: PublicSettings,
) -> None:
    strokes, _, _, plain, scaled = SealData().cases(ring)
    assert strokes.facts["friction [N]"] == pytest.approx(3.0, rel=0.05)
    assert [len(case.training) for case in (plain, scaled)] == [2, 2]
    assert scaled.tests[0].height == pytest.approx(9.0, rel=0.05)


@pytest.mark.slow
def test_friction_that_follows_the_pressure_halves_the_error(ring: PublicSettings, tmp_path: Path) -> None:
    outcome = STUDY.begin(ring, tmp_path / "study").finish()
    *_, plain, scaled = outcome.drawn
    errors = {r.job.case: next(iter(r.scores.values())) for r in outcome.done}
    assert not outcome.failed
    assert errors[scaled.name].spread < 0.5 * errors[plain.name].spread
    assert errors[scaled.name].span == pytest.approx(errors[plain.name].span)


def test_a_test_file_is_of_the_same_seal_or_refused(tmp_path: Path) -> None:
    rng, other = np.random.default_rng(3), tmp_path / "other"
    other.mkdir()
    data, test = seal_file(tmp_path, "ring", 1.0, rng), seal_file(other, "ring", 2.0, rng)
    cases = SealData().cases(PublicSettings.of(dataset="seals", data=data, test=[test]))
    assert [case.name for case in cases] == ["ring_1bar", "ring_2bar from 1 other"]  # one pressure makes no line
    stranger = seal_file(other, "lip", 2.0, rng)
    with pytest.raises(LogError, match="no file of the same seal"):
        SealData().cases(PublicSettings.of(dataset="seals", data=data, test=[stranger]))
    with pytest.raises(LogError, match="expected a name like"):
        SealData().cases(PublicSettings.of(dataset="seals", data=data.rename(tmp_path / "ring.tsv")))


def test_the_layouts_are_those_of_the_examples() -> None:
    examples = Path(__file__).parents[2] / "examples"
    assert load_mapping(examples / "seal_friction.yaml") == SEAL_LAYOUT
    assert load_mapping(examples / "fatigue_rig.yaml") == RIG_LAYOUT


def test_the_last_third_of_a_rig_is_scored_and_test_files_whole(tmp_path: Path) -> None:
    t = np.arange(4000) / 100
    for name in ("one", "two"):
        rows = "\n".join(f"{a},0,{np.sin(a)},0,{np.cos(a)}" for a in t.tolist())
        (tmp_path / f"{name}.csv").write_text(f"t,r,u,y,d\n{rows}\n")
    settings = PublicSettings.of(dataset="rig", data=tmp_path / "one.csv", test=[tmp_path / "two.csv"])
    (case,) = RigData().cases(settings)
    last, whole = case.tests
    assert sum(map(len, case.training)) == last.first == round(2 / 3 * len(last.trial))
    assert (last.name, whole.name, whole.first) == ("last third", "two.csv", 125)
    assert (last.trial.units.command, last.trial.units.angle) == ("V", "mm")


@pytest.mark.slow
def test_one_kind_from_the_record_to_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(boucwen, "simulated_tests", cache(simulated_tests))  # asked for by every `begin`
    steady = simulated_tests(5, quick=True)[0].trial
    force = np.concatenate([np.zeros(400), steady.command[: PERIOD // 4]])  # from rest: no start has to be searched
    device = Chain(Oscillator(*PUBLISHED_SYSTEM, hold=3, steps=4))
    data = written(tmp_path / "record.csv", force, run_chain(device, force, dt=1 / RATE_HZ))
    test = written(tmp_path / "steady.csv", steady.command, steady.angle)
    settings = PublicSettings.of(dataset="boucwen", data=data, test=[test], kinds=("oscillator",))
    folder = tmp_path / "study"
    outcome = STUDY.begin(settings, folder).finish()
    assert not outcome.failed
    (result,) = outcome.done
    assert result.scores["steady, given"].rmse < 5e-6
    assert result.parameters["oscillator.mass"] == pytest.approx(2.0, rel=0.01)
    rows = list(csv.DictReader((folder / "tables" / "errors.csv").open()))
    tests = {"steady, given", "multisine, simulated", "sine sweep, simulated"}
    assert {row["test"] for row in rows if row["from"] == "ours"} == tests
    assert {row["test"] for row in rows if row["from"] == "published"} == {"multisine, official"}
    assert "steady.csv" in (folder / "report.html").read_text()
    assert STUDY.begin(settings, folder).costs == {}  # nothing is done twice
