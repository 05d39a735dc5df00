"""`fit auto` with measured inputs: what depends on them is identified, and nothing where they say nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hystmpc.models.evaluate import evaluate
from hystmpc.models.identify.chain_kinds import CHAIN_KINDS
from hystmpc.models.identify.runs import fingerprint
from hystmpc.models.kinds.kind import FitRequest, Identified
from hystmpc.models.kinds.operator_kinds import AutoKind, OperatorKind
from hystmpc.models.scheduled import Scheduled
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.errors import FitError, LogError
from hystmpc.trials.trial import Trial, Units

DT = 0.04
T = np.arange(0.0, 16.0, DT)
LEVELS = (1.0, 1.4, 2.0)


def command(k: int) -> np.ndarray:
    return 3.0 - 2.8 * np.cos(2 * np.pi * (0.11 + 0.05 * k) * T) * (1.0 - 0.5 * T / T[-1])


def device(u: np.ndarray, z: np.ndarray, width: float = 0.25) -> np.ndarray:
    """Three plays whose half-widths grow with z, and a bend with the command: no single operator."""
    states, y = np.full(3, u[0]), np.empty(u.size)
    for k in range(u.size):
        r = width * z[k] * np.array([0.5, 1.0, 1.5])
        states = np.maximum(u[k] - r, np.minimum(u[k] + r, states))
        y[k] = 20.0 + 4.0 * u[k] + float(states @ [3.0, 2.0, 2.0])
    return y


def trials(z_of: Callable[[int], np.ndarray], offset: float = 0.0, seed: int = 1) -> list[Trial]:
    made, rng = [], np.random.default_rng(seed)
    for k in range(len(LEVELS)):
        u, z = command(k), z_of(k)
        y = device(u, z) + offset * z + 0.05 * rng.standard_normal(T.size)
        made.append(Trial(T, u, y, units=Units("mm", "deg"), source=f"trial {k}", inputs={"bar": z}))
    return made


def level(k: int) -> np.ndarray:
    return np.full(T.size, LEVELS[k])


def fitted(seen: list[Trial]) -> Identified:
    return AutoKind().fit(seen, FitRequest())


def slope(fit: Identified, group: str) -> float:
    assert fit.parts is not None
    return next((r.value for r in fit.parts.parameters if r.owner == f"{group}_by_bar"), 0.0)


def rmse(fit: Identified, z: float) -> float:
    assert fit.simulator is not None
    (trial, *_) = trials(lambda k: np.full(T.size, z), seed=9)
    return evaluate(ChainModel(fit.simulator), trial).errors.rmse_deg


@pytest.fixture(scope="module")
def by_friction() -> Identified:
    return fitted(trials(level))


def test_friction_that_grows_with_an_input_is_identified_and_holds_between_its_values(by_friction: Identified) -> None:
    assert by_friction.simulator is not None
    core = by_friction.simulator.chain.core
    assert isinstance(core, Scheduled)
    # half-widths are proportional to z: 1 + s (z - z_0) with s = 1 / z_0
    assert slope(by_friction, "friction") == pytest.approx(1.0 / core.inputs[0].reference, rel=0.1)
    assert rmse(by_friction, 1.7) < 0.12  # of a sensor with 0.05 deg
    assert rmse(by_friction, 1.2) < 0.12


@pytest.mark.slow
def test_the_model_is_never_worse_than_without_the_input(by_friction: Identified) -> None:
    plain = fitted([trial.with_inputs([]) for trial in trials(level)])
    assert by_friction.parts is not None
    assert plain.parts is not None
    assert by_friction.parts.choice.rmse_deg <= plain.parts.choice.rmse_deg
    assert rmse(by_friction, 1.7) < 0.5 * rmse(plain, 1.7)


@pytest.mark.slow
def test_an_input_that_hardly_varies_is_named_and_changes_nothing() -> None:
    seen = trials(lambda k: 3.0 + 0.01 * np.sin(T))
    fit, plain = fitted(seen), fitted([trial.with_inputs([]) for trial in seen])
    assert fit.parts is not None
    assert any(line.startswith("bar: not determined: the input hardly varies") for line in fit.parts.advice)
    assert fit.simulator is not None
    assert plain.simulator is not None
    assert not fit.simulator.chain.inputs
    np.testing.assert_array_equal(fit.simulator.chain.values, plain.simulator.chain.values)


@pytest.mark.slow
def test_an_offset_by_an_input_is_one_also_beside_sensors_that_were_zeroed_anew() -> None:
    seen = [
        Trial(t.t, t.command, t.angle + zero, units=t.units, source=t.source, inputs=t.inputs)
        for t, zero in zip(trials(level, offset=60.0), (0.4, -0.5, 0.2), strict=True)
    ]
    fit = fitted(seen)
    assert slope(fit, "offset") == pytest.approx(60.0, abs=4.0)


@pytest.mark.slow
def test_an_input_without_effect_is_left_out_and_said() -> None:
    rng = np.random.default_rng(5)
    seen = [
        Trial(t.t, t.command, t.angle, units=t.units, source=t.source, inputs={"bar": rng.uniform(1.0, 2.0) + 0.0 * T})
        for t in trials(lambda k: np.full(T.size, 1.3))
    ]
    fit = fitted(seen)
    assert fit.simulator is not None
    assert fit.parts is not None
    assert not fit.simulator.chain.inputs
    assert "bar: no dependence on it lowers the error on trials left out" in fit.parts.advice


def test_an_evaluation_needs_the_input_of_the_log(by_friction: Identified) -> None:
    assert by_friction.simulator is not None
    with pytest.raises(LogError, match="no input 'bar'"):
        evaluate(ChainModel(by_friction.simulator), trials(level)[0].select(0).with_signals(np.asarray, inputs={}))


def test_other_kinds_refuse_an_input_in_one_line() -> None:
    with pytest.raises(FitError, match="backlash: got the input bar, expected none; `auto` takes it"):
        OperatorKind(CHAIN_KINDS["backlash"]).check(trials(level), FitRequest())


def test_the_fingerprint_of_trials_has_their_inputs() -> None:
    seen, other = trials(level), trials(level)
    assert fingerprint(seen) == fingerprint(other)
    assert fingerprint(seen) != fingerprint([t.with_signals(np.asarray, inputs={"bar": 2 * level(0)}) for t in other])
    assert fingerprint([t.with_inputs([]) for t in seen]) != fingerprint(seen)
