"""No diagnosis and no page of one contradicts itself."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.decide.ambiguity import limited_by_inclusion, probability, ranking
from hystmpc.gap.decide.attribution import Attribution, as_given_if_better, floor_of
from hystmpc.gap.decide.gap_closed import measured_blocks
from hystmpc.gap.decide.verdict import VERDICTS as CASES
from hystmpc.gap.decide.verdict import VerdictDecision
from hystmpc.gap.diagnosis import FLIPS, ConfirmedShare, Diagnosis, Gap, IdentifiedEffect, Stability, TrackingGap
from hystmpc.gap.expected_tracking import with_tracking
from hystmpc.gap.logs.preparation import PreparedTrials, prepare
from hystmpc.gap.report.report_data import ReportData
from hystmpc.gap.report.words import reason_for
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.effects.catalogue import diagnosable
from hystmpc.models.identify.cross_validation import CrossValidation
from hystmpc.models.simulator import Identification, Residual

from ..models.zoo import BACKLASH, simulator
from .consistency import contradictions
from .engine_examples import moves, trials_of
from .report_examples import report_data

LIBRARY = list(diagnosable())
SHARE, SIZE, LOWEST = st.floats(0.0, 1.0), st.floats(1e-4, 50.0), st.floats(-0.5, 1.0)


@st.composite
def diagnoses(draw: st.DrawFn) -> ReportData:
    """Report data made of drawn facts as the steps of a diagnosis make them: shares, inclusions, sizes, splits."""
    case: str = draw(st.sampled_from([*CASES]))
    verdict, stable = CASES[case], draw(SHARE)
    count = draw(st.integers(1, 4)) if verdict in ("named", "one_of") else 0
    names = draw(st.lists(st.sampled_from(LIBRARY), min_size=count, max_size=count, unique=True))
    rivals = [name for name in LIBRARY if name not in names]
    ambiguity: tuple[tuple[str, ...], ...] = ()
    if verdict == "one_of":
        others = draw(st.lists(st.sampled_from(rivals), min_size=1, max_size=3, unique=True))
        ambiguity = ((names[0], *others),)
    inclusion = {name: draw(SHARE) for name in LIBRARY}
    floor, *rest = sorted(draw(st.lists(SIZE, min_size=4, max_size=4)))
    with_effects, retuned, nominal = rest
    closed = (retuned**2 - with_effects**2) / max(retuned**2 - floor**2, 1e-12)
    repeats = draw(st.sampled_from((math.nan, retuned, 1.1 * retuned))) if verdict == "unknown" else math.nan
    sizes = Gap(nominal, retuned, with_effects, floor, "noise", closed, 1 - closed, (0.0, 1.0), ("a.csv",), repeats)
    found = []
    for name in names:
        share = draw(SHARE)
        replaceable = any(name == group[0] for group in ambiguity)
        chance = limited_by_inclusion(probability(name, share, replaceable, stable), inclusion[name])
        found.append(IdentifiedEffect(name, chance, inclusion[name], share, (0.0, 1.0), retuned, with_effects, {}, {}))
    effects = tuple(sorted(found, key=lambda effect: -effect.probability))
    left_open = 1.0 if verdict not in ("none", "retuned") else 1 - 0.95 * stable
    ranked = ranking({e.name: e.probability for e in effects}, inclusion, ambiguity, LIBRARY, left_open)
    moved = draw(st.booleans())
    plain = report_data(verdict, 3)
    diagnosis = replace(
        plain.diagnosis,
        reason=reason_for(VerdictDecision(case, ambiguity), effects, sizes, "too short", ""),
        effects=effects,
        ambiguity=ambiguity,
        ranking=ranked,
        gap=sizes,
        retuned={"gain": (10.0, 10.4 if moved else 10.0)},
        stability=Stability(stable, 20),
        next_motion=None,
    )
    if draw(st.booleans()):
        shares = {e.name: ConfirmedShare(low + 0.1, (low, low + 0.2)) for e in effects if (low := draw(LOWEST)) < 0.9}
        played = {"confirmed": shares, "confirmed_rmse_deg": with_effects} if draw(st.booleans()) else {}
        diagnosis = replace(diagnosis, simulator="stand_in", stand_in_rmse_deg=0.2, replay=("a.csv",), **played)
    told = TrackingGap(1.2, 0.4, (1.1, 1.3), (0.35, 0.45))
    unsure = diagnosis.relies_on_its_split or verdict in ("unknown", "too_little")
    return replace(plain, diagnosis=replace(diagnosis, tracking=TrackingGap(why_not="why") if unsure else told))


@given(diagnoses())
@settings(deadline=None)
def test_no_page_contradicts_itself(evidence: ReportData) -> None:
    assert contradictions(evidence) == []


def test_contradictions_are_seen() -> None:
    """What users ran into, each by its own sentence."""
    evidence = report_data("named", 3)
    plain = evidence.diagnosis
    effect, told = plain.effects[0], TrackingGap(1.2, 0.3, (1.1, 1.3), (0.25, 0.35))
    seen: dict[str, Diagnosis] = {
        "likelier than what was found": replace(plain, ranking=(("lag", 0.95), ("creep", 0.93))),
        "inclusion 0.00": replace(plain, effects=(replace(effect, inclusion=0.0),)),
        "foretold": replace(plain, stability=Stability(0.3, 20), tracking=told),
        "worse than as given": replace(plain, gap=replace(plain.gap, nominal_rmse_deg=1.91, retuned_rmse_deg=2.01)),
        "floor is above": replace(plain, gap=replace(plain.gap, floor_rmse_deg=0.447, retuned_rmse_deg=0.408)),
        "confirmed, and not named": replace(plain, confirmed={"lag": ConfirmedShare(0.5, (0.4, 0.6))}),
        "without a replay": replace(plain, confirmed={effect.name: ConfirmedShare(0.5, (0.4, 0.6))}),
        "its stand-in's error": replace(plain, simulator="stand_in"),
        "nothing is missing": replace(plain, verdict="none", effects=(), ranking=(("contact", 0.5),)),
    }
    for said, diagnosis in seen.items():
        assert any(said in each for each in contradictions(replace(evidence, diagnosis=diagnosis))), said


@given(
    st.lists(st.tuples(st.sampled_from(LIBRARY), SHARE), min_size=1, max_size=4, unique_by=lambda row: row[0]),
    st.lists(st.sampled_from(LIBRARY), max_size=3, unique=True),
    st.dictionaries(st.sampled_from(LIBRARY), SHARE),
)
def test_what_was_found_leads_the_ranking(
    found: list[tuple[str, float]], others: list[str], inclusion: dict[str, float]
) -> None:
    chosen = dict(found)
    rivals = tuple(name for name in others if name not in chosen)
    ranked = ranking(chosen, inclusion, ((found[0][0], *rivals),), LIBRARY)
    chance = dict(ranked)
    assert ranked[0][0] in chosen
    assert ranked[0][1] == max(chosen.values())
    assert [p for _, p in ranked] == sorted(chance.values(), reverse=True)
    assert all(chance[name] == p for name, p in found)
    assert all(chance[name] <= chosen[found[0][0]] for name in rivals), "it explains the trials no better"


def attribution_of(prepared: PreparedTrials) -> Attribution:
    """The retuned simulator, with nothing selected."""
    validation, nothing = CrossValidation(prepared.baseline, prepared.development), cast("Any", None)
    return Attribution(validation, validation.retuned(), nothing, {}, None, nothing)


@pytest.mark.parametrize("final_gain", [1.0, 1.06, 1.12])
def test_numbers_that_are_worse_on_final_trials_are_not_taken(final_gain: float) -> None:
    """The gain moved by 12 % in the trials to choose on, and by less or as much in those that are opened once."""
    made = trials_of(Chain(BACKLASH), [moves(seed, 12.0) for seed in range(4)])
    plain = simulator(Chain(BACKLASH))
    kept_for_the_end = {run.name for run in prepare(made, plain).final}
    trials = [replace(t, angle=(final_gain if t.source in kept_for_the_end else 1.12) * t.angle) for t in made]
    prepared = prepare(trials, plain)
    before = attribution_of(prepared)
    after = as_given_if_better(prepared, before)
    problem = before.retuned.problem
    given_q = problem.start(prepared.baseline.nominal, [])
    taken = measured_blocks(prepared, after.retuned).mse
    assert taken <= measured_blocks(prepared, replace(before.retuned, q=given_q)).mse
    assert (after.retuned is before.retuned) == (final_gain > 1.06)


@given(step=st.floats(0.01, 1.5), seed=st.integers(0, 9))
@settings(max_examples=8, deadline=None)
def test_no_floor_lies_below_the_rounding_of_the_readings(step: float, seed: int) -> None:
    """Nor are steps that the sensor had when the simulator was identified a fault of it."""
    made = trials_of(Chain(BACKLASH), [moves(seed, 12.0), moves(seed + 1, 12.0)], noise_deg=0.0)
    trials = [replace(trial, angle=step * np.round(trial.angle / step)) for trial in made]
    residual = Residual(log="a", motion="holds", samples=99, rmse_deg=0.3 * step, bias_deg=0.0, lag_one=0.9)
    noise = NoiseModel(
        sensor_sigma_deg=0.3 * step,
        drift_sigma_deg_per_sqrt_s=0.0,
        motion_sigma_deg_per_sqrt_unit=0.0,
        sensor_resolution_deg=step,
    )
    known = replace(
        simulator(Chain(BACKLASH)), identification=Identification(method="fit", residuals=(residual,), noise=noise)
    )
    prepared = prepare(trials, known)
    floor = floor_of(prepared, attribution_of(prepared).retuned)
    assert min(floor.rmse_deg, floor.noise_deg) >= step / math.sqrt(12) * (1 - 1e-6)
    assert prepared.excess_mse <= 1e-9


def test_no_fall_is_foretold_with_effects_that_flip() -> None:
    evidence = report_data("named", 3)
    evidence = replace(evidence, nominal=simulator(Chain(BACKLASH)))
    flips = replace(evidence, diagnosis=replace(evidence.diagnosis, stability=Stability(0.3, 20), tracking=None))
    found = with_tracking(flips).diagnosis.tracking
    assert found is not None
    assert found.why_not == FLIPS
