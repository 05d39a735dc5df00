"""Sampling planners: model-predictive path integral control and the cross-entropy method, over batched roll-outs."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from hystmpc.models.model import Predictor
from hystmpc.trials.types import Mat, Vec

from ..command import Stopwatch
from ..limits import CommandLimits
from ..planning import CommandPlan, PlanCost, Planner, PlanningError, PlanningProblem
from ..planning_settings import SamplingSettings

_KEPT = 0.3  # share of the elites that take part in the next iteration again (Pinneri et al. 2020)


@dataclass(frozen=True)
class SampleCounter:
    """Steps taken so far: with the seed it fixes every random number of the next step."""

    step: int


class SamplingPlanner(Planner[SampleCounter]):
    """Smooth random plans, clipped into the limits before they are rolled out."""

    def __init__(self, predictor: Predictor, settings: SamplingSettings, limits: CommandLimits) -> None:
        self._predictor, self._limits, self._settings = predictor, limits, settings
        self._shape = np.ascontiguousarray(settings.noise.matrix(settings.horizon).T)
        self._cost = PlanCost(settings.weights, settings.horizon)

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
        """The best plan of all iterations, no worse than `start`."""

    def _perturbations(self, generator: np.random.Generator) -> Mat:
        """Smooth noise of unit variance (N, H)."""
        return generator.standard_normal((self._settings.samples, self._shape.shape[0])) @ self._shape

    def _admissible(self, plans: Mat, problem: PlanningProblem) -> Mat:
        return self._limits.clip_plans(plans, problem.u_last, self._predictor.dt)

    def _rolled_out(self, plan: Vec, problem: PlanningProblem) -> CommandPlan:
        """One plan (H,), made admissible."""
        plans = self._admissible(plan[None, :], problem)
        return self._cost.best(plans, self._predictor.rollout(problem.state, plans), problem)


@final
class PathIntegralPlanner(SamplingPlanner):
    """Weighted mean of random plans around the best candidate (Williams et al., T-RO 2018, eq. (30)).

    The samples spread geometrically from `sigma` to its finest share, so that one iteration both explores and refines.
    The mean is moved to the weighted mean or to the best sample, whichever costs less, never to a worse plan.
    """

    def __init__(self, predictor: Predictor, settings: SamplingSettings, limits: CommandLimits) -> None:
        super().__init__(predictor, settings, limits)
        self._sigmas = settings.sigma * np.geomspace(1.0, settings.finest, settings.samples)[:, None]

    def _best(
        self, problem: PlanningProblem, start: CommandPlan, generator: np.random.Generator, watch: Stopwatch
    ) -> CommandPlan:
        for _ in range(self._settings.iterations):
            start = self._iterate(problem, start, generator, watch)
        return start

    def _iterate(
        self, problem: PlanningProblem, start: CommandPlan, generator: np.random.Generator, watch: Stopwatch
    ) -> CommandPlan:
        plans = self._admissible(start.commands + self._sigmas * self._perturbations(generator), problem)
        watch.lap("sample")
        angles = self._predictor.rollout(problem.state, plans)
        watch.lap("rollout")
        costs = self._cost(plans, angles, problem)
        usable = np.isfinite(costs)
        if not usable.any():
            raise PlanningError(f"none of {len(plans)} samples has a finite prediction")
        averaged = self._rolled_out(self._weighted(plans[usable], costs[usable]), problem)
        best = int(np.argmin(costs))
        watch.lap("weigh")
        return min((start, averaged, CommandPlan(plans[best], angles[best], float(costs[best]))), key=lambda p: p.cost)

    def _weighted(self, plans: Mat, costs: Vec) -> Vec:
        lowest = costs.min()
        spread = float(np.median(costs)) - lowest
        weights = np.exp(-(costs - lowest) / max(self._settings.temperature * spread, np.finfo(float).tiny))
        return weights @ plans / weights.sum()


class _Search(NamedTuple):
    """Distribution of the next plans, the elites that stay, and the best plan so far."""

    mean: Vec
    deviation: Vec
    elites: Mat
    best: CommandPlan


@final
class CrossEntropyPlanner(SamplingPlanner):
    """Mean and deviation of smooth random plans, fitted again and again to the cheapest of them.

        u_n = mean + deviation * F w_n,  mean = mean of the elites,  deviation = max(std of the elites, finest sigma)

    over every sample of the horizon; F is the noise. The first mean is the best candidate. The result is the cheapest
    plan seen, the last mean included, so that it never costs more than the start (Pinneri et al., "Sample-efficient
    cross-entropy method for real-time planning", CoRL 2020, algorithm 1).
    """

    def __init__(self, predictor: Predictor, settings: SamplingSettings, limits: CommandLimits) -> None:
        super().__init__(predictor, settings, limits)
        self._elites = min(max(2, math.ceil(settings.elites * settings.samples)), settings.samples)
        self._kept = math.ceil(_KEPT * self._elites)

    def _best(
        self, problem: PlanningProblem, start: CommandPlan, generator: np.random.Generator, watch: Stopwatch
    ) -> CommandPlan:
        horizon = start.commands.size
        search = _Search(start.commands, np.full(horizon, self._settings.sigma), np.empty((0, horizon)), start)
        for _ in range(self._settings.iterations):
            search = self._iterate(problem, search, generator, watch)
        last = self._rolled_out(search.mean, problem)
        watch.lap("rollout")
        return last if last.cost < search.best.cost else search.best

    def _iterate(
        self, problem: PlanningProblem, search: _Search, generator: np.random.Generator, watch: Stopwatch
    ) -> _Search:
        plans = self._admissible(search.mean + search.deviation * self._perturbations(generator), problem)
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
        found = CommandPlan(plans[first], angles[first], float(costs[first]))
        deviation = np.maximum(elites.std(axis=0), self._settings.finest * self._settings.sigma)
        watch.lap("weigh")
        best = found if found.cost < search.best.cost else search.best
        return _Search(elites.mean(axis=0), deviation, elites[: self._kept], best)


def random_numbers(seed: int, step: int) -> np.random.Generator:
    """The generator of one step, fixed by seed and step alone."""
    # a counter-based generator: the third word counts steps, the lower two what one step draws
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, step, 0]))
