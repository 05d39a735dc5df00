"""What these commands could show, and at which size, before an angle is looked at."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hystmpc.gap.diagnose import detectable_in_logs
from hystmpc.gap.diagnosis import Detectable
from hystmpc.gap.logs.detectable import NO_GAP, detectable_sizes, smallest_detectable
from hystmpc.gap.logs.preparation import prepare
from hystmpc.gap.report.words import DETECTABLE_COLUMNS, detectable_rows, detectable_sentence
from hystmpc.models.effects.catalogue import diagnosable
from hystmpc.models.identify.baseline import Baseline, baseline_of
from hystmpc.models.identify.runs import Run, runs_of
from hystmpc.models.simulator import Residual
from hystmpc.trials.trial import Trial

from ..models.zoo import BACKLASH, CHAINS, simulator
from .engine_examples import moves, simulator_of, trials_of

DT, NEEDED = 0.04, 0.02
SIMULATOR = simulator(CHAINS["pi"])


def trials(slow: float = 1.0, seed: int = 0) -> tuple[Trial, ...]:
    """Ramps with holds, a sine and quick steps; `slow` stretches them. The angles are noise."""
    t = DT * np.arange(500)
    shapes = (
        np.interp(t / slow, [0, 3, 6, 9, 12, 15], [0, 3, 3, 0, 0, 2]),
        1.5 - 1.5 * np.cos(1.2 * t / slow),
        np.interp(t / slow, [0, 1, 1.3, 3, 3.3, 5, 5.3], [0, 0, 2, 2, 1, 1, 2.5]),
    )
    angles = 40.0 + np.random.default_rng(seed).normal(0.0, 5.0, (3, t.size))
    angles[:, 0] = 30.0
    return tuple(Trial(t, u, y) for u, y in zip(shapes, angles, strict=True))


def posed(given: tuple[Trial, ...]) -> tuple[Baseline, tuple[Run, ...]]:
    return baseline_of(SIMULATOR.chain, SIMULATOR.command_limits), runs_of(given)


@cache
def found(needed: float = NEEDED, slow: float = 1.0, seed: int = 0) -> dict[str, Detectable]:
    made = detectable_sizes(*posed(trials(slow, seed)), needed)
    return {one.effect: one for one in made}


def test_every_effect_of_angles_has_a_size_and_a_unit() -> None:
    assert list(found()) == [name for name in diagnosable() if name != "sensor"]
    assert all(one.size > 0 and one.unit for one in found().values())


def test_measured_angles_are_not_looked_at() -> None:
    assert found(seed=1) == found()


def test_twice_the_error_takes_twice_the_size_of_what_adds_to_the_angle() -> None:
    more = found(4.0 * NEEDED)
    for name in ("trial_shift", "periodic_disturbance", "drift", "creep"):
        assert more[name].size == pytest.approx(2.0 * found()[name].size, rel=0.1)


def test_slow_motions_hide_what_is_fast() -> None:
    slow = found(slow=4.0)
    for name in ("lag", "delay", "rate_dependence"):
        assert slow[name].size > 1.5 * found()[name].size


def test_one_trial_shows_no_shift_between_trials() -> None:
    alone = detectable_sizes(*posed(trials()[:1]), NEEDED)
    assert np.isinf(next(one.size for one in alone if one.effect == "trial_shift"))


FORM_DEG = 0.3
RESIDUAL = Residual(log="other.csv", motion="continuous", samples=500, rmse_deg=FORM_DEG, bias_deg=0.0, lag_one=0.5)
KNOWN = simulator_of(BACKLASH, (RESIDUAL,))


def device_trials() -> list[Trial]:
    return trials_of(KNOWN.chain, [moves(1), moves(2), moves(3)])


def clocked() -> list[Trial]:
    """The same, one after the other by their time stamps."""
    return [replace(trial, t=trial.t + 1e9 + 100.0 * k) for k, trial in enumerate(device_trials())]


def test_what_counts_as_a_gap_is_what_the_verdict_says() -> None:
    shown = detectable_in_logs(device_trials(), KNOWN)
    assert shown.needed_rmse_deg**2 == pytest.approx((NO_GAP - 1.0) * FORM_DEG**2)
    assert f"{shown.needed_rmse_deg:.3g} deg" in detectable_sentence(shown)
    shift = next(one for one in shown.effects if one.effect == "trial_shift")
    assert shift.size == pytest.approx(shown.needed_rmse_deg * np.sqrt(3 / 2)), "of three shifts one is common"


def test_without_a_model_form_error_no_size_is_stated_and_one_line_says_why() -> None:
    shown = detectable_in_logs(device_trials(), simulator_of(BACKLASH))
    assert (shown.effects, detectable_rows(shown)) == ((), [])
    assert "model-form error is unknown" in detectable_sentence(shown)
    assert "\n" not in shown.why_not


@pytest.mark.slow
def test_what_needs_the_order_is_marked_only_where_that_is_unknown() -> None:
    unknown, known = (detectable_in_logs(given, KNOWN) for given in (device_trials(), clocked()))
    assert [one.effect for one in unknown.effects if one.untestable] == ["drift"]
    assert not any(one.untestable for one in known.effects)
    assert ("order" in detectable_sentence(unknown), "order" in detectable_sentence(known)) == (True, False)


def test_every_row_has_the_size_and_the_unit_of_its_effect() -> None:
    shown = smallest_detectable(prepare(clocked(), KNOWN), without=("creep",))
    rows = {row[0].replace(" ", "_"): row for row in detectable_rows(shown)}
    assert "creep" not in rows
    for one in shown.effects:
        assert len(rows[one.effect]) == len(DETECTABLE_COLUMNS)
        size = rows[one.effect][1]
        if np.isinf(one.size):
            assert size == "none shows"
        else:
            name, value, *unit = size.split()
            assert (name, unit) == (one.parameter, [] if one.unit == "1" else [one.unit])
            assert float(value) == pytest.approx(one.size, rel=0.06)
