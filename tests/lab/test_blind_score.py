"""Scoring on hand-made diagnoses: the perfect, the silent, the random and the confidently wrong one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.effects.catalogue import confusable
from hystmpc_lab.blind.bars import (
    bars,
    calibration,
    chance,
    confusion,
    metrics,
    orders_bar,
    overlap,
    resampled,
    resolved,
    true_share,
)
from hystmpc_lab.blind.generators import ALIASED_RATE, CONFIGURATION, LABELS, SCATTER
from hystmpc_lab.blind.reading import DiagnosisReading, ScoredCase, reading_of
from hystmpc_lab.blind.report import blind_report
from hystmpc_lab.blind.score import kind_of_miss, score_json, score_of
from hystmpc_lab.page import Rate

from .blind_examples import all_answers, always, answer, named, perfect


def by_name(cases: list[ScoredCase]) -> dict[str, float]:
    return {bar.name: bar.value for bar in bars(cases)}


def test_a_perfect_diagnoser_meets_every_bar_that_is_measured() -> None:
    found = bars(perfect(all_answers()))
    # Every interval of the hand-made diagnosis holds the truth: 100 % is more than the bar for 90 % intervals allows.
    assert {bar.name for bar in found if bar.state == "missed"} == {"90 % intervals cover"}
    assert {bar.name for bar in found if bar.state == "not measured"} == {
        "ambiguities that the next motion resolves",
        "same names in any order of the files",
    }
    assert {bar.name for bar in metrics(perfect(all_answers())) if bar.state != "met"} == set()
    values = {bar.name: bar.value for bar in found}
    for name in ("class top-1", "family top-1", "set precision (pairs)", "set recall (pairs)", "localisation F1"):
        assert values[name] == 1.0
    assert values["false alarms"] == values["calibration error"] == values["out of library: confidently wrong"] == 0.0
    assert score_of(perfect(all_answers())).misses() == []


def test_a_share_that_the_users_simulator_does_not_confirm_misses_its_bar() -> None:
    name = "own simulator: confirmed near the said share"
    cases = perfect(all_answers())
    assert by_name(cases)[name] == 1.0
    assert math.isnan(by_name([replace(case, confirmed=()) for case in cases])[name])
    far = [replace(case, confirmed=tuple((0.9, 0.6) for _ in case.confirmed)) for case in cases]
    assert by_name(far)[name] == 0.0
    # One effect of several that is not confirmed is enough.
    several = replace(cases[0], confirmed=((0.9, 0.9), (0.5, 0.9)))
    assert by_name([several])[name] == 0.0


def test_always_none_has_no_false_alarm_and_no_recall() -> None:
    found = by_name(always(all_answers(), DiagnosisReading("none")))
    assert found["false alarms"] == 0.0
    assert found["class top-1"] == found["set recall (pairs)"] == found["out of library: abstains"] == 0.0
    assert math.isnan(found["set precision (pairs)"])
    assert math.isnan(found["calibration error"])


def test_always_one_name_alarms_everywhere() -> None:
    found = by_name(always(all_answers(), named("lag", probability=0.95)))
    assert found["false alarms"] == 1.0
    assert found["class top-1"] == pytest.approx(1 / len(LABELS))
    confounders = sum(label != "lag" and confusable("lag", label) for label in LABELS)
    assert found["family top-1"] == pytest.approx((1 + confounders) / len(LABELS))
    assert found["out of library: confidently wrong"] == 1.0


def test_an_unnamed_gap_is_an_alarm_where_there_is_none() -> None:
    assert by_name(always([answer("none")], DiagnosisReading("unknown")))["false alarms"] == 1.0
    assert by_name(always([answer("none")], DiagnosisReading("too_little")))["false alarms"] == 0.0


def test_a_retuned_device_is_healthy_and_lowers_no_detection_rate() -> None:
    cases = always([answer("retuned")], DiagnosisReading("retuned"))
    assert cases[0].right
    assert by_name(cases)["false alarms"] == 0.0
    assert by_name(always([answer("retuned")], named("creep")))["false alarms"] == 1.0
    detection = {bar.name: bar.cases for bar in metrics(cases)}
    assert detection["detection rate, all sizes"] == 0
    assert detection["false-alarm rate"] == 1


@pytest.mark.parametrize("label", ["", SCATTER, ALIASED_RATE])
def test_of_an_aliased_motion_anything_may_be_said_but_a_disturbance(label: str) -> None:
    truth = answer("aliased", [label] if label else [])
    assert truth.labels == ()
    assert ScoredCase("a", truth, named("trial_shift", probability=0.95)).right
    assert not ScoredCase("b", truth, named("periodic_disturbance", probability=0.4)).right
    assert ScoredCase("c", truth, DiagnosisReading("unknown", ranking=(("periodic_disturbance", 0.3),))).right
    sure = DiagnosisReading("unknown", ranking=(("periodic_disturbance", 0.31),))
    assert not ScoredCase("d", truth, sure).right
    assert score_of([ScoredCase("d", truth, sure)]).confusion.counts.size == 0


def test_a_configuration_needs_its_groups_beside_its_name() -> None:
    truth = answer("configuration", [CONFIGURATION]).model_copy(update={"second": (3, 4)})
    groups = (frozenset((1, 2)), frozenset((3, 4)))
    right = ScoredCase("a", truth, replace(named(CONFIGURATION), groups=groups))
    assert right.right
    other = replace(right, reading=replace(right.reading, groups=(frozenset((1, 2, 3)), frozenset((4,)))))
    assert not other.right
    assert kind_of_miss(other) == "the right name with other groups of trials"
    assert not replace(right, reading=named("trial_shift")).right
    part = replace(right, reading=replace(right.reading, groups=(frozenset((2,)), frozenset((4, 3)))))
    assert part.right  # a trial that the diagnosis left out belongs to no group


@pytest.mark.parametrize(
    ("truth", "after", "right"),
    [
        (("lag",), named("lag"), True),
        (("lag",), named("delay"), False),
        (("lag",), named("lag", "delay"), False),
        (("lag",), replace(named("lag"), verdict="one_of", ambiguity=(frozenset({"lag", "delay"}),)), False),
        (("lag",), DiagnosisReading("unknown"), False),
        (("creep",), named("creep"), True),  # neither of the two that were open
        (("creep",), named("contact"), False),
        (("creep",), DiagnosisReading("none"), False),
        ((), DiagnosisReading("none"), True),
        ((), named("contact"), False),
    ],
)
def test_a_motion_resolves_what_it_leaves_true(truth: tuple[str, ...], after: DiagnosisReading, right: bool) -> None:
    asked = replace(named("delay"), verdict="one_of", ambiguity=(frozenset({"delay", "lag"}),))
    assert resolved(ScoredCase("001", answer("single", truth), asked, after)) == right


def test_orders_count_against_the_usual_set_of_their_case() -> None:
    a, b = frozenset({"lag"}), frozenset({"creep"})
    found = orders_bar({"001": (a, a, a, b), "002": (a,) * 4})
    assert (found.value, found.cases) == (7 / 8, 8)
    assert found.misses == ("001",)
    assert orders_bar({}).state == "not measured"


def test_a_name_that_raises_the_error_is_counted() -> None:
    sound = named("lag")
    bad = replace(sound, closed_shares=(-0.1,))
    name = "named effects that close less than nothing"
    assert by_name(always([answer("single", ["lag"])], sound))[name] == 0.0
    assert by_name(always([answer("single", ["lag"])], bad))[name] == 1.0
    assert {bar.goal for bar in bars([]) if bar.name == name} == {"0"}


def test_the_probability_of_the_truth_is_that_of_the_ranking() -> None:
    said = DiagnosisReading("unknown", ranking=(("creep", 0.7), ("lag", 0.2)))
    cases = always([answer("single", ["lag"]), answer("single", ["drift"])], said)
    assert by_name(cases)["mean probability on the true class"] == pytest.approx(0.1)


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_a_resampled_interval_of_a_share_holds_it(hits: list[bool]) -> None:
    cases = [
        ScoredCase(str(k), answer("none"), DiagnosisReading("none" if hit else "unknown")) for k, hit in enumerate(hits)
    ]
    low, high = resampled(cases, lambda some: sum(c.right for c in some) / len(some))
    assert 0 <= low <= sum(hits) / len(hits) + 1e-9
    assert sum(hits) / len(hits) - 1e-9 <= high <= 1


def test_rules_beside_are_asked_where_there_is_nothing_too() -> None:
    healthy = [answer("none"), answer("misset"), answer("controls")]
    said = replace(DiagnosisReading("none"), others={"bic": "creep", "correlation": "none"})
    found = score_of(always([*healthy, answer("single", ["lag"])], said)).groups["nothing wrong, left alone by"]
    assert {name: (r.hits, r.cases) for name, r in found.items()} == {
        "diagnosis": (3, 3),
        "rule: bic": (0, 3),
        "rule: correlation": (3, 3),
    }
    assert score_of(always([answer("single", ["lag"])], said)).groups["nothing wrong, left alone by"] == {}


@pytest.mark.slow
def test_random_guesses_score_near_chance() -> None:
    random = np.random.default_rng(0)
    cases = [
        ScoredCase(str(k), answer("single", [str(random.choice(LABELS))]), named(str(random.choice(LABELS))))
        for k in range(400)
    ]
    found = by_name(cases)["class top-1"]
    assert found == pytest.approx(1 / len(LABELS), abs=0.04)
    assert chance(cases) == pytest.approx(found, abs=0.04)


def test_leaving_it_open_is_right_only_where_the_motions_cannot_tell() -> None:
    both = DiagnosisReading(
        "one_of", ("delay",), (0.5,), (frozenset(("lag", "delay")),), (("delay", 0.5), ("lag", 0.4))
    )
    assert not ScoredCase("a", answer("single", ["lag"]), both).right
    assert ScoredCase("b", answer("single", ["lag"], separable=False), both).right
    assert not ScoredCase("c", answer("single", ["creep"], separable=False), both).right
    assert ScoredCase("d", answer("single", ["creep"], separable=False), DiagnosisReading("too_little")).right
    assert not ScoredCase("e", answer("single", ["creep"], separable=False), DiagnosisReading("none")).right


def test_small_gaps_do_not_count_for_the_bars() -> None:
    found = {bar.name: bar for bar in bars(perfect([answer("single", ["lag"], ratio=1.5)]))}
    assert found["class top-1"].cases == 0
    assert found["class top-1"].state == "not measured"


def test_a_class_left_out_asks_for_unknown_and_a_decoy_for_its_name() -> None:
    assert answer("without", ["lag"], without=["lag"]).truth == "unknown"
    assert answer("without", ["lag"], without=["creep"]).truth == "lag"


def test_confusion_rows_add_up_to_the_cases_of_their_truth() -> None:
    cases = always(all_answers(), named("creep"))
    found = confusion(cases)
    assert found.counts.sum() == len(cases)
    assert found.counts[:, found.guesses.index("creep")].sum() == len(cases)
    ideal = confusion(perfect(all_answers()))
    assert np.array_equal(ideal.counts, np.diag(np.diag(ideal.counts)))


def test_the_true_share_counts_from_the_reported_floor() -> None:
    truth = answer("single", ["lag"]).model_copy(update={"retuned_deg": 1.0, "form_deg": 0.4, "noise_deg": 0.1})
    shares = [true_share(ScoredCase("a", truth, replace(named("lag"), floor_deg=floor))) for floor in (0.1, 0.3, 0.6)]
    assert shares[0] == pytest.approx(1 - 0.4**2)
    assert shares[0] < shares[1] < shares[2] == 1.0


def test_calibration_error_is_the_distance_of_confidence_and_truth() -> None:
    right = [ScoredCase(str(k), answer("single", ["lag"]), named("lag", probability=0.7)) for k in range(6)]
    wrong = [ScoredCase(str(k), answer("single", ["lag"]), named("creep", probability=0.7)) for k in range(4)]
    assert calibration([*right, *wrong]).error == pytest.approx(0.1)


@given(st.integers(0, 200), st.integers(1, 200))
def test_the_interval_of_a_rate_holds_it_and_stays_a_share(hits: int, more: int) -> None:
    found = Rate(hits, hits + more)
    low, high = found.ci90
    assert 0 <= low <= found.value <= high <= 1


@given(st.lists(st.tuples(st.sets(st.sampled_from(LABELS)), st.sets(st.sampled_from(LABELS))), min_size=1))
def test_f1_lies_between_precision_and_recall(pairs: list[tuple[set[str], set[str]]]) -> None:
    found = overlap(pairs)
    if found.said and found.true:
        ends = sorted((found.precision, found.recall))
        assert ends[0] - 1e-12 <= found.f1 <= ends[1] + 1e-12


def test_pairs_are_confusable_both_ways() -> None:
    assert confusable("lag", "delay")
    assert confusable("delay", "lag")
    assert not confusable("lag", "sensor")


def test_a_diagnosis_is_read_as_the_interface_has_it() -> None:
    data = {
        "verdict": "one_of",
        "effects": [{"name": "lag", "probability": 0.6}],
        "ambiguity": [["lag", "delay"]],
        "ranking": [["lag", 0.6], ["delay", 0.3]],
        "gap": {"closed_share": 0.9},
        "where": {"hold": {"share": 0.6, "density": 2.1}, "0.5 Hz": {"share": 0.1, "density": 3.0}},
        "baselines": {"bic": "creep"},
    }
    said = reading_of(data)
    assert said.claims == ("lag",)
    assert said.may_be("delay")
    assert said.dense_regions == {"hold"}
    assert said.others == {"bic": "creep"}
    with pytest.raises(ValueError, match="verdict 'perhaps'"):
        reading_of({**data, "verdict": "perhaps"})


@pytest.mark.slow
def test_score_and_report_show_every_miss() -> None:
    cases = always(all_answers(), named("creep"))
    score = score_of(cases)
    data = score_json(score)
    wrong = [case.name for case in cases if not case.right]
    assert [miss["case"] for miss in data["misses"]] == wrong
    assert "NaN" not in str(data)
    page = blind_report(score).html()
    assert all(f">{name}<" in page for name in wrong)
