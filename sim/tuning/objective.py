"""Cost of a controller over a set of plants, comparison on held-out plants, and result of a tuning."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hystmpc.ctrl.config import AnyControllerSettings
from hystmpc.trajectories import PreviewTable
from hystmpc.trials.brief import in_brief
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Progress, Vec

from ..config import SimulationConfig
from ..jobs import Backend, run_jobs
from ..results import result_of
from ..study import Study
from ..sweep.plan import prepared
from ..sweep.settings import PlainStudy, drawn
from ..two_axes.config import AnyStudyConfig, parse_study
from ..two_axes.study import AnyStudy
from .settings import ObjectiveSettings, PlantsSettings, TuneSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hystmpc.ctrl.linear.report import LoopsAnalysis

_RESAMPLES = 4000
_NAMES = ("given", "tuned")
State = Literal["done", "pruned", "failed", "elsewhere"]


@dataclass(frozen=True)
class PlantScore:
    """Score of one controller on one plant over all motions."""

    error_deg: float  # root mean square error [deg]
    travel: float  # command travel relative to the need of the motions; 1 is the least
    violations: int  # samples beyond a limit
    axes_deg: tuple[float, ...] = ()  # root mean square errors of x and y of two axes [deg]


def plant_config(
    settings: TuneSettings, plants: PlantsSettings, number: int, controller: AnyControllerSettings
) -> AnyStudyConfig:
    """Return the study of plant `number` of a set."""
    plain = PlainStudy.of(settings.study)
    for path, value in drawn(settings.draw, plants.seed, number).items():
        plain = plain.changed(path, value)
    study = parse_study(plain.data, f"plant {number}")
    # Every plant has its own realisation of the noise, different from those of other sets.
    seed = int(np.random.SeedSequence([plants.seed, number]).generate_state(1)[0])
    return study.model_copy(update={"seed": seed, "controllers": {str(settings.controller): controller}})


def plant_score(config: AnyStudyConfig) -> PlantScore:
    """Compute the score of one controller along every motion."""
    study = prepared(config)
    ((name, controller),) = study.config.controllers.items()
    squares, axes, travel, need, beyond = [], [], 0.0, 0.0, 0
    for motion in study.motions:
        run = study.run(controller, motion)
        metrics = result_of(study.config, motion, name, run).metrics
        squares.append(metrics.rmse_deg**2)
        axes.append(np.square(run.axis_rmse_deg))
        travel += metrics.command_travel
        need += needed_travel(study, motion)
        beyond += metrics.limit_violations
    each = tuple(np.sqrt(np.mean(axes, axis=0)).tolist())
    return PlantScore(math.sqrt(float(np.mean(squares))), travel / max(need, 1e-9), beyond, each)


def loops_around(settings: TuneSettings, controllers: Mapping[str, AnyControllerSettings]) -> LoopsAnalysis:
    """Analyse controllers around the study's model, without learning from the plants.

    Raises:
        ModelError: if the model cannot be used.
        ControllerError: if the settings contradict the model.
    """
    from hystmpc.ctrl.command import limits_of_model, modelled_limits
    from hystmpc.ctrl.linear.report import loops_of
    from hystmpc.models.load import load_model, model_path

    study = settings.study
    if not isinstance(study, SimulationConfig):
        raise ModelError("loops: got a study of two axes, expected one axis")
    model = load_model(model_path(study.model), "conditioned")
    limits = modelled_limits(study.limits, limits_of_model(model.metadata))
    tolerance = {} if settings.margins is None else {"tolerance_deg": settings.margins.cycle_deg}
    return loops_of(model, study.model, controllers, limits, study.actuator_lag_s, **tolerance)


def margin_penalty(settings: TuneSettings, controller: AnyControllerSettings) -> float:
    """Penalty of a controller whose loop does not keep `margins` [deg]; 0 without them, and for one not analysed."""
    wanted = settings.margins
    if wanted is None:
        return 0.0
    (one,) = loops_around(settings, {"tried": controller}).controllers
    if one.margins is None:
        return 0.0
    m = one.margins
    missed = (not m.stable or m.gain < wanted.gain, not m.stable or m.phase_deg < wanted.phase_deg, one.too_great)
    return wanted.penalty_deg * sum(missed)


def needed_travel(study: AnyStudy, motion: str) -> float:
    """Command travel of the model's inverse along a motion, without feedback and noise [command unit].

    sum_k |u_k - u_{k-1}| with u_k = inverse(x_k, r_k) within the limits, from the plant's rest; of two axes over all
    commands.
    """
    if not isinstance(study, Study):
        return study.needed_travel(motion)
    predictor, inverse = study.model.feedforward
    reference = PreviewTable(study.motions[motion], predictor.dt, 1)
    u, travel = study.plant.rest_command, 0.0
    state = predictor.initial(float(reference.at(0)[0]), u)
    for k in range(reference.steps):
        wanted = study.limits.clip(inverse.command(state, float(reference.at(k)[0]), u), u, predictor.dt)
        travel, u = travel + abs(wanted - u), wanted
        _, state = predictor.advance(state, u)
    return travel


def plant_cost(score: PlantScore, objective: ObjectiveSettings) -> float:
    """Cost of one plant, J = error + violation_deg [any violation] + chatter_deg max(0, travel - 1) [deg]."""
    beyond = objective.violation_deg if score.violations else 0.0
    return score.error_deg + beyond + objective.chatter_deg * max(0.0, score.travel - 1.0)


def robust(costs: Sequence[float] | Vec, objective: ObjectiveSettings) -> float:
    """Robust objective (w_mean mean J_p + w_tail mean of the worst J_p) / (w_mean + w_tail) [deg]."""
    values = np.sort(np.asarray(costs, dtype=np.float64))[::-1]
    worst = values[: max(1, round(objective.tail_share * len(values)))]
    total = objective.mean * float(np.mean(values)) + objective.tail * float(np.mean(worst))
    return total / (objective.mean + objective.tail)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Scores of given and tuned settings on the same held-out plants with the same noise."""

    given: tuple[PlantScore, ...]
    tuned: tuple[PlantScore, ...]
    objective: ObjectiveSettings

    def costs(self, name: str) -> Vec:
        """Return the cost of `given` or `tuned` on every plant (P,) [deg]."""
        return np.array([plant_cost(score, self.objective) for score in getattr(self, name)])

    def errors(self, name: str) -> Vec:
        """Return the error on every plant (P,) [deg]."""
        return np.array([score.error_deg for score in getattr(self, name)])

    def value(self, name: str) -> float:
        """Robust objective of `given` or `tuned` [deg]."""
        return robust(self.costs(name), self.objective)

    @property
    def gain(self) -> float:
        """Relative gain, 1 - tuned / given of the robust objective."""
        return 1.0 - self.value("tuned") / self.value("given")

    def interval(self, share: float = 0.9) -> tuple[float, float]:
        """Confidence interval of the gain over resampled plants (paired bootstrap, seeded)."""
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
        """Number of plants on which the tuned settings have the lower cost."""
        return int(np.sum(self.costs("tuned") < self.costs("given")))

    @property
    def axes(self) -> str:
        """Names of the axes of two; empty of one."""
        return "xy"[: len(self.given[0].axes_deg)]

    def rows(self) -> list[tuple[Any, ...]]:
        """Return name, objective, mean error, error on the worst plant, mean travel, plants with a violation.

        Of two axes the mean error is followed by those of x and of y.
        """
        rows = []
        for name in _NAMES:
            scores: tuple[PlantScore, ...] = getattr(self, name)
            errors, travel = self.errors(name), float(np.mean([score.travel for score in scores]))
            beyond = sum(score.violations > 0 for score in scores)
            means = float(errors.mean()), *np.mean([score.axes_deg for score in scores], axis=0).tolist()
            rows.append((name, self.value(name), *means, float(errors.max()), travel, beyond))
        return rows

    def columns(self) -> dict[str, Any]:
        """Return the table with one row for each plant."""
        table: dict[str, Any] = {"plant": np.arange(len(self.given))}
        for name in _NAMES:
            scores: tuple[PlantScore, ...] = getattr(self, name)
            table[f"{name}_error_deg"] = self.errors(name)
            for k, axis in enumerate(self.axes):
                table[f"{name}_error_{axis}_deg"] = np.array([score.axes_deg[k] for score in scores])
            table[f"{name}_cost_deg"] = self.costs(name)
            table[f"{name}_travel"] = np.array([score.travel for score in scores])
            table[f"{name}_violations"] = np.array([score.violations for score in scores])
        return table


def held_out(
    settings: TuneSettings, values: dict[str, Any], backend: Backend, progress: Progress | None = None
) -> HeldOut:
    """Compute the scores of given and tuned settings on every held-out plant."""
    cases = [(name, number) for number in range(settings.held_out.count) for name in _NAMES]
    scored = partial(_held_out_score, settings, values)
    scores = dict(
        run_jobs(scored, cases, backend, total=len(cases), progress=progress, note=lambda _: "held-out plants")
    )
    given, tuned = (tuple(scores[name, number] for number in range(settings.held_out.count)) for name in _NAMES)
    return HeldOut(given, tuned, settings.objective)


def _held_out_score(
    settings: TuneSettings, tuned: Mapping[str, Any], case: tuple[str, int]
) -> tuple[tuple[str, int], PlantScore]:
    name, number = case
    controller = settings.with_values(dict(tuned) if name == "tuned" else {})
    return case, plant_score(plant_config(settings, settings.held_out, number, controller))


@dataclass(frozen=True)
class SlotOutcome:
    """Outcome of one trial of a search; `elsewhere`: another process executes it."""

    slot: int
    state: State
    message: str = ""


@dataclass(frozen=True)
class SearchTrial:
    """Finished trial of a search."""

    slot: int
    state: State  # `done` or `pruned`
    value: float  # robust objective over the plants so far [deg]
    values: Mapping[str, Any]
    error_deg: float  # robust objective of the errors alone [deg]
    travel: float  # mean command travel relative to the need
    plants: int


def pareto_front(trials: Sequence[SearchTrial]) -> tuple[SearchTrial, ...]:
    """Trials not dominated in error and travel, by rising error; pruned ones are left out."""
    front: list[SearchTrial] = []
    for trial in sorted((t for t in trials if t.state == "done"), key=lambda t: (t.error_deg, t.travel)):
        if not front or trial.travel < front[-1].travel:
            front.append(trial)
    return tuple(front)


@dataclass(frozen=True)
class Tuning:
    """Outcome of a tuning: trials by slot, pruned ones included, and the check on the held-out plants."""

    settings: TuneSettings
    trials: tuple[SearchTrial, ...]
    best: SearchTrial
    check: HeldOut
    failed: tuple[SlotOutcome, ...]

    def __repr__(self) -> str:
        given, tuned = (float(self.check.costs(name).mean()) for name in ("given", "tuned"))
        text = f"{self.settings.controller}, {len(self.trials)} trials: cost {given:.4g} as given, {tuned:.4g} tuned"
        return in_brief(self, text)

    def plot(self) -> Figure:
        """Draw the cost of every held-out plant, tuned against given; below the diagonal the tuning is better."""
        from hystmpc.trials.report import MEASURED, REFERENCE, new_figure  # matplotlib, which a search does not need

        given, tuned = self.check.costs("given"), self.check.costs("tuned")
        reach = 1.05 * float(max(given.max(), tuned.max()))
        with new_figure(4.2, 3.8) as figure:
            axes = figure.subplots()
            axes.plot((0, reach), (0, reach), color=REFERENCE, lw=0.8)
            axes.plot(given, tuned, "o", color=MEASURED, ms=4)
            axes.set(xlabel="given [deg]", ylabel="tuned [deg]", xlim=(0, reach), ylim=(0, reach), aspect="equal")
        return figure

    def _repr_html_(self) -> str:
        from hystmpc.trials.report import KeyValues, Plot, Report, Table

        means = ("mean error [deg]", *(f"mean error {axis} [deg]" for axis in self.check.axes))
        columns = ("settings", "objective [deg]", *means, "worst plant [deg]", "travel", "violations")
        pieces = Table(columns, self.check.rows()), KeyValues(dict(self.best.values)), Plot(self.plot())
        return Report(f"Tuning of {self.settings.controller}", pieces, "plants not seen in the search").fragment()
