"""Measured inputs in a controller: held over the preview, bridged where they are lost, of no effect where none is."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.planner.tip_controller import TipController
from hystmpc.models.chain import Chain
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.scheduled import Dependence, MeasuredInput, Scheduled
from hystmpc.models.simulator import export_simulator, save_simulator
from hystmpc.models.stages import prepared

from ..models.zoo import DT, simulator

BAR = MeasuredInput("bar", 2.0, 1.0, 4.0)
CORE = Scheduled.of(
    PrandtlIshlinskii(6.0, (4.0, 3.0), 0.25, 0.0, 25.0),
    (Dependence(BAR, "friction"), Dependence(BAR, "gain")),
    (0.5, -0.05),
)
CHAIN = Chain(CORE, (Delay(0.04, 2), Scheduled.of(Lag(0.06), (Dependence(BAR, "time"),), (0.2,))))
KINDS = ("linearised_mpc", "sampling_mpc", "inverse", "inverse_pid")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("models")
    onnx = folder / "m.onnx"
    export_simulator(simulator(CHAIN), onnx)
    return {"yaml": save_simulator(simulator(CHAIN), folder / "m.yaml"), "onnx": onnx}


def controller(file: Path, kind: str = "linearised_mpc", **more: object) -> TipController:
    return TipController.from_config({"model": str(file), "controller": {"kind": kind, **more}})


def wanted(t: float) -> float:
    return 55.0 + 18.0 * math.sin(1.2 * t) * math.sin(0.31 * t + 0.4)


def run(tip: TipController, z: float, inputs: object = None, samples: int = 300, y0: float = 40.0) -> np.ndarray:
    """Errors [deg] on the very device at a constant input; commands stay within the limits."""
    device = prepared(CHAIN.at_inputs({"bar": z}).operators, DT)
    x = np.asarray(CHAIN.at_inputs({"bar": z}).rest(y0, 0.0, CHAIN.at_inputs({"bar": z}).values)).ravel()
    y, errors = y0, []
    tip.set_reference(wanted)
    for k in range(samples):
        command = tip.step(y, inputs=inputs)  # type: ignore[arg-type]
        y, x = device.step(x, command.u)
        errors.append(y - wanted((k + 1) * DT))
    return np.array(errors[80:])


@pytest.mark.parametrize("kind", KINDS)
def test_a_controller_that_is_given_the_input_knows_the_device(kind: str, files: dict[str, Path]) -> None:
    more = {"adaptation": None} if kind.endswith("mpc") else {}
    known, unknown = (run(controller(files["yaml"], kind, **more), 4.0, given) for given in ({"bar": 4.0}, None))
    assert np.sqrt(np.mean(known**2)) < 0.7 * np.sqrt(np.mean(unknown**2))


@pytest.mark.parametrize("form", ["yaml", "onnx"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_identified_value_is_that_of_a_device_that_measures_none(
    kind: str, form: str, files: dict[str, Path]
) -> None:
    one, other = (run(controller(files[form], kind), 2.0, given, 120) for given in ({"bar": 2.0}, None))
    np.testing.assert_array_equal(one, other)


def test_it_holds_until_the_next_one_and_beyond_the_range_the_nearest_counts(files: dict[str, Path]) -> None:
    tips = [controller(files["yaml"]) for _ in range(4)]
    for tip in tips:
        tip.set_reference(wanted)
    for k in range(60):
        lost = [{"bar": 4.0}, None, {"bar": math.nan}, {"bar": 40.0}] if k else [{"bar": 4.0}] * 3 + [{"bar": 9.0}]
        answers = [tip.step(40.0 + 0.2 * k, inputs=given) for tip, given in zip(tips, lost, strict=True)]  # type: ignore[arg-type]
        assert len({answer.u for answer in answers}) == 1
        if k:
            assert "nan" in answers[2].status
            assert "its last value holds" in answers[2].status
            assert "identified 1 to 4: the nearest counts" in answers[3].status


def test_an_input_that_is_not_given_is_said_once(files: dict[str, Path]) -> None:
    tip = controller(files["yaml"])
    tip.set_target(50.0)
    statuses = [tip.step(40.0).status for _ in range(5)]
    assert sum("inputs: none given of bar 2, the identified value counts" in status for status in statuses) == 1


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"baar": 1.0}, "no 'baar', available: bar; did you mean 'bar'"),
        ({"bar": "much"}, "expected a finite number"),
        ({"bar": np.ones(20)}, "expected a finite number"),
        (3.0, "expected a mapping of numbers by name"),
    ],
)
def test_a_wrong_input_is_said_and_changes_nothing(given: object, words: str, files: dict[str, Path]) -> None:
    tip, other = controller(files["yaml"]), controller(files["yaml"])
    for one in (tip, other):
        one.set_target(50.0)
        one.step(40.0, inputs={"bar": 3.0})
    answer = tip.step(40.5, inputs=given)  # type: ignore[arg-type]
    assert words in answer.status
    assert len(answer.status) <= 300
    assert answer.u == other.step(40.5).u


def test_a_model_without_inputs_says_that_it_takes_none() -> None:
    tip = controller(Path("builtin:pi"))
    tip.set_target(50.0)
    tip.step(40.0)
    assert "inputs: no 'bar'" in tip.step(40.0, inputs={"bar": 1.0}).status


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(st.one_of(st.none(), st.floats(), st.integers(), st.text(max_size=3)), min_size=3, max_size=8))
def test_no_input_breaks_the_limits_or_the_step(values: list[object]) -> None:
    tip = TipController.from_config({"model": "builtin:pi", "controller": {"kind": "linearised_mpc"}})
    tip.set_target(60.0)
    last = tip.step(40.0).u
    for value in values:
        command = tip.step(41.0, inputs={"bar": value})  # type: ignore[dict-item]
        assert math.isfinite(command.u)
        assert abs(command.u - last) <= 12.0 * DT + 1e-9
        last = command.u


def test_the_last_value_holds_over_a_reset_and_a_replay(files: dict[str, Path]) -> None:
    one, other = controller(files["yaml"]), controller(files["yaml"])
    for tip in (one, other):
        tip.set_target(50.0)
        tip.step(40.0, inputs={"bar": 3.5})
        tip.reset(40.0)
        tip.set_target(60.0)
    assert [one.step(41.0).u for _ in range(5)] == [other.step(41.0, inputs={"bar": 3.5}).u for _ in range(5)]
    for tip in (one, other):
        tip.replay(np.full(30, tip.snapshot().command.u), np.full(30, 41.0))
        tip.set_target(70.0)
    answers = [(one.step(41.0), other.step(41.0, inputs={"bar": 3.5})) for _ in range(5)]
    assert all(a.u == b.u and "inputs" not in a.status for a, b in answers)


def test_a_snapshot_has_the_inputs(files: dict[str, Path]) -> None:
    tip = controller(files["yaml"])
    tip.set_reference(wanted)
    for k in range(40):
        tip.step(40.0 + 0.2 * k, inputs={"bar": 3.5})
    kept = pickle.loads(pickle.dumps(tip.snapshot().control))
    snapshot = tip.snapshot()
    np.testing.assert_array_equal(kept.memory, snapshot.control.memory)  # type: ignore[union-attr]
    first = [tip.step(48.0).u for _ in range(3)]
    tip.restore(snapshot, held=snapshot.command.u)
    assert [tip.step(48.0).u for _ in range(3)] == first
    fork = tip.fork()
    assert fork.step(49.0).u == tip.step(49.0).u
