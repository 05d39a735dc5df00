"""Settings of a tuning: study, controller, search ranges by default or given, and the plants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hystmpc.ctrl.config import AnyControllerSettings, parse_controller
from hystmpc.models.two_axes.model import load_two_axes
from hystmpc.trials.config import Count, NotNegative, NotNegativeInt, Settings
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.json_text import json_hash

from ..config import PlantSettings
from ..plants.device import varied_parameters
from ..sweep.settings import DrawSettings, PlainStudy, changed, path_parts, place, study_of, value_at
from ..two_axes.config import AnyStudyConfig, TwoAxisPlantSettings, TwoAxisSimulationConfig, parse_study

_ESTIMATOR = {
    "estimator.sensor_sigma_deg": DrawSettings(log_uniform=(0.03, 1.0)),
    "estimator.drift_sigma_deg_per_sqrt_s": DrawSettings(log_uniform=(0.03, 5.0)),
    "estimator.motion_sigma_deg_per_sqrt_unit": DrawSettings(uniform=(0.0, 6.0)),
    "estimator.dead_band_gain_deg_per_unit": DrawSettings(uniform=(0.0, 2.0)),
}
_GAINS = {
    "gains.kp_per_deg": DrawSettings(log_uniform=(1e-4, 0.2)),
    "gains.ki_per_deg_s": DrawSettings(log_uniform=(1e-2, 3.0)),
    "gains.kd_s_per_deg": DrawSettings(uniform=(0.0, 0.01)),
    "gains.dead_zone_deg": DrawSettings(uniform=(0.0, 0.5)),
}
_WEIGHTS = {
    "weights.rate": DrawSettings(log_uniform=(0.05, 100.0)),
    "weights.rate_close": DrawSettings(log_uniform=(0.002, 30.0)),
    "weights.terminal": DrawSettings(log_uniform=(0.1, 20.0)),
    "weights.effort": DrawSettings(log_uniform=(1e-4, 0.3)),
}
_HORIZON = {"horizon": DrawSettings(integer=(5, 30))}
_SAMPLING = {"sigma": DrawSettings(log_uniform=(0.03, 1.5)), "temperature": DrawSettings(log_uniform=(2e-3, 0.5))}
# By kind of controller. Samples, iterations and solvers are not searched: they trade error for computing time.
SPACES: dict[str, dict[str, DrawSettings]] = {
    "inverse": {**_ESTIMATOR, "reference_dead_zone_deg": DrawSettings(uniform=(0.0, 0.3))},
    "pid": _GAINS,
    "inverse_pid": {**_GAINS, "reference_dead_zone_deg": DrawSettings(uniform=(0.0, 0.3))},
    "linearised_mpc": {**_WEIGHTS, **_HORIZON, **_ESTIMATOR},
    "sampling_mpc": {**_WEIGHTS, **_HORIZON, **_ESTIMATOR, **_SAMPLING},
}

_LAG_S = (0.0, 0.15)
_NOISE_DEG = (0.05, 0.3)
_FACTOR = (0.9, 1.1)
_FROM_MODEL = ("weights.rate", "weights.rate_close")  # of two axes they follow from the model where left out


def default_space(settings: AnyControllerSettings) -> dict[str, DrawSettings]:
    """Return the default search ranges by dotted path below a controller.

    Raises:
        ConfigError: for an external controller, which has no known ranges.
    """
    if settings.kind not in SPACES:
        raise ConfigError(f"search: got none for {settings.kind}, expected ranges: only {', '.join(SPACES)} have some")
    return dict(SPACES[settings.kind])


def default_draws(plant: PlantSettings | TwoAxisPlantSettings) -> dict[str, DrawSettings]:
    """Return the default distributions: lag, noise, and plus or minus a tenth for each parameter that varies.

    Raises:
        ModelError: if the plant's file is missing or unusable.
    """
    draws = {"plant.lag_s": DrawSettings(uniform=_LAG_S), "plant.noise_deg": DrawSettings(uniform=_NOISE_DEG)}
    factor = DrawSettings(uniform=_FACTOR)
    if isinstance(plant, TwoAxisPlantSettings):
        axes = zip("xy", load_two_axes(plant.simulator).axes, strict=True)
        return draws | {f'plant.{n}.mismatch."{label}"': factor for n, axis in axes for label in axis.chain.labels}
    return draws | {f'plant.mismatch."{label}"': factor for label in varied_parameters(plant)}


class PlantsSettings(Settings):
    """Set of plants for the search or for the final check.

    Attributes:
        count: number of plants.
        seed: of the draws and of the plants' noise.
    """

    count: Count
    seed: NotNegativeInt


class ObjectiveSettings(Settings):
    """Weights of the objective [deg]; see `objective.robust`.

    Attributes:
        mean, tail: weights of the mean over the plants and of the mean over the worst of them.
        tail_share: share of the plants that count as the worst.
        violation_deg: added to the error of a plant with a command beyond a limit.
        chatter_deg: added per command travel beyond the need of the motion, relative to that need.
    """

    mean: NotNegative = 0.5
    tail: NotNegative = 0.5
    tail_share: Annotated[float, Field(gt=0, le=1)] = 0.1
    violation_deg: NotNegative = 10.0
    chatter_deg: NotNegative = 0.1

    @model_validator(mode="after")
    def _something(self) -> ObjectiveSettings:
        if self.mean + self.tail <= 0:
            raise ValueError("got mean 0 and tail 0, expected one of them positive")
        return self


class MarginsSettings(Settings):
    """Block `margins`: what every point of the search has to keep around the study's model, see `hystmpc analyse`.

    Attributes:
        gain: least gain margin, a factor.
        phase_deg: least phase margin.
        cycle_deg: greatest predicted oscillation.
        penalty_deg: added to the error for each of the three that is not kept.
    """

    gain: Annotated[float, Field(ge=1)] = 2.0
    phase_deg: NotNegative = 45.0
    cycle_deg: NotNegative = 0.5
    penalty_deg: NotNegative = 10.0


class TuneSettings(Settings):
    """Settings of a tuning.

    Attributes:
        base: the study: plant, model, motions; a file, or the settings themselves.
        controller: name of the tuned one; may be left out where the study has only one.
        search: range by dotted path below the controller; `default_space` of its kind where left out.
        draw: distribution by dotted path of the differences between plants; `default_draws` where left out.
        held_out: plants for the final check; drawn with another seed.
        trials: points of the search, the given settings being the first.
        pruner: rule that ends a trial before it has run on all plants.
        plants: of the search.
        objective: weights of the cost.
        margins: constraints on the loop around the model; null for none.
        seed: of the search.
    """

    base: str | dict[str, Any]
    controller: str | None = None
    search: dict[str, DrawSettings] = Field(default_factory=dict)
    draw: dict[str, DrawSettings] = Field(default_factory=dict)
    plants: PlantsSettings = PlantsSettings(count=10, seed=1)
    held_out: PlantsSettings = PlantsSettings(count=20, seed=2)
    objective: ObjectiveSettings = ObjectiveSettings()
    margins: MarginsSettings | None = None
    trials: Count = 60
    pruner: Literal["median", "hyperband", "none"] = "median"
    seed: NotNegativeInt = 0

    @model_validator(mode="after")
    def _apart(self) -> TuneSettings:
        if self.plants.seed == self.held_out.seed:
            raise ValueError(f"held_out.seed: got {self.held_out.seed}, that of `plants`, expected another")
        return self

    @property
    def study(self) -> AnyStudyConfig:
        """Return the study of one axis or of two, with the tuned controller alone."""
        return parse_study(self.base, "base")

    @property
    def given(self) -> AnyControllerSettings:
        """Return the controller before tuning."""
        return next(iter(self.study.controllers.values()))

    @property
    def fingerprint(self) -> str:
        """Hash of everything but the number of trials, which may grow; 12 hexadecimal digits."""
        left_out = {"trials", "held_out", *(("margins",) if self.margins is None else ())}
        return json_hash(self.model_dump(mode="json", exclude=left_out))[:12]

    @property
    def search_name(self) -> str:
        """Name of the search in its storage."""
        return f"hystmpc-{self.fingerprint}"

    @property
    def given_values(self) -> dict[str, Any]:
        """Return the searched settings at their given values; None for one that follows from the model of two axes."""
        given, study = self.given, self.study
        plain, values = given.model_dump(mode="json"), dict[str, Any]()
        for path in self.search:
            values[path] = value_at(plain, path)
            if isinstance(study, TwoAxisSimulationConfig) and path in _FROM_MODEL and not _is_set(given, path):
                values[path] = None
        return values

    def with_values(self, values: dict[str, Any]) -> AnyControllerSettings:
        """Return the controller with some settings changed; of two axes those that are left out stay so."""
        study = self.study
        data: Any = plain_controller(self.given, study)
        given = self.given_values if isinstance(study, TwoAxisSimulationConfig) else {}
        for path, value in values.items():
            if path not in given or value != given[path]:
                data = changed(data, path, value, self.given.model_dump(mode="json"))
        return parse_controller(data, "controller")


def complete(settings: TuneSettings, path: Path) -> TuneSettings:
    """Return the checked tuning of the file `path` with its study, the search space and all other defaults filled in.

    Raises:
        ConfigError: if study, controller or a path is wrong; names the line.
        ModelError: if a model is unknown, or the plant's file is missing or unusable.
    """
    study = study_of(settings.base, path)
    name = _chosen(settings.controller, study, path)
    only = {"controllers": {name: study.controllers[name]}, "tuned": (), "tune_pid": None}
    alone = study.model_copy(update=only)
    completed = settings.model_copy(
        update={
            "base": alone.model_dump(mode="json"),
            "controller": name,
            "search": settings.search or default_space(alone.controllers[name]),
            "draw": settings.draw or default_draws(alone.plant),
        }
    )
    _check(completed, path)
    return completed


def plain_controller(settings: AnyControllerSettings, study: AnyStudyConfig) -> dict[str, Any]:
    """Plain data of a controller in a study; of two axes what was given alone, see `TwoAxisSimulationConfig`."""
    return settings.model_dump(mode="json", exclude_unset=isinstance(study, TwoAxisSimulationConfig))


def _is_set(settings: AnyControllerSettings, path: str) -> bool:
    """Whether a setting was given."""
    block: Any = settings
    *blocks, last = path_parts(path)
    for name in blocks:
        block = getattr(block, name, None)
    return block is not None and last in block.model_fields_set


def _chosen(name: str | None, study: AnyStudyConfig, path: Path) -> str:
    if name is None and len(study.controllers) == 1:
        return next(iter(study.controllers))
    if name not in study.controllers:
        got = "none" if name is None else repr(name)
        there = did_you_mean(name or "", study.controllers)
        raise ConfigError(f"{place(path, 'controller')}controller: got {got}, {there}")
    return str(name)


def _check(settings: TuneSettings, path: Path) -> None:
    given, plain = settings.given.model_dump(mode="json"), PlainStudy.of(settings.study)
    if settings.margins is not None and isinstance(settings.study, TwoAxisSimulationConfig):
        raise ConfigError(f"{place(path, 'margins')}margins: got a study of two axes, expected none: loops of one axis")
    for block, ranges in (("search", settings.search), ("draw", settings.draw)):
        for key, one in ranges.items():
            try:
                for end in one.ends:
                    if block == "search":
                        value_at(given, key)
                        settings.with_values({key: end})
                    else:
                        parse_study(plain.changed(key, end).data, "study")
            except ConfigError as error:
                raise ConfigError(f"{place(path, block, key)}{block}: {error}") from None
