"""What a program hands over by mistake: each call says so in one line, and a step takes it for no measurement."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc
from hystmpc import Evaluation, HystmpcError
from hystmpc.ctrl import Command, Source, TipController
from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import parse_controller
from hystmpc.trials.errors import ConfigError

from .plays import DT, PLAY
from .test_tip_controller import LIMITS, controller_for


class Hostile:
    """Raises whatever is asked of it."""

    def __float__(self) -> float:
        raise RuntimeError("no\nfloat")

    def __array__(self, *_: object, **__: object) -> Any:
        raise RuntimeError("no array")

    def __repr__(self) -> str:
        raise RuntimeError("no text")


NO_NUMBERS: list[Any] = [
    "x",
    "45",
    b"45",
    True,
    np.True_,
    1j,
    [1.0, 2.0],
    [[1.0], [1.0, 2.0]],
    {"a": 1},
    np.array([1.0, 2.0]),
    np.array(["x"]),
    object(),
    Hostile(),
    10**400,
    "long " * 200,
]
ODD_NUMBERS: list[Any] = [math.nan, math.inf, -math.inf, np.float64("nan"), 1e300]
NO_LISTS: list[Any] = [
    None,
    "x",
    b"x",
    [],
    ["a"],
    [[1.0], [1.0, 2.0]],
    {"a": 1},
    object(),
    Hostile(),
    [math.nan],
    [None],
]
NO_LISTS += [["45"], [1j], [10**400], np.zeros((2, 2, 2)), list(range(10_000, 20_000))]

NUMBERS: dict[str, Callable[[TipController, Any], Any]] = {
    "set_target": lambda tip, x: tip.set_target(x),
    "reset": lambda tip, x: tip.reset(x),
    "reset to a command": lambda tip, x: tip.reset(PLAY.y_rest, x),
    "measure": lambda tip, x: tip.measure(x, 0.0),
    "measure at": lambda tip, x: tip.measure(PLAY.y_rest, x),
    "replay held": lambda tip, x: tip.replay([0.0], [PLAY.y_rest], x),
    "restore held": lambda tip, x: tip.restore(tip.snapshot(), x),
    "took": lambda tip, x: tip.took(1, Command(x, Source.MPC)),
}
WITHOUT_NONE = {"set_target", "measure", "measure at", "took"}
LISTS: dict[str, Callable[[TipController, Any], Any]] = {
    "waypoints": lambda tip, x: tip.set_waypoints(x, [0.0]),
    "holds": lambda tip, x: tip.set_waypoints([40.0], x),
    "replayed commands": lambda tip, x: tip.replay(x, [PLAY.y_rest]),
    "replayed angles": lambda tip, x: tip.replay([0.0], x),
    "predict": lambda tip, x: tip.predict(x),
    "reference": lambda tip, x: tip.set_reference(x),
    "restore": lambda tip, x: tip.restore(x),
    "took": lambda tip, x: tip.took(1, x),
    "took so many": lambda tip, x: tip.took(x, Command(0.0, Source.MPC)),
}


@pytest.fixture
def tip() -> TipController:
    """Started, at rest."""
    made = controller_for()
    made.reset(PLAY.y_rest)
    made.step(PLAY.y_rest)
    return made


def refused(call: Callable[[], Any]) -> None:
    with pytest.raises(HystmpcError) as caught:
        call()
    line = str(caught.value)
    assert line
    assert "\n" not in line
    assert len(line) <= 300


@pytest.mark.parametrize("name", NUMBERS)
def test_what_is_no_number_is_refused_in_a_line_and_changes_nothing(name: str, tip: TipController) -> None:
    before = tip.snapshot()
    for value in [*NO_NUMBERS, *ODD_NUMBERS, *([None] if name in WITHOUT_NONE else [])]:
        refused(lambda value=value: NUMBERS[name](tip, value))
        assert tip.snapshot() is before


@pytest.mark.parametrize("name", LISTS)
def test_what_is_no_list_of_numbers_is_refused_in_a_line_and_changes_nothing(name: str, tip: TipController) -> None:
    before = tip.snapshot()
    for value in NO_LISTS:
        refused(lambda value=value: LISTS[name](tip, value))
        assert tip.snapshot() is before


def test_an_odd_function_is_refused_in_a_line(tip: TipController) -> None:
    def with_duration(duration: Any) -> Callable[[Any], Any]:
        def still(t: Any) -> Any:
            return 40.0 + 0.0 * t

        still.duration_s = duration  # type: ignore[attr-defined]
        return still

    functions: list[Any] = [lambda t: Hostile(), lambda t: np.zeros((50, 50)), lambda t: "x", lambda: 1.0, Hostile]
    for function in [*functions, *map(with_duration, ["x", None, math.nan, -1.0, Hostile()])]:
        refused(lambda function=function: tip.set_reference(function))


@pytest.mark.parametrize("kind", ["linearised_mpc", "pid", "inverse"])
@pytest.mark.parametrize("sensor", ["continuous", "intermittent"])
def test_a_step_takes_anything_for_no_measurement(kind: str, sensor: str) -> None:
    """Before the start too: nothing of this starts a controller."""
    tip = controller_for(kind=kind, estimator={"sensor": sensor})
    last = tip.state().command
    for started in (False, True):
        if started:
            tip.reset(PLAY.y_rest)
        for value in [*NO_NUMBERS, *ODD_NUMBERS, None]:
            command = tip.step(value)
            assert abs(command.u - last) <= LIMITS.rate * DT * (1 + 1e-12)
            last = command.u
            assert math.isnan(tip.state().measured_deg) or tip.state().measured_deg == PLAY.y_rest
        assert (tip.snapshot().control is not None) is started


@pytest.mark.parametrize("kind", [float, np.float32, np.float64, np.array, Fraction, int, np.int16])
def test_a_number_of_any_kind_is_one(kind: Callable[[float], Any], tip: TipController) -> None:
    twin = controller_for()
    twin.reset(PLAY.y_rest)
    twin.step(PLAY.y_rest)
    for one, convert in ((tip, kind), (twin, float)):
        one.set_target(convert(60.0))
        one.step(convert(31.0))
    assert tip.state() == twin.state()
    tip.reset(kind(32.0), kind(1.0))
    assert (tip.state().measured_deg, tip.state().command) == (32.0, 1.0)


@pytest.mark.parametrize("value", [*NO_NUMBERS, *ODD_NUMBERS, None])
def test_a_controller_of_its_own_starts_at_numbers_alone(value: Any) -> None:
    controller = build_controller(parse_controller({"kind": "pid"}, "controller"), PLAY.predictor, PLAY.inverse, LIMITS)
    refused(lambda: controller.init(value, 0.0))
    refused(lambda: controller.init(PLAY.y_rest, value))
    command, _ = controller.step(controller.init(PLAY.y_rest, 0.0), value, value)
    assert command.u == 0.0


def test_files_of_results_are_named_by_a_path(tmp_path: Path) -> None:
    for value in [None, 3, [], object(), tmp_path / "no" / "such.html"]:
        refused(lambda value=value: Evaluation(()).report(value))


WRONG: list[Any] = [None, 3, [], [1], {"a": 1}, {1: 2}, object(), b"x", math.nan, [[1], [1, 2]], Path(), "no/such"]
FACE: dict[str, Callable[[Any, Path], Any]] = {
    "from_config": lambda x, out: TipController.from_config(x),
    "load_model": lambda x, out: hystmpc.load_model(x),
    "simulator of a file": lambda x, out: hystmpc.load_model(x).simulator,
    "read_trials": lambda x, out: hystmpc.read_trials(x),
    "check": lambda x, out: hystmpc.check(x),
    "fit kind": lambda x, out: hystmpc.fit(x, []),
    "fit trials": lambda x, out: hystmpc.fit("pi", x),
    "evaluate model": lambda x, out: hystmpc.evaluate(x, []),
    "evaluate trials": lambda x, out: hystmpc.evaluate("builtin:pi", x),
    "export": lambda x, out: hystmpc.export(x, out / "model.onnx"),
    "diagnose trials": lambda x, out: hystmpc.diagnose(x, "builtin:pi"),
    "diagnose model": lambda x, out: hystmpc.diagnose([], x),
    "commission": lambda x, out: hystmpc.commission(x, out / "c"),
    "commission logs": lambda x, out: hystmpc.commission(None, out / "c", logs=x),
    "investigate": lambda x, out: hystmpc.investigate(x, out / "i"),
    "simulate": lambda x, out: hystmpc.simulate(x),
    "tune": lambda x, out: hystmpc.tune(x, out / "t"),
    "controller": lambda x, out: hystmpc.build_controller(x, "builtin:pi"),
    "controller of a model": lambda x, out: hystmpc.build_controller("pid", x),
    "least command": lambda x, out: hystmpc.Limits(x if x != 3 else "3", 6.0, 10.0),
    "greatest command": lambda x, out: hystmpc.Limits(0.0, x if x != 3 else "3", 10.0),
    "rate": lambda x, out: hystmpc.Limits(0.0, 6.0, x if x != 3 else True),
}


@pytest.mark.parametrize("name", FACE)
def test_every_function_of_the_package_refuses_a_wrong_type_in_a_line(name: str, tmp_path: Path) -> None:
    for value in WRONG:
        refused(lambda value=value: FACE[name](value, tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_what_python_says_of_a_wrong_type_is_the_cause() -> None:
    with pytest.raises(
        ConfigError, match=r"^simulate: got \(3\), expected what help\(hystmpc.simulate\) says"
    ) as caught:
        hystmpc.simulate(3)  # type: ignore[arg-type]  # on purpose
    assert isinstance(caught.value.__cause__, AttributeError)
