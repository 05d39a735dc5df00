"""Laws of the withheld physics, and that every effect changes the angle by the size it is given."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hystmpc_lab.blind
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec
from hystmpc_lab.blind.device import DEVICES, BlindDevice, core_of, lasts_s
from hystmpc_lab.blind.generators import (
    ALIASED_RATE,
    CONFIGURATION,
    GENERATORS,
    LABELS,
    SCATTER,
    UNKNOWN,
    Generator,
    Withheld,
    cascaded_servo,
    generator_named,
    generators_of,
    jittered_delay,
    log_relaxation,
    lugre_tip,
)
from hystmpc_lab.blind.plan import RAMP_HOLD, SINE, STEPS, TRIANGLES
from hystmpc_lab.devices import kernels as cores
from hystmpc_lab.devices.cores import (
    FINE_S,
    TRAVEL_MM,
    CapstanCore,
    Core,
    DahlCore,
    Mounting,
    MuscleCore,
    RodCore,
    Scene,
)

ELASTIC_ROD = RodCore(fast_share=0.0, slow_share=0.0)
CORES = (CapstanCore(), DahlCore(), RodCore(), MuscleCore())
NUMBERS = {CONFIGURATION: {"second": 7.0}, ALIASED_RATE: {"hz": 0.2, "phase": 0.1}, SCATTER: {}}
SCENE = Scene(seed=1, trial=0, clock_s=0.0, travel=TRAVEL_MM, rest_deg=20.0, span_deg=60.0)


def commands(core: Core) -> list[Vec]:
    random = np.random.default_rng(2)
    return [kind.draw(random)[:700] * (core.travel / TRAVEL_MM) for kind in (SINE, TRIANGLES, STEPS, RAMP_HOLD)]


def rms(a: list[Vec], b: list[Vec]) -> float:
    return float(np.sqrt(np.mean((np.concatenate(a) - np.concatenate(b)) ** 2)))


def test_nothing_of_the_library_s_operators_is_used() -> None:
    folder = Path(hystmpc_lab.blind.__file__).parent
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert not (node.module or "").startswith(("hystmpc.models.operators", "hystmpc.sim.effects"))


def test_every_effect_of_the_design_has_a_generator() -> None:
    wanted = (
        "lag delay rate_dependence creep drift first_flexure slack stick_slip contact nonlinear_gain asymmetry "
        "trial_shift periodic_disturbance sensor"
    )
    assert set(LABELS) == set(wanted.split())
    assert len(generators_of(UNKNOWN)) >= 4
    with pytest.raises(ConfigError, match="no generator 'servos'"):
        generator_named("servos")


@pytest.mark.slow
@pytest.mark.parametrize("core", CORES, ids=lambda c: type(c).__name__)
@pytest.mark.parametrize("generator", GENERATORS, ids=lambda g: g.name)
def test_an_effect_changes_the_angle_and_more_of_it_changes_it_more(core: Core, generator: Generator) -> None:
    device = BlindDevice(core, 0.05, 0.01, 7)
    shape = NUMBERS.get(generator.label) or generator.draw(np.random.default_rng(3))
    plain = device.true_angles(commands(core))
    changes = []
    for factor in (0.25, 1.0):
        effect = Withheld(generator, factor * generator.typical, shape)
        affected = device.with_effects([effect]).true_angles(commands(core))
        assert all(np.isfinite(angle).all() for angle in affected)
        changes.append(rms(affected, plain))
    assert 0 < changes[0] < changes[1]


@pytest.mark.parametrize("core", [CapstanCore(), DahlCore(), ELASTIC_ROD, MuscleCore()], ids=lambda c: type(c).__name__)
def test_cores_are_rate_independent(core: Core) -> None:
    u = np.interp(np.linspace(0, 5, 6001), range(6), [0, 5, 1, 4, 2, 6]) * (core.travel / TRAVEL_MM)
    slow = core.run(u, np.ones(u.size))
    fast = core.run(u[::3], np.ones(u[::3].size))
    assert np.abs(slow[::3] - fast).max() < 0.02 * np.ptp(slow)
    held = core.run(np.concatenate([u, np.full(500, u[-1])]), np.ones(u.size + 500))
    assert np.ptp(held[u.size + 20 :]) < 1e-6  # a muscle has a valve of 2 ms


@pytest.mark.parametrize("core", CORES, ids=lambda c: type(c).__name__)
def test_cores_have_loops_that_grow_with_friction(core: Core) -> None:
    scale = core.travel / TRAVEL_MM
    u = np.interp(np.linspace(0, 2, 4001), [0, 1, 2], [0, 5 * scale, 0])

    def width(friction: float) -> float:
        angle = core.mounted(Mounting(friction=friction)).run(u, np.ones(u.size))
        return float(np.interp(-2.5 * scale, -u[2000:], angle[2000:]) - np.interp(2.5 * scale, u[:2001], angle[:2001]))

    assert 0 < width(0.5) < width(1.0) < width(2.0)


def test_a_rod_relaxes_in_a_hold_by_less_than_its_loop_is_wide() -> None:
    u = np.concatenate([np.interp(np.linspace(0, 1, 2001), [0, 1], [0, 5]), np.full(5000, 5.0)])
    held = RodCore().run(u, np.ones(u.size))[2000:]
    assert np.all(np.diff(held) > -1e-9)
    assert 0.05 < held[-1] - held[0] < 2.0
    assert np.ptp(held[2500:]) < 0.3 * np.ptp(held)
    elastic = ELASTIC_ROD.run(u, np.ones(u.size))[2000:]
    assert np.ptp(elastic) < 1e-6


def test_the_tendon_of_a_rod_can_only_pull() -> None:
    u = np.interp(np.linspace(0, 3, 6001), [0, 1, 2, 3], [0, 4, -8, -12])  # past its pretension and its friction
    angle = ELASTIC_ROD.run(u, np.ones(u.size))
    assert np.ptp(angle[4001:]) < 1e-3 < np.ptp(angle[:4001])
    assert angle[-1] > ELASTIC_ROD.offset_deg + 5  # friction keeps the rest of the tension
    smooth = replace(ELASTIC_ROD, friction=0.0, drag_n=0.0).run(u, np.ones(u.size))
    assert smooth[-1] == pytest.approx(ELASTIC_ROD.offset_deg, abs=1e-6)


def test_a_rod_s_trial_does_not_know_what_comes_after_it() -> None:
    u = np.interp(np.linspace(0, 5, 5001), range(6), [0, 5, 1, 4, 2, 6])
    scale = 1 + 0.5 * np.sin(np.arange(u.size) / 300)
    whole, part = RodCore().run(u, scale), RodCore().run(u[:3001], scale[:3001])
    assert np.array_equal(whole[:3001], part)


@pytest.mark.parametrize("kind", DEVICES, ids=lambda k: k.__name__)
def test_a_core_is_built_again_from_its_sealed_numbers(kind: type[Core]) -> None:
    core = kind.draw(np.random.default_rng(1))
    assert core_of(core.numbers()) == core
    with pytest.raises(ConfigError, match=r"no device core 'RodCores', .*did you mean 'RodCore'"):
        core_of({**core.numbers(), "core": "RodCores"})


def test_mounting_a_rod_alters_its_gain_friction_and_offset_and_nothing_else() -> None:
    off = RodCore().mounted(Mounting(gain=1.1, friction=0.8, offset_deg=2.0))
    back = replace(off, gain=32.0, friction=0.06, drag_n=1.2, offset_deg=-8.5)
    assert back == RodCore()
    assert (off.gain, off.offset_deg) == (pytest.approx(35.2), -6.5)
    assert (off.friction, off.drag_n) == (pytest.approx(0.048), pytest.approx(0.96))


@pytest.mark.parametrize("dry", [0.0, 0.4])
def test_capstan_tension_stays_within_the_friction_cone(dry: float) -> None:
    rest, wrap, nodes = 8.0, 0.3, 16
    tension, out = np.full(nodes, rest), np.empty(3000)
    weights = np.full(nodes, 1 / nodes / 2.0)
    shares = weights + 0.06 / nodes
    x = 2.5 * (1 - np.cos(np.linspace(0, 20, 3000)))
    drag = np.concatenate([[0.0], np.full(nodes - 1, dry)])
    cores.capstan(x, wrap, np.ones(x.size), 0.0, tension, (shares, weights, drag), rest, out)
    cone = np.exp(wrap * np.arange(nodes) / (nodes - 1))
    assert np.all(tension <= tension[0] * cone + drag + 1e-6)
    assert np.all(tension >= tension[0] / cone - drag - 1e-6)
    assert shares @ (tension - rest) == pytest.approx(x[-1], abs=1e-6)


def test_log_creep_in_a_hold_is_linear_in_the_logarithm_of_time() -> None:
    step = np.concatenate([np.zeros(10), np.ones(20000)])
    t = (np.arange(step.size) - 10) * FINE_S
    crept = log_relaxation(step, 0.1, 0.5)
    late = t > 0
    slope, _ = np.polyfit(np.log10(1 + t[late] / 0.5), crept[late], 1)
    assert slope == pytest.approx(0.1, rel=1e-6)
    assert np.allclose(crept[late], 0.1 * np.log10(1 + t[late] / 0.5), atol=1e-9)


@given(st.floats(0.03, 0.5), st.floats(1.2, 2.6))
def test_a_servo_starts_flat_overshoots_lags_by_its_size_and_has_a_top_speed(lag: float, inner: float) -> None:
    shape = {"inner": inner, "strokes_per_s": 1e6}
    step = np.concatenate([np.zeros(5), np.ones(round(40 * lag / FINE_S))])
    out = cascaded_servo(step, SCENE, lag, shape)
    first = 1 - np.exp(-FINE_S / lag)  # what a first-order lag of that size would have made of the first step
    assert out[5] < 2 * inner * FINE_S / lag * first + 1e-9
    assert out.max() > 1.0
    assert out[-1] == pytest.approx(1.0, abs=1e-3)
    ramp = np.arange(round(40 * lag / FINE_S)) * FINE_S
    assert ramp[-1] - cascaded_servo(ramp, SCENE, lag, shape)[-1] == pytest.approx(lag, abs=1.5 * FINE_S)
    slow = cascaded_servo(step, SCENE, lag, {"inner": inner, "strokes_per_s": 0.1 / lag / SCENE.travel})
    assert np.diff(slow).max() < 1.4 * 0.1 / lag * FINE_S


def test_lugre_sticks_below_break_away_and_slips_above() -> None:
    t = np.arange(30000) * FINE_S
    slow = 2.0 * t / t[-1]  # 2 degrees in a minute
    out = lugre_tip(slow, SCENE, 4.0, {"ratio": 0.4, "stribeck_deg_s": 3.0})
    assert out[-1] < 0.2 * slow[-1]
    ramp = 0.5 * t
    out = lugre_tip(ramp, SCENE, 4.0, {"ratio": 0.4, "stribeck_deg_s": 3.0})
    stretch = ramp - out
    assert 3.3 < stretch.max() < 4.4  # breaks away at about its static friction
    after = stretch[int(np.argmax(stretch)) :]
    assert after.min() < 0.75 * stretch.max()  # and falls towards the kinetic one
    assert np.diff(out).max() > 8 * 0.5 * FINE_S  # in jumps


def test_jittered_packets_are_late_and_in_order() -> None:
    u = np.arange(4000) * FINE_S
    late = u - jittered_delay(u, SCENE, 0.1, {"jitter": 0.2})
    assert 0.09 < np.median(late[500:]) < 0.16
    assert np.ptp(late[500:]) > 0.005
    assert np.all(np.diff(jittered_delay(u, SCENE, 0.1, {"jitter": 0.2})) >= 0)


def test_what_is_random_in_a_trial_does_not_depend_on_the_size() -> None:
    generator = generator_named("heavy_tails")
    angle = np.zeros(200)
    one, two = (generator.apply(angle, SCENE, size, {"freedom": 3.0}) for size in (1.0, 2.0))
    assert np.allclose(2 * one, two)


def test_devices_can_be_drawn() -> None:
    for kind in DEVICES:
        for seed in range(5):
            core = kind.draw(np.random.default_rng(seed))
            u = np.interp(np.linspace(0, 2, 2001), [0, 1, 2], [0, core.travel, 0])
            assert 30 < np.ptp(core.run(u, np.ones(u.size))) < 90


@given(st.integers(0, 999), st.floats(0.5, 3.0), st.floats(0.4, 2.5), st.floats(1.0, 20.0))
def test_the_angle_of_a_muscle_never_rises_as_its_pressure_falls(
    seed: int, friction: float, weights: float, factor: float
) -> None:
    core = MuscleCore.draw(np.random.default_rng(seed)).mounted(Mounting(friction=friction)).reweighted(weights)
    u = np.interp(np.linspace(0, 2, 1001), [0, 1, 2], [0, core.travel, 0])
    fall = core.run(u, np.full(u.size, factor))[505:]  # the valve takes its time to turn
    assert np.diff(fall).max() < 1e-3


@pytest.mark.parametrize("core", CORES, ids=lambda c: type(c).__name__)
def test_other_numbers_of_a_core_change_its_angle_and_one_changes_nothing(core: Core) -> None:
    u = np.interp(np.linspace(0, 3, 1501), range(4), [0, 5, 1, 4]) * (core.travel / TRAVEL_MM)
    plain = core.run(u, np.ones(u.size))
    for change in (core.stiffer, core.reweighted):
        assert change(1.0) == core
        assert np.abs(change(1.4).run(u, np.ones(u.size)) - plain).max() > 0.1


def test_a_second_configuration_holds_for_its_trials_alone() -> None:
    for name in ("bent_sheath", "other_lever", "other_zero"):
        generator, angle = generator_named(name), np.linspace(20.0, 60.0, 50)
        scenes = [replace(SCENE, trial=k) for k in range(4)]
        found = [generator.apply(angle, scene, 1.0, {"second": 0b0110}) for scene in scenes]
        assert np.array_equal(found[0], found[3])
        assert np.array_equal(found[1], found[2])
        assert np.abs(found[1] - found[0]).max() > 0.5


def test_a_trial_recorded_later_is_that_of_the_same_session() -> None:
    drift = generator_named("thermal_drift")
    effect = Withheld(drift, drift.typical, drift.draw(np.random.default_rng(3)))
    device = BlindDevice(DahlCore(), 0.05, 0.01, 11, (effect,))
    first, second = SINE.draw(np.random.default_rng(1)), STEPS.draw(np.random.default_rng(2))
    whole = device.record([first, second])[1]
    (later,) = device.record([second], 1, lasts_s(first.size))
    assert np.array_equal(whole.angle, later.angle)
    assert not np.array_equal(whole.angle, device.record([second], 1)[0].angle)
