"""What a controller is worth: its error on each plant, and the mean of all with the mean of the worst."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.ctrl.config import AnyControllerSettings
from hystmpc.trajectories import PreviewTable
from hystmpc.trials.types import Vec

from ..closed_loop import run_closed_loop
from ..config import SimulationConfig
from ..results import result_of
from ..study import Study, prepare
from ..sweep.draws import drawn
from ..sweep.paths import changed
from ..sweep.worker import shared_knowledge
from .settings import ObjectiveSettings, PlantsSettings, TuneSettings


@dataclass(frozen=True)
class PlantScore:
    """One controller on one plant, all motions.

    Attributes:
        error_deg: root mean square error over all motions [deg].
        travel: command travel over the need of the motions; 1 is a command that does no more than it must.
        violations: samples beyond a limit.
    """

    error_deg: float
    travel: float
    violations: int


def plant_config(
    settings: TuneSettings, plants: PlantsSettings, number: int, controller: AnyControllerSettings
) -> SimulationConfig:
    """The study of plant `number` of a set.

    Raises:
        ConfigError: if a draw does not fit the study.
    """
    data = settings.base
    for path, value in drawn(settings.draw, plants.seed, number).items():
        data = changed(data, path, value)
    study = SimulationConfig.parse(data, f"plant {number}")
    # Another realisation of the noise for every plant, and none of those of another set.
    seed = int(np.random.SeedSequence([plants.seed, number]).generate_state(1)[0])
    return study.model_copy(update={"seed": seed, "controllers": {str(settings.controller): controller}})


def plant_score(config: SimulationConfig) -> PlantScore:
    """Run one controller along every motion.

    Raises:
        HystmpcError: what `prepare` raises.
        KeyboardInterrupt: if the user ended it.
    """
    study = prepare(config, shared_knowledge(config))
    ((name, controller),) = study.config.controllers.items()
    squares, travel, need, beyond = [], 0.0, 0.0, 0
    for motion, trajectory in study.motions.items():
        run = run_closed_loop(study.controller(controller), study.plant, trajectory)
        if run.log.interrupted:
            raise KeyboardInterrupt  # the loop ends quietly
        metrics = result_of(study.config, motion, name, run).metrics
        squares.append(metrics.rmse_deg**2)
        travel += metrics.command_travel
        need += needed_travel(study, motion)
        beyond += metrics.limit_violations
    return PlantScore(math.sqrt(float(np.mean(squares))), travel / max(need, 1e-9), beyond)


def needed_travel(study: Study, motion: str) -> float:
    """Command travel of the model's inverse along a motion, without feedback and noise [command unit].

    sum_k |u_k - u_{k-1}| with u_k = inverse(x_k, r_k) within the limits, from the plant's rest.
    """
    predictor, inverse = study.feedforward
    reference = PreviewTable(study.motions[motion], predictor.dt, 1)
    u, travel = study.plant.rest_command, 0.0
    state = predictor.initial(float(reference.at(0)[0]), u)
    for k in range(reference.steps):
        wanted = study.limits.clip(inverse.command(state, float(reference.at(k)[0]), u), u, predictor.dt)
        travel, u = travel + abs(wanted - u), wanted
        _, state = predictor.advance(state, u)
    return travel


def plant_cost(score: PlantScore, objective: ObjectiveSettings) -> float:
    """J = error + violation_deg [any violation] + chatter_deg max(0, travel - 1) [deg]."""
    beyond = objective.violation_deg if score.violations else 0.0
    return score.error_deg + beyond + objective.chatter_deg * max(0.0, score.travel - 1.0)


def robust(costs: Sequence[float] | Vec, objective: ObjectiveSettings) -> float:
    """(w_mean mean J_p + w_tail mean of the worst J_p) / (w_mean + w_tail) [deg]; the worst are one plant at least."""
    values = np.sort(np.asarray(costs, dtype=np.float64))[::-1]
    worst = values[: max(1, round(objective.tail_share * len(values)))]
    total = objective.mean * float(np.mean(values)) + objective.tail * float(np.mean(worst))
    return total / (objective.mean + objective.tail)
