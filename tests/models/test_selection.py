"""Search for the causes: it goes on after an exchange, and a sure second cause is not hidden by a large first one."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hystmpc.models.identify.cross_validation import HeldOutErrors, Hypothesis, gain, sureness
from hystmpc.models.identify.least_squares import side_by_side
from hystmpc.models.identify.problem import TrialTerms
from hystmpc.models.identify.runs import Blocks
from hystmpc.models.identify.selection import OF_SINGLE_TRIALS, SelectionSettings, reselect, select

SETTINGS, FLOOR = SelectionSettings(), 0.01
BLOCKS, SAMPLES = 24, 10


def judged(names: tuple[str, ...], mse: float, uneven: float = 0.0) -> HeldOutErrors:
    """A hypothesis with errors of that size on four trials, every other block worse by `uneven` [deg^2]."""
    effects = [SimpleNamespace(effect=name, free=()) for name in names if name not in OF_SINGLE_TRIALS]
    terms = SimpleNamespace(names=tuple(name for name in names if name in OF_SINGLE_TRIALS))
    problem = cast("Any", SimpleNamespace(effects=effects, terms=terms))
    energy = SAMPLES * (mse + uneven * (-1.0) ** np.arange(BLOCKS))
    run = np.arange(BLOCKS) // 6
    return HeldOutErrors(energy, np.full(BLOCKS, SAMPLES), run, Hypothesis(problem, np.empty(0), mse), (), ())


def chosen(uneven: float = 0.0, **errors: float) -> set[str]:
    """Causes chosen among these, each with its error [deg^2]; names of several are joined by `__`.

    Errors with two causes and more are uneven: a fall from one cause to two has the standard error u sqrt(6/5/24), and
    from two to three twice that.
    """
    made = []
    for name, mse in errors.items():
        names = tuple(name.split("__")) if name != "nothing" else ()
        made.append(judged(names, mse, (-1) ** len(names) * uneven if len(names) > 1 else 0.0))
    return set(reselect({j.hypothesis.effects: j for j in made}, SETTINGS, FLOOR).chosen.hypothesis.effects)


def test_after_an_exchange_a_further_cause_is_looked_for() -> None:
    found = chosen(nothing=10.0, nonlinear_gain=0.9, slack=1.0, nonlinear_gain__creep=0.88, slack__asymmetry=0.1)
    assert found == {"slack", "asymmetry"}


@given(st.floats(0.02, 0.6), st.sampled_from([0.0, 0.2]))
def test_beside_a_large_cause_a_sure_one_needs_much_of_what_is_left(left: float, uneven: float) -> None:
    assume(left >= uneven)  # no block has a negative error
    found = chosen(uneven, nothing=10.0, lag=0.6, lag__creep=left)
    fall, error = 0.6 - left, uneven * np.sqrt(6 / 5 / BLOCKS)
    clear = fall > SETTINGS.clear_errors * error
    most = SETTINGS.clear_most if clear else SETTINGS.most_share
    enough = fall > most * (0.6 - FLOOR) and fall > SETTINGS.sure_share * 9.99 and fall > SETTINGS.sure_errors * error
    assert ("creep" in found) == enough


def test_a_clear_third_cause_may_be_a_small_part_of_what_is_left() -> None:
    errors = {"nothing": 7.0, "delay": 5.0, "delay__creep": 3.8, "delay__creep__contact": 3.1}
    assert chosen(**errors) == {"delay", "creep", "contact"}
    assert chosen(uneven=0.3, **errors) == {"delay", "creep"}


def test_a_clear_line_beside_large_causes_needs_no_share_of_the_whole_gap() -> None:
    errors = {"nothing": 20.0, "lag": 0.9}
    assert chosen(**errors, lag__periodic_disturbance=0.8) == {"lag", "periodic_disturbance"}
    assert chosen(**errors, lag__contact=0.8) == {"lag"}
    assert chosen(uneven=0.2, **errors, lag__periodic_disturbance=0.8) == {"lag"}


@given(st.floats(0.02, 0.6), st.sampled_from(["asymmetry", "nonlinear_gain"]))
def test_beside_another_cause_a_generic_one_has_to_explain_most_of_what_is_left(left: float, name: str) -> None:
    found = chosen(nothing=3.0, lag=0.6, **{f"lag__{name}": left})
    assert (name in found) == (0.6 - left > SETTINGS.generic_share * 0.6)


@given(st.floats(0.02, 0.6), st.sampled_from(["asymmetry", "nonlinear_gain"]))
def test_beside_a_large_cause_a_generic_one_has_to_halve_what_is_left(left: float, name: str) -> None:
    """All of it is less than 8 % of the gap; three quarters of its energy are no form error of another cause."""
    found = chosen(nothing=10.0, lag=0.6, **{f"lag__{name}": left})
    assert (name in found) == (0.6 - left > SETTINGS.generic_sure * 0.6)


def test_an_exchange_brings_no_generic_cause_that_could_not_have_been_added() -> None:
    errors = {"nothing": 8.0, "lag": 1.0, "contact": 4.0, "asymmetry": 4.0, "lag__contact": 0.5}
    assert chosen(**errors, lag__asymmetry=0.4) == {"lag", "contact"}
    assert chosen(**errors, lag__asymmetry=0.3) == {"lag", "asymmetry"}


@dataclass(frozen=True)
class Named:
    """A candidate without parameters."""

    effect: str
    free: tuple[()] = ()
    starts: tuple[tuple[()], ...] = ((),)

    @property
    def label(self) -> str:
        return self.effect


class Fitted:
    """Trials on which two causes are there; each fit and each judgement is counted."""

    def __init__(self, refitted: float) -> None:
        self.fits, self.judgements, self._refitted = Counter[str](), Counter[str](), refitted

    def retuned(self) -> Hypothesis:
        return self._made((), 10.0)

    def with_causes(self, effects: Sequence[Any], terms: Any, z: object, starts: object) -> Hypothesis:
        del terms, z, starts
        names = tuple(candidate.effect for candidate in effects)
        self.fits["+".join(names)] += 1
        left = {frozenset({"lag"}): 4.0, frozenset({"slack"}): 6.0, frozenset({"lag", "slack"}): 0.1}
        return self._made(effects, left.get(frozenset(names), 12.0))

    def with_one_more(self, base: Hypothesis, candidate: Any) -> Hypothesis:
        return self.with_causes((*base.problem.effects, candidate), None, None, None)

    def finished(self, hypothesis: Hypothesis) -> Hypothesis:
        return hypothesis

    def without(self, hypothesis: Hypothesis, dropped: set[str]) -> Hypothesis:
        effects = [c for c in hypothesis.problem.effects if c.effect not in dropped]
        known = self.with_causes(effects, None, None, None)
        return self._made(effects, known.mse * self._refitted)

    def judge(self, hypothesis: Hypothesis) -> HeldOutErrors:
        self.judgements["+".join(sorted(hypothesis.effects))] += 1
        return replace(judged(tuple(hypothesis.effects), hypothesis.mse), hypothesis=hypothesis)

    def _made(self, effects: Sequence[Any], mse: float) -> Hypothesis:
        values = {"retuned": lambda q: None, "effect_values": lambda q: [{} for _ in effects]}
        problem = SimpleNamespace(effects=tuple(effects), terms=TrialTerms(), **values)
        return Hypothesis(cast("Any", problem), np.empty(0), mse)


@pytest.mark.parametrize(("refitted", "judgements"), [(1.0, 1), (0.9, 2)])
def test_what_a_cause_adds_is_fitted_again_only_where_the_rest_fits_better_than_before(
    refitted: float, judgements: int
) -> None:
    """The exchange of a cause starts from the other one, to which everything was added before."""
    trials, library = Fitted(refitted), [Named(name) for name in ("lag", "slack", "creep")]
    found = select(cast("Any", trials), cast("Any", library), SETTINGS, FLOOR, sorted(OF_SINGLE_TRIALS))
    assert found.chosen.hypothesis.effects == {"lag", "slack"}
    assert trials.judgements["lag"] == judgements
    assert trials.fits["lag+creep"] == judgements


def test_what_could_not_be_added_is_neither_fitted_nor_judged() -> None:
    """Of two causes 0.1 is left: less than a third one has to explain. What the fits do not need, trials do not."""
    trials, library = Fitted(1.0), [Named(name) for name in ("lag", "slack", "creep")]
    select(cast("Any", trials), cast("Any", library), SETTINGS, FLOOR, sorted(OF_SINGLE_TRIALS))
    assert not any(name.count("+") == 2 for name in trials.fits)
    assert trials.fits["lag+creep"]
    assert not trials.judgements["creep+lag"]


@given(st.floats(0.3, 9.0), st.floats(0.95, 1.5), st.sampled_from(["creep", "asymmetry", "trial_shift", "drift"]))
def test_a_cause_that_leaves_nearly_all_is_not_added(before: float, left: float, name: str) -> None:
    """The least that an addition has to explain: half of the lesser of two shares, `_Fits._may_be_worth`."""
    assert chosen(nothing=10.0, lag=before, **{f"lag__{name}": left * before}) == {"lag"}


def by_trial(names: tuple[str, ...], *mse: float) -> HeldOutErrors:
    """A hypothesis with an error of each trial [deg^2]."""
    made, blocks = judged(names, float(np.mean(mse))), BLOCKS // 6
    run = np.repeat(np.arange(len(mse)), blocks)
    return replace(made, energy=SAMPLES * np.repeat(mse, blocks), samples=np.full(run.size, SAMPLES), run=run)


def shifts_chosen(before: list[float], after: list[float]) -> bool:
    """Whether shifts are chosen that lower the errors of trials so [deg^2]."""
    tried = {j.hypothesis.effects: j for j in (by_trial((), *before), by_trial(("trial_shift",), *after))}
    return "trial_shift" in reselect(tried, SETTINGS, FLOOR).chosen.hypothesis.effects


@given(st.floats(1.0, 10.0), st.integers(6, 8), st.integers(1, 3))
def test_shifts_recur_where_several_trials_differ_and_not_where_one_does(size: float, trials: int, odd: int) -> None:
    """The retuned simulator lies at the mean of all trials."""
    shift = np.where(np.arange(trials) < odd, size, 0.0)
    errors = (shift - shift.mean()) ** 2 + FLOOR
    assert shifts_chosen(errors.tolist(), [FLOOR] * trials) == (odd > 1)


def test_unequal_trials_recur_if_shifts_explain_every_one() -> None:
    before = [0.1, 0.2, 0.3, 0.4, 2.0, 4.0, 20.0]  # the median is a tenth of the mean
    assert shifts_chosen(before, [FLOOR] * 7)
    assert not shifts_chosen(before, [0.08, *[FLOOR] * 6])


def test_shifts_do_not_hide_a_drift_that_shows_within_trials() -> None:
    errors = {"nothing": 12.0, "trial_shift": 0.3, "drift": 8.0}
    assert chosen(**errors, trial_shift__drift=0.15) == {"trial_shift", "drift"}
    assert chosen(**errors, trial_shift__lag=0.15) == {"trial_shift"}
    assert chosen(**errors, trial_shift__drift=0.25, uneven=0.1) == {"trial_shift"}


@given(st.floats(0.0, 1.0))
def test_shifts_that_follow_the_clock_are_a_drift(share: float) -> None:
    """A drift that explains that share of what the shifts explain, alone or beside what they add to it."""
    shifts = 0.5
    drift = 10.0 - share * (10.0 - shifts)
    found = chosen(nothing=10.0, trial_shift=shifts, drift=drift, trial_shift__drift=shifts - 0.1)
    both = (10.0 - drift) / (10.0 - shifts + 0.1)
    if both >= 1 - SETTINGS.line_of_shifts:
        assert found == {"drift"}
    elif share < 1 - SETTINGS.line_of_shifts:
        assert "trial_shift" in found


@given(st.integers(0, BLOCKS - 1), st.floats(100.0, 1e4))
def test_a_fall_that_is_largest_in_one_block_is_as_sure_as_the_others_make_it(block: int, large: float) -> None:
    run = np.arange(BLOCKS) // 6
    energy = np.where(np.arange(BLOCKS) == block, large, 1.0) * SAMPLES
    before, samples = Blocks(energy, np.full(BLOCKS, SAMPLES), run), np.full(BLOCKS, SAMPLES)
    fall, error = gain(before, Blocks(0.5 * energy, samples, run))
    assert fall < 1.5 * error
    worse = np.where(np.arange(BLOCKS) == block, 0.5, 1.0) * energy
    assert sureness(before, Blocks(0.5 * energy, samples, run)) > sureness(before, Blocks(worse, samples, run))
    assert sureness(before, Blocks(worse, samples, run)) < SETTINGS.standard_errors


@given(st.floats(1.01, 5.0), st.floats(1.0, 1e6))
def test_an_error_that_grows_is_never_sure_to_fall(growth: float, unit: float) -> None:
    run = np.arange(BLOCKS) // 6
    energy, samples = unit * (1.0 + np.arange(BLOCKS) % 5), np.full(BLOCKS, SAMPLES)
    assert sureness(Blocks(energy, samples, run), Blocks(growth * energy, samples, run)) < 0


def test_fits_side_by_side_come_in_their_order_and_an_error_ends_them() -> None:
    begun: list[int] = []
    both = threading.Barrier(2)

    def fit(k: int) -> int:
        begun.append(k)
        if k < 2:
            both.wait(timeout=60.0)  # the first two wait for each other
        if k == 3:
            raise ValueError("fit 3")
        if k > 3:
            time.sleep(0.01)  # all of them together take five seconds
        return k

    results = side_by_side(fit, range(1000))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="fit 3"):
        next(results)
    assert len(begun) < 1000


@given(st.integers(0, 2**32 - 1))
def test_a_gain_is_the_sum_of_the_falls_and_its_error_their_scatter_within_runs(seed: int) -> None:
    random = np.random.default_rng(seed)
    run = np.sort(random.choice([0, 2, 3, 7], random.integers(1, 12)))  # runs may be missing, or have one block
    before, after = (Blocks(random.uniform(0, 9, run.size), np.full(run.size, SAMPLES), run) for _ in range(2))
    parts = [(before.energy - after.energy)[run == k] for k in np.unique(run)]
    variance = sum(float(p[0] ** 2) if p.size == 1 else p.size * float(np.var(p, ddof=1)) for p in parts)
    total = SAMPLES * run.size
    expected = sum(float(part.sum()) for part in parts) / total, np.sqrt(variance) / total
    np.testing.assert_allclose(gain(before, after), expected, rtol=1e-9, atol=1e-12)
