"""The two topics of a device, by a ROS 2 node: any middleware that ROS 2 has."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, final

from builtin_interfaces.msg import Time
from hystmpc_msgs.msg import Float64PairStamped, Float64Stamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, Float64MultiArray, Header

from hystmpc.rig.axes import PerAxis, each
from hystmpc.rig.transports.topics import TopicMessage, TopicSettings, numbers, stamp, unknown

if TYPE_CHECKING:
    from rclpy.node import Node


@final
class RosWire:
    """A publisher of commands and a subscription of angles; the settings are those of the transport `dds`.

    A message without a stamp is as old as its receipt.

    Args:
        now_ns: monotonic clock [ns].
        axes: of the device.
    """

    def __init__(
        self, node: Node, topics: TopicSettings, now_ns: Callable[[], int] = time.monotonic_ns, axes: int = 1
    ) -> None:
        self._stamped, qos = topics.message == "float64_stamped", profile(topics)
        kinds = (Float64Stamped, Float64PairStamped) if self._stamped else (Float64, Float64MultiArray)
        kind: Any = kinds[axes - 1]
        self._kind, self._axes = kind, axes
        self._node, self._sequence, self._taken, self._now = node, 0, 0, now_ns
        self._come: deque[TopicMessage] = deque(maxlen=topics.qos.depth)
        self._publisher = node.create_publisher(kind, topics.command_topic, qos)
        self._subscription = node.create_subscription(kind, topics.angle_topic, self._receive, qos)
        self.session = secrets.randbits(32)

    def read(self) -> TopicMessage | None:
        """The oldest message that has not been read yet, None where there is none."""
        return self._come.popleft() if self._come else None

    def write(self, value: PerAxis, held: PerAxis, *, note: str = "") -> None:
        """Publish a command, of two axes both."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        data, at_rest = (one if self._axes == 1 else list(each(one)) for one in (value, held))
        if not self._stamped:
            self._publisher.publish(self._kind(data=data))
            return
        sec, nanosec = stamp(time.time_ns())
        header = Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=note)
        self._publisher.publish(
            self._kind(header=header, session=self.session, sequence=self._sequence, data=data, held=at_rest)
        )

    def close(self) -> None:
        """Leave both topics."""
        self._node.destroy_publisher(self._publisher)
        self._node.destroy_subscription(self._subscription)

    def _receive(self, message: Any) -> None:
        self._taken += 1
        if self._stamped:
            self._come.append(TopicMessage.of(message))
        else:
            nothing = unknown(self._axes)
            self._come.append(TopicMessage(numbers(message.data), self._taken, self._now(), held=nothing))


def profile(topics: TopicSettings) -> QoSProfile:
    """Quality of service of both topics."""
    wanted = topics.qos
    reliable, kept = wanted.reliability == "reliable", wanted.durability == "transient_local"
    return QoSProfile(
        depth=wanted.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )
