"""Global identification: differential evolution or CMA-ES over a box, with the budget of S1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.optimize import differential_evolution

from hystmpc.models.identify.chain_fit import ChainFit, ChainTask, OperatorFitSettings, Tracker, fit_chain
from hystmpc.models.identify.free_run import FreeRuns
from hystmpc.models.model import FitProgress
from hystmpc.trials.errors import FitError
from hystmpc.trials.types import Vec

Search = Callable[[Tracker, "Region", "GlobalSettings"], None]


@dataclass(frozen=True)
class GlobalSettings:
    """Settings of a global search.

    Attributes:
        iterations: budget in iterations (generations); 1000 in S1, which used the genetic algorithm of MATLAB.
        population: points of a generation; 200 is that algorithm's default beyond five parameters.
        polish: end with a bounded least-squares fit from the best point; not part of S1's method.
        skip_first_flexure: score each trial from the first reversal of its command on.
        seed: of everything drawn at random.

    Raises:
        FitError: if the budget or the population is too small.
    """

    iterations: int = 1000
    population: int = 200
    polish: bool = False
    skip_first_flexure: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.population < 5:
            raise FitError(
                f"{self.iterations} iterations of {self.population} points, expected at least 1 iteration of 5 points"
            )


@dataclass(frozen=True, eq=False)
class Region:
    """Search region over the free parameters (Q,).

    Attributes:
        first_lower, first_upper: ends of the part of it in which the search begins.
        start: a point to begin at, for searches that begin at one.
    """

    lower: Vec
    upper: Vec
    first_lower: Vec
    first_upper: Vec
    start: Vec


def fit_globally(
    name: str, search: Search, task: ChainTask, settings: GlobalSettings, progress: FitProgress | None = None
) -> ChainFit:
    """Run a search over the task's box and report how it converged.

    KeyboardInterrupt ends it and keeps the best so far; progress gets the iteration and the best rmse.
    """
    loss = FreeRuns(task.starts[0], task.trials, settings.skip_first_flexure)
    free = task.free
    tracker, interrupted = Tracker(loss.mse, free, progress), False
    try:
        ends = (free.part(end) for end in (*task.box, *task.first, task.starts[0].values))
        search(tracker, Region(*ends), settings)
    except KeyboardInterrupt:
        interrupted = True
    chain = tracker.chain(task.starts[0], interrupted)
    found = ChainFit(
        chain,
        float(np.sqrt(tracker.best_loss)),
        tracker.evaluations,
        tracker.report(name, settings.iterations),
        interrupted,
    )
    return _polished(found, task, settings) if settings.polish and not interrupted else found


def evolve(tracker: Tracker, region: Region, settings: GlobalSettings) -> None:
    """Differential evolution from a Latin hypercube: best/1/bin with dithered mutation, without a starting point.

    Source: Storn and Price, J. Global Optim. 11 (1997).
    """
    rng, count = np.random.default_rng(settings.seed), settings.population
    strata = np.stack([rng.permutation(count) for _ in region.lower], axis=1)
    hypercube = (strata + rng.uniform(size=strata.shape)) / count

    def end_of_generation(intermediate_result: Any) -> None:  # SciPy calls it by this argument's name
        del intermediate_result
        tracker.iteration()

    cast(Any, differential_evolution)(  # its types know one of the names of `seed`, which differ between versions
        lambda q: min(tracker(q), 1e300),  # infinities would make the spread of the population not a number
        list(zip(region.lower, region.upper, strict=True)),
        maxiter=settings.iterations,
        init=region.first_lower + hypercube * (region.first_upper - region.first_lower),
        recombination=0.9,  # the parameters of plays and dead zones depend on one another
        tol=0.0,  # the whole budget, as S1 reports it
        polish=False,
        seed=rng,
        callback=end_of_generation,
    )


def _polished(found: ChainFit, task: ChainTask, settings: GlobalSettings) -> ChainFit:
    """Bounded least-squares fit from the given point, if it is better."""
    polish = OperatorFitSettings(settings.skip_first_flexure, restarts=0, seed=settings.seed)
    fit = fit_chain([found.chain], task.trials, polish, fixed=task.fixed)
    evaluations = found.evaluations + fit.evaluations
    if fit.rmse_deg >= found.rmse_deg:
        return replace(found, evaluations=evaluations)
    return ChainFit(fit.chain, fit.rmse_deg, evaluations, found.report, fit.interrupted)


SPREAD = 0.25  # first standard deviation, as a share of the box


def adapt(tracker: Tracker, region: Region, settings: GlobalSettings) -> None:
    """Covariance matrix adaptation over the box scaled to one, from the start; restarts at a random point.

    Source: Hansen, arXiv 1604.00772.
    """
    import cma

    rng = np.random.default_rng(settings.seed)
    lower, width = region.lower, region.upper - region.lower
    point, done = np.clip((region.start - lower) / width, 0.02, 0.98), 0
    while done < settings.iterations:
        seed = int(rng.integers(1, 2**31))  # zero would mean the clock
        options = {"bounds": [0, 1], "popsize": settings.population, "seed": seed, "verbose": -9, "maxiter": np.inf}
        strategy = cma.CMAEvolutionStrategy(point, SPREAD, options)
        while done < settings.iterations and not strategy.stop():
            points = strategy.ask()
            strategy.tell(points, [min(tracker(lower + x * width), 1e300) for x in points])
            tracker.iteration()
            done += 1
        point = (rng.uniform(region.first_lower, region.first_upper) - lower) / width
