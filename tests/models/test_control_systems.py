"""Models as systems of python-control: the library's functions agree with our own simulation."""

from __future__ import annotations

import subprocess
import sys

import control
import numpy as np
import pytest

import hystmpc
from hystmpc.models.chain import Chain
from hystmpc.models.linear.systems import from_control, linear_part
from hystmpc.models.operators.dynamics import Delay, Lag, LinearDynamics, Servo
from hystmpc.models.operators.hysteresis import Play
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Deadband, Line, NonlinearGain
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.errors import ModelError

from .test_describing import simulator
from .zoo import BACKLASH, BOUC_WEN, DT, RATE_PI, STATIC_PI

BENT = Deadband(1.1, (0.5,), (0.6,), (15.0,), (15.0,), 50.0, 48.0)
CHAINS = [
    simulator(core=RATE_PI),
    simulator(core=BOUC_WEN),
    simulator(Delay(1.5 * DT, 2), Lag(0.12), core=RATE_PI),
    simulator(Servo(0.1, 0.6), Play(0.2), core=BACKLASH, after=(Lag(0.2), BENT, Lag(0.05))),
    simulator(NonlinearGain(-0.011, 0.0, 2.9), core=STATIC_PI, after=(NonlinearGain(0.001, 0.0, 60.0),)),
]
every_chain = pytest.mark.parametrize("chain", CHAINS, ids=lambda s: "+".join(o.name for o in s.chain.operators))


def commands(samples: int = 200) -> np.ndarray:
    """A motion with many reversals, from 0.5 mm."""
    k = np.arange(samples)
    return 3.0 + 2.0 * np.sin(0.11 * k) + 0.5 * np.sin(0.43 * k) - 0.5 * (k == 0)


@every_chain
def test_a_response_is_our_own_simulation(chain: object) -> None:
    model = ChainModel(chain, "conditioned")  # type: ignore[arg-type]
    u, x = commands(), model.resting_x(40.0, 2.0)
    system = chain.to_control()  # type: ignore[attr-defined]
    response = control.input_output_response(system, DT * np.arange(u.size + 1), np.append(u, 0.0), x)
    ours = model.run_on(x[None, :-1], u[None])[0][0]
    np.testing.assert_allclose(response.outputs[1:], ours, rtol=0.0, atol=1e-9)
    assert (system.input_labels, system.output_labels, system.dt) == (["command_mm"], ["angle_deg"], DT)


def test_a_loop_interconnected_by_the_library_is_our_own_loop() -> None:
    """An integrator around a device with a drive: nothing is algebraic, since the output of a device is a state."""
    device = CHAINS[2]
    integrator = control.ss([[1.0]], [[0.02]], [[1.0]], [[0.01]], DT, inputs=["e"], outputs=["command_mm"], name="pi")
    less = control.summing_junction(["r", "-angle_deg"], "e", name="less")
    loop = control.interconnect(
        [device.to_control(), integrator, less], inputs=["r"], outputs=["angle_deg", "command_mm"]
    )
    model, reference = ChainModel(device, "conditioned"), np.where(np.arange(121) < 60, 50.0, 40.0)
    x = model.resting_x(40.0, 2.0)
    response = control.input_output_response(loop, DT * np.arange(121), reference, np.append(x, 2.0))
    angle, integral, state, angles = float(x[-1]), 2.0, x[None, :-1], []
    for wanted in reference:
        angles.append(angle)
        error = wanted - angle
        moved, state = model.run_on(state, np.array([[integral + 0.01 * error]]))
        angle, integral = float(moved[0, 0]), integral + 0.02 * error
    np.testing.assert_allclose(response.outputs[0], angles, rtol=0.0, atol=1e-9)


@every_chain
def test_the_operating_point_is_a_rest_of_the_model(chain: object) -> None:
    model = ChainModel(chain, "conditioned")  # type: ignore[arg-type]
    system, x = chain.to_control(), model.resting_x(45.0, 2.5)  # type: ignore[attr-defined]
    point = control.find_operating_point(system, x, [2.5])
    held = model.run_on(point.states[None, :-1], np.full((1, 50), 2.5))[0][0]
    np.testing.assert_allclose(held, point.outputs[0], atol=1e-6)


@every_chain
@pytest.mark.parametrize("branch", [1, -1])
def test_a_linearisation_takes_the_branch_that_is_asked_for(chain: object, branch: int) -> None:
    """Its answer to a small move in that direction is that of the model, to first order."""
    model = ChainModel(chain, "conditioned")  # type: ignore[arg-type]
    u = np.full(40, 3.0)
    before = model.run_on(model.resting_x(30.0, 1.0)[None, :-1], np.append(np.linspace(1.0, 3.0, 40), u)[None])
    state, last = before[1][0], before[0][0, -1]
    system = chain.to_control()  # type: ignore[attr-defined]
    linear = control.linearize(system, np.append(state, last), [3.0], params={"branch": branch})
    small = 1e-5
    moved = model.run_on(state[None], np.append(u[:1], u + branch * small)[None])[0][0]
    held = model.run_on(state[None], np.append(u[:1], u)[None])[0][0]
    step = control.forced_response(linear, DT * np.arange(40), np.ones(40), np.zeros(linear.nstates))
    one = (moved[1] - held[1]) / (branch * small)
    assert float(step.outputs[1]) == pytest.approx(one, rel=1e-2, abs=2e-2)


def test_the_two_branches_of_a_play_at_its_edge() -> None:
    system = simulator(core=Play(0.5)).to_control()
    edge = np.array([2.5, 2.5])  # z and angle, at the end of a rise to 3
    rising, falling = (control.linearize(system, edge, [3.0], params={"branch": b}) for b in (1, -1))
    np.testing.assert_allclose(rising.A, 0.0, atol=1e-9)
    np.testing.assert_allclose(rising.B.ravel(), [1.0, 1.0], rtol=1e-9)
    np.testing.assert_allclose(falling.A, [[1.0, 0.0], [1.0, 0.0]], rtol=1e-9)
    np.testing.assert_allclose(falling.B, 0.0, atol=1e-9)


def test_linear_drives_are_blocks_of_their_own() -> None:
    system = CHAINS[3].to_control()
    kinds = {block.name: type(block).__name__ for block in system.syslist}
    assert kinds == {
        "servo": "StateSpace", "play_backlash": "NonlinearIOSystem", "lag_1": "StateSpace",
        "deadband": "NonlinearIOSystem", "lag_2": "StateSpace",
    }  # fmt: skip
    np.testing.assert_allclose(CHAINS[2].to_control().syslist[1].poles(), np.exp(-DT / 0.12))


def test_a_network_is_a_system_too() -> None:
    model = hystmpc.load_model("builtin:lstm", "conditioned")
    u, x = commands(40), model.resting_x(30.0, 1.0)
    response = control.input_output_response(model.to_control(), model.dt * np.arange(41), np.append(u, 0.0), x)
    np.testing.assert_allclose(response.outputs[1:], model.run_on(x[None, :-1], u[None])[0][0], atol=1e-9)


LINEAR = [
    (control.tf([1.0], [0.1, 1.0]), Lag(0.1)),
    (control.tf([1.0], [(0.1 / 1.2) ** 2, 0.1, 1.0]), Servo(0.1, 0.6, 0)),
]


@pytest.mark.parametrize(("system", "operator"), LINEAR, ids=["lag", "servo"])
def test_a_system_of_the_library_is_the_operator_of_the_same_equation(system: object, operator: Operator) -> None:
    """Servo: w = 2 d / tau, so that w^2 = (1.2 / 0.1)^2 at a damping of 0.6."""
    model = ChainModel(simulator(from_control(system, DT), core=STATIC_PI), "conditioned")
    ours = ChainModel(simulator(operator, core=STATIC_PI), "conditioned")
    np.testing.assert_allclose(model.run(commands(), 35.0), ours.run(commands(), 35.0), atol=1e-9)


def test_a_system_goes_there_and_back() -> None:
    drive = control.tf([0.02, 1.0], [0.002, 0.09, 1.0])
    operator = from_control(drive, DT)
    back = control.ss(*(linear_part(operator, DT) or ()), DT)
    z = np.exp(1j * np.array([0.1, 0.7, 2.0]))
    held = control.sample_system(control.ss(drive), DT, method="zoh")
    np.testing.assert_allclose(back(z), (held(z) * z), rtol=1e-9)  # its output counts at the end of the sample
    filtered = control.tf([0.2, 0.1], [1.0, -0.7], DT)
    part = linear_part(from_control(filtered, DT), DT)
    np.testing.assert_allclose(control.ss(*(part or ()), DT)(z), filtered(z), rtol=1e-9)


@pytest.mark.parametrize("dt_s", [0.01, 0.1])
def test_a_drive_at_another_sample_time_is_the_same_drive(dt_s: float) -> None:
    drive = control.tf([0.02, 1.0], [0.002, 0.09, 1.0])
    moved, made = from_control(drive, DT).resampled(dt_s, DT), from_control(drive, dt_s)
    np.testing.assert_allclose(moved.values, made.values, rtol=1e-6, atol=1e-9)


def test_a_drive_from_the_library_is_saved_and_inverted_over_a_preview(tmp_path: object) -> None:
    simulated = simulator(from_control(LINEAR[0][0], DT), core=STATIC_PI)
    file = simulated.save(f"{tmp_path}/driven.yaml")
    again = hystmpc.load_model(file)
    np.testing.assert_array_equal(again.simulator.chain.values, simulated.chain.values)
    assert hystmpc.build_controller("inverse", again).horizon > 1


@pytest.mark.parametrize(
    ("system", "message"),
    [
        ("no system", "expected a linear system"),
        (control.tf([2.0], [0.1, 1.0]), "static gain of 2, expected 1"),
        (control.tf([1.0], [0.1, 0.0]), "expected stable ones"),
        (control.tf([0.5], [1.0, -0.5], 0.1), "continuous or at 0.04 s"),
        (control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), "2 inputs, 2 outputs"),
    ],
)
def test_what_is_no_drive_is_refused(system: object, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        from_control(system, DT)


def test_numbers_that_are_no_drive_are_refused() -> None:
    with pytest.raises(ModelError, match="static gain"):
        LinearDynamics((-0.5,), (1.0, 0.0))
    with pytest.raises(ModelError, match="expected n \\+ 1 and n"):
        LinearDynamics((-0.5,), (0.5,))
    with pytest.raises(ModelError, match="pole at zero"):
        LinearDynamics((0.0,), (0.0, 1.0)).resampled(0.01, DT)


def test_a_line_has_an_offset_and_is_no_linear_part() -> None:
    assert linear_part(Line(2.0, 1.0), DT) is None
    assert linear_part(Line(2.0, 0.0), DT) is not None
    assert Chain(Line(2.0, 0.0)).state_size == 1


@pytest.mark.slow
def test_neither_the_package_nor_a_control_loop_imports_python_control() -> None:
    code = (
        "import sys, hystmpc, numpy as np\n"
        "c = hystmpc.build_controller('linearised_mpc', 'builtin:tendon-catheter')\n"
        "s = c.init(30.0, 0.0)\n"
        "c.step(s, 30.0, np.full(c.horizon, 31.0))\n"
        "sys.exit('control is imported' if 'control' in sys.modules else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
