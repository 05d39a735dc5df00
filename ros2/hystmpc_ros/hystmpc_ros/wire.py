"""The two topics of a device, by a ROS 2 node: any middleware that ROS 2 has."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, final

from builtin_interfaces.msg import Time
from hystmpc_msgs.msg import Float64Stamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, Header

from hystmpc.rig.transports.topics import TopicMessage, TopicSettings, stamp

if TYPE_CHECKING:
    from rclpy.node import Node


@final
class RosWire:
    """A publisher of commands and a subscription of angles; the settings are those of the transport `dds`.

    A plain Float64 carries no stamp: its age counts from its receipt.

    Args:
        now_ns: monotonic clock [ns].
    """

    def __init__(self, node: Node, topics: TopicSettings, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._stamped, qos = topics.message == "float64_stamped", profile(topics)
        kind: Any = Float64Stamped if self._stamped else Float64
        self._node, self._sequence, self._taken, self._now = node, 0, 0, now_ns
        self._come: deque[TopicMessage] = deque(maxlen=topics.qos.depth)
        self._publisher = node.create_publisher(kind, topics.command_topic, qos)
        self._subscription = node.create_subscription(kind, topics.angle_topic, self._receive, qos)
        self.session = secrets.randbits(32)

    def read(self) -> TopicMessage | None:
        """The oldest message that has not been read yet, None where there is none."""
        return self._come.popleft() if self._come else None

    def write(self, value: float, held: float, *, note: str = "") -> None:
        """Publish a command."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        if not self._stamped:
            self._publisher.publish(Float64(data=value))
            return
        sec, nanosec = stamp(time.time_ns())
        header = Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=note)
        self._publisher.publish(
            Float64Stamped(header=header, session=self.session, sequence=self._sequence, data=value, held=held)
        )

    def close(self) -> None:
        """Leave both topics."""
        self._node.destroy_publisher(self._publisher)
        self._node.destroy_subscription(self._subscription)

    def _receive(self, message: Any) -> None:
        self._taken += 1
        plain = not self._stamped
        self._come.append(TopicMessage(message.data, self._taken, self._now()) if plain else TopicMessage.of(message))


def profile(topics: TopicSettings) -> QoSProfile:
    """Quality of service of both topics."""
    wanted = topics.qos
    reliable, kept = wanted.reliability == "reliable", wanted.durability == "transient_local"
    return QoSProfile(
        depth=wanted.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )
