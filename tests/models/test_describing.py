"""Describing functions: closed forms against settled cycles and python-control, and its idioms on our subclasses."""

from __future__ import annotations

import inspect

import control
import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.linear.describing import closed_form, of_play, settled_cycle, whole_cycle
from hystmpc.models.linear.nonlinearities import OperatorNonlinearity, SettledNonlinearity
from hystmpc.models.model import Predictor
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.friction import MaxwellSlip
from hystmpc.models.operators.hysteresis import Backlash, BoucWen, Play, Stop
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.operators.static_curves import Deadband, Line
from hystmpc.models.prediction.build import predictor_for
from hystmpc.models.simulator import ChainModel, Identification, Simulator
from hystmpc.trials.errors import ModelError

from .zoo import DT

OPERATORS = [
    (Play(1.0), 0.0),
    (Stop(0.7), 0.4),
    (Line(3.0, 2.0), 1.0),
    (Backlash(10.0, 11.0, 3.2, 2.0), 3.0),
    (Backlash(10.0, 10.0, 2.4, 2.0), 3.0),
    (PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5), 0.3, 0.0, 22.0), 3.0),
    (MaxwellSlip(2.0, (3.0, 1.0), 0.09, 0.05, 1.0), 2.0),
    (Deadband(2.0, (0.5, 3.0), (0.01, 1.0), (0.3, 0.8), (0.5, 0.4), 1.0, 4.0), 0.7),
]
AMPLITUDES = np.array([0.2, 0.55, 1.001, 1.7, 4.0])
by_name = pytest.mark.parametrize(("operator", "centre"), OPERATORS, ids=lambda value: getattr(value, "name", ""))


def simulator(*before: Operator, core: Operator, after: tuple[Operator, ...] = ()) -> Simulator:
    """A device of these operators, 0 to 6 mm."""
    wide = Range(lower=0.0, upper=6.0)
    return Simulator(
        Chain(core, before, after), DT, "mm", wide, 100.0, wide, Range(lower=0.0, upper=90.0), 100.0,
        Identification(method="chosen by hand"),
    )  # fmt: skip


def predictor(*before: Operator, core: Operator, after: tuple[Operator, ...] = ()) -> Predictor:
    """Its compiled predictor."""
    return predictor_for(ChainModel(simulator(*before, core=core, after=after), "conditioned"))


@by_name
def test_closed_form_is_the_limit_of_settled_cycles(operator: Operator, centre: float) -> None:
    """With n samples a period a cycle with kinks is off by some n^-2: the difference at 60,000 is far below 1e-6."""
    closed = closed_form(operator, AMPLITUDES, centre)
    cycle = settled_cycle(predictor(core=operator), centre, AMPLITUDES, 60_000)
    assert closed is not None
    assert np.all(cycle.settled)
    np.testing.assert_allclose(closed, cycle.first, rtol=0.0, atol=1e-6)


def test_a_play_is_the_librarys_backlash_of_twice_its_half_width() -> None:
    library = control.friction_backlash_nonlinearity(2.0)
    np.testing.assert_allclose(of_play(AMPLITUDES, 1.0), [library.describing_function(a) for a in AMPLITUDES])


@pytest.mark.parametrize("amplitudes", [np.array([1.2, 3.0, 9.0]), np.array([9.0, 3.0, 1.2])])
def test_the_librarys_numeric_routine_is_off_where_the_closed_form_is_not(amplitudes: np.ndarray) -> None:
    """It goes through one cycle of the smallest amplitude first, so that later amplitudes begin with a transient."""
    ours = OperatorNonlinearity(Play(1.0))
    numeric = control.describing_function(ours, amplitudes, num_points=2000, try_method=False)
    exact = control.describing_function(ours, amplitudes)
    np.testing.assert_array_equal(exact, of_play(amplitudes, 1.0))
    assert np.max(np.abs(numeric - exact) / np.abs(exact)) > 0.01


def test_a_stop_and_a_play_add_up_to_the_identity() -> None:
    one, two = (closed_form(o, AMPLITUDES) for o in (Play(0.7), Stop(0.7)))
    np.testing.assert_allclose(np.asarray(one) + np.asarray(two), 1.0, atol=1e-15)


def test_of_a_linear_chain_it_is_the_frequency_response() -> None:
    chain = simulator(Lag(0.1), Delay(1.5 * DT, 2), core=Line(5.0, 1.0), after=(Lag(0.3),))
    samples, periods = whole_cycle(7.3 * DT)
    omega = 2.0 * np.pi * periods / (samples * DT)
    response = chain.to_control().linearize(np.zeros(6), [0.0])(np.exp(1j * omega * DT)) * np.exp(1j * omega * DT)
    cycle = settled_cycle(predictor_for(ChainModel(chain)), 3.0, np.array([0.5, 2.0]), samples, periods)
    assert abs(omega / 7.3 - 1.0) < 0.02
    np.testing.assert_allclose(cycle.first, response, rtol=1e-6)
    assert np.all(cycle.third < 1e-9)


def test_of_a_drive_before_a_play_it_is_a_product() -> None:
    """N(A, omega) = G(omega) N_play(|G| A), with G from python-control."""
    samples = 2000
    drive = control.ss(*_matrices(Lag(0.4)), DT)
    g = drive(np.exp(2j * np.pi / samples))
    cycle = settled_cycle(predictor(Lag(0.4), core=Play(0.5)), 3.0, AMPLITUDES, samples)
    np.testing.assert_allclose(cycle.first, g * of_play(np.abs(g) * AMPLITUDES, 0.5), atol=1e-5)


def _matrices(operator: Operator) -> tuple[np.ndarray, ...]:
    from hystmpc.models.linear.systems import linear_part

    part = linear_part(operator, DT)
    assert part is not None
    return part


def test_bouc_wen_tends_to_its_slope_for_great_amplitudes() -> None:
    bouc_wen = predictor(core=BoucWen(-4.0, 0.0, 2.0, 8.0, 8.0, 0.0, 20.0))
    values = [SettledNonlinearity(bouc_wen, 0.0).describing_function(a) for a in (0.01, 50.0)]
    assert values[0] == pytest.approx(8.0 - 4.0, rel=0.02)
    assert values[1].real == pytest.approx(8.0, rel=0.01)
    assert values[1].imag < 0


def test_where_the_rate_matters_the_frequency_does() -> None:
    model = predictor(core=PrandtlIshlinskii(3.0, (2.5, 2.0), 0.2, 0.05, 22.0))
    slow, fast = (SettledNonlinearity(model, 3.0, omega).describing_function(1.0) for omega in (0.5, 20.0))
    assert abs(np.angle(fast)) > 1.2 * abs(np.angle(slow))


def test_the_librarys_plot_and_response_find_the_limit_cycle(tmp_path: object) -> None:
    loop = control.tf([6.0], [2.0, 1.0, 0.0])  # integral control of a play behind a lag
    amplitudes = np.geomspace(1.05, 30.0, 80)
    response = control.describing_function_response(loop, OperatorNonlinearity(Play(1.0)), amplitudes)
    assert len(response.intersections) >= 1
    for amplitude, omega in response.intersections:
        assert loop(1j * omega) * of_play(np.array([amplitude]), 1.0)[0] == pytest.approx(-1.0, abs=1e-3)
    drawn = control.describing_function_plot(loop, OperatorNonlinearity(Play(1.0)), amplitudes)
    assert len(drawn.lines[1]) == 1


@pytest.mark.parametrize("kind", [OperatorNonlinearity, SettledNonlinearity])
def test_docstrings_name_every_parameter_as_the_library_asks(kind: type) -> None:
    """The check of python-control's own suite: each parameter stands in the numpy section of its docstring."""
    assert issubclass(kind, control.DescribingFunctionNonlinearity)
    for member in (kind, kind.__call__, kind.describing_function):
        names = [name for name in inspect.signature(member).parameters if name != "self"]
        section = (inspect.getdoc(member) or "").partition("Parameters\n----------\n")[2]
        assert [name for name in names if f"{name} : " not in section] == []
        assert member is kind or "Returns\n-------" in (inspect.getdoc(member) or "")


@pytest.mark.parametrize("arguments", [(OperatorNonlinearity, Play(1.0)), (SettledNonlinearity, None, 3.0)])
def test_unknown_keywords_are_refused(arguments: tuple[type, object]) -> None:
    kind, *given = arguments
    with pytest.raises(TypeError, match="unexpected keyword"):
        kind(*given, unknown=None)


def test_what_python_controls_suite_asks_of_a_nonlinearity() -> None:
    play = OperatorNonlinearity(Play(1.0))
    assert [play(x) for x in (0, 1, 2, 1, 0, -1)] == pytest.approx([0, 0, 1, 1, 1, 0])
    assert not play._isstatic()
    assert OperatorNonlinearity(Line(2.0, 1.0))._isstatic()
    assert OperatorNonlinearity(Line(2.0, 1.0))(0.0) == 0.0
    with pytest.raises(ModelError, match="expected 0 or more"):
        play.describing_function(-1.0)
    with pytest.raises(ModelError, match="has no closed form here"):
        OperatorNonlinearity(BoucWen(-4.0, 0.0, 2.0, 8.0, 8.0, 0.0, 20.0))


def test_impossible_cycles_are_refused() -> None:
    model = predictor(core=Play(1.0))
    with pytest.raises(ModelError, match="expected amplitudes above 0"):
        settled_cycle(model, 3.0, np.array([0.0]), 10)
    with pytest.raises(ModelError, match="rad per sample"):
        whole_cycle(3.0)
