"""Settings of benches and experiments, shared by `run` and `record`, and those of `run` alone."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from hystmpc.ctrl.command import CommandLimits, LimitsSettings, ModelledLimitsSettings
from hystmpc.ctrl.config import sensor_fault, with_sensor_facts
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.models.load import absolute_name
from hystmpc.trajectories.config import Motion, motion_in
from hystmpc.trials.config import FolderName, NotNegative, Positive, Settings, load_settings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.from_outside import with_kind

from .axes import InputNames, each
from .experiment.phases import PrepareStep, PretensionSettings
from .live.desk import LiveSettings
from .realtime import RealtimeSettings
from .safety.intake import SensorSettings
from .safety.plausibility import PlausibilitySettings
from .safety.ramp import RampSettings
from .transports.dds import DdsSettings
from .transports.from_outside import GROUP, PythonSettings
from .transports.simulated import ReplaySettings, SimulatedSettings
from .transports.transport import TransportBase, WireUnits
from .transports.udp import UdpSettings

# The table of transports: a new one of the package is one file and one line here. Those from outside are `python`.
TRANSPORTS: Mapping[str, type[TransportBase]] = {
    "simulated": SimulatedSettings,
    "replay": ReplaySettings,
    "udp": UdpSettings,
    "dds": DdsSettings,
    "python": PythonSettings,
}
TransportSettings = Annotated[
    SimulatedSettings | ReplaySettings | UdpSettings | DdsSettings | PythonSettings,
    Field(discriminator="kind"),
    BeforeValidator(with_kind(TRANSPORTS, GROUP)),
]


_WITH_INPUTS = ("udp", "simulated", "python")


class BenchSettings(Settings):
    """Settings of a bench: device, limits, ramps, sensor, transport, preparation.

    Attributes:
        name: of the device; a latched stop belongs to it.
        rate_hz: samples per second.
        command_unit: of every command here, in logs and in trials.
        limits: hard limits of value and rate, applied once more right before the wire.
        ramps: how the loop moves the command by itself.
        start_command: what the device holds at the start; null asks the device, which has to tell then.
        safe_command: where a stop leads. Choose the command to which the device's own watchdog leads.
        stop_overshoot: how far a stop may go on in the direction of the motion, in the command's unit; null takes the
            smaller of 0.2 and 2 % of the range of `limits`.
        plausibility: how far commanded and measured motion may disagree.
        sensor: plausibility of the angle.
        wire: units of the device.
        transport: the wire itself.
        prepare: steps before the first sample of the experiment.
        realtime: scheduling.
        connect_timeout_s: how long to wait for the first angle.
        latch_file: where a stop is remembered; by name of the device in the user's state folder where left out.
        inputs: measured inputs that every reading has, such as `[pressure_bar]`, in their order on the wire.
    """

    name: FolderName
    rate_hz: float = Field(ge=1, le=1000)
    command_unit: Literal["mm", "bar"]
    limits: LimitsSettings
    ramps: RampSettings = RampSettings()
    start_command: float | None = None
    safe_command: float
    stop_overshoot: Positive | None = None
    sensor: SensorSettings
    plausibility: PlausibilitySettings = PlausibilitySettings()
    wire: WireUnits = WireUnits()
    transport: TransportSettings
    prepare: tuple[PrepareStep, ...] = ()
    realtime: RealtimeSettings = RealtimeSettings()
    connect_timeout_s: Positive = 5.0
    latch_file: Path | None = None
    inputs: InputNames = ()

    @model_validator(mode="after")
    def _inputs_come(self) -> BenchSettings:
        if self.inputs and self.transport.kind not in _WITH_INPUTS:
            raise ValueError(f"got inputs with transport {self.transport.kind}, expected {', '.join(_WITH_INPUTS)}")
        if self.inputs and self.realtime.backend == "c":
            raise ValueError("got inputs with realtime.backend c, expected auto or python")
        return self

    @model_validator(mode="after")
    def _inside(self) -> BenchSettings:
        limits = self.axes_limits
        wanted = {"safe_command": self.safe_command, "start_command": self.start_command}
        for name, values in wanted.items():
            for value, one in zip(() if values is None else each(values), limits, strict=False):
                if not one.lower <= value <= one.upper:
                    raise ValueError(f"got {name} {value}, expected it within limits {one.lower} to {one.upper}")
        if self.sensor.kind == "none" and any(isinstance(step, PretensionSettings) for step in self.prepare):
            raise ValueError("got prepare step pretension_check with sensor.kind none, expected steps without an angle")
        slowest = min(one.rate for one in limits)
        if self.ramps.velocity_per_s > slowest:
            raise ValueError(
                f"got ramps.velocity_per_s {self.ramps.velocity_per_s}, expected at most limits.rate_per_s {slowest}"
            )
        brake, rate = self.ramps.brake_per_s2, max(one.rate for one in limits)
        if brake is not None and rate**2 / (2.0 * brake) > self.overshoot * (1 + 1e-9):
            raise ValueError(
                f"got ramps.brake_per_s2 {brake:g}, with which a stop from {rate:g} per s goes on for v^2 / (2 a) = "
                f"{rate**2 / (2.0 * brake):.4g}, expected at most stop_overshoot {self.overshoot:g}: brake with at "
                f"least {rate**2 / (2.0 * self.overshoot):.4g}, or leave it out"
            )
        return self

    @property
    def axes_limits(self) -> tuple[CommandLimits, ...]:
        """Limits of the command of each axis."""
        return each(self.limits.build())

    @property
    def overshoot(self) -> float:
        """Greatest overshoot of a stop in the direction of motion [mm or bar]; the same for both axes of two."""
        return self.stop_overshoot or min(0.2, 0.02 * min(one.upper - one.lower for one in self.axes_limits))

    @property
    def dt_s(self) -> float:
        """Sample time [s]."""
        return 1.0 / self.rate_hz


class ReviewSettings(Settings):
    """Block `review`: greatest free-run error of the model without a new identification or diagnosis.

    Attributes:
        due_above_deg: RMS error of the free run [deg].
    """

    due_above_deg: Positive = 1.0


class DrillSettings(Settings):
    """Block `drill`: an exercise in which the control law fails for a given time after the start of tracking.

    Attributes:
        solver_fails_from_s: start [s].
        solver_fails_for_s: duration [s].
    """

    solver_fails_from_s: NotNegative
    solver_fails_for_s: Positive


class RunSettings(BenchSettings):
    """Settings of a closed-loop experiment (`hystmpc run`).

    Attributes:
        limits: as of every bench; wider ones than those of the model are refused unless `limits.beyond_model` is true.
        controller: a planner's controller; its own limits may narrow those of the bench.
        reference: what is tracked.
        review: of the run.
        drill: an exercise, None for none.
        live: the local page.
    """

    limits: ModelledLimitsSettings  # pyright: ignore[reportIncompatibleVariableOverride]  # settings are frozen
    controller: TipSettings
    reference: Motion
    review: ReviewSettings = ReviewSettings()
    drill: DrillSettings | None = None
    live: LiveSettings = LiveSettings()

    @model_validator(mode="before")
    @classmethod
    def _controller_knows_the_sensor(cls, data: Any) -> Any:
        tip = data.get("controller") if isinstance(data, Mapping) else None
        if not isinstance(tip, Mapping) or not isinstance(data.get("sensor"), Mapping):
            return data
        try:
            keys = SensorSettings.model_validate(data["sensor"]).estimator_keys()
        except ValidationError:  # the field itself says what is wrong
            return data
        law = with_sensor_facts(tip.get("controller", {"kind": LinearisedMpcSettings().kind}), keys)
        return {**data, "controller": {**tip, "controller": law}} if keys else data

    @model_validator(mode="after")
    def _controller_fits_the_sensor(self) -> RunSettings:
        if fault := sensor_fault(self.controller.controller, self.sensor.kind):
            raise ValueError(f"controller.controller.{fault}")
        return self


def load_run(path: Path | str, overrides: Iterable[str] = ()) -> RunSettings:
    """Read the settings of an experiment; file names relative to its folder become absolute.

    Raises:
        ConfigError: on an unreadable file, an unknown key or a value out of bounds.
        ModelError: on an unknown built-in model.
    """
    settings, folder = load_settings(RunSettings, path, overrides), Path(path).resolve().parent
    tip, reference = settings.controller, motion_in(folder, settings.reference)
    inverse = None if tip.inverse is None else absolute_name(tip.inverse, folder)
    tip = tip.model_copy(update={"model": absolute_name(tip.model, folder), "inverse": inverse})
    return settings.model_copy(update={"controller": tip, "reference": reference, **located(settings, folder)})


def located(settings: BenchSettings, folder: Path) -> dict[str, Any]:
    """Resolve the file names in the settings of a bench relative to `folder`.

    Raises:
        ConfigError: if the latch's file is another kind of file, which a stop would replace and `--reset` remove.
    """
    changes: dict[str, Any] = {"transport": settings.transport.resolved(folder)}
    if settings.latch_file is not None:
        changes["latch_file"] = place = folder / settings.latch_file
        if not _may_latch(place):
            raise ConfigError(f"latch_file: {place} is another kind of file, expected a latch or a new file")
    return changes


def _may_latch(file: Path) -> bool:
    """Whether a file may be used as a latch: it is a latch, empty, or missing."""
    try:
        text = file.read_text(encoding="utf-8")
        content = json.loads(text) if text.strip() else {"cause": ""}
    except (FileNotFoundError, NotADirectoryError):
        return True
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and "cause" in content
