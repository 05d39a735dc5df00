"""Sampling planners: model-predictive path integral control and the cross-entropy method, with batched roll-outs."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from hystmpc.models.inverse.inverses import Bounds, clip_plans
from hystmpc.models.kernels.numba_ import njit
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Mat, Vec

from .command import CommandLimits, CommandPlan, Stopwatch
from .linearised.planner import BlockedQp, MoveBlocking, PlanProgram, TrackingQp
from .linearised.qp import DaqpOptions, DaqpSolver
from .mpc import PlanCost, Planner, PlanningError, PlanningProblem
from .mpc_settings import SamplingMpcSettings, WeightsSettings

_SMALL = 1e-12  # squared distance from the start below which a sample is not used
_RIDGE = 1e-6  # of the fit, as a share of its normal matrix's trace
_TINY = float(np.finfo(np.float64).tiny)


@njit(cache=True, error_model="numpy", nogil=True)
def draw_plans(
    normals: Any,
    shape: Any,
    mean: Any,
    deviations: Any,
    low: float,
    high: float,
    reach: float,
    u_last: float,
    plans: Any,
) -> None:
    """Draw admissible plans (N, H) = mean + deviations * (w shape), in place; w (N, m) are `normals` made orthogonal.

    shape (m, H); mean (H,); deviations (N, 1) or (1, H).
    """
    make_orthogonal(normals)
    plans[:] = 0.0
    for n in range(normals.shape[0]):
        for j in range(normals.shape[1]):
            add(plans[n], normals[n, j], shape[j])
    plans[:] = mean + deviations * plans
    clip_plans(plans, low, high, reach, u_last)


@njit(cache=True, error_model="numpy", nogil=True)
def make_orthogonal(normals: Any) -> None:
    """Make each block of m rows of (N, m) orthogonal, in place; every row keeps its length."""
    count, size = normals.shape
    squares = np.empty(count)
    for n in range(count):
        row = normals[n]
        squares[n] = product(row, row)
        for other in range(n - n % size, n):
            add(row, -product(normals[other], row) / squares[other], normals[other])
        row *= np.sqrt(squares[n] / product(row, row))


@njit(cache=True, error_model="numpy", nogil=True)
def fit_columns(
    plans: Any, angles: Any, commands: Any, start_angles: Any, ends: Any, whitening: Any, columns: Any
) -> None:
    """Compute S F^-1 (H, m) in place: the fit of `SampledGaussNewton` to plans (N, H) and angles (N, H).

    ends (m,): last samples of the blocks; whitening (m, m): F^-1, transposed.
    """
    size, horizon = ends.size, commands.size
    normal, products = np.zeros((size, size)), np.zeros((size, horizon))
    z, column = np.empty(size), np.empty(horizon)
    for n in range(plans.shape[0]):
        z[:] = 0.0
        for j in range(size):
            add(z, plans[n, ends[j]] - commands[ends[j]], whitening[j])
        change = angles[n] - start_angles
        near = 1.0 / max(product(z, z), _SMALL) ** 2
        for j in range(size):
            add(normal[j, j:], near * z[j], z[j:])
            add(products[j], near * z[j], change)
    # slope zero if no sample has moved
    ridge = _RIDGE * np.trace(normal) + _TINY
    for j in range(size):
        normal[j, j] += ridge
    solve(normal, products)
    for i in range(size):
        column[:] = 0.0
        for j in range(size):
            add(column, whitening[i, j], products[j])
        columns[:, i] = column


@njit(cache=True, error_model="numpy", nogil=True)
def solve(matrix: Any, right: Any) -> None:
    """Solve matrix X = right (m, H) in place, by matrix = R'R; of `matrix` only the upper triangle is used."""
    size = matrix.shape[0]
    for j in range(size):
        for i in range(j):
            factor = -matrix[i, j]
            add(matrix[j, j:], factor, matrix[i, j:])
            add(right[j], factor, right[i])
        root = np.sqrt(matrix[j, j])
        matrix[j, j:] /= root
        right[j] /= root
    for j in range(size - 1, -1, -1):
        for i in range(j + 1, size):
            add(right[j], -matrix[j, i], right[i])
        right[j] /= matrix[j, j]


@njit(cache=True, error_model="numpy", nogil=True)
def product(a: Any, b: Any) -> Any:
    """Inner product of two vectors."""
    total = 0.0
    for k in range(a.size):
        total += a[k] * b[k]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def add(target: Any, factor: float, row: Any) -> None:
    """Add factor * row to target, in place."""
    for k in range(target.size):
        target[k] += factor * row[k]


@njit(cache=True, error_model="numpy", nogil=True)
def weighted_mean(plans: Any, costs: Any, temperature: float) -> Any:
    """Weighted mean (H,) of plans (N, H), by exp(-(J - J_min) / lambda); see `SamplingMpcSettings`."""
    lowest = costs.min()
    scale = max(temperature * (np.median(costs) - lowest), _TINY)
    total, mean = 0.0, np.zeros(plans.shape[1])
    for n in range(plans.shape[0]):
        weight = np.exp((lowest - costs[n]) / scale)
        total += weight
        add(mean, weight, plans[n])
    return mean / total


_LEAST = 0.05  # of every direction in the noise, as a share of the strongest, so that the fit covers all of them
_PARTS = np.array([1.0, 0.6, 0.35, 0.2, 0.1])[:, None]
_KEPT = 0.3  # share of the elites that take part in the next iteration again (Pinneri et al. 2020)


@dataclass(frozen=True)
class SampleCounter:
    """Number of steps so far, which with the seed determines the random numbers of the next step."""

    step: int


class SamplingPlanner(Planner[SampleCounter]):
    """Base of the planners with smooth random plans in blocked moves, clipped to the limits before the roll-out.

        u = p + sigma M F w,  w standard normal

    with p the plan around which they lie, M (H, m) of `MoveBlocking` and F (m, m) the noise at the ends of the blocks.
    The w of m successive samples are orthogonal, so that m samples cover every direction once.
    """

    def __init__(self, predictor: Predictor, settings: SamplingMpcSettings, limits: CommandLimits) -> None:
        self._predictor, self._settings = predictor, settings
        horizon, dt = settings.preview_samples(predictor.dt), predictor.dt
        self._bounds = Bounds(limits.lower, limits.upper, limits.rate * dt)
        self._sigma = settings.deviation(limits.rate * dt)
        blocking = MoveBlocking(settings.blocks(dt), horizon)
        # the same distribution from as few normals as there are blocks
        left, sizes, _ = np.linalg.svd(settings.noise.matrix(horizon)[blocking.ends])
        strengths = np.full(len(left), _LEAST * sizes[0])
        strengths[: sizes.size] = np.maximum(sizes, strengths[: sizes.size])
        factor = left * strengths
        self._shape = np.ascontiguousarray((blocking.matrix @ factor).T)
        self._cost = PlanCost(settings.weights, horizon)
        self._polish = SampledGaussNewton(settings.weights, limits, blocking, factor, dt)

    def init(self) -> SampleCounter:
        return SampleCounter(0)

    def improve(
        self, problem: PlanningProblem, start: CommandPlan, memory: SampleCounter, watch: Stopwatch
    ) -> tuple[CommandPlan, str, SampleCounter]:
        generator = random_numbers(self._settings.seed, memory.step)
        return self._best(problem, start, generator, watch), "ok", SampleCounter(memory.step + 1)

    @abstractmethod
    def _best(
        self, problem: PlanningProblem, start: CommandPlan, generator: np.random.Generator, watch: Stopwatch
    ) -> CommandPlan:
        """Best plan of all iterations, which costs no more than `start`."""

    def _drawn(self, generator: np.random.Generator, mean: Vec, deviations: Mat, problem: PlanningProblem) -> Mat:
        """Admissible plans (N, H) around `mean` (H,), from smooth noise of unit variance times `deviations`."""
        normals = generator.standard_normal((self._settings.samples, len(self._shape)))
        plans = np.empty((len(normals), mean.size))
        draw_plans(normals, self._shape, mean, deviations, *self._bounds, problem.u_last, plans)
        return plans

    def _admissible(self, plans: Mat, problem: PlanningProblem) -> Mat:
        clip_plans(plans, *self._bounds, problem.u_last)
        return plans

    def _cheapest(self, plans: Mat, problem: PlanningProblem) -> CommandPlan:
        plans = self._admissible(plans, problem)
        return self._cost.best(plans, self._predictor.rollout(problem.state, plans), problem)


@final
class SampledGaussNewton:
    """Gauss-Newton step within the limits, with a Jacobian fitted to the samples instead of derivatives of the model.

        theta_n - theta_0 ~ S z_n,  F z_n = p_n - p_0 at the ends of the blocks,  F (m, m) the noise there
        S = argmin sum_n |theta_n - theta_0 - S z_n|^2 / |z_n|^4
        w = argmin of the planning cost with theta_0 + S F^-1 w and p_0 + M w, within the limits of `BlockedQp`

    The samples near the start count most; those further off give a slope where the play's own is zero.
    """

    def __init__(
        self, weights: WeightsSettings, limits: CommandLimits, blocking: MoveBlocking, factor: Mat, dt: float
    ) -> None:
        self._ends = blocking.ends
        self._whitening = np.ascontiguousarray(np.linalg.inv(factor).T)
        single = len(blocking.lengths) == blocking.horizon
        self._qp: PlanProgram = (
            TrackingQp(weights, limits, blocking.horizon, dt) if single else BlockedQp(weights, limits, blocking, dt)
        )
        self._solver = DaqpSolver(self._qp.pattern, DaqpOptions())

    def plans(self, start: CommandPlan, plans: Mat, angles: Mat, problem: PlanningProblem) -> Mat:
        """Return the full step from `start` and parts of it (5, H), from samples (N, H) and their angles (N, H).

        The result is empty, shape (0, H), if the program cannot be solved.
        """
        columns = np.empty((start.commands.size, self._ends.size))
        fit_columns(plans, angles, start.commands, start.angles, self._ends, self._whitening, columns)
        solution = self._solver.solve(self._qp.blocked(problem, start, columns))
        if not solution.usable:
            return np.empty((0, start.commands.size))
        parts: Mat = start.commands + _PARTS * self._qp.deviation(solution.primal)
        return parts


@final
class PathIntegralPlanner(SamplingPlanner):
    """Path integral control: weighted mean of random plans around the best one (Williams et al., T-RO 2018, eq. (30)).

    The samples spread geometrically from `sigma` to its finest share, so that one iteration both explores and refines.
    The mean is moved to the weighted mean, to the best sample or along the step of `SampledGaussNewton`, whichever
    costs least, never to a worse plan. The weighted mean alone would follow the noise of the disturbance estimate.
    """

    def __init__(self, predictor: Predictor, settings: SamplingMpcSettings, limits: CommandLimits) -> None:
        super().__init__(predictor, settings, limits)
        self._sigmas = self._sigma * np.geomspace(1.0, settings.finest, settings.samples)[:, None]

    def _best(
        self, problem: PlanningProblem, start: CommandPlan, generator: np.random.Generator, watch: Stopwatch
    ) -> CommandPlan:
        for _ in range(self._settings.iterations):
            plans = self._drawn(generator, start.commands, self._sigmas, problem)
            watch.lap("sample")
            angles = self._predictor.rollout(problem.state, plans)
            watch.lap("rollout")
            start = self._better(problem, start, plans, angles)
            watch.lap("weigh")
        return start

    def _better(self, problem: PlanningProblem, start: CommandPlan, plans: Mat, angles: Mat) -> CommandPlan:
        """Cheapest of the start, the samples, their weighted mean and the parts of the fitted step."""
        costs = self._cost(plans, angles, problem)
        if not math.isfinite(costs.sum()):
            usable = np.isfinite(costs)
            if not usable.any():
                raise PlanningError(f"none of {len(plans)} samples has a finite prediction")
            plans, angles, costs = plans[usable], angles[usable], costs[usable]
        best = int(costs.argmin())
        sample = CommandPlan(plans[best], angles[best], float(costs[best]))
        polished = self._polish.plans(start, plans, angles, problem)
        averaged = weighted_mean(plans, costs, self._settings.temperature)
        tried = self._cheapest(np.vstack((averaged, polished)), problem)
        return min((start, tried, sample), key=lambda p: p.cost)


class _CrossEntropy(NamedTuple):
    """Distribution of the next plans, the elites that are reused, and the best plan so far."""

    mean: Vec
    deviation: Vec
    elites: Mat
    best: CommandPlan


@final
class CrossEntropyPlanner(SamplingPlanner):
    """Cross-entropy method: mean and deviation of smooth random plans, fitted repeatedly to the cheapest of them.

        u_n = mean + deviation * F w_n,  mean = mean of the elites,  deviation = max(std of the elites, finest sigma)

    over every sample of the horizon; F is the noise. The first mean is the best candidate. The result is the cheapest
    plan so far, the last mean and the steps of `SampledGaussNewton` included, so that it never costs more than the
    start (Pinneri et al., "Sample-efficient cross-entropy method for real-time planning", CoRL 2020, algorithm 1).
    """

    def __init__(self, predictor: Predictor, settings: SamplingMpcSettings, limits: CommandLimits) -> None:
        super().__init__(predictor, settings, limits)
        self._elites = min(max(2, math.ceil(settings.elites * settings.samples)), settings.samples)
        self._kept = math.ceil(_KEPT * self._elites)

    def _best(
        self, problem: PlanningProblem, start: CommandPlan, generator: np.random.Generator, watch: Stopwatch
    ) -> CommandPlan:
        horizon = start.commands.size
        search = _CrossEntropy(start.commands, np.full(horizon, self._sigma), np.empty((0, horizon)), start)
        for _ in range(self._settings.iterations):
            search = self._iterate(problem, search, generator, watch)
        last = self._cheapest(search.mean[None], problem)
        watch.lap("rollout")
        return last if last.cost < search.best.cost else search.best

    def _iterate(
        self, problem: PlanningProblem, search: _CrossEntropy, generator: np.random.Generator, watch: Stopwatch
    ) -> _CrossEntropy:
        plans = self._drawn(generator, search.mean, search.deviation[None], problem)
        plans = np.vstack([plans, search.elites])
        watch.lap("sample")
        angles = self._predictor.rollout(problem.state, plans)
        watch.lap("rollout")
        costs = self._cost(plans, angles, problem)
        order = np.argsort(costs, kind="stable")[: self._elites]
        order = order[np.isfinite(costs[order])]
        if not order.size:
            raise PlanningError(f"none of {len(plans)} samples has a finite prediction")
        elites, first = plans[order], int(order[0])
        sample = CommandPlan(plans[first], angles[first], float(costs[first]))
        deviation = np.maximum(elites.std(axis=0), self._settings.finest * self._sigma)
        finite = np.isfinite(costs)
        polished = self._cheapest(self._polish.plans(search.best, plans[finite], angles[finite], problem), problem)
        best = min((search.best, sample, polished), key=lambda plan: plan.cost)
        watch.lap("weigh")
        return _CrossEntropy(elites.mean(axis=0), deviation, elites[: self._kept], best)


def random_numbers(seed: int, step: int) -> np.random.Generator:
    """Return the random generator of one step, determined by seed and step alone."""
    # counter-based generator: the third word counts steps, the lower two count the draws of one step
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, step, 0]))
