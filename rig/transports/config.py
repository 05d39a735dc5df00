"""Settings of every transport, told apart by `kind`."""

from __future__ import annotations

import importlib.util
import ipaddress
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hystmpc.ctrl.limits import Count, Port
from hystmpc.ctrl.loop import Plant
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import RunFolder

from .simulated import SimulatedTransport, recorded_plant
from .transport import Conversion, Transport
from .udp import UdpTransport


class SimulatedSettings(Settings):
    """`kind: simulated`: a device computed in this process; `plant` as in a simulation file."""

    kind: Literal["simulated"]
    plant: dict[str, Any]
    seed: int = Field(default=0, ge=0)


class ReplaySettings(Settings):
    """`kind: replay`: the angles of a recorded run, one a sample, whatever is commanded."""

    kind: Literal["replay"]
    run: Path


class UdpSettings(Settings):
    """`kind: udp`: datagrams to a device and back.

    Attributes:
        host, port: of the device.
        bind_host, bind_port: of this end; port 0 takes a free one.
        allow_network: needed for every address beyond the loopback.
    """

    kind: Literal["udp"]
    host: str = "127.0.0.1"
    port: Port = 47001
    bind_host: str = "127.0.0.1"
    bind_port: Port = 0
    allow_network: bool = False

    @model_validator(mode="after")
    def _local(self) -> UdpSettings:
        for name in ("host", "bind_host"):
            require_local(name, getattr(self, name), self.allow_network)
        return self


class QosSettings(Settings):
    """Quality of service of both topics, in the words of ROS 2."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: Count = 10


class DdsSettings(Settings):
    """`kind: dds`: two topics of a DDS domain, as ROS 2 nodes see them.

    Attributes:
        angle_topic, command_topic: names as ROS 2 has them, without the prefix `rt/`.
        message: `float64` is std_msgs/msg/Float64; `float64_stamped` adds a header, session and sequence, see the docs.
        domain: ROS_DOMAIN_ID.
        qos: of both topics.
        interface: network interface; everything stays on the loopback where left out.
    """

    kind: Literal["dds"]
    angle_topic: str = "tip/angle_deg"
    command_topic: str = "tip/command"
    message: Literal["float64", "float64_stamped"] = "float64_stamped"
    domain: int = Field(default=0, ge=0, le=232)
    qos: QosSettings = QosSettings()
    interface: str | None = None


TransportSettings = Annotated[
    SimulatedSettings | ReplaySettings | UdpSettings | DdsSettings, Field(discriminator="kind")
]


def require_local(name: str, host: str, allow_network: bool) -> None:
    """Refuse addresses beyond the loopback unless they were allowed.

    Raises:
        ValueError: for pydantic, with the key and what to do.
    """
    try:
        local = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = False
    if not (local or allow_network):
        raise ValueError(f"got {name} {host!r}, expected a loopback address, or `allow_network: true`")


# Makes the device of `kind: simulated`: settings and sample time to a plant and the command that it holds.
PlantFactory = Callable[[SimulatedSettings, float], tuple[Plant, float]]


def build_transport(
    settings: TransportSettings, conversion: Conversion, dt_s: float, now_ns: Callable[[], int], plants: PlantFactory
) -> Transport:
    """The transport that `settings` describe, open.

    Args:
        settings: of any kind.
        conversion: of the wire's units.
        dt_s: sample time of the loop [s].
        now_ns: monotonic clock.
        plants: makes the simulated device; given by the program, since this room knows no simulator.

    Raises:
        ConfigError: if the wire cannot be opened, or a package is missing for it.
        LogError: if a run to replay cannot be read.
    """
    if isinstance(settings, SimulatedSettings):
        plant, held = plants(settings, dt_s)
        return SimulatedTransport(plant, dt_s, held, now_ns)
    if isinstance(settings, ReplaySettings):
        recorded, held = recorded_plant(RunFolder.open(settings.run), dt_s)
        return SimulatedTransport(recorded, dt_s, held, now_ns)
    if isinstance(settings, UdpSettings):
        return UdpTransport(settings, conversion)
    return _dds(settings, conversion)


def _dds(settings: DdsSettings, conversion: Conversion) -> Transport:
    require_dds()
    from .dds_ import DdsTransport

    return DdsTransport(settings, conversion)


def require_dds() -> None:
    """Say how to get DDS where it is not installed.

    Raises:
        ConfigError: if `cyclonedds` is not installed.
    """
    if importlib.util.find_spec("cyclonedds") is None:
        raise ConfigError("dds: the package cyclonedds is not installed, expected `pip install hystmpc[rig]`")
