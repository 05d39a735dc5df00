"""Given and tuned settings on plants that the search has not seen: by how much is it better, and how sure is that."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hystmpc.trials.types import Vec

from ..parallel.backend import Backend
from .objective import PlantScore, plant_config, plant_cost, plant_score, robust
from .settings import ObjectiveSettings, TuneSettings

Progress = Callable[[int, int, str], None]
_RESAMPLES = 4000
_NAMES = ("given", "tuned")


@dataclass(frozen=True)
class Case:
    """One controller on one held-out plant, as it is handed to a worker."""

    name: str
    plant: int
    values: str
    settings: str


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Scores on the held-out plants, the same plants and noise for both.

    Attributes:
        given, tuned: score of every plant.
        objective: how they are judged.
    """

    given: tuple[PlantScore, ...]
    tuned: tuple[PlantScore, ...]
    objective: ObjectiveSettings

    def costs(self, name: str) -> Vec:
        """Cost of `given` or `tuned` on every plant (P,) [deg]."""
        return np.array([plant_cost(score, self.objective) for score in getattr(self, name)])

    def errors(self, name: str) -> Vec:
        """Error on every plant (P,) [deg]."""
        return np.array([score.error_deg for score in getattr(self, name)])

    def value(self, name: str) -> float:
        """Robust objective [deg]."""
        return robust(self.costs(name), self.objective)

    @property
    def gain(self) -> float:
        """1 - tuned / given of the robust objective."""
        return 1.0 - self.value("tuned") / self.value("given")

    def interval(self, share: float = 0.9) -> tuple[float, float]:
        """Interval of the gain over resampled plants (paired bootstrap, seeded)."""
        given, tuned = self.costs("given"), self.costs("tuned")
        random = np.random.default_rng(0)
        gains = []
        for _ in range(_RESAMPLES):
            rows = random.integers(len(given), size=len(given))
            gains.append(1.0 - robust(tuned[rows], self.objective) / robust(given[rows], self.objective))
        low, high = np.quantile(gains, [0.5 - share / 2, 0.5 + share / 2])
        return float(low), float(high)

    @property
    def better(self) -> int:
        """Plants on which the tuned settings cost less."""
        return int(np.sum(self.costs("tuned") < self.costs("given")))

    def rows(self) -> list[tuple[str, float, float, float, float, int]]:
        """Name, objective, mean error, error on the worst plant, mean travel, plants with a violation."""
        rows = []
        for name in _NAMES:
            scores: tuple[PlantScore, ...] = getattr(self, name)
            errors, travel = self.errors(name), float(np.mean([score.travel for score in scores]))
            beyond = sum(score.violations > 0 for score in scores)
            rows.append((name, self.value(name), float(errors.mean()), float(errors.max()), travel, beyond))
        return rows

    def columns(self) -> dict[str, Any]:
        """A table, a row a plant."""
        table: dict[str, Any] = {"plant": np.arange(len(self.given))}
        for name in _NAMES:
            scores: tuple[PlantScore, ...] = getattr(self, name)
            table[f"{name}_error_deg"] = self.errors(name)
            table[f"{name}_cost_deg"] = self.costs(name)
            table[f"{name}_travel"] = np.array([score.travel for score in scores])
            table[f"{name}_violations"] = np.array([score.violations for score in scores])
        return table


def held_out(
    settings: TuneSettings, values: dict[str, Any], backend: Backend, progress: Progress | None = None
) -> HeldOut:
    """Run given and tuned settings on every held-out plant.

    Args:
        settings: of the tuning.
        values: tuned settings by path.
        backend: where the runs are made.
        progress: called after every plant.

    Raises:
        ConfigError: if a draw does not fit the study.
        KeyboardInterrupt: if the user ended it.
    """
    plain = settings.model_dump_json()
    names = {"given": "{}", "tuned": json.dumps(values)}
    count = settings.held_out.count
    cases = [Case(name, number, text, plain) for number in range(count) for name, text in names.items()]
    found: dict[str, dict[int, PlantScore]] = {name: {} for name in names}
    for done, (name, number, score) in enumerate(backend.results(run_case, cases), start=1):
        found[name][number] = score
        if progress:
            progress(done, len(cases), "held-out plants")
    given, tuned = (tuple(found[name][number] for number in range(count)) for name in _NAMES)
    return HeldOut(given, tuned, settings.objective)


def run_case(case: Case) -> tuple[str, int, PlantScore]:
    """One controller on one held-out plant.

    Raises:
        HystmpcError: what preparing the study raises.
        KeyboardInterrupt: if the user ended it.
    """
    settings = TuneSettings.parse(json.loads(case.settings), "case")
    controller = settings.with_values(json.loads(case.values))
    return case.name, case.plant, plant_score(plant_config(settings, settings.held_out, case.plant, controller))
