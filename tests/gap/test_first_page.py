"""The first page says in a dozen sentences what the result says, and recommends nothing that is not proven."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.diagnosis import FIXED_FILE, NextMotion, Stability, TrackingGap, Untestable, Verdict
from hystmpc.gap.report.folder import diagnosis_json
from hystmpc.gap.report.page import diagnosis_report
from hystmpc.gap.report.report_data import ReportData
from hystmpc.gap.report.words import certainty, headline, next_actions, verdict_facts
from hystmpc.trials.report import Folded, Heading, Plot, Points

from .report_examples import VERDICTS, report_data

MOST_SENTENCES = 12
SHARES = st.floats(0.01, 0.99)


def said(evidence: ReportData) -> list[str]:
    """All points of the first page."""
    diagnosis = evidence.diagnosis
    return [*verdict_facts(diagnosis), *next_actions(evidence), *certainty(diagnosis)]


def crowded() -> ReportData:
    """A diagnosis with everything that can be said at once: four effects, a motion, no order, no repeats."""
    evidence = report_data("named", 6)
    first, diagnosis = evidence.diagnosis.effects[0], evidence.diagnosis
    names = ("creep", "lag", "slack", "contact")
    return replace(
        evidence,
        diagnosis=replace(
            diagnosis,
            effects=tuple(replace(first, name=name) for name in names),
            gap=replace(diagnosis.gap, floor_kind="noise"),
            next_motion=NextMotion("next_motion.csv", ("creep", "drift"), 0.85, 76.0),
            tracking=TrackingGap(1.2, 0.4, (1.1, 1.3), (0.35, 0.45)),
            order="unknown",
            untestable=(Untestable("drift", "Why."), Untestable("set_across_trials", "Why.")),
        ),
    )


def numbers(value: Any) -> Iterator[float]:
    """Every number of a JSON value."""
    if isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


@pytest.fixture(scope="module", params=[*VERDICTS, "crowded"])
def evidence(request: pytest.FixtureRequest) -> ReportData:
    """Made for the tests that ask, not when tests are collected."""
    return crowded() if request.param == "crowded" else report_data(request.param, 6)


def test_every_number_is_one_of_the_result(evidence: ReportData) -> None:
    result = json.loads(diagnosis_json(evidence.diagnosis))
    places = [place["share"] / place["density"] for place in result["where"].values()]
    splits = [result["resamples"], (result["stability"] or 0.0) * result["resamples"]]
    tracking = evidence.diagnosis.tracking
    known = [*numbers(result), *places, *splits, float(len(result["gap"]["final_trials"]))]
    known += [] if tracking is None else [tracking.fall_share]
    shown = {text for x in known for text in (f"{x:.3g}", f"{x:.0f}", f"{100 * x:.0f}")} | {"90"}
    for text in said(evidence):
        if text.rstrip(".").lower() == result["reason"].rstrip(".").lower():
            continue
        assert set(re.findall(r"(?<![\w.])-?\d+(?:\.\d+)?(?!\w)", text)) <= shown, text


def test_a_dozen_sentences_at_most(evidence: ReportData) -> None:
    texts = said(evidence)
    assert 0 < sum(len(re.findall(r"\.(?=\s|$)", text)) for text in texts) <= MOST_SENTENCES, texts
    for text in texts:
        assert text.endswith("."), text
        assert text[0].isupper(), text
        assert "nan" not in text.split(), text


@given(SHARES, SHARES, SHARES)
def test_probability_share_and_stability_are_those_of_the_result(chance: float, closed: float, stable: float) -> None:
    evidence = report_data("named", 3)
    found = replace(evidence.diagnosis.effects[0], probability=chance)
    diagnosis = replace(
        evidence.diagnosis,
        effects=(found,),
        gap=replace(evidence.diagnosis.gap, closed_share=closed),
        stability=Stability(stable, 40),
    )
    assert f"explains {100 * closed:.0f} % of the gap" in headline(diagnosis)
    assert f"Creep is present with {100 * chance:.0f} % probability." in certainty(diagnosis)
    advice = " ".join(next_actions(replace(evidence, diagnosis=diagnosis)))
    assert (f"Use {FIXED_FILE}" in advice) == (not diagnosis.stability.flips), "what flips is not recommended"


@pytest.mark.parametrize("verdict", ["one_of", "unknown", "too_little"])
def test_a_correction_that_is_not_proven_is_not_recommended(verdict: Verdict) -> None:
    assert f"Use {FIXED_FILE}" not in " ".join(next_actions(report_data(verdict, 6)))


@pytest.mark.parametrize("name", ["trial_shift", "sensor", "stick_slip"])
def test_what_the_corrected_simulator_cannot_hold_is_not_said_to_be_in_it(name: str) -> None:
    evidence = report_data("named", 3)
    creep = evidence.diagnosis.effects[0]
    alone, both = (
        " ".join(next_actions(replace(evidence, diagnosis=replace(evidence.diagnosis, effects=effects))))
        for effects in ((replace(creep, name=name),), (creep, replace(creep, name=name)))
    )
    words = name.replace("_", " ")
    assert alone == f"The file {FIXED_FILE} is retuned only: it does not hold {words}."
    assert both == f"Use {FIXED_FILE}: it is the simulator with creep. It does not hold {words}."


@given(st.floats(0.1, 5), st.floats(0.1, 5))
def test_without_a_gap_the_better_simulator_is_recommended(given_deg: float, retuned_deg: float) -> None:
    evidence = report_data("none", 6)
    gap = replace(evidence.diagnosis.gap, nominal_rmse_deg=given_deg, retuned_rmse_deg=retuned_deg)
    advice = next_actions(replace(evidence, diagnosis=replace(evidence.diagnosis, gap=gap)))[0]
    assert advice.startswith(f"Use {FIXED_FILE}" if retuned_deg < given_deg else "Keep the simulator as given")


def test_where_no_angle_follows_its_command_the_wiring_is_to_be_looked_at() -> None:
    evidence = report_data("unknown", 3)
    assert evidence.fixed is not None
    advice = next_actions(
        replace(evidence, nominal=evidence.fixed, fixed=None, diagnosis=replace(evidence.diagnosis, next_motion=None))
    )
    assert advice == ("Look for a wrong file or column, a loose sensor, or a tendon or line that is broken.",)


@pytest.mark.slow
@pytest.mark.parametrize("verdict", VERDICTS)
def test_one_figure_stands_first_and_everything_else_is_folded(verdict: Verdict) -> None:
    pieces = diagnosis_report(report_data(verdict, 3)).pieces
    assert pieces[0] == Heading(headline(report_data(verdict, 3).diagnosis))
    first = [piece for piece in pieces if not isinstance(piece, Folded)]
    assert pieces[: len(first)] == tuple(first), "nothing stands between or below the folded sections"
    assert sum(isinstance(piece, Plot) for piece in first) == 1
    assert {type(piece) for piece in first} == {Heading, Points, Plot}


@pytest.mark.parametrize("verdict", ["named", "none"])
def test_no_heading_is_without_content(verdict: Verdict) -> None:
    pieces = diagnosis_report(report_data(verdict, 2)).pieces
    assert all(piece.pieces for piece in pieces if isinstance(piece, Folded))
    assert all(piece.texts for piece in pieces if isinstance(piece, Points))
    under = [(a, b) for a, b in itertools.pairwise(pieces) if isinstance(a, Heading) and a.level == 3]
    assert under
    assert all(isinstance(b, Points | Plot) for _, b in under)
