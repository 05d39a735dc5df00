"""Settings of a closed-loop experiment on a device of two axes (`hystmpc run`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hystmpc.ctrl.config import sensor_fault
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisTipSettings
from hystmpc.models.load import model_path
from hystmpc.models.two_axes.model import has_two_axes
from hystmpc.trajectories.config import MotionInPlane
from hystmpc.trials.config import OfBothAxes, Settings, load_settings, read_yaml
from hystmpc.trials.errors import ConfigError

from .axes import ModelledPlaneLimitsSettings, PlaneLimitsSettings, together
from .config import BenchSettings, ReviewSettings, located
from .experiment.phases import CommandMotion, Phase, RelaxationSettings
from .live.desk import LiveSettings
from .safety.ramp import RampSettings, ramp_commands
from .transports.simulated import SimulatedSettings
from .transports.transport import PlaneWireUnits

Both = Annotated[tuple[float, float], OfBothAxes]
_TRANSPORTS = ("udp", "dds", "simulated")


class PlaneMoveSettings(Settings):
    """Preparation step `step: move` of two axes: a ramp of both commands, which arrive at the same time.

    Attributes:
        to: commands x, y at the end [mm or bar].
    """

    step: Literal["move"]
    to: Both

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """Build the phase of this step."""
        still = together((0.0, 0.0))
        return CommandMotion("move", lambda held: ramp_commands(held, still, together(self.to), ramps, dt_s))


PlaneStep = Annotated[PlaneMoveSettings | RelaxationSettings, Field(discriminator="step")]


class PlaneBenchSettings(BenchSettings):
    """Settings of a bench of two axes; keys as of one axis, with `[x, y]` for commands.

    Ramps, sensor and plausibility are those of both axes.

    Attributes:
        limits: hard limits of both commands, a list each.
        start_command: what the device holds at the start; null asks the device.
        safe_command: where a stop leads both commands, which arrive at the same time.
        stop_overshoot: as of one axis; null takes the smaller of 0.2 and 2 % of the smaller range of `limits`.
        sensor: plausibility of both angles; a continuous sensor.
        wire: units of the device.
        transport: of kind udp, dds or simulated.
        prepare: steps before the first sample of the experiment: `move` and `relaxation`.
    """

    limits: PlaneLimitsSettings  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]
    start_command: Both | None = None  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]
    safe_command: Both  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]
    wire: PlaneWireUnits = PlaneWireUnits()  # pyright: ignore[reportIncompatibleVariableOverride]
    prepare: tuple[PlaneStep, ...] = ()  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]

    @model_validator(mode="after")
    def _of_two_axes(self) -> PlaneBenchSettings:
        if self.sensor.kind != "continuous":
            raise ValueError(f"got sensor.kind {self.sensor.kind}, expected continuous for two axes")
        if self.transport.kind not in _TRANSPORTS:
            raise ValueError(
                f"got transport.kind {self.transport.kind}, expected {', '.join(_TRANSPORTS)} for two axes"
            )
        if isinstance(self.transport, SimulatedSettings) and self.transport.sensor.kind != "continuous":
            raise ValueError(f"got transport.sensor {self.transport.sensor.kind}, expected continuous for two axes")
        if self.realtime.backend != "python":
            raise ValueError(f"got realtime.backend {self.realtime.backend}, expected python for two axes")
        for step in self.prepare:
            ends = zip(step.to, self.axes_limits, strict=True) if isinstance(step, PlaneMoveSettings) else ()
            for value, one in ends:
                if not one.lower <= value <= one.upper:
                    raise ValueError(f"got prepare step move to {value}, expected it within {one.lower} to {one.upper}")
        return self


class PlaneRunSettings(PlaneBenchSettings):
    """Settings of a closed-loop experiment on a device of two axes (`hystmpc run`).

    Attributes:
        limits: as of every bench; wider ones than those of the model are refused unless `limits.beyond_model` is true.
        controller: a planner's controller of two axes; its own limits may narrow those of the bench.
        reference: motion of both angles.
        review: of the run.
        live: the local page, which takes no target of two axes.
    """

    limits: ModelledPlaneLimitsSettings  # pyright: ignore[reportIncompatibleVariableOverride]  # settings are frozen
    controller: TwoAxisTipSettings
    reference: MotionInPlane
    review: ReviewSettings = ReviewSettings()
    live: LiveSettings = LiveSettings()

    @model_validator(mode="after")
    def _controller_fits_the_sensor(self) -> PlaneRunSettings:
        if fault := sensor_fault(self.controller.controller, self.sensor.kind):
            raise ValueError(f"controller.controller.{fault}")
        return self


def file_of_two_axes(path: Path | str) -> bool:
    """Whether a bench's file is of two axes: its limits are lists, or its model has two; what cannot be read is not."""
    try:
        return says_two_axes(read_yaml(path), Path(path).resolve().parent)
    except ConfigError:
        return False


def says_two_axes(data: Any, folder: Path) -> bool:
    """Whether the plain data of a bench or a simulated device is of two axes, with file names relative to a folder."""

    def block(name: str) -> Mapping[str, Any]:
        inner = data.get(name) if isinstance(data, Mapping) else None
        return inner if isinstance(inner, Mapping) else {}

    if any(isinstance(block("limits").get(end), list) for end in ("lower", "upper", "rate_per_s")):
        return True
    files = block("controller").get("model"), block("plant").get("simulator")
    return any(has_two_axes(folder / file) for file in files if isinstance(file, str))


def load_plane_run(path: Path | str, overrides: Iterable[str] = ()) -> PlaneRunSettings:
    """Read the settings of an experiment of two axes; file names relative to its folder become absolute.

    Raises:
        ConfigError: on an unreadable file, an unknown key or a value out of bounds.
        ModelError: on an unknown built-in model.
    """
    settings, folder = load_settings(PlaneRunSettings, path, overrides), Path(path).resolve().parent
    tip = settings.controller.model_copy(update={"model": str(model_path(settings.controller.model, folder))})
    return settings.model_copy(update={"controller": tip, **located(settings, folder)})
