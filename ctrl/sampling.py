"""Sampling planners: model-predictive path integral control and the cross-entropy method, with batched roll-outs."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Mat, Vec

from .command import CommandLimits, CommandPlan, Stopwatch
from .law_tables import LawTables, MoveBlocking
from .linearised.qp import ActiveSetOptions
from .mpc import PlanCost, Planner, PlanningError, PlanningProblem
from .mpc_settings import SamplingMpcSettings, WeightsSettings

_LEAST = 0.05  # of every direction in the noise, as a share of the strongest, so that the fit covers all of them
_PARTS = 5  # of the fitted step, the whole one first
_CHANGES = ActiveSetOptions().changes
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
        self._tables = LawTables(settings.weights, horizon, limits, dt, more=settings.samples)
        self._draw, self._clip = engine().draw_plans, engine().clip_plans

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
        sizes, along = (*normals.shape, mean.size), len(deviations) == 1
        given = self._shape, mean, deviations, along
        self._draw(*sizes, normals, *given, *self._tables.bounds, problem.u_last, plans)
        return plans

    def _admissible(self, plans: Mat, problem: PlanningProblem) -> Mat:
        self._clip(*plans.shape, *self._tables.bounds, problem.u_last, plans)
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
        self._whitening = np.ascontiguousarray(np.linalg.inv(factor).T)
        single = len(blocking.lengths) == blocking.horizon
        self._tables = LawTables(weights, blocking.horizon, limits, dt, None if single else blocking)
        self._steps = engine().sampled_steps

    def plans(self, start: CommandPlan, plans: Mat, angles: Mat, problem: PlanningProblem) -> Mat:
        """Return the full step from `start` and parts of it (5, H), from samples (N, H) and their angles (N, H).

        The result is empty, shape (0, H), if the program cannot be solved.
        """
        parts, tables = np.empty((_PARTS, start.commands.size)), self._tables
        samples = len(plans), plans, np.ascontiguousarray(angles), self._whitening
        known = tables.address, problem.task, *samples, start.commands, start.angles
        return parts if self._steps(*known, _CHANGES, tables.room, parts) >= 0 else parts[:0]


@final
class PathIntegralPlanner(SamplingPlanner):
    """Path integral control: weighted mean of random plans around the best one (Williams et al., T-RO 2018, eq. (30)).

    The samples spread geometrically from `sigma` to its finest share, so that one iteration both explores and refines.
    The mean is moved to the weighted mean, to the best sample or along the step of `SampledGaussNewton`, whichever
    costs least, never to a worse plan. The weighted mean alone would follow the noise of the disturbance estimate.
    """

    def __init__(self, predictor: Predictor, settings: SamplingMpcSettings, limits: CommandLimits) -> None:
        super().__init__(predictor, settings, limits)
        self._mean = engine().weighted_mean
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
        averaged, tables = np.empty(self._tables.horizon), self._tables
        self._mean(*plans.shape, plans, costs, self._settings.temperature, tables.room, averaged)
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
