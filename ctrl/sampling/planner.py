"""Model-predictive path integral control over batched roll-outs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from hystmpc.models.model import Predictor
from hystmpc.trials.types import Mat, Vec

from ..limits import CommandLimits
from ..planning import Plan, PlanCost, Planner, PlanningError, PlanningProblem, Weights
from ..stopwatch import Stopwatch
from .noise import random_numbers
from .options import SampleOptions


@final
@dataclass(frozen=True)
class SamplingOptions(SampleOptions):
    """Samples spread geometrically from `sigma` to its finest share, so that one iteration both explores and refines.

    Attributes:
        temperature: of the weights exp(-(J - J_min) / lambda), with lambda = temperature (median J - J_min).
    """

    temperature: float = 0.02


@dataclass(frozen=True)
class SampleCounter:
    """Steps taken so far: with the seed it fixes every random number of the next step."""

    step: int


@final
class SamplingPlanner(Planner[SampleCounter]):
    """Weighted mean of random plans around the best candidate (Williams et al., T-RO 2018, eq. (30)).

    Perturbations are smooth (`noise`), plans are clipped into the limits before they are rolled out, and the mean
    is moved to the weighted mean or to the best sample, whichever costs less, never to a worse plan.

    Args:
        predictor: the model.
        weights: weights of the cost.
        limits: hard limits.
        noise: perturbations are noise @ w, w standard normal; shape (H, K).
        options: number and spread of the samples.
    """

    def __init__(
        self, predictor: Predictor, weights: Weights, limits: CommandLimits, noise: Mat, options: SamplingOptions
    ) -> None:
        self._predictor, self._limits, self._options = predictor, limits, options
        self._shape = np.ascontiguousarray(noise.T)
        self._cost = PlanCost(weights, noise.shape[0])
        self._sigmas = options.sigma * np.geomspace(1.0, options.finest, options.samples)[:, None]

    def init(self) -> SampleCounter:
        return SampleCounter(0)

    def improve(
        self, problem: PlanningProblem, start: Plan, memory: SampleCounter, watch: Stopwatch
    ) -> tuple[Plan, str, SampleCounter]:
        generator = random_numbers(self._options.seed, memory.step)
        for _ in range(self._options.iterations):
            start = self._iterate(problem, start, generator, watch)
        return start, "ok", SampleCounter(memory.step + 1)

    def _iterate(self, problem: PlanningProblem, start: Plan, generator: np.random.Generator, watch: Stopwatch) -> Plan:
        normals = generator.standard_normal((self._options.samples, self._shape.shape[0]))
        plans = self._admissible(start.commands + self._sigmas * (normals @ self._shape), problem)
        watch.lap("sample")
        angles = self._predictor.rollout(problem.state, plans)
        watch.lap("rollout")
        costs = self._cost(plans, angles, problem)
        usable = np.isfinite(costs)
        if not usable.any():
            raise PlanningError(f"none of {len(plans)} samples has a finite prediction")
        mean = self._admissible(self._weighted(plans[usable], costs[usable])[None, :], problem)
        averaged = self._cost.best(mean, self._predictor.rollout(problem.state, mean), problem)
        best = int(np.argmin(costs))
        watch.lap("weigh")
        return min((start, averaged, Plan(plans[best], angles[best], float(costs[best]))), key=lambda p: p.cost)

    def _weighted(self, plans: Mat, costs: Vec) -> Vec:
        lowest = costs.min()
        spread = float(np.median(costs)) - lowest
        weights = np.exp(-(costs - lowest) / max(self._options.temperature * spread, np.finfo(float).tiny))
        return weights @ plans / weights.sum()

    def _admissible(self, plans: Mat, problem: PlanningProblem) -> Mat:
        return self._limits.clip_plans(plans, problem.u_last, self._predictor.dt)
