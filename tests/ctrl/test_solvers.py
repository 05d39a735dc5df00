"""Two solvers, and two routes to the linearisation: one result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl.command import CommandLimits, Source, Stopwatch, attempt
from hystmpc.ctrl.estimation.observer import EstimatorSettings, OutputEstimator
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.law import FallbackSettings
from hystmpc.ctrl.linearised.planner import LinearisedPlanner, TrackingQp
from hystmpc.ctrl.linearised.qp import (
    ActiveSetOptions,
    OsqpOptions,
    OsqpSolver,
    QpData,
    QpPattern,
    QpSolver,
)
from hystmpc.ctrl.mpc import PlanningError, PredictiveLaw
from hystmpc.ctrl.mpc_settings import HoldSettings, LinearisedMpcSettings, WeightsSettings
from hystmpc.models.inverse.inverses import AccompaniedPredictor
from hystmpc.models.load import library_file, load_model
from hystmpc.models.model import Inverse, LoadedModel, Predictor
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel

from ..models.casadi_predictor import CasadiPredictor
from .plays import DT, SOUND, Case, Faulty
from .test_linearised import HARD, LIMITS, SOFT, H, mpc, posed

Options = OsqpOptions | ActiveSetOptions
FINE = OsqpOptions(eps=1e-6, iterations=2000)  # the default of 1e-5 leaves up to 1e-3 mm
TIGHT = OsqpOptions(eps=1e-9, iterations=20_000)
DEVICE = CommandLimits(0.0, 6.0, 12.0)


def program(case: Case, weights: WeightsSettings, seed: int, horizon: int = H) -> tuple[TrackingQp, QpData]:
    problem, start = posed(case, horizon, seed)
    qp = TrackingQp(weights, LIMITS, horizon, DT)
    return qp, qp.data(problem, start, case.predictor.linearise(problem.state, start.commands)[1])


ONE_SIDED = SOFT.model_copy(update={"angle_lower_deg": None})


@pytest.mark.slow
@pytest.mark.parametrize("weights", [HARD, SOFT, ONE_SIDED], ids=["hard", "soft", "one-sided"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("horizon", [1, H, 20])
def test_both_solve_one_program_alike(weights: WeightsSettings, case: Case, horizon: int) -> None:
    for seed in range(5):
        qp, data = program(case, weights, seed, horizon)
        exact = ActiveSetOptions().solver(qp.pattern).solve(data)
        iterated = OsqpSolver(qp.pattern, TIGHT).solve(data)
        assert exact.status == "solved"
        assert iterated.status in ("solved", "solved inaccurate")  # within ten times 1e-9
        np.testing.assert_allclose(exact.primal[:horizon], iterated.primal[:horizon], atol=1e-6)


def test_the_exact_solver_leaves_its_data_alone_and_answers_equally_whatever_came_before() -> None:
    qp, _ = program(SOUND[0], SOFT, 0)
    solver, data = (
        ActiveSetOptions().solver(qp.pattern),
        [program(SOUND[0], SOFT, seed)[1] for seed in range(4)],
    )
    copies = [np.concatenate([d.hessian.ravel(), d.gradient, d.lower, d.upper]) for d in data]
    first = [solver.solve(d).primal for d in data]
    backwards = [solver.solve(d).primal for d in data[::-1]][::-1]
    np.testing.assert_array_equal(first, backwards)
    for d, copy in zip(data, copies, strict=True):
        np.testing.assert_array_equal(np.concatenate([d.hessian.ravel(), d.gradient, d.lower, d.upper]), copy)


SOLVERS: dict[str, Callable[[QpPattern], QpSolver]] = {
    "OSQP": OsqpOptions().solver,
    "active set": ActiveSetOptions().solver,
}


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("spoilt", ["crossed", "gradient", "hessian", "nan"])
def test_a_solver_that_failed_is_as_good_as_new(name: str, weights: WeightsSettings, spoilt: str) -> None:
    qp, data = program(SOUND[0], weights, 0)
    solver = SOLVERS[name](qp.pattern)
    good = solver.solve(data)
    bad = {
        "crossed": replace(data, lower=data.lower + 10.0, upper=data.lower + 10.0),
        "gradient": replace(data, gradient=np.full_like(data.gradient, np.nan)),
        "hessian": replace(data, hessian=np.full_like(data.hessian, np.inf)),
        "nan": replace(data, hessian=np.full_like(data.hessian, np.nan)),
    }[spoilt]
    for _ in range(2):
        solution, _ = attempt(lambda: solver.solve(bad))  # a solver's own exception counts as a failure as well
        assert solution is None or not solution.usable
    np.testing.assert_array_equal(solver.solve(data).primal, good.primal)


def test_the_exact_solver_stops_after_its_changes() -> None:
    qp, data = program(SOUND[0], SOFT, 1)
    needed = ActiveSetOptions().solver(qp.pattern).solve(data).iterations
    assert needed > 1
    for changes in range(needed + 1):
        stopped = ActiveSetOptions(changes).solver(qp.pattern).solve(data)
        assert (stopped.usable, stopped.unfinished) == (changes == needed, changes < needed)


def test_a_program_that_overflows_is_a_planning_error() -> None:
    case = SOUND[1]
    problem, start = posed(case)
    planner = LinearisedPlanner(Faulty(case.predictor, lambda value: 1e200 * value, -1.0), mpc(HARD, H), LIMITS)
    with np.errstate(all="ignore"), pytest.raises(PlanningError, match="program is not finite"):
        planner.improve(problem, start, None, Stopwatch())


def controller_for(
    predictor: Predictor, inverse: Inverse, options: Options, blocks: tuple[int, ...] | None = None
) -> GuardedController[Any]:
    """A linearised controller whose holds are not shortened by the hold rule."""
    settings = LinearisedMpcSettings(move_blocking=blocks, hold=HoldSettings(tolerance_deg=0.0))
    law = PredictiveLaw(predictor, inverse, DEVICE, LinearisedPlanner(predictor, settings, DEVICE, options), settings)
    return GuardedController(
        law,
        OutputEstimator(predictor, EstimatorSettings()),
        FallbackChain(DEVICE, FallbackSettings(), inverse),
        DEVICE,
        DT,
    )


def compared(
    leader: GuardedController[Any], other: GuardedController[Any], y: float, u: float, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Commands along a scan and a hold on the leader's own model, and what the other says in the same states.

    Not-a-number where the other ran out of iterations.
    """
    state, commands, others = leader.init(y, u), [], []
    random = np.random.default_rng(1)
    wanted = y + np.minimum(15.0 * (1 - np.cos(0.1 * np.arange(steps + 30))), 25.0)
    for k in range(steps):
        angle = state.estimate.angles[0] + state.estimate.disturbance + 0.05 * random.standard_normal()
        preview = wanted[k + 1 : k + 21]
        answer, _ = other.step(state, angle, preview)
        command, state = leader.step(state, angle, preview)
        assert command.source is Source.MPC
        commands.append(command.u)
        others.append(answer.u if answer.status == command.status else np.nan)
    return np.array(commands), np.array(others)


@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize(("osqp", "tolerance"), [(FINE, 1e-4), (TIGHT, 1e-6)], ids=["fine", "tight"])
def test_both_solvers_give_the_same_commands(case: Case, osqp: OsqpOptions, tolerance: float) -> None:
    exact = controller_for(case.predictor, case.inverse, ActiveSetOptions())
    iterated = controller_for(case.predictor, case.inverse, osqp)
    ours, theirs = compared(exact, iterated, case.y_rest, case.u_rest, 60)
    solved = np.isfinite(theirs)
    assert solved.mean() > 0.9  # OSQP may run out of iterations
    assert np.ptp(ours) > 1.0
    np.testing.assert_allclose(theirs[solved], ours[solved], atol=tolerance)


def reference_route(model: LoadedModel) -> tuple[Predictor, Predictor, Inverse]:
    """The compiled route, the route through CasADi's own derivatives with the same state, and their inverse."""
    compiled, inverse = controller_model(model).predictive
    slow = CasadiPredictor(model.casadi_function(), model.metadata)
    if isinstance(model, ChainModel):
        return compiled, slow, inverse
    assert isinstance(compiled, AccompaniedPredictor)
    return compiled, AccompaniedPredictor(slow, compiled.companion), inverse


# Compiled operators run in double precision, compiled networks in single: 1e-7 of 85 deg over 10 deg/mm, and amplified
# by the weight of the error against that of a move.
@pytest.mark.parametrize(
    ("name", "tolerance"),
    [("backlash", 1e-6), ("pi", 1e-6), pytest.param("lstm", 5e-6, marks=pytest.mark.slow)],
)
def test_two_routes_give_one_command(name: str, tolerance: float) -> None:
    model = load_model(library_file(name), start="conditioned")
    compiled, reference, inverse = reference_route(model)
    fast, slow = (controller_for(route, inverse, ActiveSetOptions()) for route in (compiled, reference))
    ours, theirs = compared(fast, slow, 30.0, 0.0, 8 if name == "lstm" else 40)
    np.testing.assert_allclose(theirs, ours, atol=tolerance)
    assert np.ptp(ours) > 0.5
