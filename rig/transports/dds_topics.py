"""Topics of the DDS transport: names, message, domain and quality of service."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from hystmpc.trials.config import Count, Settings

from .transport import TransportBase


class QosSettings(Settings):
    """Quality of service of both topics, in the words of ROS 2.

    Attributes:
        reliability: whether a lost message is sent again.
        durability: whether a late reader gets the last messages.
        depth: messages that are kept.
    """

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: Count = 10


class DdsTopics(TransportBase):
    """What both ends of the wire read, explained in `DdsSettings`."""

    kind: Literal["dds"]
    angle_topic: str = "tip/angle_deg"
    command_topic: str = "tip/command"
    message: Literal["float64", "float64_stamped"] = "float64_stamped"
    domain: int = Field(default=0, ge=0, le=232)
    qos: QosSettings = QosSettings()
    interface: str | None = None

    @property
    def place(self) -> str:
        return f"dds topic {self.angle_topic} in domain {self.domain}"
