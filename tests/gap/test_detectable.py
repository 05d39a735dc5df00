"""What these commands could show, and at which size, before an angle is looked at."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hystmpc.gap.logs.detectable import Detectable, detectable_sizes
from hystmpc.models.effects.catalogue import DIAGNOSABLE
from hystmpc.models.identify.baseline import Baseline, baseline_of
from hystmpc.models.identify.runs import Run, runs_of
from hystmpc.trials.trial import Trial

from ..models.zoo import CHAINS, simulator

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
    made = detectable_sizes(*posed(trials(slow, seed)), needed, "mm")
    return {one.effect: one for one in made}


def test_every_effect_of_angles_has_a_size_and_a_unit() -> None:
    assert list(found()) == [name for name in DIAGNOSABLE if name != "sensor"]
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
    alone = detectable_sizes(*posed(trials()[:1]), NEEDED, "mm")
    assert np.isinf(next(one.size for one in alone if one.effect == "trial_shift"))


def test_sizes_carry_the_units_of_the_device() -> None:
    bar = {one.effect: one.unit for one in detectable_sizes(*posed(trials()), NEEDED, "bar", "um")}
    assert (bar["slack"], bar["trial_shift"], bar["drift"]) == ("bar", "um", "um/min")
