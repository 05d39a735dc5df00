"""Whole diagnoses of small devices: nothing, one effect, what cannot be told apart, too little, unusable."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.gap.report.folder import diagnosis_json
from hystmpc.gap.report.report_data import ReportData
from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import diagnosable
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import GapError
from hystmpc.trials.trial import Trial
from hystmpc_lab.blind.run import closed_in_later_session

from ..models.zoo import BACKLASH
from .consistency import contradictions
from .engine_examples import moves, simulator_of, sine, trials_of

pytestmark = pytest.mark.slow

HOLDS = (moves(1, 20.0, 3.0), sine(0.1), moves(2, 20.0, 1.0), moves(3, 20.0, 4.0))
SINES = (sine(0.1), sine(0.15), sine(0.1))
CREEP = Creep((0.15,), (3.0,))
SIMULATOR = simulator_of(BACKLASH)
KEYS: dict[str, Any] = {
    "format": str,
    "verdict": str,
    "effects": list,
    "ambiguity": list,
    "ranking": list,
    "gap": dict,
    "retuned": dict,
    "where": dict,
}
EFFECT = {"name", "probability", "inclusion", "closed_share", "closed_ci90", "rmse_before_deg", "rmse_after_deg"}
GAP_NUMBERS = {"nominal_rmse_deg", "retuned_rmse_deg", "with_effects_rmse_deg", "floor_rmse_deg"}
GAP_NUMBERS |= {"closed_share", "unexplained_share"}


def recorded(*before: Operator, motions: tuple[Any, ...] = HOLDS, seed: int = 0) -> list[Trial]:
    """Trials of a backlash behind some effects."""
    return trials_of(Chain(BACKLASH, before), list(motions), seed=seed)


def diagnosed(trials: list[Trial], simulator: Simulator, **chosen: Any) -> tuple[Diagnosis, ReportData]:
    """A diagnosis that does not contradict itself."""
    diagnosis, evidence = conclude(find_causes(trials, simulator, **chosen))
    assert contradictions(evidence) == []
    return diagnosis, evidence


@functools.cache
def creeping() -> tuple[Diagnosis, ReportData]:
    """The diagnosis of a device that creeps."""
    return diagnosed(recorded(CREEP), SIMULATOR, seed=3)


def found(diagnosis: Diagnosis) -> set[str]:
    """Names of the effects, those in ambiguity sets among them."""
    return {e.name for e in diagnosis.effects} | {name for names in diagnosis.ambiguity for name in names}


@pytest.mark.slow
def test_nothing_is_found_where_there_is_nothing() -> None:
    diagnosis, _ = diagnosed(recorded(), SIMULATOR)
    assert diagnosis.verdict == "none"
    assert not diagnosis.effects
    assert diagnosis.next_motion is None
    assert diagnosis.gap.with_effects_rmse_deg == pytest.approx(0.05, rel=0.3)
    assert diagnosis.explainable_share is None


def test_creep_is_named_with_its_numbers() -> None:
    diagnosis, _ = creeping()
    assert diagnosis.verdict == "named"
    (effect,) = diagnosis.effects
    assert effect.name == "creep"
    assert effect.parameters["share"] == pytest.approx(0.15, rel=0.2)
    assert effect.parameters["tau_s"] == pytest.approx(3.0, rel=0.2)
    assert effect.closed_share > 0.9
    assert diagnosis.gap.retuned_rmse_deg <= diagnosis.gap.nominal_rmse_deg
    assert diagnosis.ranking[0][0] == "creep"


def test_its_evidence_is_whole() -> None:
    diagnosis, evidence = creeping()
    rows = {(row.owner, row.name): row for row in evidence.parameters}
    for name, true in (("share", 0.15), ("tau_s", 3.0)):
        low, high = rows["creep", name].ci90
        assert low < rows["creep", name].value < high
        assert low - 0.1 * true < true < high + 0.1 * true
        assert not rows["creep", name].flat
    assert rows["creep", "share"].neutral == 0.0
    assert {"gain", "offset", "backlash_width"} == {name for owner, name in rows if owner == "baseline"}
    assert evidence.localisation is not None
    assert set(diagnosis.where) == set(evidence.localisation.places)
    assert evidence.noise_deg == pytest.approx(0.05, rel=0.3)
    assert diagnosis.explainable_share is not None
    assert 0.0 <= diagnosis.explainable_share <= 1.0
    assert {trial.role for trial in evidence.trials} == {"fit", "final"}
    assert tuple(t.trial.source for t in evidence.trials if t.role == "final") == diagnosis.gap.final_trials
    assert next(row for row in evidence.candidates if row.name == "creep").chosen


def test_the_corrected_simulator_holds_the_effect_and_its_own_residuals() -> None:
    _, evidence = creeping()
    assert evidence.fixed is not None
    assert [operator.name for operator in evidence.fixed.chain.before] == ["creep"]
    residuals = evidence.fixed.identification.residuals
    assert [r.log for r in residuals] == [t.name for t in evidence.trials if t.role == "fit"]
    assert all(r.rmse_deg < 0.15 and r.fingerprint for r in residuals)
    assert evidence.fixed.identification.noise is not None
    assert evidence.fixed.identification.noise.sensor_sigma_deg == pytest.approx(0.05, rel=0.2)


def test_the_result_has_the_fixed_form() -> None:
    """Section 4 of the design: names and types of `diagnosis.json`."""
    read = json.loads(diagnosis_json(creeping()[0]))
    assert read["format"] == "hystmpc-diagnosis/3"
    for key, kind in KEYS.items():
        assert isinstance(read[key], kind), key
    second = {
        "order",
        "untestable",
        "stability",
        "resamples",
        "otherwise",
        "explainable_share",
        "depends_on",
        "detectable",
        "moved",
        "groups",
        "unit",
        "command_unit",
    }
    third = {"simulator", "stand_in_rmse_deg", "replay", "confirmed", "confirmed_rmse_deg"}
    assert set(read) == set(KEYS) | {"reason", "notes", "next_motion", "tracking"} | second | third
    assert (read["simulator"], read["stand_in_rmse_deg"]) == ("given", None)
    assert (read["replay"], read["confirmed"], read["confirmed_rmse_deg"]) == ([], {}, None)
    assert (read["order"], read["untestable"]) == ("known", [])
    assert read["stability"] == 1.0
    assert read["resamples"] >= 8
    (effect,) = read["effects"]
    assert set(effect) == EFFECT | {"parameters", "units", "undetermined"}
    assert effect["units"] == {"share": "1", "tau_s": "s"}
    assert all(isinstance(effect[name], float) for name in EFFECT - {"name", "closed_ci90"})
    assert [type(v) for v in effect["closed_ci90"]] == [float, float]
    assert all(isinstance(v, float) for v in effect["parameters"].values())
    gap = read["gap"]
    others = {"floor_kind", "final_trials", "closed_ci90", "repeats_rmse_deg", "model_form_rmse_deg"}
    assert set(gap) == GAP_NUMBERS | others
    assert all(isinstance(gap[name], float) for name in GAP_NUMBERS)
    assert gap["floor_kind"] in ("repeats", "noise")
    assert gap["closed_share"] + gap["unexplained_share"] == pytest.approx(1.0)
    assert {name for name, _ in read["ranking"]} == set(diagnosable())
    assert all(0.0 <= p <= 1.0 for _, p in read["ranking"])
    assert all(len(pair) == 2 for pair in read["retuned"].values())
    for place in read["where"].values():
        assert set(place) == {"share", "density", "ci90"}
    if read["next_motion"] is not None:
        assert set(read["next_motion"]) == {"file", "separates", "expected_probability", "duration_s"}


@pytest.mark.slow
def test_a_seed_gives_one_result() -> None:
    again, _ = diagnosed(recorded(CREEP), SIMULATOR, seed=3)
    assert diagnosis_json(again) == diagnosis_json(creeping()[0])


@pytest.mark.slow
def test_an_effect_that_is_left_out_is_not_named() -> None:
    diagnosis, evidence = diagnosed(recorded(CREEP), SIMULATOR, without=("creep",))
    assert "creep" not in found(diagnosis) | {name for name, _ in diagnosis.ranking}
    assert "creep" not in {row.name for row in evidence.candidates}
    only, _ = diagnosed(recorded(CREEP), SIMULATOR, only=("creep", "lag"))
    assert {name for name, _ in only.ranking} == {"creep", "lag"}
    assert found(only) == {"creep"}


@pytest.mark.slow
def test_sines_leave_open_what_lag_is() -> None:
    """Lag, delay and rate dependence look alike in sines: a set of them, or a motion that tells them apart."""
    diagnosis, _ = diagnosed(recorded(Lag(0.2), motions=SINES), SIMULATOR)
    family = {"lag", "delay", "rate_dependence"}
    assert found(diagnosis) & family
    assert diagnosis.next_motion is not None
    assert all(dict(diagnosis.ranking)[name] >= 0.02 for name in diagnosis.next_motion.separates)
    assert len(family & set(diagnosis.next_motion.separates)) >= 2
    assert 0.5 < diagnosis.next_motion.expected_probability <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_few_trials_are_judged_by_their_parts(count: int) -> None:
    motions = (moves(7, 40.0, 2.0), moves(8, 40.0, 3.0))[:count]
    diagnosis, evidence = diagnosed(recorded(CREEP, motions=motions), SIMULATOR)
    assert "creep" in found(diagnosis)
    assert len(diagnosis.gap.final_trials) == count
    assert all(trial.start > 0 for trial in evidence.trials)
    if count == 1:
        assert any("One trial" in note for note in diagnosis.notes)


SHORT = (moves(7, 7.0, 1.0),)
ONE_WAY = (np.clip(np.arange(1000) / 900.0, 0.0, 1.0) * 6.0,)


@pytest.mark.parametrize(("motions", "lacks"), [(SHORT, "s in all, expected 15 s"), (ONE_WAY, "turns 0 times")])
def test_too_little_says_what_lacks_and_what_to_record(motions: tuple[Any, ...], lacks: str) -> None:
    diagnosis, _ = diagnosed(recorded(CREEP, motions=motions), SIMULATOR)
    assert diagnosis.verdict == "too_little"
    assert lacks in diagnosis.reason
    assert not diagnosis.effects
    assert not diagnosis.ambiguity
    assert diagnosis.next_motion is not None


def test_a_constant_command_is_refused() -> None:
    still = [replace(trial, command=np.zeros(len(trial))) for trial in recorded()[:2]]
    with pytest.raises(GapError, match="the command is constant in every trial"):
        diagnosed(still, SIMULATOR)


def test_an_unknown_effect_is_refused_with_the_nearest() -> None:
    with pytest.raises(GapError, match=r"no effect 'crep'.*did you mean 'creep'"):
        diagnosed(recorded(), SIMULATOR, without=("crep",))


def test_what_is_not_finite_is_null() -> None:
    diagnosis = creeping()[0]
    broken = replace(diagnosis, gap=replace(diagnosis.gap, closed_share=math.nan))
    assert json.loads(diagnosis_json(broken))["gap"]["closed_share"] is None


def test_another_session_of_the_device_is_closed_as_far_and_that_of_another_device_is_not() -> None:
    findings = find_causes(recorded(CREEP), SIMULATOR, seed=3)
    assert closed_in_later_session(findings, recorded(CREEP, seed=8)) == pytest.approx(
        findings.conclusion.closed.gap.closed_share, abs=0.1
    )
    assert closed_in_later_session(findings, recorded(seed=8)) < 0.0
