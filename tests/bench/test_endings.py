"""When an investigation ends, and that it says why."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.bench.round_plan import RoundPlan
from hystmpc.bench.rounds import RoundVerdict, with_next
from hystmpc.gap.diagnosis import Verdict

PLAN = RoundPlan(("4-designed",), 15.0, ("lag", "delay"), 0.9, 0.85)


def judged(verdict: Verdict, *effects: str, ambiguity: tuple[tuple[str, ...], ...] = ()) -> RoundVerdict:
    return RoundVerdict(verdict, effects, ambiguity, "reason", "headline", "closed", 0.9, 0.9, 1.0, 0.1, 3)


def ended(*verdicts: RoundVerdict, left_s: float = 100.0, plan: RoundPlan | None = PLAN) -> RoundVerdict:
    return with_next(verdicts[-1], verdicts[:-1], lambda: plan, left_s, 12.0)


LAG, CREEP, NONE, UNKNOWN = judged("named", "lag"), judged("named", "creep"), judged("none"), judged("unknown")
RETUNED = judged("retuned")
BOTH = judged("named", "lag", "creep")
FLIPS, HALF, PART = replace(LAG, flips=True), replace(LAG, closed_share=0.5), replace(LAG, closed_share=0.49)
EITHER = judged("one_of", "lag", ambiguity=(("lag", "delay"),))


@pytest.mark.parametrize(
    ("verdicts", "ending"),
    [
        ((LAG,), ""),
        ((LAG, LAG), "named"),
        ((LAG, CREEP), ""),
        ((LAG, CREEP, LAG), ""),
        ((CREEP, LAG, LAG), "named"),
        ((BOTH, BOTH), ""),
        ((BOTH, BOTH, BOTH), "named"),
        ((NONE, NONE, NONE), ""),
        ((NONE, NONE, NONE, NONE), "no_gap"),
        ((RETUNED, NONE, RETUNED, NONE), "no_gap"),
        ((LAG, NONE, RETUNED), ""),
        ((UNKNOWN, UNKNOWN, UNKNOWN), ""),
        ((UNKNOWN,) * 4, ""),
        ((EITHER,) * 4, ""),
        ((FLIPS, FLIPS), ""),
        ((FLIPS, LAG), "named"),
        ((HALF, HALF), "named"),
        ((PART, PART, PART), ""),
        ((NONE, NONE, NONE, replace(NONE, flips=True)), ""),
        ((EITHER, UNKNOWN, EITHER), ""),
        ((judged("too_little"),) * 5, ""),
    ],
)
def test_it_ends_where_the_result_is_stable(verdicts: tuple[RoundVerdict, ...], ending: str) -> None:
    found = ended(*verdicts)
    assert found.ended == ending
    assert (found.next is None) == bool(ending)


def test_it_ends_where_time_or_motions_run_out() -> None:
    assert ended(LAG, left_s=11.9).ended == "budget"
    assert ended(LAG, plan=None).ended == "nothing_gained"
    assert "in 4 rounds in a row" in ended(*[UNKNOWN] * 4, plan=None).why


@given(
    verdicts=st.lists(st.sampled_from([LAG, CREEP, NONE, UNKNOWN, EITHER]), min_size=1, max_size=6),
    left_s=st.floats(0, 60),
    some=st.booleans(),
)
def test_it_goes_on_or_says_why_not_and_changes_no_verdict(
    verdicts: list[RoundVerdict], left_s: float, some: bool
) -> None:
    found = ended(*verdicts, left_s=left_s, plan=PLAN if some else None)
    assert (found.next is None) == bool(found.ended) == bool(found.why)
    assert found.next is None or left_s >= 12.0
    assert replace(found, next=None, ended="", why="") == verdicts[-1]
