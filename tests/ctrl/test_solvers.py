"""Two solvers, and two routes to the linearisation: one result."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Timer
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl import problem
from hystmpc.ctrl.command import CommandLimits, Source, attempt
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.law_tables import law_over
from hystmpc.ctrl.linearised.program import IterativeSolution, PlanProgram
from hystmpc.ctrl.linearised.qp import OsqpOptions, OsqpSolver, QpData, QpPattern, QpSolution
from hystmpc.ctrl.mpc_settings import HoldSettings, LinearisedMpcSettings, WeightsSettings
from hystmpc.models.inverse.inverses import AccompaniedPredictor
from hystmpc.models.load import library_file, load_model
from hystmpc.models.model import Inverse, LoadedModel, Predictor
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel

from ..models.casadi_predictor import CasadiPredictor
from .planners import LIMITS, Planner, exact, posed
from .plays import DT, LINEAR, SOUND, Case, Faulty
from .test_linearised import HARD, SOFT, H, mpc

FINE = OsqpOptions(eps=1e-6, iterations=2000)  # the default of 1e-5 leaves up to 1e-3 mm
TIGHT = OsqpOptions(eps=1e-9, iterations=20_000)
DEVICE = CommandLimits(0.0, 6.0, 12.0)


def program(case: Case, weights: WeightsSettings, seed: int, horizon: int = H) -> tuple[QpPattern, QpData]:
    around = PlanProgram(law_over(weights, horizon, LIMITS, DT))
    return around.pattern, posed(case, horizon, seed).program(around, case.predictor)


ONE_SIDED = SOFT.model_copy(update={"angle_lower_deg": None})


@pytest.mark.slow
@pytest.mark.parametrize("weights", [HARD, SOFT, ONE_SIDED], ids=["hard", "soft", "one-sided"])
@pytest.mark.parametrize("case", SOUND, ids=lambda c: c.name)
@pytest.mark.parametrize("horizon", [1, H, 20])
def test_both_solve_one_program_alike(weights: WeightsSettings, case: Case, horizon: int) -> None:
    for seed in range(5):
        pattern, data = program(case, weights, seed, horizon)
        ours, iterated = exact(data), OsqpSolver(pattern, TIGHT).solve(data)
        assert ours.status == "solved"
        assert iterated.status in ("solved", "solved inaccurate")  # within ten times 1e-9
        np.testing.assert_allclose(ours.primal[:horizon], iterated.primal[:horizon], atol=1e-6)


def test_the_exact_solver_leaves_its_data_alone_and_answers_equally_whatever_came_before() -> None:
    data = [program(SOUND[0], SOFT, seed)[1] for seed in range(4)]
    copies = [np.concatenate([d.hessian.ravel(), d.gradient, d.lower, d.upper]) for d in data]
    first = [exact(d).primal for d in data]
    backwards = [exact(d).primal for d in data[::-1]][::-1]
    np.testing.assert_array_equal(first, backwards)
    for d, copy in zip(data, copies, strict=True):
        np.testing.assert_array_equal(np.concatenate([d.hessian.ravel(), d.gradient, d.lower, d.upper]), copy)


def test_ctrl_c_ends_a_process_whose_threads_have_solved_by_osqp() -> None:
    """OSQP has a handler of its own while it solves; of two solutions at once it would keep it for good."""
    pattern, data = program(SOUND[0], SOFT, 0, 20)
    solver = OsqpSolver(pattern, TIGHT)
    with ThreadPoolExecutor(3) as threads:
        list(threads.map(lambda _: solver.solve(data), range(60)))
    with pytest.raises(KeyboardInterrupt):
        ended_by_ctrl_c(lambda: time.sleep(0.1))


def test_ctrl_c_while_osqp_solves_is_not_lost() -> None:
    pattern, data = program(SOUND[0], SOFT, 0, 20)
    solver = OsqpSolver(pattern, replace(TIGHT, eps=1e-15))  # goes on until the iterations run out
    with pytest.raises(KeyboardInterrupt):
        ended_by_ctrl_c(lambda: solver.solve(data))


def ended_by_ctrl_c(work: Callable[[], object]) -> None:
    """Do it again and again; Ctrl-C comes after 0.2 s."""
    Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    for _ in range(1000):
        work()


SOLVERS: dict[str, Callable[[QpPattern], Callable[[QpData], QpSolution]]] = {
    "OSQP": lambda pattern: OsqpSolver(pattern, OsqpOptions()).solve,
    "active set": lambda pattern: exact,
}


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("weights", [HARD, SOFT], ids=["hard", "soft"])
@pytest.mark.parametrize("spoilt", ["crossed", "gradient", "hessian", "nan"])
def test_a_solver_that_failed_is_as_good_as_new(name: str, weights: WeightsSettings, spoilt: str) -> None:
    pattern, data = program(SOUND[0], weights, 0)
    solve = SOLVERS[name](pattern)
    good = solve(data)
    bad = {
        "crossed": replace(data, lower=data.lower + 10.0, upper=data.lower + 10.0),
        "gradient": replace(data, gradient=np.full_like(data.gradient, np.nan)),
        "hessian": replace(data, hessian=np.full_like(data.hessian, np.inf)),
        "nan": replace(data, hessian=np.full_like(data.hessian, np.nan)),
    }[spoilt]
    for _ in range(2):
        solution, _ = attempt(lambda: solve(bad))  # a solver's own exception counts as a failure as well
        assert solution is None or not solution.usable
    np.testing.assert_array_equal(solve(data).primal, good.primal)


def test_the_exact_solver_stops_after_its_changes() -> None:
    _, data = program(SOUND[0], SOFT, 1)
    needed = exact(data).iterations
    assert needed > 1
    for changes in range(needed + 1):
        stopped = exact(data, changes)
        assert (stopped.usable, stopped.unfinished) == (changes == needed, changes < needed)


@pytest.mark.parametrize("options", [None, OsqpOptions()], ids=["active set", "OSQP"])
def test_a_program_that_overflows_is_no_plan(options: OsqpOptions | None) -> None:
    huge = Faulty(LINEAR.predictor, lambda value: 1e200 * value, -1.0)
    planner = Planner(LINEAR, mpc(HARD, H), huge, options)
    assert planner.improve(posed(LINEAR, H)).words == "the quadratic program is not finite"


def controller_for(
    predictor: Predictor, inverse: Inverse, options: OsqpOptions | None = None, blocks: tuple[int, ...] | None = None
) -> GuardedController:
    """A linearised controller whose holds are not shortened by the hold rule; `options` solve by OSQP."""
    given: dict[str, Any] = {"adaptation": None, "move_blocking": blocks, "solver": "osqp" if options else "active_set"}
    settings = LinearisedMpcSettings(
        hold=HoldSettings(tolerance_deg=0.0), weights=WeightsSettings(rate=3.0), **given
    )  # OSQP's tolerance is in the cost: a small weight on moves leaves them open
    solution = None
    if options is not None:
        horizon = settings.preview_samples(predictor.dt)
        weights = settings.weights.discounted(problem.is_first_guess(inverse))
        solution = IterativeSolution(weights, DEVICE, horizon, predictor.dt, blocks, options)
    observer = settings.estimator.observer(predictor)
    part = problem.problem_of(settings, predictor, inverse, DEVICE, observer=observer, solve=solution)
    return GuardedController(part, DEVICE, observer, predictor.initial, solution=solution)


@pytest.mark.parametrize("solver", ["active set: maximum changes reached", "OSQP: dual infeasible"])
def test_a_program_without_a_solution_is_said_with_its_solver(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    unsolved = QpSolution(np.zeros(20), usable=False, status="dual infeasible", iterations=1)
    monkeypatch.setattr(OsqpSolver, "solve", lambda *_: unsolved)
    monkeypatch.setattr(problem, "CHANGES", 0)
    controller = controller_for(LINEAR.predictor, LINEAR.inverse, FINE if "OSQP" in solver else None)
    state = controller.init(LINEAR.y_rest, LINEAR.u_rest)
    wanted = np.append(np.full(10, 45.0), np.full(10, 20.0))  # no candidate is the best there is
    command, _ = controller.step(state, LINEAR.y_rest, wanted)
    assert (command.source, command.status) == (Source.INVERSE, f"PlanningError: {solver}")


def compared(
    leader: GuardedController, other: GuardedController, y: float, u: float, steps: int
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
    direct = controller_for(case.predictor, case.inverse)
    iterated = controller_for(case.predictor, case.inverse, osqp)
    ours, theirs = compared(direct, iterated, case.y_rest, case.u_rest, 60)
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
    fast, slow = (controller_for(route, inverse) for route in (compiled, reference))
    ours, theirs = compared(fast, slow, 30.0, 0.0, 8 if name == "lstm" else 40)
    np.testing.assert_allclose(theirs, ours, atol=tolerance)
    assert np.ptp(ours) > 0.5
