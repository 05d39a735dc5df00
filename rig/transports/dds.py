"""Settings of the DDS transport; module `dds_` contains the part that needs Cyclone DDS (extra `rig`)."""

from __future__ import annotations

import importlib.util

from hystmpc.trials.errors import ConfigError

from .topics import TopicSettings
from .transport import DeviceLink, RunContext, SocketWrapper, Transport


class DdsSettings(TopicSettings):
    """Transport `kind: dds`: two topics of a DDS domain, as seen by ROS 2 nodes.

    Attributes:
        angle_topic, command_topic: names as ROS 2 has them, without the prefix `rt/`.
        message: `float64` is std_msgs/msg/Float64, of two axes Float64MultiArray; `float64_stamped` adds a header,
            session and sequence, see the docs.
        domain: ROS_DOMAIN_ID.
        qos: of both topics.
        interface: network interface; everything stays on the loopback where left out.
    """

    def open(self, run: RunContext) -> Transport:
        require_dds()
        from .dds_ import dds_transport

        return dds_transport(self, run.conversion)

    def listen(self, silence_s: float, through: SocketWrapper | None, axes: int = 1) -> DeviceLink:
        """Open the device's end; faults cannot be injected in front of DDS.

        Raises:
            ConfigError: if it cannot be opened, or a package is missing for it.
        """
        del through
        require_dds()
        from .dds_ import DdsLink

        return DdsLink(self, silence_s, axes)


def require_dds() -> None:
    """Check that Cyclone DDS is installed.

    Raises:
        ConfigError: if `cyclonedds` is not installed.
    """
    if importlib.util.find_spec("cyclonedds") is None:
        raise ConfigError("dds: the package cyclonedds is not installed, expected `pip install hystmpc[rig]`")
