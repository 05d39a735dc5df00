"""Settings of a closed-loop study: plant, model, motions and controllers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError, model_validator

from hystmpc.ctrl.command import ModelledLimitsSettings
from hystmpc.ctrl.config import ControllerSettings, sensor_fault, with_sensor_facts
from hystmpc.ctrl.loop import AnySensorSettings, ContinuousSensorSettings, SimulatedSensor
from hystmpc.models.effects.place import EffectError, effect_from
from hystmpc.models.load import absolute_name
from hystmpc.trajectories.config import Motion, motion_in
from hystmpc.trials.config import (
    FolderName,
    MisplacedError,
    NotNegative,
    NotNegativeInt,
    Settings,
    load_settings,
    place_in,
)
from hystmpc.trials.errors import ModelError
from hystmpc.trials.layouts import is_mapping_file
from hystmpc.trials.read import read_trials
from hystmpc.trials.types import Vec

from .devices.names import DeviceError, device_parameters


class EffectSettings(Settings):
    """Block of one effect of the library; see `hystmpc effects` for names, parameters, units and bounds.

    Attributes:
        side: of the core; the effect's first where left out.
        parameters: by name; those left out have their neutral values, if they have any.
        terms, ways, harmonics, seed: sizes of creep, lag, periodic disturbance and sensor; all but the seed also follow
            from the names of the parameters.
        effect: its name.
    """

    effect: str
    side: str | None = None
    parameters: dict[str, float] = Field(default_factory=dict)
    terms: int | None = None
    ways: int | None = None
    harmonics: int | None = None
    seed: int | None = None

    @model_validator(mode="after")
    def _known_effect(self) -> Self:
        try:
            effect_from(self.model_dump(exclude_none=True))
        except EffectError as error:
            raise MisplacedError(str(error), error.at) from None
        return self


class InputSignal(Settings):
    """Measured input of the plant over the time of a run: a number, or a signal of a log.

    Attributes:
        value: constant; a number alone in place of the block says the same.
        log: file that holds the input under its name, or by `layout`; its first value also counts at rest, and the last
            one is held.
        layout: of the log: auto, canonical, tendon-catheter, or a mapping file *.yaml.
    """

    value: float | None = None
    log: str | None = None
    layout: str = "auto"

    @model_validator(mode="before")
    @classmethod
    def _number_alone(cls, data: Any) -> Any:
        return {"value": data} if isinstance(data, int | float) and not isinstance(data, bool) else data

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.value is None) == (self.log is None):
            raise ValueError("expected one of `value: NUMBER` and `log: FILE`")
        return self

    def in_folder(self, folder: Path) -> Self:
        """The same with absolute file names, relative ones starting at `folder`."""
        files = {"log": self.log, "layout": self.layout if is_mapping_file(self.layout) else None}
        return self.model_copy(update={k: str((folder / name).resolve()) for k, name in files.items() if name})

    def at(self, name: str, t: Vec) -> Vec:
        """Values (T,) at times t (T,) [s] from the reset on.

        Raises:
            LogError: if the log cannot be read, or has no such signal.
        """
        if self.log is None:
            return np.full(t.shape, self.value)
        trial = read_trials(self.log, self.layout)[0].with_inputs([name])
        return np.interp(t, trial.t - trial.t[0], trial.inputs[name])


class PlantSettings(Settings):
    """Simulated plant: a simulator or a device, with additional effects; see `make_plant` and `Effects`.

    Attributes:
        simulator: a simulator file, or `builtin:NAME`.
        device: in its place, a device whose physics is not made of operators: tendon, muscle or rod.
        parameters: numbers of the device other than its defaults, by name.
        mismatch: factors on parameters, of a simulator by label such as `prandtl_ishlinskii.a0`, of a device by name.
        effects: effects of the library in addition to lag, delay, noise and quantisation.
        virgin: start without the initialisation flexure.
        inputs: measured inputs on which the simulator depends, by name; the identified values where left out. The
            controllers measure them, too.
        lag_s: first-order lag of the command [s].
        delay_s: delay of the command [s].
        noise_deg: standard deviation of the sensor's white noise [deg].
        quantisation_deg: resolution of the sensor [deg]; 0 for none.
    """

    simulator: str | None = None
    device: str | None = None
    parameters: dict[str, float] = Field(default_factory=dict)
    lag_s: NotNegative = 0.0
    delay_s: NotNegative = 0.0
    noise_deg: NotNegative = 0.0
    quantisation_deg: NotNegative = 0.0
    mismatch: dict[str, float] = Field(default_factory=dict)
    effects: tuple[EffectSettings, ...] = ()
    virgin: bool = False
    inputs: dict[str, InputSignal] = Field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the plant: its file, `builtin:NAME`, or the device's name."""
        return str(self.simulator) if self.device is None else f"device {self.device}"

    @model_validator(mode="after")
    def _one_plant(self) -> Self:
        if (self.simulator is None) == (self.device is None):
            got = "none" if self.device is None else "both"
            raise ValueError(f"got {got} of simulator and device, expected one: a file or builtin:NAME, or a name")
        if self.device is None:
            if names := ", ".join(self.parameters):
                expected = "expected none: its numbers stand in its file, see mismatch"
                raise MisplacedError(f"got {names} for a simulator, {expected}", ("parameters",))
            return self
        if names := ", ".join(self.inputs):
            raise MisplacedError(f"got {names} for a device, expected none: a simulator has them", ("inputs",))
        try:
            device_parameters(self.device, self.parameters, self.mismatch)
        except DeviceError as error:
            raise MisplacedError(str(error), error.at) from None
        return self


class TuningSettings(Settings):
    """Settings of the search for PID gains.

    Attributes:
        evaluations: closed-loop runs over all motions, about, for each controller.
    """

    evaluations: Annotated[int, Field(ge=10)] = 300


class SimulationConfig(Settings):
    """Closed-loop study in which every controller follows every motion on one simulated plant.

    Attributes:
        model: model of the controllers: a simulator (.yaml), an exported model (.onnx), or `builtin:NAME`.
        actuator_lag_s: first-order lag of the command, missing in the model, that controllers take into account.
        inverse: simulator (.yaml) that is inverted in the model's place: `inverse` and `inverse_pid` know nothing else,
            predictive controllers take their first guess from it. For networks, which have no inverse of their own;
            where left out, a backlash fitted to the network's free run. Or an inverse map (.onnx, or .yaml for
            an operator), which is asked for the command and runs beside the model.
        sensor: sensor of the controllers: the plant's own sensor in every sample, frames of an imaging system, or
            nothing. Its facts on frames and noise are defaults of every controller's block `estimator`.
        limits: hard limits of command and rate; those of the model where left out. Wider ones are refused unless
            `limits.beyond_model` is true.
        approach: lead the tip from the plant's rest to the start of a motion that starts far from it; this part does
            not count. Without it, the first jump is scored too.
        tune_pid: search the gains of every `pid` and `inverse_pid` first; where left out the given gains are used.
        tuned: controllers whose gains such a search has found; a run writes them here beside the gains, so that its
            configuration repeats the run without the search.
        plant: the simulated device.
        motions: references by name, each with its `kind`.
        controllers: controllers by name, each with its `kind`.
        seed: of sensor noise and disturbances.
    """

    plant: PlantSettings
    model: str
    inverse: str | None = None
    actuator_lag_s: NotNegative = 0.0
    sensor: SimulatedSensor = ContinuousSensorSettings()
    motions: dict[FolderName, Motion] = Field(min_length=1)
    controllers: dict[FolderName, ControllerSettings] = Field(min_length=1)
    limits: ModelledLimitsSettings | None = None
    approach: bool = True
    tune_pid: TuningSettings | None = None
    tuned: tuple[FolderName, ...] = ()
    seed: NotNegativeInt = 0

    def narrowed(self, controller: str, motion: str) -> Self:
        """Return the study with one controller and one motion alone."""
        return self.model_copy(update=one_run(self, controller, motion))

    @model_validator(mode="before")
    @classmethod
    def _require_controllers(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not isinstance(data.get("controllers"), Mapping):
            return data
        try:
            sensor: AnySensorSettings = _SENSORS.validate_python(data.get("sensor", {"kind": "continuous"}))
        except ValidationError:  # the field itself says what is wrong
            return data
        keys, blocks = sensor.estimator_keys(), data["controllers"].items()
        return {**data, "controllers": {name: with_sensor_facts(block, keys) for name, block in blocks}}

    @model_validator(mode="after")
    def _controllers_fit_the_sensor(self) -> Self:
        for name, settings in self.controllers.items():
            if fault := sensor_fault(settings, self.sensor.kind):
                raise MisplacedError(f"controllers.{name}.{fault}", ("controllers", name, "estimator"))
        return self


def one_run(config: Any, controller: str, motion: str) -> dict[str, Any]:
    """Changes of a study, of one axis or of two, that leave one controller and one motion."""
    return {
        "motions": {motion: config.motions[motion]},
        "controllers": {controller: config.controllers[controller]},
        "tuned": tuple(name for name in config.tuned if name == controller),
    }


_SENSORS: TypeAdapter[AnySensorSettings] = TypeAdapter(SimulatedSensor)


def load_simulation(path: Path | str, overrides: Iterable[str] = ()) -> SimulationConfig:
    """Read a study; relative file names start at its folder and become absolute.

    Raises:
        ConfigError: on an unreadable file, a malformed override, an unknown key or a value out of bounds.
        ModelError: on an unknown built-in model.
    """
    changes = tuple(overrides)
    config = load_settings(SimulationConfig, path, changes)
    return located(config, Path(path).resolve().parent, place_in(path, changes))


def located(
    config: SimulationConfig, folder: Path, where: Callable[[Sequence[str | int]], str] | None = None
) -> SimulationConfig:
    """Return the study with absolute file names, relative ones starting at `folder`; built-in models keep their names.

    Raises:
        ModelError: on an unknown built-in model.
    """

    def file(text: str, *keys: str) -> str:
        try:
            return absolute_name(text, folder)
        except ModelError as error:
            raise ModelError(f"{where(keys)}: {'.'.join(keys)}: {error}" if where else str(error)) from None

    device = config.plant.simulator
    plant: dict[str, Any] = {"simulator": None if device is None else file(device, "plant", "simulator")}
    plant["inputs"] = {name: one.in_folder(folder) for name, one in config.plant.inputs.items()}
    changes = {
        "plant": config.plant.model_copy(update=plant),
        "model": file(config.model, "model"),
        "inverse": None if config.inverse is None else file(config.inverse, "inverse"),
        "motions": {name: motion_in(folder, motion) for name, motion in config.motions.items()},
    }
    return config.model_copy(update=changes)
