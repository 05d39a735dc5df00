"""Settings of a device server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hystmpc.ctrl.config import LimitsSettings
from hystmpc.trials.config import Settings

from ..realtime_ import SchedulingSettings
from ..settings_types import Port, Positive
from ..transports.settings import DdsSettings, require_local
from ..transports.units import WireUnits
from .faults import FaultSettings


class UdpListenSettings(Settings):
    """`kind: udp`: where the device listens; port 0 takes a free one and says which."""

    kind: Literal["udp"]
    bind_host: str = "127.0.0.1"
    bind_port: Port = 47001
    allow_network: bool = False

    @model_validator(mode="after")
    def _local(self) -> UdpListenSettings:
        require_local("bind_host", self.bind_host, self.allow_network)
        return self


class DeviceSettings(Settings):
    """A simulated device in a process of its own: `hystmpc device`.

    Attributes:
        rate_hz: samples per second.
        command_unit: of the plant.
        plant: `simulator` and effects as in a simulation file, or `device: tendon | muscle | rod`.
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

    rate_hz: float = Field(ge=1, le=500)
    command_unit: Literal["mm", "bar"]
    plant: dict[str, Any]
    limits: LimitsSettings
    wire: WireUnits = WireUnits()
    link: Annotated[UdpListenSettings | DdsSettings, Field(discriminator="kind")]
    watchdog_s: Positive = 0.5
    watchdog_rate_per_s: Positive = 2.0
    faults: tuple[FaultSettings, ...] = ()
    realtime: SchedulingSettings = SchedulingSettings()
    log: Path | None = None
    seed: Annotated[int, Field(ge=0)] = 0

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
