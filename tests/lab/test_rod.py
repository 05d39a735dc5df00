"""The rod device obeys the laws that its equations are made of."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hystmpc.sim.devices.device import DeviceMotion
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec
from hystmpc_lab.devices.rod import RodCatheter, RodParameters
from hystmpc_lab.devices.rod_solver import TOLERANCE_MM, gravity

pytestmark = pytest.mark.slow

DT = 0.04
USUAL = RodParameters()
ELASTIC = replace(USUAL, fast_share=0.0, slow_share=0.0, drive_lag_s=0.0)
CAPSTAN = replace(ELASTIC, friction=0.2, shaft_bend_deg=120.0, shaft_drag_n=0.0, rod_drag_n=0.0, pretension_mm=2.0)


def run(p: RodParameters, commands: Vec, state: Vec | None = None, dt: float = DT) -> tuple[RodCatheter, DeviceMotion]:
    """The device, and what it did from `state` or as a virgin."""
    rod = RodCatheter(p)
    start = rod.virgin() if state is None else state
    return rod, rod.advance(start, commands, dt, np.random.default_rng(0))


def wave(periods: float, peak: float = 5.0, frequency: float = 0.2, dt: float = DT) -> Vec:
    """From 0 to `peak` and back."""
    t = np.arange(1, round(periods / frequency / dt) + 1) * dt
    return peak / 2 * (1 - np.cos(2 * np.pi * frequency * t))


def path(turns: Any, steps: int) -> Vec:
    """Straight ways between turning points, `steps` samples each."""
    return np.interp(np.arange(1, (len(turns) - 1) * steps + 1) / steps, np.arange(len(turns)), turns)


@st.composite
def parameters(draw: st.DrawFn) -> RodParameters:
    """Devices within bounds that are physical together, slack, heavy, rough and smooth ones among them."""
    p = RodParameters()
    drawn: dict[str, Any] = {
        "rest_deg": draw(st.floats(-60, 90)),
        "offset_mm": draw(st.floats(0.2, 6)),
        "stiffness_nmm": draw(st.floats(2, 200)),
        "shaft_n_per_mm": draw(st.floats(0.5, 200)),
        "rod_n_per_mm": draw(st.floats(1, 2000)),
        "pretension_mm": draw(st.floats(-3, 5)),
        "friction": draw(st.floats(0, 0.6)),
        "shaft_bend_deg": draw(st.floats(0, 360)),
        "shaft_drag_n": draw(st.sampled_from([0.0, 0.01, 1.0, 20.0])),
        "rod_drag_n": draw(st.sampled_from([0.0, 0.01, 1.0, 20.0])),
        "fast_share": draw(st.floats(0, 2)),
        "slow_share": draw(st.floats(0, 2)),
        "set_share": draw(st.floats(0, 0.6)),
        "segments": draw(st.integers(1, 12)),
        "shaft_contacts": draw(st.integers(1, 6)),
        "down_deg": draw(st.floats(-180, 180)),
    }
    heaviest = 0.5 * drawn["stiffness_nmm"] / p.length_mm
    return replace(p, **drawn, weight_n=draw(st.sampled_from([0.0, 0.2, 0.95])) * heaviest)


EDGE = RodParameters(  # every contact at the edge of slack, where Newton circles: without the net a residual of 2 mm
    rest_deg=1.0,
    offset_mm=1.0,
    stiffness_nmm=2.0,
    shaft_n_per_mm=1.0,
    rod_n_per_mm=13.0,
    pretension_mm=0.0,
    friction=0.5,
    shaft_bend_deg=0.0,
    shaft_drag_n=0.0,
    rod_drag_n=0.0,
    fast_share=0.0,
    slow_share=0.0,
    set_share=0.0,
    weight_n=1 / 300,
    down_deg=0.0,
    shaft_contacts=1,
    segments=8,
)


@pytest.mark.slow
@given(p=parameters(), u=st.lists(st.floats(-5.0, 12.0), min_size=1, max_size=25), dt=st.floats(0.002, 0.2))
@example(p=EDGE, u=[0.0], dt=0.125)
@settings(max_examples=60)
def test_any_command_on_any_device(p: RodParameters, u: list[float], dt: float) -> None:
    """Every step is solved to the stated tolerance, nothing is ever not-a-number, and the tendon never pushes."""
    rod, done = run(p, np.array(u), dt=dt)
    assert np.isfinite(done.angle).all()
    assert np.isfinite(done.state).all()
    assert done.tension.min() >= 0
    assert rod.residual_mm <= TOLERANCE_MM


@given(seed=st.integers(0, 100), cut=st.integers(1, 99))
def test_state_is_all_the_memory(seed: int, cut: int) -> None:
    rod, random = RodCatheter(), np.random.default_rng(seed)
    u, start = np.abs(np.cumsum(random.normal(0, 0.3, 100))), rod.virgin()
    whole = rod.advance(start, u, DT, random)
    first = rod.advance(start, u[:cut], DT, random)
    rest = rod.advance(first.state, u[cut:], DT, random)
    np.testing.assert_array_equal(np.concatenate([first.angle, rest.angle]), whole.angle)
    np.testing.assert_array_equal(start, rod.virgin())


def test_capstan_closed_form_where_all_slips() -> None:
    """Euler and Eytelwein: the tip's tension is the drive's over exp(mu wrap), or times it on the way back."""
    rod, pulled = run(CAPSTAN, np.linspace(0, 6, 200))
    _, let = run(CAPSTAN, np.linspace(6, 1, 200), pulled.state)
    for done, sign in ((pulled, -1), (let, 1)):
        tensions, bends = rod.tensions(done.state), rod.bends(done.state)
        wrap = math.radians(CAPSTAN.shaft_bend_deg) + np.abs(bends).sum()
        assert tensions[-1] / tensions[0] == pytest.approx(math.exp(sign * CAPSTAN.friction * wrap), rel=1e-6)
        assert tensions[0] == pytest.approx(done.tension[-1], abs=1e-9)


@given(turns=st.lists(st.floats(0, 6), min_size=2, max_size=6))
def test_friction_stays_within_its_limits(turns: list[float]) -> None:
    rod, done = run(USUAL, path(turns, 20))
    tensions, bends = rod.tensions(done.state), rod.bends(done.state)
    shaft = np.full(USUAL.shaft_contacts, math.radians(USUAL.shaft_bend_deg) / USUAL.shaft_contacts)
    grip = np.exp(USUAL.friction * np.concatenate([shaft, np.abs(bends)]))
    drag = rod.parameters.numbers().drag[1:]
    assert np.all(tensions[:-1] <= grip * tensions[1:] + drag + 1e-6)
    assert np.all(tensions[1:] <= grip * tensions[:-1] + drag + 1e-6)


@given(turns=st.lists(st.floats(0, 6), min_size=3, max_size=6), slower=st.sampled_from([2, 5]))
def test_without_viscosity_only_the_path_counts(turns: list[float], slower: int) -> None:
    turns = [0.0, *turns]
    ends = [run(ELASTIC, path(turns, 50), dt=dt)[1].angle for dt in (DT, slower * DT)]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-5)
    fine = run(ELASTIC, path(turns, 50 * slower))[1].angle[slower - 1 :: slower]
    np.testing.assert_allclose(ends[0], fine, atol=2e-2)


@given(stop=st.floats(0, 6))
def test_without_viscosity_a_hold_holds(stop: float) -> None:
    _, done = run(ELASTIC, np.concatenate([path([0.0, 5.0, stop], 30), np.full(500, stop)]))
    assert np.ptp(done.angle[60:]) < 1e-5


def test_a_hold_relaxes_and_then_holds() -> None:
    _, done = run(USUAL, np.concatenate([np.linspace(0, 4, 50), np.full(2000, 4.0)]))
    assert np.ptp(done.angle[51:]) > 0.01
    assert np.ptp(done.angle[-500:]) < 1e-4


@given(peaks=st.lists(st.floats(0.5, 6), min_size=1, max_size=4), frequency=st.floats(0.05, 3.0), elastic=st.booleans())
def test_closed_cycles_take_energy(peaks: list[float], frequency: float, elastic: bool) -> None:
    """Passivity: after the same cycles were made once, repeating them costs the drive work and never gives any."""
    dt = 0.002 / frequency * 5
    cycles = np.concatenate([wave(1, peak, frequency, dt) for peak in peaks])
    rod, before = run(ELASTIC if elastic else USUAL, np.tile(cycles, 6), dt=dt)
    done = rod.advance(before.state, cycles, dt, np.random.default_rng(0))
    drive = np.concatenate([before.actuator[-1:], done.actuator])
    tension = np.concatenate([before.tension[-1:], done.tension])
    work = float(np.sum(0.5 * (tension[1:] + tension[:-1]) * np.diff(drive)))
    assert work > -1e-3 * float(np.abs(np.diff(drive)).sum())


def test_energy_lost_in_the_largest_loop_is_that_of_friction() -> None:
    _, done = run(CAPSTAN, np.tile(wave(1, 6.0, dt=0.01), 3), dt=0.01)
    n = done.angle.size // 3
    work = float(np.trapezoid(done.tension[-n - 1 :], done.actuator[-n - 1 :]))
    assert work > 1.0
    frictionless = replace(CAPSTAN, friction=0.0)
    _, free = run(frictionless, np.tile(wave(1, 6.0, dt=0.01), 3), dt=0.01)
    assert abs(float(np.trapezoid(free.tension[-n - 1 :], free.actuator[-n - 1 :]))) < 1e-6 * work


def test_first_flexure_happens_once() -> None:
    rod, first = run(USUAL, wave(1, 6.0))
    rest = np.zeros(400)
    settled = rod.advance(first.state, rest, DT, np.random.default_rng(0))
    second = rod.advance(settled.state, np.concatenate([wave(2, 6.0), rest]), DT, np.random.default_rng(0))
    virgin = float(np.degrees(rod.bends(rod.virgin()).sum()))
    assert settled.angle[-1] > virgin + 5
    assert second.angle[-1] == pytest.approx(settled.angle[-1], abs=0.1)
    none = replace(ELASTIC, set_share=0.0, friction=0.0, shaft_drag_n=0.0, rod_drag_n=0.0)
    _, back = run(none, np.append(wave(1, 6.0), 0.0))
    assert back.angle[-1] == pytest.approx(float(np.degrees(rod_bend(none))), abs=1e-5)


def rod_bend(p: RodParameters) -> float:
    """Bend of the virgin rod [rad]."""
    rod = RodCatheter(p)
    return float(rod.bends(rod.virgin()).sum())


def test_a_reversal_is_flat_first_then_slow_then_steep() -> None:
    down = np.linspace(5.0, 1.0, 401)
    _, done = run(ELASTIC, np.concatenate([np.linspace(0, 5, 400), down]))
    slope = -np.diff(done.angle[400:]) / 0.01
    assert np.allclose(slope[:5], 0.0, atol=0.1)
    assert 0.2 * slope[-1] < slope[100] < 0.95 * slope[-1]
    assert slope[-1] == pytest.approx(slope[-50], rel=0.15)


def test_a_slack_tendon_does_not_bend() -> None:
    loose = replace(ELASTIC, pretension_mm=-2.0)
    _, done = run(loose, np.linspace(0, 4, 401))
    np.testing.assert_allclose(done.angle[:200], loose.rest_deg, atol=1e-9)
    assert done.tension[199] == 0
    assert done.angle[-1] > loose.rest_deg + 1


@pytest.mark.parametrize(("p", "bound_deg"), [(ELASTIC, 0.02), (USUAL, 0.15)])
def test_finer_steps_change_little(p: RodParameters, bound_deg: float) -> None:
    """The command runs evenly within a coarse sample, so that only the steps differ; the drive has no lag."""
    p = replace(p, drive_lag_s=0.0)
    coarse = wave(2, 5.0, 0.5)
    fine = np.interp(np.arange(1, 8 * coarse.size + 1) / 8, np.arange(coarse.size + 1), np.append(0.0, coarse))
    _, few = run(p, coarse)
    _, many = run(p, fine, dt=DT / 8)
    assert np.abs(few.angle - many.angle[7::8]).max() < bound_deg


def test_gravity_is_the_slope_of_its_potential() -> None:
    p = replace(USUAL, weight_n=0.05, down_deg=70.0, segments=5).numbers()
    bends = np.random.default_rng(0).normal(0, 0.3, 5)

    def height(q: Vec) -> float:
        angle = np.cumsum(q) - p.down
        along = p.length * np.cos(angle)
        return -p.weight * float(np.sum(np.cumsum(along) - 0.5 * along))

    moments, step = np.empty(5), 1e-6
    gravity(bends, moments, p)
    slopes = [(height(bends + step * e) - height(bends - step * e)) / (2 * step) for e in np.eye(5)]
    np.testing.assert_allclose(moments, [-slope for slope in slopes], rtol=1e-6)


def test_gravity_mirrors() -> None:
    smooth = replace(ELASTIC, friction=0.0, shaft_drag_n=0.0, rod_drag_n=0.0)  # else the stuck tendon resists one side
    loose = replace(smooth, pretension_mm=-8.0, rest_deg=0.0, weight_n=0.05, set_share=0.0)
    angles = [run(replace(loose, down_deg=down), np.zeros(3))[1].angle[-1] for down in (90.0, -90.0)]
    assert angles[0] == pytest.approx(-angles[1], abs=1e-5)
    assert abs(angles[0]) > 1.0


@given(name=st.sampled_from([f.name for f in fields(RodParameters)]))
@example(name="friction")
def test_parameters_out_of_bounds(name: str) -> None:
    bounds = next(f.metadata["bounds"] for f in fields(RodParameters) if f.name == name)
    with pytest.raises(ConfigError, match=rf"RodParameters\.{name}: got"):
        replace(USUAL, **{name: bounds[1] + 1})


def test_a_rod_too_heavy_for_itself() -> None:
    with pytest.raises(ConfigError, match="weight_n: got 50"):
        replace(USUAL, weight_n=50.0)
