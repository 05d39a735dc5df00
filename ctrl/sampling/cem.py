"""The cross-entropy method over batched roll-outs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, final

import numpy as np

from hystmpc.models.model import Predictor
from hystmpc.trials.types import Mat, Vec

from ..limits import CommandLimits
from ..planning import Plan, PlanCost, Planner, PlanningError, PlanningProblem, Weights
from ..stopwatch import Stopwatch
from .noise import random_numbers
from .options import SampleOptions
from .planner import SampleCounter

_KEPT = 0.3  # share of the elites that take part in the next iteration again (Pinneri et al. 2020)


@final
@dataclass(frozen=True)
class CrossEntropyOptions(SampleOptions):
    """Mean and deviation fitted again in every iteration; the deviation of the first is `sigma`.

    Attributes:
        elites: share of the samples that mean and deviation are fitted to, at least two plans.
    """

    title: ClassVar[str] = "cross-entropy MPC"
    most: ClassVar[Mapping[str, float]] = {"finest": 1.0, "elites": 0.5}

    elites: float = 0.1


class _Search(NamedTuple):
    """Distribution of the next plans, the elites that stay, and the best plan so far."""

    mean: Vec
    deviation: Vec
    elites: Mat
    best: Plan


@final
class CrossEntropyPlanner(Planner[SampleCounter]):
    """Mean and deviation of smooth random plans, fitted again and again to the cheapest of them.

        u_n = mean + deviation * F w_n,  mean = mean of the elites,  deviation = max(std of the elites, finest sigma)

    over every sample of the horizon; F is the noise. The first mean is the best candidate. Plans are clipped into the
    limits before they are rolled out; the result is the cheapest plan seen, the last mean included, so that it never
    costs more than the start (Pinneri et al., "Sample-efficient cross-entropy method for real-time planning", CoRL
    2020, algorithm 1).

    Args:
        predictor: the model.
        weights: weights of the cost.
        limits: hard limits.
        noise: perturbations are noise @ w, w standard normal; shape (H, K).
        options: number and spread of the samples.
    """

    def __init__(
        self, predictor: Predictor, weights: Weights, limits: CommandLimits, noise: Mat, options: CrossEntropyOptions
    ) -> None:
        self._predictor, self._limits, self._options = predictor, limits, options
        self._shape = np.ascontiguousarray(noise.T)
        self._cost = PlanCost(weights, noise.shape[0])
        self._elites = min(max(2, math.ceil(options.elites * options.samples)), options.samples)
        self._kept = math.ceil(_KEPT * self._elites)

    def init(self) -> SampleCounter:
        return SampleCounter(0)

    def improve(
        self, problem: PlanningProblem, start: Plan, memory: SampleCounter, watch: Stopwatch
    ) -> tuple[Plan, str, SampleCounter]:
        generator = random_numbers(self._options.seed, memory.step)
        horizon = start.commands.size
        search = _Search(start.commands, np.full(horizon, self._options.sigma), np.empty((0, horizon)), start)
        for _ in range(self._options.iterations):
            search = self._iterate(problem, search, generator, watch)
        mean = self._admissible(search.mean[None, :], problem)
        last = self._cost.best(mean, self._predictor.rollout(problem.state, mean), problem)
        watch.lap("rollout")
        best = last if last.cost < search.best.cost else search.best
        return best, "ok", SampleCounter(memory.step + 1)

    def _iterate(
        self, problem: PlanningProblem, search: _Search, generator: np.random.Generator, watch: Stopwatch
    ) -> _Search:
        normals = generator.standard_normal((self._options.samples, self._shape.shape[0]))
        plans = self._admissible(search.mean + search.deviation * (normals @ self._shape), problem)
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
        found = Plan(plans[first], angles[first], float(costs[first]))
        deviation = np.maximum(elites.std(axis=0), self._options.finest * self._options.sigma)
        watch.lap("weigh")
        best = found if found.cost < search.best.cost else search.best
        return _Search(elites.mean(axis=0), deviation, elites[: self._kept], best)

    def _admissible(self, plans: Mat, problem: PlanningProblem) -> Mat:
        return self._limits.clip_plans(plans, problem.u_last, self._predictor.dt)
