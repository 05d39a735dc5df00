"""Settings of a closed-loop study of two axes: plant, model, motions in the plane and controllers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, field_serializer, model_validator

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import AnyControllerSettings, ControllerSettings
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisLimitsSettings
from hystmpc.models.two_axes.model import has_two_axes
from hystmpc.trajectories.config import MotionInPlane
from hystmpc.trials.config import FolderName, NotNegative, NotNegativeInt, Settings, load_settings, read_yaml
from hystmpc.trials.errors import ConfigError

from ..config import EffectSettings, SimulationConfig, TuningSettings, one_run

_ONE_AXIS = ("inverse", "actuator_lag_s", "sensor")


class AxisChangesSettings(Settings):
    """Changes of one axis of the plant.

    Attributes:
        mismatch: factors on parameters by label, such as `prandtl_ishlinskii.a0`.
        effects: effects of the library in addition to those in the file.
    """

    mismatch: dict[str, float] = Field(default_factory=dict)
    effects: tuple[EffectSettings, ...] = ()


class TwoAxisPlantSettings(Settings):
    """Simulated device of two axes: a model file with changes.

    Attributes:
        simulator: a model of two axes (.yaml).
        x, y: changes of each axis; they act behind the tendons and in front of the sensor's frame.
        virgin: start without the initialisation flexure of each axis.
        lag_s: first-order lag of every command [s].
        delay_s: delay of every command [s].
        noise_deg: standard deviation of the white noise of each angle [deg].
        quantisation_deg: resolution of each angle [deg]; 0 for none.
    """

    simulator: str
    x: AxisChangesSettings = AxisChangesSettings()
    y: AxisChangesSettings = AxisChangesSettings()
    virgin: bool = False
    lag_s: NotNegative = 0.0
    delay_s: NotNegative = 0.0
    noise_deg: NotNegative = 0.0
    quantisation_deg: NotNegative = 0.0

    @property
    def name(self) -> str:
        """Name of the plant: its file."""
        return self.simulator


class TwoAxisSimulationConfig(Settings):
    """Closed-loop study of two axes: every controller follows every motion on one simulated device.

    Attributes:
        axes: 2, which the model says; a run writes it.
        plant: the simulated device.
        model: model of two axes (.yaml) of the controllers.
        motions: references in the plane of both angles by name, each with its `kind`.
        controllers: controllers by name, each with its `kind`; both axes have the same one.
        limits: hard limits of the commands; those of the model where left out.
        approach: lead the tip from the plant's rest to the start of a motion that starts far from it; this part does
            not count.
        tune_pid: search the gains of every `pid` and `inverse_pid` first; where left out the given gains are used.
        tuned: controllers whose gains such a search has found; a run writes them here beside the gains.
        seed: of the sensor noise.
    """

    axes: Literal[2] = 2
    plant: TwoAxisPlantSettings
    model: str
    motions: dict[FolderName, MotionInPlane] = Field(min_length=1)
    controllers: dict[FolderName, ControllerSettings] = Field(min_length=1)
    limits: TwoAxisLimitsSettings | None = None
    approach: bool = True
    tune_pid: TuningSettings | None = None
    tuned: tuple[FolderName, ...] = ()
    seed: NotNegativeInt = 0

    @model_validator(mode="before")
    @classmethod
    def _no_key_of_one_axis(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and (given := [name for name in _ONE_AXIS if name in data]):
            raise ValueError(f"got {', '.join(given)} and a model of two axes, expected none of these keys here")
        return data

    @field_serializer("controllers")
    def _as_given(self, controllers: Mapping[str, AnyControllerSettings]) -> dict[str, Any]:
        """What was given alone: some settings that are left out depend on what joins the axes."""
        return {name: one.model_dump(mode="json", exclude_unset=True) for name, one in controllers.items()}

    def narrowed(self, controller: str, motion: str) -> Self:
        """Return the study with one controller and one motion alone."""
        return self.model_copy(update=one_run(self, controller, motion))

    def command_limits(self) -> tuple[CommandLimits, ...]:
        """Limits of every command.

        Raises:
            ConfigError: if the settings leave the limits out.
        """
        if self.limits is None:
            raise ConfigError("limits: got none, expected those of a run's resolved settings")
        rows = zip(self.limits.lower, self.limits.upper, self.limits.rate_per_s, strict=True)
        return tuple(CommandLimits(*row) for row in rows)


AnyStudyConfig = SimulationConfig | TwoAxisSimulationConfig


def parse_study(
    data: Any, where: str | Callable[[Sequence[str | int]], str], folder: Path | None = None
) -> AnyStudyConfig:
    """Study of plain data, of one axis or of two; a relative name of its model starts at `folder`.

    Raises:
        ConfigError: on an unknown key or a value out of bounds; begins with `where`.
    """
    kind = TwoAxisSimulationConfig if says_two_axes(data, folder or Path()) else SimulationConfig
    return kind.parse(data, where)


def says_two_axes(data: Any, folder: Path) -> bool:
    """Whether the plain data of a study is of two axes: it says so, or its model is, relative to a folder."""
    if not isinstance(data, Mapping):
        return False
    return data.get("axes") == 2 or (isinstance(data.get("model"), str) and has_two_axes(folder / data["model"]))


def file_of_two_axes(path: Path | str) -> bool:
    """Whether a study's file is of two axes; what cannot be read is not."""
    try:
        return says_two_axes(read_yaml(path), Path(path).resolve().parent)
    except ConfigError:
        return False


def load_two_axis_simulation(path: Path | str, overrides: Iterable[str] = ()) -> TwoAxisSimulationConfig:
    """Read a study; relative file names start at its folder and become absolute.

    Raises:
        ConfigError: on an unreadable file, a malformed override, an unknown key or a value out of bounds.
    """
    return located_plane(load_settings(TwoAxisSimulationConfig, path, tuple(overrides)), Path(path).resolve().parent)


def located_plane(config: TwoAxisSimulationConfig, folder: Path) -> TwoAxisSimulationConfig:
    """Return the study with absolute file names, relative ones starting at `folder`."""
    plant = config.plant.model_copy(update={"simulator": str(folder / config.plant.simulator)})
    return config.model_copy(update={"plant": plant, "model": str(folder / config.model)})
