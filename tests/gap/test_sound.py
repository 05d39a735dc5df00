"""Laws of a sound diagnosis: what is named is proven, and no sentence contradicts another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.decide.gap_closed import ClosedByCause, GapClosed, negligible_cause
from hystmpc.gap.decide.verdict import decide_verdict
from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.diagnosis import Diagnosis, Gap, Stability
from hystmpc.gap.report.page import NOT_DETERMINED, parameters_table
from hystmpc.gap.report.words import (
    ceiling_sentence,
    floor_words,
    headline,
    parameter_words,
    reason_for,
    stability_sentence,
)
from hystmpc.models.chain import Chain
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.trials.trial import Trial

from ..models.zoo import BACKLASH
from .engine_examples import DT, simulator_of, trials_of
from .report_examples import VERDICTS, report_data
from .test_verdict import NOTHING

ENDS = st.floats(-1, 1)
GAP = Gap(3.0, 1.0, 0.2, 0.1, "repeats", 0.9, 0.1, (0.8, 0.95), ("a.csv",))


@given(st.dictionaries(st.sampled_from(["lag", "creep", "contact"]), ENDS, max_size=3), ENDS)
def test_what_is_proven_has_intervals_above_zero_alone_and_together(lows: dict[str, float], together: float) -> None:
    causes = {name: ClosedByCause(0.5, (low, 1.0), 1.0, {}) for name, low in lows.items()}
    closed = GapClosed(replace(GAP, closed_ci90=(together, 1.0)), causes, 0.1)
    proven = together > 0 and all(low > 0 for low in lows.values())
    assert bool(closed.unproven()) == bool(causes and not proven)
    if closed.unproven():
        assert lows[closed.unproven()] == min(lows.values())


@given(st.floats(-1, 1), ENDS)
def test_faults_of_the_sensor_have_to_close_something_and_need_no_interval(share: float, low: float) -> None:
    """The log itself proves them; a resample without the few blocks that hold them is no evidence against them."""
    causes = {"lag": ClosedByCause(0.5, (0.2, 1.0), 1.0, {}), "sensor": ClosedByCause(share, (low, 1.0), 1.0, {})}
    closed = GapClosed(replace(GAP, closed_ci90=(0.1, 1.0)), causes, 0.1)
    assert closed.unproven() == ("sensor" if share <= 0 else "")


@given(st.dictionaries(st.sampled_from(["lag", "creep", "contact"]), st.floats(0.01, 0.5), min_size=1))
def test_beside_others_what_could_be_replaced_has_to_close_five_percent(shares: dict[str, float]) -> None:
    assert negligible_cause(shares, ()) == ""
    found = negligible_cause(shares, shares)
    assert (found == "") == (len(shares) == 1 or min(shares.values()) >= 0.05)
    assert found == "" or shares[found] == min(shares.values())


@given(st.floats(0, 1), st.floats(0, 1))
def test_the_ceiling_bounds_the_headline_or_says_why_not(ceiling: float, closed: float) -> None:
    diagnosis = report_data("named", 3).diagnosis
    gap = replace(diagnosis.gap, closed_share=closed, unexplained_share=1 - closed)
    said = ceiling_sentence(replace(diagnosis, gap=gap, explainable_share=ceiling))
    assert ("can reach" in said) == (closed <= ceiling)
    assert ("no bound" in said) == (closed > ceiling)


@given(st.floats(0, 1), st.integers(8, 40))
def test_a_verdict_that_flips_says_so_in_the_headline(share: float, count: int) -> None:
    diagnosis = replace(report_data("named", 3).diagnosis, stability=Stability(share, count))
    assert ("flips" in headline(diagnosis)) == (share < 0.7)
    assert f"{round(share * count)} of {count}" in stability_sentence(diagnosis)


def test_what_is_not_determined_has_no_number_and_every_number_a_unit() -> None:
    evidence = report_data("named")
    for row, shown in zip(evidence.parameters, parameters_table(evidence).rows, strict=True):
        assert shown[2] == row.unit != ""
        assert (NOT_DETERMINED in shown) == row.flat == (row.value not in shown)
    (effect,) = evidence.diagnosis.effects
    assert parameter_words(effect) == "share 0.16 [1], tau_s not determined"


@pytest.mark.parametrize("verdict", VERDICTS)
def test_what_is_proposed_concerns_what_is_open(verdict: str) -> None:
    diagnosis: Diagnosis = next(e for e in (report_data(v, 3) for v in VERDICTS if v == verdict)).diagnosis
    motion, probability = diagnosis.next_motion, dict(diagnosis.ranking)
    if motion is not None and verdict in ("named", "one_of"):
        named = {name for names in diagnosis.ambiguity for name in names} | {e.name for e in diagnosis.effects}
        assert all(name in named or probability[name] >= 0.02 for name in motion.separates)


def test_a_gap_that_repeats_do_not_have_is_not_at_its_own_floor() -> None:
    gap = replace(GAP, floor_kind="noise", floor_rmse_deg=0.05, repeats_rmse_deg=0.99, closed_share=0.0)
    said = reason_for(decide_verdict(NOTHING), (), gap, "", "")
    assert "repeats of a motion differ by 0.990 deg" in said
    assert "Repeats of a motion differ by 0.99 deg" in floor_words(gap)
    assert "No motion was repeated" in floor_words(replace(gap, repeats_rmse_deg=float("nan")))


def widths(*wider: float) -> list[Trial]:
    """Triangles of 0.157 Hz on plays whose widths differ from trial to trial."""
    command = 6.0 - 12.0 * np.abs((0.157 * DT * np.arange(1000)) % 1 - 0.5)
    m_lo, m_up, c_lo, c_up = BACKLASH.values
    made = []
    for k, more in enumerate(wider):
        core = Backlash(m_lo, m_up, c_lo + more, c_up - more)
        made += [replace(trials_of(Chain(core), [command], seed=k)[0], source=f"trial_{k}.csv")]
    return made


@pytest.mark.slow
def test_widths_that_differ_from_trial_to_trial_are_no_disturbance() -> None:
    diagnosis, _ = conclude(find_causes(widths(0.1, 0.5, 0.3, 0.8), simulator_of(BACKLASH), ordered=False))
    assert "periodic_disturbance" not in {e.name for e in diagnosis.effects}
    assert dict(diagnosis.ranking)["periodic_disturbance"] <= 0.3
    assert diagnosis.stability is not None
    assert diagnosis.stability.resamples >= 8
    assert all(e.closed_ci90[0] > 0 for e in diagnosis.effects)
