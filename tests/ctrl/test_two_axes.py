"""Laws of the controller of two axes: limits for any input, two single axes where nothing joins them, the interface."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc import TipController
from hystmpc.ctrl.build import build_controller, pair_for
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.two_axes.guarded import TwoAxisController
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisTipController, TwoAxisTipSettings
from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.scheduled import Dependence, MeasuredInput, Scheduled
from hystmpc.models.simulator import ChainModel, Simulator
from hystmpc.models.two_axes.model import CrossFriction, TwoAxisModel
from hystmpc.trials.errors import ConfigError, ControllerError, ModelError

from ..models.two_axis_examples import COUPLED, DT, RATE, REACH, SHARED, Vec, two_axes, wandering

KINDS: tuple[dict[str, Any], ...] = (
    {"kind": "linearised_mpc"},
    {"kind": "sampling_mpc", "samples": 32},
    {"kind": "inverse"},
    {"kind": "inverse_pid"},
    {"kind": "pid"},
)
JOINED = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), SHARED)
TENDONS = two_axes().with_tendons([0, 90, 180, 270], pretension=1.0, limits=[(0.2, 4.0)] * 4, rates_per_s=[RATE] * 4)


def noisy(axis: Simulator) -> Simulator:
    """The same with what an identification says of its noise."""
    noise = NoiseModel(
        sensor_sigma_deg=0.1, drift_sigma_deg_per_sqrt_s=0.02, motion_sigma_deg_per_sqrt_unit=0.05, model_sigma_deg=0.1
    )
    return replace(axis, identification=axis.identification.model_copy(update={"noise": noise}))


def controller_of(model: TwoAxisModel, given_: dict[str, Any]) -> TwoAxisController:
    return TwoAxisController(model, parse_controller(given_, "controller"))


class Device:
    """A device that is the model, at rest at zero travel."""

    def __init__(self, model: TwoAxisModel) -> None:
        self.model, self.sent = model, [np.array(model.rest_commands)]

    def advance(self, u: Vec) -> Vec:
        self.sent.append(u)
        return np.asarray(self.model.run(np.array(self.sent), np.zeros(2))[-1])


@pytest.mark.parametrize("given_", KINDS, ids=[kind["kind"] for kind in KINDS])
def test_without_a_joint_each_axis_is_what_it_is_alone(given_: dict[str, Any]) -> None:
    model, settings = two_axes(), parse_controller(given_, "controller")
    both = TwoAxisController(model, settings)
    alone = [
        build_controller(
            settings,
            *pair_for(settings, controller_model(ChainModel(one, "conditioned"))),
            CommandLimits(-REACH, REACH, RATE),
        )
        for one in model.axes
    ]
    state, states = both.init((0.0, 0.0), (0.0, 0.0)), [one.init(0.0, 0.0) for one in alone]
    device, angles = Device(model), np.zeros(2)
    t = DT * np.arange(60 + both.horizon)
    wanted = np.stack([10 * np.sin(t), 8 * np.sin(0.7 * t)], axis=1)
    for k in range(60):
        command, state = both.step(state, angles, wanted[k : k + both.horizon])
        for i in range(2):
            one, states[i] = alone[i].step(states[i], float(angles[i]), wanted[k : k + both.horizon, i].copy())
            assert command.u[i] == pytest.approx(one.u, abs=2e-6)
        angles = device.advance(command.u)


readings = st.one_of(
    st.tuples(st.floats(), st.floats()),
    st.tuples(st.floats(-40, 40), st.floats(-40, 40)),
    st.sampled_from([None, "x", (), (1.0,), [[1.0, 2.0]]]),
)
references = st.one_of(
    st.tuples(st.floats(), st.floats()), st.tuples(st.floats(-60, 60), st.floats(-60, 60)), st.none()
)
models = st.sampled_from([JOINED, TENDONS, two_axes()])


@given(models, st.sampled_from(KINDS), st.lists(st.tuples(readings, references, st.booleans()), max_size=12))
def test_any_input_is_answered_within_the_limits(
    model: TwoAxisModel, given_: dict[str, Any], steps: list[tuple[Any, Any, bool]]
) -> None:
    controller = controller_of(model, given_)
    low, high = (np.array([getattr(one, end) for one in model.command_limits]) for end in ("lower", "upper"))
    reach = np.array(model.command_rates_per_s) * model.dt_s
    last = np.array(model.rest_commands)
    state = controller.init((0.0, 0.0), last)
    for reading, reference, late in steps:
        wanted = np.empty((0, 2)) if reference is None else np.tile(reference, (controller.horizon, 1))
        command, state = controller.step(replace(state, refusal="late" if late else ""), reading, wanted)
        assert np.all((low <= command.u) & (command.u <= high))
        assert np.all(np.abs(command.u - last) <= reach * (1 + 1e-12))
        assert command.status
        last = command.u


def test_the_commands_track_a_circle_that_both_axes_share() -> None:
    """The device is the model: what is left of the error is that of the start."""
    controller, device = controller_of(JOINED, KINDS[0]), Device(JOINED)
    state, angles = controller.init((0.0, 0.0), (0.0, 0.0)), np.zeros(2)
    t = DT * np.arange(150 + controller.horizon)
    wanted = np.stack([12 * np.sin(1.2 * t), 12 * (1 - np.cos(1.2 * t))], axis=1)
    errors = []
    for k in range(150):
        command, state = controller.step(state, angles, wanted[k : k + controller.horizon])
        angles = device.advance(command.u)
        errors.append(angles - wanted[k])
        assert command.status == "ok"
    assert np.sqrt(np.mean(np.square(errors[25:]))) < 0.1


def test_at_rest_of_both_references_the_commands_cease() -> None:
    """The device is the model, and the sensor is noisy: corrections end, though each frees the other axis."""
    model = replace(JOINED, axes=(noisy(JOINED.axes[0]), noisy(JOINED.axes[1])))
    controller, device, random = controller_of(model, KINDS[0]), Device(model), np.random.default_rng(3)
    state, angles, moves = controller.init((0.0, 0.0), (0.0, 0.0)), np.zeros(2), []
    for k in range(200):
        wanted = np.tile([9.0, -7.0] if k < 60 else [4.0, 2.0], (controller.horizon, 1))
        command, state = controller.step(state, angles + 0.1 * random.standard_normal(2), wanted)
        moves.append(float(np.abs(command.u - device.sent[-1]).max()))
        angles = device.advance(command.u)
    assert max(moves[140:]) < 0.02 * REACH
    assert np.median(moves[140:]) == 0.0
    assert angles == pytest.approx([4.0, 2.0], abs=0.3)


def test_a_start_away_from_zero_knows_the_static_coupling_there() -> None:
    """The device is the model and rests under commands that both axes share: nothing departs, nothing moves."""
    model, held = two_axes(cross=COUPLED), np.array([2.0, -1.5])
    path = np.clip(np.linspace(0.0, 2.0, 120), 0.0, 1.0)[:, None] * held
    angles = model.run(path, np.zeros(2))[-1]
    assert model.run(np.tile(held, (50, 1)), angles) == pytest.approx(np.tile(angles, (50, 1)), abs=1e-6)
    controller = controller_of(model, KINDS[0])
    state = controller.init(angles, held)
    for _ in range(20):
        command, state = controller.step(state, angles, np.tile(angles, (controller.horizon, 1)))
        assert command.disturbance == pytest.approx(np.zeros(2), abs=1e-6)
        assert command.u == pytest.approx(held, abs=1e-6)


def test_both_axes_together_reverse_without_an_oscillation() -> None:
    """A motion of y removes the dead band of x, whose wanted angle is constant: x hardly moves to and fro."""
    model = two_axes(cross=CrossFriction(lag_s=0.0, radii=(0.3,), weights=((6.0,), (6.0,))))
    controller, device = controller_of(model, KINDS[0]), Device(model)
    state, angles, sent = controller.init((0.0, 0.0), (0.0, 0.0)), np.zeros(2), []
    t = DT * np.arange(200 + controller.horizon)
    wanted = np.stack([np.clip(12 * t, 0, 12), np.clip(15 * (t - 1.5), 0, 15) - np.clip(15 * (t - 4), 0, 15)], axis=1)
    for k in range(200):
        command, state = controller.step(state, angles, wanted[k : k + controller.horizon])
        angles = device.advance(command.u)
        sent.append(command.u[0])
    travel = float(np.abs(np.diff(sent[40:])).sum())
    assert travel < 0.5


def test_where_limits_bind_one_program_decides_between_the_axes() -> None:
    """Both axes want more than the commands allow together: the plan is not beaten by that of any cut of both."""
    model = two_axes(((1.0, 0.8), (-0.1, 1.0)))
    controller = controller_of(model, {"kind": "linearised_mpc", "adaptation": None})
    state = controller.init((0.0, 0.0), (0.0, 0.0))
    target = model.run(np.tile([2.9, 2.9], (200, 1)), (0.0, 0.0))[-1] * [1.0, 0.8]
    wanted = np.tile(target, (controller.horizon, 1))
    device, angles = Device(model), np.zeros(2)
    for _ in range(60):
        command, state = controller.step(state, angles, wanted)
        angles = device.advance(command.u)
    assert np.max(np.abs(command.u)) <= REACH
    cost = float(np.sum(np.square(angles - target)))
    for share in np.linspace(0.9, 1.0, 11):
        for other in np.linspace(0.9, 1.0, 11):
            u = np.clip(model.commands(model.travels(command.u) * [share, other]), -REACH, REACH)
            held = model.run(np.vstack([np.array(device.sent), np.tile(u, (60, 1))]), np.zeros(2))[-1]
            assert cost <= float(np.sum(np.square(held - target))) + 0.5


def test_four_tendons_are_never_slack_and_keep_their_pretension() -> None:
    controller, device = controller_of(TENDONS, KINDS[0]), Device(TENDONS)
    state, angles = controller.init((0.0, 0.0), TENDONS.rest_commands), np.zeros(2)
    for k in range(120):
        wanted = np.tile([6.0, -5.0] if k < 60 else [-4.0, 0.0], (controller.horizon, 1))
        command, state = controller.step(state, angles, wanted)
        angles = device.advance(command.u)
        assert np.min(command.u) >= 0.2
    assert np.mean(command.u) == pytest.approx(1.0, abs=0.15)
    assert angles == pytest.approx([-4.0, 0.0], abs=0.2)


@pytest.mark.parametrize("size", [4.0, 30.0])
def test_angles_are_foretold_along_the_plan_that_is_sent(size: float) -> None:
    """On a device that is the model, where limits bind and where they do not."""
    controller, device = controller_of(JOINED, KINDS[0]), Device(JOINED)
    state, angles = controller.init((0.0, 0.0), (0.0, 0.0)), np.zeros(2)
    t = DT * np.arange(60 + controller.horizon)
    wanted = size * np.stack([np.sin(3 * t), np.sin(2 * t)], axis=1)
    for k in range(60):
        command, state = controller.step(state, angles, wanted[k : k + controller.horizon])
        angles = device.advance(command.u)
        assert command.plan[0] == pytest.approx(command.u, abs=1e-12)
        assert command.predicted[0] == pytest.approx(angles, abs=1e-6)


@pytest.mark.parametrize("other", KINDS[2:], ids=lambda kind: kind["kind"])
def test_the_state_of_another_controller_is_refused(other: dict[str, Any]) -> None:
    """The engine does not look where memory ends."""
    controller, foreign = controller_of(JOINED, KINDS[0]), controller_of(JOINED, other).init((0.0, 0.0), (0.0, 0.0))
    for use in (
        lambda: controller.step(foreign, (0.0, 0.0), np.zeros((controller.horizon, 2))),
        lambda: controller.measure(foreign, (0.0, 0.0), 1.0),
        lambda: controller.stop(foreign, "tested"),
        lambda: controller.holding(foreign, (0.0, 0.0)),
    ):
        with pytest.raises(ControllerError, match="cut off, or of another controller"):
            use()


@pytest.mark.parametrize("given_", KINDS, ids=[kind["kind"] for kind in KINDS])
def test_a_controller_that_is_given_an_input_plans_with_the_device_there(given_: dict[str, Any]) -> None:
    """Its commands are those of a controller whose model has the parameters at this value."""
    z, u = 3.5, np.zeros(2)
    depending = two_axes(((1.0, 0.2), (-0.1, 1.0)))
    core = depending.axes[1].chain.core
    axes = [
        replace(depending.axes[1], chain=replace(depending.axes[1].chain, core=one))
        for one in (
            Scheduled.of(core, (Dependence(MeasuredInput("bar", 2.0, 1.0, 4.0), "gain"),), (-0.1,)),
            core.with_values([(1 - 0.1 * (z - 2.0)) * v if p.name.startswith("a") and p.name != "alpha" else v
                              for p, v in zip(core.parameters, core.values, strict=True)]),
        )
    ]  # fmt: skip
    given_ = {**given_, "adaptation": None} if given_["kind"].endswith("mpc") else given_
    one, other = (
        controller_of(replace(depending, axes=(noisy(depending.axes[0]), noisy(axis))), given_) for axis in axes
    )
    first, second = one.init(u, u), other.init(u, u)
    wanted = np.stack([np.linspace(0, 12, one.horizon), np.linspace(0, -9, one.horizon)], axis=1)
    for k in range(40):
        first = one.with_inputs(first, {"bar": z})
        angles = np.array([0.2 * k, -0.15 * k])
        (a, first), (b, second) = one.step(first, angles, wanted + angles), other.step(second, angles, wanted + angles)
        if k > 4:  # each began at rest at its own reference value
            np.testing.assert_allclose(a.u, b.u, atol=0.02 if given_["kind"] != "sampling_mpc" else 0.4)
    with pytest.raises(ControllerError, match="no input 'baar'"):
        one.with_inputs(first, {"baar": 1.0})


@pytest.mark.parametrize("cross", [None, SHARED, COUPLED])
def test_the_state_shows_the_angles_as_measured(cross: CrossFriction | None) -> None:
    """With the friction that both axes share, which each axis does not see: else a target would never be settled."""
    model = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), cross)
    tip, device = TwoAxisTipController(model, TwoAxisTipSettings(model="-")), Device(model)
    angles = np.zeros(2)
    tip.step(angles)
    tip.set_target((12.0, -8.0))
    for _ in range(150):
        command = tip.step(angles)
        np.testing.assert_allclose(tip.state().measured_deg, angles, atol=1e-9)
        angles = device.advance(command.u)
    assert tip.state().settled


def test_inputs_of_a_tip_are_held_and_said() -> None:
    axis = two_axes().axes[0]
    core = Scheduled.of(axis.chain.core, (Dependence(MeasuredInput("bar", 2.0, 1.0, 4.0), "gain"),), (-0.1,))
    model = replace(two_axes(), axes=(replace(axis, chain=replace(axis.chain, core=core)), two_axes().axes[1]))
    tip, other = (TwoAxisTipController(model, TwoAxisTipSettings(model="-")) for _ in range(2))
    for one in (tip, other):
        one.set_target((10.0, 5.0))
    statuses = [one.step((0.0, 0.0), inputs=given_).status for one, given_ in ((tip, {"bar": 3.0}), (other, None))]
    assert statuses[0] == "ok"
    assert other.step((0.1, 0.1)).status == "inputs: none given of bar 2, the identified value counts"
    assert "inputs: none given" not in other.step((0.2, 0.1)).status
    answers = [
        one.step((0.3, 0.2), inputs=given_) for one, given_ in ((tip, {"bar": float("nan")}), (other, {"bar": 3.0}))
    ]
    assert "its last value holds" in answers[0].status
    assert dict(tip.snapshot().inputs) == dict(other.snapshot().inputs) == {"bar": 3.0}  # type: ignore[attr-defined]


def test_an_axis_that_stops_stops_the_other() -> None:
    """The sensor of x fails for good, that of y does not."""
    controller = controller_of(two_axes(), KINDS[0])
    state = controller.init((0.0, 0.0), (0.0, 0.0))
    wanted = np.tile([5.0, 5.0], (controller.horizon, 1))
    for _ in range(500):
        _, state = controller.step(state, (np.nan, 0.0), wanted)
        if state.first.stopped:
            break
    assert state.first.stopped
    command, state = controller.step(state, (np.nan, 0.0), wanted)
    assert state.second.stopped
    again, _ = controller.step(state, (0.0, 0.0), wanted)
    np.testing.assert_array_equal(again.u, command.u)


def test_a_stop_holds_to_the_last_bit() -> None:
    controller = controller_of(JOINED, KINDS[0])
    state = controller.init((1.0, 2.0), (0.3, -0.7))
    wanted = np.tile([8.0, 3.0], (controller.horizon, 1))
    command, state = controller.step(state, (1.0, 2.0), wanted)
    state = controller.stop(state, "by test")
    for _ in range(3):
        stopped, state = controller.step(state, (1.0, 2.0), wanted)
        np.testing.assert_array_equal(stopped.u, command.u)
        assert "by test" in stopped.status
    assert state.stopped


@pytest.fixture
def tip(tmp_path: Path) -> TwoAxisTipController:
    path = JOINED.save(tmp_path / "both.yaml")
    given_ = {
        "model": str(path),
        "limits": {"lower": [-3, -3], "upper": [3, 3], "rate_per_s": [8, 8]},
        "controller": {"kind": "linearised_mpc"},
    }
    return cast(TwoAxisTipController, TipController.from_config(given_))


def test_the_interface_of_a_planner_has_arrays_of_both_axes(tip: TwoAxisTipController) -> None:
    device, angles = Device(JOINED), np.zeros(2)
    assert tip.step((np.nan, 1.0)).status.startswith("not started")
    assert tip.step(angles).u.shape == (2,)
    assert tip.set_target((9.0, -6.0))
    for _ in range(80):
        angles = device.advance(tip.step(angles).u)
    state, plan = tip.state(), tip.plan()
    assert state.settled
    assert state.measured_deg == pytest.approx([9.0, -6.0], abs=0.5)
    shapes = [getattr(state, name).shape for name in ("measured_deg", "reference_deg", "command", "sigma_deg")]
    assert shapes == [(2,)] * 4
    assert plan.command.shape == plan.predicted_deg.shape == plan.reference_deg.shape
    reach = tip.reachable((300.0, 0.0))
    assert not reach
    assert np.all(np.isfinite(reach.nearest_deg))
    for source in (lambda t: (9.0 + t, -6.0), lambda t: np.stack([9 + t, 0 * t - 6], axis=-1), [[9.0, -6.0]] * 5):
        tip.set_reference(source)
        assert tip.step(angles).status == "ok"


def test_a_snapshot_determines_what_follows(tip: TwoAxisTipController) -> None:
    tip.step((0.0, 0.0))
    tip.set_waypoints([(5.0, 2.0), (-3.0, 4.0)], [0.2, 0.0])
    readings_ = np.random.default_rng(1).normal(0, 0.5, (30, 2))
    snapshot = tip.snapshot()
    first = [tip.step(reading).u for reading in readings_]
    tip.restore(snapshot, held=(0.0, 0.0))
    np.testing.assert_array_equal([tip.step(reading).u for reading in readings_], first)


def test_stop_is_released_by_reset_alone(tip: TwoAxisTipController) -> None:
    held = tip.step((0.0, 0.0)).u
    tip.stop()
    np.testing.assert_array_equal(tip.step((0.0, 0.0)).u, held)
    with pytest.raises(ControllerError, match="the stop is latched"):
        tip.set_target((1.0, 1.0))
    tip.reset((0.0, 0.0))
    assert not tip.state().stopped


def test_a_reference_that_fails_holds_and_says_so(tip: TwoAxisTipController) -> None:
    tip.step((0.0, 0.0))

    def fails(t: float) -> tuple[float, float]:
        if t > 0.5:  # within the preview of the first step
            raise ValueError("beyond its end")
        return 0.0, 0.0

    tip.set_reference(fails)
    command = tip.step((0.0, 0.0))
    assert "reference" in command.status
    np.testing.assert_array_equal(command.u, [0.0, 0.0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"limits": {"lower": [-3], "upper": [3, 3], "rate_per_s": [8, 8]}}, "expected 2 of each"),
        ({"limits": {"lower": [-9, -3], "upper": [3, 3], "rate_per_s": [8, 8]}}, "beyond_model"),
        ({"start_command": [5, 0]}, "start_command"),
        ({"controller": {"kind": "pid", "limits": {"lower": 0, "upper": 1, "rate_per_s": 1}}}, "controller.limits"),
        ({"controler": {}}, "controller"),
        ({"model": "nowhere.yaml"}, "nowhere.yaml"),
    ],
)
def test_wrong_settings_are_one_line(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = JOINED.save(tmp_path / "both.yaml")
    with pytest.raises((ControllerError, ConfigError, ModelError), match=words) as refused:
        TipController.from_config({"model": str(path), **change})
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("target", [(1.0,), "x", (np.nan, 0.0), (1e9, 0.0)])
def test_wrong_targets_are_one_line(tip: TwoAxisTipController, target: Any) -> None:
    with pytest.raises(ControllerError, match="expected pairs") as refused:
        tip.set_target(target)
    assert len(str(refused.value)) <= 300


def test_frames_of_a_late_sensor_start_and_correct(tmp_path: Path) -> None:
    path = JOINED.save(tmp_path / "both.yaml")
    given_ = {"model": str(path), "controller": {"kind": "linearised_mpc", "estimator": {"sensor": "intermittent"}}}
    tip = cast(TwoAxisTipController, TipController.from_config(given_))
    tip.measure((0.0, 0.0), 0.0)
    tip.set_target((6.0, 4.0))
    device, seen = Device(JOINED), [np.zeros(2)]
    for k in range(120):
        if k >= 5 and k % 5 == 0:
            tip.measure(seen[k - 4] + 0.5, (k - 4) * tip.dt)
        seen.append(device.advance(tip.step((np.nan, np.nan)).u))
    assert seen[-1] + 0.5 == pytest.approx([6.0, 4.0], abs=0.4)
    with pytest.raises(ControllerError, match="age -3"):
        tip.measure((6.0, 4.0), 123 * tip.dt)  # of the future


@pytest.mark.parametrize("cross", [None, SHARED, COUPLED])
def test_after_a_replay_the_controller_knows_the_hysteresis_of_the_device(cross: CrossFriction | None) -> None:
    """It foretells the device without an error; a controller that starts at rest there does not."""
    model = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), cross)
    controller, sent = controller_of(model, KINDS[0]), 0.5 * wandering(3, 300)
    angles = model.run(sent, np.zeros(2))
    measured = np.vstack([np.zeros(2), angles[:-1]])  # each when its command was sent
    known, fresh = controller.replay(sent, measured), controller.init(angles[-1], sent[-1])
    off = []
    for state in (known, fresh):
        wanted = np.tile(angles[-1] + 2.0, (controller.horizon, 1))
        command, _ = controller.step(state, angles[-1], wanted)
        truth = model.run(np.vstack([sent, command.u]), np.zeros(2))[-1]
        off.append(float(np.abs(command.predicted[0] - truth).max()))
    assert off[0] < 1e-6
    assert off[1] > 100 * off[0]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind["kind"])
def test_every_kind_takes_over_a_device_that_shares_friction(kind: dict[str, Any]) -> None:
    """After a replay the first command lies within the rates of those that the device holds."""
    controller, sent = controller_of(JOINED, kind), 0.5 * wandering(5, 200)
    measured = JOINED.run(sent, np.zeros(2))
    state = controller.replay(sent, measured)
    command, _ = controller.step(state, measured[-1], np.tile(measured[-1] + 5.0, (controller.horizon, 1)))
    assert np.all(np.abs(command.u - sent[-1]) <= RATE * DT + 1e-9)


def test_a_replay_ends_at_the_command_that_the_device_holds() -> None:
    tip = TwoAxisTipController(JOINED, TwoAxisTipSettings(model="unused"))
    sent = 0.5 * wandering(1, 100)
    tip.replay(sent.tolist(), np.zeros((100, 2)).tolist())
    assert tip.state().command == pytest.approx(sent[-1])
    after = tip.step((0.0, 0.0)).u
    assert np.all(np.abs(after - sent[-1]) <= RATE * DT * (1 + 1e-12))
    held = tip.state().command
    assert tip.skip().u == pytest.approx(held)
    assert tip.snapshot().steps == 2  # type: ignore[attr-defined]
    for commands, angles in (
        (sent, np.zeros((99, 2))),
        (9.0 + sent, np.zeros((100, 2))),
        (sent, np.full((100, 2), np.nan)),
    ):
        with pytest.raises(ControllerError, match="replay"):
            tip.replay(commands, angles)
