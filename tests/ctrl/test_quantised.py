"""A sensor with steps: a hold rests within one of them, whatever the device is, with learning on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.estimation.noise import NoiseBank
from hystmpc.ctrl.feedback import PidSettings, SupervisorSettings, feedback_gains
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.trials.types import Vec

from .plays import DRIVEN, DT, PLAY, SOUND, Backlash, Case, compiled
from .plays import Lag as Line
from .test_hold import Bench

LIMITS = CommandLimits(0.0, 6.0, 12.0)
HOLD_S, RESTS_S = 12.0, 2.0
steps_deg = st.floats(0.05, 3.0)


def noise_of(step: float) -> NoiseModel:
    """What an identification says of a sensor that has these steps and no other noise."""
    return NoiseModel(
        sensor_sigma_deg=max(step / math.sqrt(12.0), 1e-3),
        drift_sigma_deg_per_sqrt_s=0.3,
        motion_sigma_deg_per_sqrt_unit=1.0,
        sensor_resolution_deg=step,
    )


def tracked(
    pair: tuple[Predictor, Inverse],
    plant: Predictor,
    rest: tuple[float, float],
    targets: tuple[float, ...],
    step: float,
    controller: dict[str, Any],
    noise: NoiseModel | None,
) -> list[tuple[Vec, Vec]]:
    """Commands and true angles of a hold at each of the targets, reached at 30 deg/s; readings have an offset."""
    predictor, inverse = pair
    object.__setattr__(predictor, "noise", noise)  # some are frozen
    control = build_controller(parse_controller(controller), predictor, inverse, LIMITS)
    wanted, ends, before = [np.full(2, rest[0])], list[int](), rest[0]
    for target in targets:
        ramp = np.linspace(before, target, math.ceil(abs(target - before) / 30.0 / DT) + 1)[1:]
        wanted += [ramp, np.full(round(HOLD_S / DT), target)]
        ends.append(sum(part.size for part in wanted))
        before = target
    reference = np.concatenate([*wanted, np.full(control.horizon, before)])
    x, y, sent, true = plant.initial(*rest), rest[0], list[float](), list[float]()

    def reading() -> float:
        return float(np.round((y - 0.3 * step) / step) * step + 0.3 * step)

    state = control.init(reading(), rest[1])
    for k in range(ends[-1]):
        command, state = control.step(state, reading(), reference[k : k + control.horizon])
        y, x = plant.advance(x, command.u)
        sent.append(command.u)
        true.append(y)
    count = round(HOLD_S / DT)
    parts = [slice(end - count, end - control.horizon) for end in ends]  # the end looks at the next motion
    return [(np.array(sent[part]), np.array(true[part])) for part in parts]


def rests(commands: Vec) -> bool:
    """Whether the command is constant after 2 s of the hold."""
    return float(np.ptp(commands[round(RESTS_S / DT) :])) == 0.0


@pytest.mark.parametrize(
    "case",
    [SOUND[0], *(pytest.param(case, marks=pytest.mark.slow) for case in (*SOUND[1:], DRIVEN))],
    ids=lambda c: c.name,
)
@pytest.mark.parametrize("kind", ["linearised_mpc", "sampling_mpc"])
@pytest.mark.parametrize("step", [0.1, 0.9, 3.0])
def test_a_hold_rests_within_a_step(case: Case, kind: str, step: float) -> None:
    pair = case.build()
    for target, (commands, true) in zip(
        (50.0, 41.3),
        tracked(pair, case.build()[0], (case.y_rest, 0.0), (50.0, 41.3), step, {"kind": kind}, noise_of(step)),
        strict=True,
    ):
        assert rests(commands)
        assert abs(true[-1] - target) <= step + 0.05


def device(gain: float, width: float, tau: float) -> Chain:
    """Two plays on a line behind a lag, as wide as this share of the range."""
    plays = PrandtlIshlinskii(0.02 * gain, (0.49 * gain, 0.49 * gain), max(3.0 * width, 1e-3), 0.0, 20.0)
    return Chain(plays, (Lag(tau),) if tau else ())


def reach(plant: Predictor) -> tuple[float, float]:
    """Angles that the device rests at well within its range, on its way back and there."""
    state, ends = plant.initial(20.0, 0.0), list[float]()
    for u in (5.5, 0.5):
        for _ in range(100):
            angle, state = plant.advance(state, u)
        ends.append(angle)
    return ends[1] + 0.1 * (ends[0] - ends[1]), ends[0] - 0.1 * (ends[0] - ends[1])


@pytest.mark.slow
@settings(max_examples=6, deadline=None, derandomize=True)
@given(
    st.floats(5.0, 15.0), st.floats(0.0, 0.4), st.sampled_from([0.0, 0.05, 0.1, 0.2]), steps_deg, st.floats(-0.03, 0.03)
)
def test_a_hold_rests_on_any_device(gain: float, width: float, tau: float, step: float, off: float) -> None:
    """The model's gain and play are off; the same loop with a sensor taken for a continuous one hunts."""
    plant = compiled(device(gain, width, tau))[0]
    pair = compiled(device(gain * (1.0 + off), width * (1.0 + 2.0 * off), tau))
    low, high = reach(plant)
    targets = (low + 0.7 * (high - low), low + 0.3 * (high - low))
    for target, (commands, true) in zip(
        targets,
        tracked(pair, plant, (20.0, 0.0), targets, step, {"kind": "linearised_mpc"}, noise_of(step)),
        strict=True,
    ):
        moved = np.flatnonzero(np.diff(commands)) * DT
        assert np.sum(moved > RESTS_S) <= 0.05 * HOLD_S / DT  # a step may have been wrong; no cycle
        assert abs(true[-1] - target) <= 1.5 * step + 0.1


def test_without_its_steps_the_same_loop_hunts() -> None:
    """So the law above says something."""
    at_rest = noise_of(0.9).model_copy(update={"sensor_sigma_deg": 0.02, "sensor_resolution_deg": 0.0})
    controller = {"kind": "linearised_mpc"}
    ((commands, _),) = tracked(PLAY.build(), Backlash(), (PLAY.y_rest, 0.0), (50.0,), 0.9, controller, at_rest)
    assert not rests(commands)


@settings(max_examples=20)
@given(
    st.floats(0.05, 3.0), st.floats(0.0, 0.5), st.floats(-1.5, 1.5).filter(lambda share: abs(abs(share) - 1.0) > 1e-6)
)
def test_what_is_held_is_left_for_more_than_a_step(step: float, sigma: float, share: float) -> None:
    line = Line(a=0.0)
    object.__setattr__(line, "noise", noise_of(step))
    bench = Bench(predictor=line)
    assert bench.held(20)
    bench.script.sigma, bench.script.disturbance = sigma, share * (step + 5.0 * sigma + 0.03)
    bench.step()
    assert bench.holding == (abs(share) < 1.0)
    assert not Bench(0.04, line).held(2)  # it is entered as without steps


@given(steps_deg)
def test_equal_readings_are_no_better_than_their_steps(step: float) -> None:
    model = Backlash()
    object.__setattr__(model, "noise", noise_of(step))
    bank = NoiseBank((None, None, None), model, 90.0)
    assert float(np.min(np.asarray(bank.struct().fields["sensor_variances"]))) >= step**2 / 12.0 * (1.0 - 1e-9)


@given(steps_deg, st.floats(0.0, 2.0))
def test_feedback_does_not_integrate_half_a_step(step: float, dead_zone: float) -> None:
    gains = PidSettings(dead_zone_deg=dead_zone).with_dead_zone(step)
    assert gains.dead_zone_deg >= max(0.5 * step, dead_zone)
    assert PidSettings(dead_zone_deg=dead_zone).with_dead_zone(0.0).dead_zone_deg == dead_zone
    model = Backlash()
    object.__setattr__(model, "noise", noise_of(step))
    assert feedback_gains(SupervisorSettings(), model).dead_zone_deg >= 0.5 * step
