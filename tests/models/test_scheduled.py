"""Parameters that depend on measured inputs: one equation in all forms, within bounds at any value of the input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.models.chain import Chain, chain_from, chain_spec
from hystmpc.models.evaluate import free_run
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.load import load_model
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.static_curves import Line
from hystmpc.models.scheduled import GROUPS, Dependence, MeasuredInput, Scheduled, members
from hystmpc.models.simulator import ChainModel, export_simulator, load_simulator, save_simulator
from hystmpc.trials.errors import ModelError

from .zoo import BACKLASH, CHAINS, DT, EXAMPLES, PRESSURE, RATE_PI, simulator

CHAIN = CHAINS["pi by two inputs"]
T = np.arange(0.0, 6.0, DT)
COMMANDS = 3.0 - 3.0 * np.cos(2 * np.pi * 0.37 * T) + 0.01 * np.sin(T)
ALONG = {"pressure_bar": 3.0 + 3.5 * np.sin(0.9 * T), "load_g": 60.0 * np.abs(np.sin(0.4 * T))}
OPERATORS = [*EXAMPLES, Lag(0.1), Lag(0.1, (0.2,)), Line(2.0, 1.0)]
KEEP = settings(deadline=None, max_examples=60, derandomize=True)


def groups_of(operator: Operator) -> list[str]:
    return [group for group in GROUPS if members(operator, group)]


def effective(operator: Scheduled, z: float) -> Operator:
    """The operator inside with its parameters at z, written again in plain numbers."""
    p = np.asarray(operator.effective(np.array(operator.values), np.array([z])), dtype=np.float64).ravel()
    return operator.operator.with_values(p.tolist())


@st.composite
def scheduled(draw: Any) -> Scheduled:
    operator = draw(st.sampled_from([o for o in OPERATORS if groups_of(o)]))
    low, width = draw(st.floats(-1e3, 1e3)), draw(st.floats(0.1, 1e3))
    known = MeasuredInput("z", low + draw(st.sampled_from([0.0, 0.3, 1.0])) * width, low, low + width)
    groups = draw(st.lists(st.sampled_from(groups_of(operator)), min_size=1, unique=True))
    dependences = [Dependence(known, group, draw(st.booleans())) for group in groups]
    ends = [e for d in dependences for e in d.bounds]
    slopes = [draw(st.floats(low, high)) for low, high in ends]
    return Scheduled.of(operator, dependences, slopes)


@KEEP
@given(scheduled(), st.one_of(st.floats(-1e9, 1e9), st.sampled_from([-np.inf, np.inf])))
def test_no_parameter_leaves_its_bounds_at_any_value_of_an_input(operator: Scheduled, z: float) -> None:
    inside = effective(operator, z)  # refuses what is out of bounds
    if isinstance(inside, Backlash):
        before, after = operator.operator.values, inside.values
        assert (after[2] - after[3]) * (before[2] - before[3]) >= 0  # its lines do not cross
    for p, value, was in zip(inside.parameters, inside.values, operator.operator.values, strict=True):
        assert value * was >= 0 or p.unit in ("deg", "cmd")


@KEEP
@given(scheduled(), st.floats(-2e3, 2e3))
def test_at_a_constant_input_it_is_the_operator_with_other_parameters(operator: Scheduled, z: float) -> None:
    plain, chain = Chain(effective(operator, z)), Chain(operator)
    known, values = {"z": np.full((T.size, 1), z)}, {"z": np.array([z])}
    start = StagedChain(plain).settled(COMMANDS[:1], np.array([40.0]), DT)[0]
    state = StagedChain(chain).settled(COMMANDS[:1], np.array([40.0]), DT, inputs=values)[0]
    np.testing.assert_allclose(state[: len(plain.core.states)], start, rtol=1e-9, atol=1e-9)
    expected = StagedChain(plain).simulate(COMMANDS[:, None], DT, start)[0]
    got = StagedChain(chain).simulate(COMMANDS[:, None], DT, state, inputs=known)[0]
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-6)


def test_at_its_reference_it_is_the_operator_itself() -> None:
    plain = Chain(RATE_PI, before=CHAIN.before[:1])
    chain = replace(CHAIN, before=CHAIN.before[:1])
    start, state = (StagedChain(c).settled(COMMANDS[:1], np.array([40.0]), DT)[0] for c in (plain, chain))
    expected, got = (StagedChain(c).simulate(COMMANDS[:, None], DT, x)[0] for c, x in ((plain, start), (chain, state)))
    np.testing.assert_array_equal(got, expected)


def test_signals_and_states_that_follow_them_are_one() -> None:
    staged = StagedChain(CHAIN)
    first = {name: z[:1] for name, z in ALONG.items()}
    state = staged.settled(COMMANDS[:1], np.array([40.0]), DT, inputs=first)[0]
    driven, _ = staged.simulate(COMMANDS[:, None], DT, state, inputs={n: z[:, None] for n, z in ALONG.items()})
    model = ChainModel(simulator(CHAIN))
    held = free_run(model, COMMANDS, 40.0, ALONG)
    np.testing.assert_allclose(driven[:, 0], held, atol=1e-9)
    assert np.ptp(held - free_run(model, COMMANDS, 40.0)) > 1.0


def test_sensitivities_are_those_of_differences_while_the_inputs_change() -> None:
    staged, p = StagedChain(CHAIN), CHAIN.values * 1.0137 + 1e-4
    state = np.full((CHAIN.state_size, 1), 31.0)
    still = np.zeros((CHAIN.state_size, 1, p.size))

    def run(values: np.ndarray) -> np.ndarray:
        along = {name: z[:, None] for name, z in ALONG.items()}
        return staged.simulate(COMMANDS[:, None], DT, state, values, along)[0][:, 0]

    theta, gradient = staged.differentiate(COMMANDS, DT, state, still, p, inputs=ALONG)
    np.testing.assert_allclose(theta, run(p), atol=1e-10)
    for j in range(p.size):
        step = 1e-7 * np.eye(p.size)[j]
        difference = (run(p + step) - run(p - step)) / 2e-7
        assert np.quantile(np.abs(difference - gradient[:, j]), 0.9) <= 1e-5 * max(1.0, np.abs(difference).max())


def test_an_exported_model_measures_its_inputs(tmp_path: Path) -> None:
    model = ChainModel(simulator(CHAIN))
    export_simulator(model.simulator, tmp_path / "m.onnx")
    opened = load_model(tmp_path / "m.onnx")
    assert [i.name for i in opened.inputs] == ["load_g", "pressure_bar"]
    np.testing.assert_allclose(
        free_run(opened, COMMANDS, 40.0, ALONG), free_run(model, COMMANDS, 40.0, ALONG), atol=1e-6
    )


def test_a_file_says_what_depends_on_what_and_one_without_inputs_is_as_before(tmp_path: Path) -> None:
    file = save_simulator(simulator(CHAIN), tmp_path / "m.yaml")
    assert load_simulator(file).chain == CHAIN
    assert chain_spec(CHAIN)["core"]["depends_on"]["pressure_bar"] == {
        "reference": 3.0,
        "lower": 1.0,
        "upper": 7.0,
        "friction": 0.25,
        "gain": [0.1, -0.05],
    }
    plain = save_simulator(simulator(Chain(BACKLASH)), tmp_path / "plain.yaml").read_text()
    assert "depends_on" not in plain
    assert "inputs" not in plain


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"p": {"reference": 1, "lower": 0, "upper": 2, "fricton": 0.1}}, "did you mean 'friction'"),
        ({"p": {"reference": 1, "lower": 0, "upper": 2, "time": 0.1}}, "no time that could depend"),
        ({"p": {"reference": 1, "lower": 0, "upper": 2, "friction": -1.5}}, "friction_per_p is -1.5"),
        ({"p": {"reference": 3, "lower": 0, "upper": 2, "friction": 0.1}}, "lower <= reference"),
        ({"p": {"reference": 1, "lower": 0, "friction": 0.1}}, "expected numbers reference, lower, upper"),
        ({"p": {"reference": 1, "lower": 0, "upper": 2, "friction": [0.1, 0.1, 0.1]}}, "a slope, or two"),
        ({"p": {"reference": 1, "lower": 0, "upper": 2, "friction": "much"}}, "a slope, or two"),
        ([], "expected a block"),
        ({}, "expected a block"),
    ],
)
def test_a_wrong_block_is_one_line(change: Any, words: str) -> None:
    spec = chain_spec(CHAINS["pi"])
    spec["core"] = {**spec["core"], "depends_on": change}
    with pytest.raises(ModelError, match=words) as refused:
        chain_from(spec, "m.yaml: chain")
    assert len(str(refused.value)) <= 300
    assert "\n" not in str(refused.value)


def test_one_input_has_one_range_in_a_chain() -> None:
    other = Scheduled.of(Lag(0.1), (Dependence(replace(PRESSURE, upper=8.0), "time"),))
    with pytest.raises(ModelError, match="two ranges"):
        _ = replace(CHAIN, before=(other,)).inputs


def test_a_trial_without_the_input_is_refused_where_others_are_given() -> None:
    staged = StagedChain(CHAIN)
    with pytest.raises(ModelError, match="input load_g: not among"):
        staged.simulate(
            COMMANDS[:, None], DT, np.zeros((CHAIN.state_size, 1)), inputs={"pressure_bar": COMMANDS[:, None]}
        )
