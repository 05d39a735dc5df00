"""The verdict: every row of the decision table, their order, and what a ruling implies."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.decide.ambiguity import probability
from hystmpc.gap.decide.retuning import Retuning
from hystmpc.gap.decide.verdict import (
    VERDICTS,
    FinalFacts,
    VerdictFacts,
    decide_verdict,
)
from hystmpc.gap.diagnosis import Gap
from hystmpc.gap.report.words import reason_for

EXPLAINED = VerdictFacts(
    effects=frozenset({"lag"}),
    retuned_mse=1.0,
    chosen_mse=0.02,
    retuned_fit_mse=1.0,
    floor_mse=0.01,
    form_mse=0.01,
    final=FinalFacts(closed_share=0.9, residual_ratio=1.2),
)
NOTHING = replace(EXPLAINED, effects=frozenset(), chosen_mse=1.0, final=FinalFacts(0.0, 10.0))
OPEN = replace(EXPLAINED, chosen_mse=0.9)
AMBIGUOUS = replace(EXPLAINED, ambiguity=(("lag", "delay"),))
UNPROVEN = FinalFacts(closed_share=0.0, residual_ratio=1.0, unproven=True)
GROWN = Retuning(2.0, 0.5, 0.75)
ANEW = Retuning(2.0, reidentified_share=0.75)
WEAK = FinalFacts(closed_share=0.5, residual_ratio=3.0)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_what_closes_everywhere_is_between_what_closes_in_parts(left: float, final_left: float, part: float) -> None:
    """Of one structural error before, part of the samples being of the final trials."""
    facts = replace(EXPLAINED, chosen_mse=0.01 + 0.99 * left)
    shares = 1 - left, 1 - final_left
    share = facts.closed_everywhere((1.0, 0.01 + 0.99 * final_left), part)
    assert min(shares) - 1e-9 <= share <= max(shares) + 1e-9


@pytest.mark.parametrize(
    ("facts", "case", "verdict"),
    [
        (EXPLAINED, "explained", "named"),
        (AMBIGUOUS, "ambiguous", "one_of"),
        (replace(EXPLAINED, final=None), "explained", "named"),
        # final trials
        (replace(EXPLAINED, final=WEAK), "not_confirmed", "unknown"),
        (replace(AMBIGUOUS, final=WEAK), "not_confirmed", "unknown"),
        (replace(EXPLAINED, final=FinalFacts(0.6, 3.0)), "explained", "named"),
        (
            replace(EXPLAINED, effects=frozenset({"lag", "creep"}), final=FinalFacts(0.6, 3.0)),
            "not_confirmed",
            "unknown",
        ),
        (replace(EXPLAINED, final=FinalFacts(0.5, 2.4)), "explained", "named"),
        # final trials that hold little of what the others show: all together decide, and the final ones may not object
        (replace(EXPLAINED, final=replace(WEAK, everywhere=0.6)), "explained", "named"),
        (replace(EXPLAINED, final=replace(WEAK, everywhere=0.5)), "not_confirmed", "unknown"),
        (replace(EXPLAINED, final=FinalFacts(0.3, 3.0, everywhere=0.9)), "not_confirmed", "unknown"),
        # within the reach of a poor simulator, but they close too little
        (replace(EXPLAINED, final=FinalFacts(0.3, 1.9)), "not_confirmed", "unknown"),
        (replace(EXPLAINED, final=WEAK, sensor=True), "explained", "named"),
        (replace(EXPLAINED, final=WEAK, jumps=True), "explained", "named"),
        (replace(EXPLAINED, final=UNPROVEN), "unproven", "unknown"),
        (replace(EXPLAINED, final=UNPROVEN, jumps=True), "jumps", "named"),
        (replace(NOTHING, final=FinalFacts(0.0, 1.0, at_floor=True)), "at_floor", "none"),
        (replace(EXPLAINED, final=FinalFacts(0.9, 1.2, at_floor=True)), "explained", "named"),
        # selection
        (replace(EXPLAINED, structure_left=True), "structure_left", "unknown"),
        (OPEN, "left_open", "unknown"),
        (replace(OPEN, form_mse=0.2), "small_gap", "none"),
        (replace(OPEN, floor_mse=0.7), "explained", "named"),
        (NOTHING, "no_effect", "unknown"),
        (replace(NOTHING, form_mse=0.2), "small_gap", "none"),
        (replace(EXPLAINED, retuned_fit_mse=0.02), "no_gap", "none"),
        (replace(EXPLAINED, form_mse=0.5), "no_gap", "none"),
        # sensor and jumps
        (replace(NOTHING, sensor=True), "sensor_alone", "named"),
        (replace(NOTHING, sensor=True, form_mse=0.5), "no_gap", "none"),
        (replace(EXPLAINED, sensor=True, sensor_gap=True, form_mse=0.5), "sensor_alone", "named"),
        # what the sensor's fault explains by itself is no gap of the simulator
        (replace(EXPLAINED, sensor=True, sensor_gap=True, excess_mse=0.99), "sensor_alone", "named"),
        (replace(EXPLAINED, sensor=True, sensor_gap=True, excess_mse=0.97), "explained", "named"),
        (replace(EXPLAINED, sensor_gap=True, excess_mse=0.99), "explained", "named"),
        (replace(EXPLAINED, sensor_gap=True, form_mse=0.5), "no_gap", "none"),  # the library goes without the sensor
        (replace(EXPLAINED, sensor=True, sensor_gap=True), "explained", "named"),
        (replace(OPEN, sensor=True, final=FinalFacts(0.4, 5.0)), "sensor_beside_unknown", "named"),
        (replace(OPEN, sensor=True, final=FinalFacts(0.39, 5.0)), "left_open", "unknown"),
        (replace(OPEN, sensor=True, final=None), "left_open", "unknown"),
        (replace(OPEN, jumps=True), "jumps", "named"),
        (replace(NOTHING, jumps=True, form_mse=0.5), "jumps", "named"),
        # steps of the readings, where there would be no gap
        (replace(NOTHING, new_step=True, form_mse=0.5), "sensor_alone", "named"),
        (replace(EXPLAINED, new_step=True, form_mse=0.5), "sensor_alone", "named"),
        (replace(OPEN, new_step=True, form_mse=0.2), "sensor_alone", "named"),
        (replace(NOTHING, new_step=True, final=FinalFacts(0.0, 1.0, at_floor=True)), "sensor_alone", "named"),
        (replace(EXPLAINED, new_step=True), "explained", "named"),
        (replace(NOTHING, new_step=True), "no_effect", "unknown"),
        (replace(NOTHING, new_step=True, form_mse=0.5, retuning=Retuning(2.0)), "moved", "retuned"),
        (replace(NOTHING, new_step=True, too_little=True), "too_little", "too_little"),
        # retuning
        (replace(EXPLAINED, retuned_fit_mse=0.02, retuning=Retuning(2.0)), "moved", "retuned"),
        (replace(NOTHING, final=FinalFacts(0.0, 1.0, at_floor=True), retuning=Retuning(2.0)), "moved", "retuned"),
        (replace(NOTHING, retuning=Retuning(2.0, 0.5)), "reshaped", "retuned"),
        (replace(NOTHING, retuning=Retuning(2.0, 0.4, 0.75)), "reshaped", "retuned"),
        (replace(NOTHING, retuning=Retuning(2.0, 0.4, 0.7)), "no_effect", "unknown"),
        (replace(NOTHING, retuning=Retuning(1.1, 0.5, 0.75)), "no_effect", "unknown"),
        # what repeats do not share is no form error, and retuning has to lower the error of the final trials, too
        (replace(NOTHING, form_mse=0.2, retuning=Retuning(2.0, unrepeatable=0.5)), "no_effect", "unknown"),
        (replace(NOTHING, form_mse=0.2, retuning=Retuning(2.0, unrepeatable=0.4)), "moved", "retuned"),
        (replace(NOTHING, retuning=Retuning(2.0, 0.5, unrepeatable=0.5)), "no_effect", "unknown"),
        (replace(NOTHING, retuning=Retuning(2.0, 0.5), final=FinalFacts(0.0, 10.0, moved=1.1)), "no_effect", "unknown"),
        (
            replace(NOTHING, form_mse=0.5, retuning=Retuning(2.0), final=FinalFacts(0.0, 10.0, moved=1.9)),
            "no_gap",
            "none",
        ),
        (replace(NOTHING, retuning=Retuning(9.0, 0.4, 0.5)), "no_effect", "unknown"),
        # where no effect explains it, seven times the form error that has grown with the loop, itself at most sevenfold
        (replace(NOTHING, form_mse=0.06, retuning=Retuning(9.0, 0.15)), "reshaped", "retuned"),
        (replace(OPEN, form_mse=0.06, retuning=Retuning(9.0, 0.15)), "reshaped", "retuned"),
        (replace(NOTHING, form_mse=0.06, retuning=Retuning(9.0, 0.14)), "no_effect", "unknown"),
        (replace(NOTHING, form_mse=0.02, retuning=Retuning(9.0, 0.4)), "no_effect", "unknown"),
        (replace(EXPLAINED, form_mse=0.06, retuning=Retuning(9.0, 0.15)), "explained", "named"),
        (replace(EXPLAINED, retuning=GROWN), "explained", "named"),
        (replace(EXPLAINED, effects=frozenset({"asymmetry"}), retuning=GROWN), "reshaped", "retuned"),
        (replace(EXPLAINED, effects=frozenset({"asymmetry"}), retuning=GROWN, jumps=True), "explained", "named"),
        (replace(NOTHING, jumps=True, retuning=GROWN), "jumps", "named"),
        # what a generic effect could replace is as vague as that
        (replace(EXPLAINED, ambiguity=(("lag", "asymmetry"),), retuning=GROWN), "reshaped", "retuned"),
        (replace(AMBIGUOUS, retuning=GROWN), "ambiguous", "one_of"),
        # plays of the core explain more than the effects
        (replace(EXPLAINED, chosen_mse=0.5, retuning=GROWN), "reshaped", "retuned"),
        (replace(EXPLAINED, chosen_mse=0.5, retuning=GROWN, sensor=True), "explained", "named"),
        (replace(EXPLAINED, chosen_mse=0.5, retuning=Retuning(2.0, 0.5, 0.74)), "explained", "named"),
        (replace(EXPLAINED, chosen_mse=0.5, retuning=Retuning(1.1, 0.5, 0.75)), "explained", "named"),
        # a core identified anew explains what a friction does that has grown far
        (replace(EXPLAINED, retuning=ANEW, width_grown=1.5), "reshaped", "retuned"),
        (replace(AMBIGUOUS, retuning=ANEW, width_grown=1.5), "reshaped", "retuned"),
        (replace(NOTHING, retuning=ANEW, width_grown=1.5), "reshaped", "retuned"),
        (replace(EXPLAINED, retuning=ANEW, width_grown=1.3), "explained", "named"),
        (replace(EXPLAINED, retuning=replace(ANEW, reidentified_share=0.74), width_grown=1.5), "explained", "named"),
        (replace(EXPLAINED, retuning=ANEW, width_grown=1.5, jumps=True), "explained", "named"),
        # trials
        (replace(EXPLAINED, too_little=True), "too_little", "too_little"),
        (replace(EXPLAINED, too_little=True, unrelated=True), "too_little", "too_little"),
        (replace(NOTHING, unrelated=True, sensor=True, jumps=True), "unrelated", "unknown"),
    ],
)
def test_every_row_of_the_table(facts: VerdictFacts, case: str, verdict: str) -> None:
    decision = decide_verdict(facts)
    assert (decision.case, decision.verdict) == (case, verdict)


def test_what_a_ruling_implies() -> None:
    assert decide_verdict(AMBIGUOUS).ambiguity == (("lag", "delay"),)
    assert decide_verdict(replace(AMBIGUOUS, structure_left=True)).ambiguity == ()
    assert decide_verdict(AMBIGUOUS).explained
    assert not decide_verdict(replace(OPEN, jumps=True)).explained
    beside = decide_verdict(replace(OPEN, sensor=True))
    assert beside.case == "sensor_beside_unknown"
    assert beside.sensor
    assert beside.effects_unknown
    assert not decide_verdict(replace(NOTHING, sensor=True, form_mse=0.5)).sensor


mse = st.floats(1e-6, 10.0)
facts_ = st.builds(
    VerdictFacts,
    effects=st.sampled_from([frozenset(), frozenset({"lag"}), frozenset({"lag", "creep"})]),
    retuned_mse=mse,
    chosen_mse=mse,
    retuned_fit_mse=mse,
    floor_mse=mse,
    form_mse=mse,
    structure_left=st.booleans(),
    ambiguity=st.sampled_from([(), (("lag", "delay"),)]),
    sensor=st.booleans(),
    new_step=st.booleans(),
    jumps=st.booleans(),
    too_little=st.booleans(),
    unrelated=st.booleans(),
    retuning=st.builds(Retuning, st.floats(0, 9), mse, st.floats(0, 1)),
    final=st.one_of(st.none(), st.builds(FinalFacts, st.floats(-1, 1), st.floats(0, 20), st.booleans(), st.booleans())),
)


@given(facts_)
def test_rules_that_hold_for_all_facts(facts: VerdictFacts) -> None:
    decision = decide_verdict(facts)
    assert decision.verdict == VERDICTS[decision.case]
    assert bool(decision.ambiguity) == (decision.verdict == "one_of")
    if facts.too_little or facts.unrelated:
        assert decision.verdict == ("too_little" if facts.too_little else "unknown")
        assert (decision.sensor, decision.explained) == (False, False)
    elif facts.jumps:
        assert decision.verdict in ("named", "one_of")
    if decision.sensor:
        assert facts.sensor or facts.new_step
    if decision.verdict == "retuned":
        assert facts.retuning.moved >= 1.2
        assert not decision.explained
    # The final trials alone never turn a gap into none, unless it is at their floor, nor an unexplained gap into an
    # explanation by effects.
    before = decide_verdict(replace(facts, final=None))
    assert (before.verdict == "none") == (decision.verdict == "none") or decision.case == "at_floor"
    if facts.final is not None and facts.final.unproven:
        assert not decision.explained
    assert before.explained or not decision.explained


def test_the_reason_states_the_verdict_and_its_numbers() -> None:
    gap = Gap(3.0, 1.0, 0.2, 0.1, "repeats", 0.9, 0.1, (0.8, 0.95), ("a.csv",))
    sizes = "(retuned 1.00 deg, floor 0.100 deg)"
    texts = {
        "one_of": (AMBIGUOUS, "one of lag or delay: these trials cannot tell them apart; 90 % of"),
        "unknown": (NOTHING, f"a structural gap that no effect of the library explains {sizes}"),
        "too_little": (replace(NOTHING, too_little=True), f"too little: 3 s in all {sizes}"),
    }
    for facts, text in texts.values():
        assert text in reason_for(decide_verdict(facts), (), gap, "3 s in all", "")


@given(st.floats(0, 1), st.floats(0, 1), st.booleans(), st.sampled_from(["lag", "trial_shift"]))
def test_what_is_stable_and_closes_much_is_likelier_and_what_has_rivals_less(
    share: float, stable: float, ambiguous: bool, name: str
) -> None:
    chance = probability(name, share, ambiguous, stable)
    assert 0 < chance < 1
    assert probability(name, 1.0, ambiguous, 1.0) >= chance >= probability(name, 0.0, ambiguous, 0.0)
    assert probability(name, share, True, stable) <= chance
    assert probability("trial_shift", share, ambiguous, stable) <= probability("lag", share, ambiguous, stable)
    assert probability("trial_shift", 1.0, ambiguous, 1.0) == probability("lag", 1.0, ambiguous, 1.0)
    assert probability(name, share, ambiguous, stable, untried=True) < 0.8


@pytest.mark.parametrize(
    ("effects", "ambiguity", "form"),
    [
        ({"lag", "contact"}, (("contact", "asymmetry", "nonlinear_gain"),), {"contact"}),
        ({"contact"}, (("contact", "asymmetry", "nonlinear_gain"),), set()),  # alone it is the open question itself
        ({"lag", "contact"}, (("contact", "asymmetry"),), set()),
        ({"lag", "contact"}, (("contact", "nonlinear_gain", "slack"),), set()),
    ],
)
def test_what_three_shapes_explain_equally_beside_another_effect_is_form(
    effects: set[str], ambiguity: tuple[tuple[str, ...], ...], form: set[str]
) -> None:
    assert replace(EXPLAINED, effects=frozenset(effects), ambiguity=ambiguity).form_like == form
