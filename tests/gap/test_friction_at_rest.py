"""Friction that is greater at rest or one way scales all plays of a core: no retuning does the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.models.chain import Chain
from hystmpc.models.identify.baseline import baseline_of, with_play_friction, without_idle_friction
from hystmpc.models.identify.problem import Problem
from hystmpc.models.operators.hysteresis import CurvedPlays
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.trials.errors import ModelError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.running import run_operator
from ..models.zoo import CURVED, GRADUAL, REST_CURVED, REST_PI, STATIC_PI
from .engine_examples import COMMAND, DT, device_runs, moves, simulator_of, sine, trials_of


def ramps(speed: float, levels: tuple[float, ...] = (0.0, 5.5, 1.0, 4.0, 0.0)) -> Vec:
    """Ramps between levels at one speed [cmd/s], from rest."""
    ends = np.cumsum([0.4, *np.abs(np.diff(levels)) / speed])
    return np.interp(np.arange(0.0, ends[-1], DT), ends, levels)


def wider(core: PrandtlIshlinskii | CurvedPlays, factor: float) -> PrandtlIshlinskii | CurvedPlays:
    """Core with all plays wider."""
    if isinstance(core, PrandtlIshlinskii):
        return replace(core, alpha=factor * core.alpha)
    return replace(core, radii=tuple(factor * r for r in core.radii))


@pytest.mark.parametrize("core", [STATIC_PI, CURVED, GRADUAL], ids=["pi", "curved", "gradual"])
@pytest.mark.parametrize(("stribeck_speed", "factor"), [(1e3, 2.5), (0.01, 1.0)])
def test_thresholds_grow_in_proportion_at_rest_and_not_in_a_fast_motion(
    core: PrandtlIshlinskii | CurvedPlays, stribeck_speed: float, factor: float
) -> None:
    command = np.concatenate([np.arange(0.0, 5.5, DT), np.arange(5.5, 0.0, -DT)])
    found = run_operator(replace(core, speeds=(1.5, stribeck_speed, 0.0)), command)
    scaled = run_operator(wider(core, factor), command)
    back = slice(-command.size // 3, None)  # behind the turn, where every play is carried along
    np.testing.assert_allclose(found[back], scaled[back], atol=0.02)


@pytest.mark.parametrize("core", [STATIC_PI, CURVED, GRADUAL], ids=["pi", "curved", "gradual"])
def test_one_way_widens_the_plays_from_the_first_falling_command_to_the_first_rising_one(
    core: PrandtlIshlinskii | CurvedPlays,
) -> None:
    rises, falls = np.arange(0.0, 5.5, DT), np.arange(5.5, 0.0, -DT)
    command = np.concatenate([rises, falls, np.full(20, falls[-1]), rises])
    up = slice(rises.size // 2, rises.size)  # where every play is carried along
    down = slice(rises.size + 2 * falls.size // 3, rises.size + falls.size + 20)
    found = run_operator(replace(core, speeds=(0.0, 1.0, 0.6)), command)
    for part, factor in ((up, 1.0), (down, 1.6)):
        np.testing.assert_allclose(found[part], run_operator(wider(core, factor), command)[part], atol=0.1)


@pytest.mark.parametrize("core", [STATIC_PI, CURVED, GRADUAL], ids=["pi", "curved", "gradual"])
def test_retuning_leaves_it_at_none_and_a_simulator_without_it_is_as_given(core: Operator) -> None:
    chain = Chain(core)
    wide = with_play_friction(chain, COMMAND)
    assert without_idle_friction(wide) == chain
    assert without_idle_friction(Chain(REST_PI)) == Chain(REST_PI)
    one, other = (Problem(baseline_of(made, COMMAND)) for made in (chain, wide))
    assert one.size == other.size
    for trial in device_runs():
        np.testing.assert_allclose(one.angles(one.as_given, trial), other.angles(other.as_given, trial), atol=1e-12)


def test_it_has_no_analytic_inverse() -> None:
    with pytest.raises(ModelError, match="no analytic inverse"):
        REST_PI.inverse()


def recorded(core: Operator) -> list[Trial]:
    """Trials at slow and fast speeds."""
    speeds = (0.3, 0.8, 2.0, 5.0)
    return trials_of(Chain(core), [*(ramps(v) for v in speeds), moves(1, 20.0), sine(0.1), ramps(0.5), moves(2, 20.0)])


@pytest.mark.slow
@pytest.mark.parametrize(("core", "plain"), [(REST_PI, STATIC_PI), (REST_CURVED, CURVED)], ids=["pi", "curved"])
def test_without_a_jump_it_is_named_with_its_numbers(core: Operator, plain: Operator) -> None:
    findings = find_causes(recorded(core), simulator_of(plain))
    found, _ = conclude(findings)
    (effect,) = found.effects
    assert findings.attribution.facts.width_grown == pytest.approx(1.0, rel=0.1)  # of a motion that is not at rest
    assert (found.verdict, effect.name) == ("named", "stick_slip")
    assert effect.parameters["stribeck"] == pytest.approx(3.0, rel=0.15)
    assert effect.parameters["stribeck_speed"] == pytest.approx(1.0, rel=0.15)
    assert found.gap.with_effects_rmse_deg == pytest.approx(0.05, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("plain", "one_way"), [(STATIC_PI, 1.2), (STATIC_PI, -0.6), (CURVED, 1.2)])
def test_friction_that_is_greater_one_way_is_named_with_its_number(
    plain: PrandtlIshlinskii | CurvedPlays, one_way: float
) -> None:
    found, _ = conclude(find_causes(recorded(replace(plain, speeds=(0.0, 1.0, one_way))), simulator_of(plain)))
    (effect,) = found.effects
    assert (found.verdict, effect.name) == ("named", "asymmetry")
    assert effect.parameters["one_way"] == pytest.approx(one_way, rel=0.1)
    assert found.gap.with_effects_rmse_deg == pytest.approx(0.05, rel=0.3)


@pytest.mark.slow
def test_wider_plays_alone_are_retuned() -> None:
    found, _ = conclude(find_causes(recorded(replace(STATIC_PI, alpha=0.3)), simulator_of(STATIC_PI)))
    assert found.verdict == "retuned"
