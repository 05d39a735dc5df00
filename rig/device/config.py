"""Settings of a device server, and of the faults between it and a controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hystmpc.ctrl.command import LimitsSettings
from hystmpc.ctrl.loop import ContinuousSensorSettings, SimulatedSensor
from hystmpc.trials.config import NotNegative, NotNegativeInt, Positive, Settings

from ..realtime import SchedulingSettings
from ..transports.dds import DdsSettings
from ..transports.transport import WireUnits
from ..transports.udp import UdpListenSettings

Direction = Literal["readings", "commands"]
FaultName = Literal[
    "freeze",
    "blocked",
    "dislodged",
    "nan",
    "outlier",
    "dropout",
    "delay",
    "jitter",
    "reorder",
    "duplicate",
    "replay",
    "stamp_jump",
    "out_of_range",
    "corrupt",
]
_SENSOR = ("freeze", "blocked", "dislodged", "nan", "outlier", "stamp_jump", "out_of_range")


class FaultSettings(Settings):
    """One fault of the readings, or of the commands on their way to the device.

    Attributes:
        fault: `dropout` sends nothing; `delay` sends `delay_s` late; `jitter` up to `delay_s` late; `reorder` holds a
            message back behind the next; `duplicate` sends it twice; `replay` sends an old one again; `corrupt` spoils
            one byte of a datagram. Of readings only: `freeze` repeats the last angle; `blocked` sends the last angle
            plus noise, as of a tip that cannot move; `dislodged` the same shifted by `size_deg`, as of a sensor that
            has come off; `nan`; `outlier` adds `size_deg` with a random sign; `stamp_jump` shifts the sender's clock by
            `delay_s`, of either sign; `out_of_range` sends 10 000 deg.
        of: which way the messages go that it hits.
        start_s: when it begins, counted from the first command.
        duration_s: how long it lasts.
        share: of the messages that it hits.
        size_deg: of an outlier, or of the shift of a dislodged sensor.
        noise_deg: standard deviation of the angle of a blocked tip or a dislodged sensor.
        delay_s: see `fault`.
    """

    fault: FaultName
    of: Direction = "readings"
    start_s: NotNegative = 0.0
    duration_s: NotNegative = 1e9
    share: float = Field(default=1.0, gt=0, le=1)
    size_deg: NotNegative = 40.0
    noise_deg: NotNegative = 0.05
    delay_s: float = 0.2

    @model_validator(mode="after")
    def _possible(self) -> FaultSettings:
        if self.of == "commands" and self.fault in _SENSOR:
            known = "dropout, delay, jitter, reorder, duplicate, replay, corrupt"
            raise ValueError(f"got fault {self.fault} of commands, available for them: {known}")
        return self

    @property
    def of_datagrams(self) -> bool:
        """Whether it needs to get at the datagrams themselves."""
        return self.of == "commands" or self.fault == "corrupt"


class DeviceSettings(Settings):
    """A simulated device in a process of its own: `hystmpc device`.

    Attributes:
        rate_hz: samples per second.
        command_unit: of the plant.
        plant: `simulator` and effects as in a simulation file, or `device: tendon | muscle | rod`.
        sensor: the plant's angle in every message; frames of an imaging system, in messages of their own, stamped with
            the time at which they were taken; or none. A message without an angle has not-a-number in its place and
            says what the device holds, in every sample.
        limits: what the drive can do; commands beyond are clipped and counted.
        wire: units on the wire.
        link: how it is reached.
        watchdog_s: silence of the controller after which the drive returns to its rest by itself.
        watchdog_rate_per_s: how fast it returns.
        faults: what goes wrong, and when, counted from the first command.
        realtime: scheduling of the server's process.
        log: CSV file of every sample: time, command received, angle; for tests of controllers.
        seed: of noise and faults.
    """

    rate_hz: float = Field(ge=1, le=1000)
    command_unit: Literal["mm", "bar"]
    plant: dict[str, Any]
    sensor: SimulatedSensor = ContinuousSensorSettings()
    limits: LimitsSettings
    wire: WireUnits = WireUnits()
    link: Annotated[UdpListenSettings | DdsSettings, Field(discriminator="kind")]
    watchdog_s: Positive = 0.5
    watchdog_rate_per_s: Positive = 2.0
    faults: tuple[FaultSettings, ...] = ()
    realtime: SchedulingSettings = SchedulingSettings()
    log: Path | None = None
    seed: NotNegativeInt = 0

    @model_validator(mode="after")
    def _datagrams(self) -> DeviceSettings:
        wrong = [fault for fault in self.faults if fault.of_datagrams]
        if wrong and not isinstance(self.link, UdpListenSettings):
            raise ValueError(
                f"got fault {wrong[0].fault} of {wrong[0].of} with link {self.link.kind}, expected link udp: only "
                "datagrams can be got at"
            )
        return self

    @property
    def dt_s(self) -> float:
        """Sample time [s]."""
        return 1.0 / self.rate_hz
