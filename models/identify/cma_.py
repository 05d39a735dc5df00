"""CMA-ES by the package `cma` (extra `train`)."""

from __future__ import annotations

import cma
import numpy as np

from .chain_fit import Tracker
from .global_search import GlobalSettings, Region

SPREAD = 0.25  # first standard deviation, as a share of the box


def adapt(tracker: Tracker, region: Region, settings: GlobalSettings) -> None:
    """Covariance matrix adaptation over the box scaled to one, from the start; once settled, from a random point.

    Source: Hansen, arXiv 1604.00772.
    """
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
