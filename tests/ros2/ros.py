"""As much of ROS 2 as the node uses, in one process: topics, services, timers, messages from the interface files."""

from __future__ import annotations

import enum
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType, SimpleNamespace
from typing import Any

from .interfaces import PRIMITIVE, Pair, interfaces


@cache
def message_class(name: str) -> Any:
    """A message as `rosidl` makes it for Python: every field has its default and refuses another type."""
    parts = interfaces()[name]

    def start(self: Any, **given: Any) -> None:
        assert given.keys() <= {key for key, _ in parts}, given
        for key, of in parts:
            setattr(self, key, given.get(key, PRIMITIVE[of]() if of in PRIMITIVE else message_class(of)()))

    def put(self: Any, key: str, value: Any) -> None:
        of = dict(parts)[key]
        if of == "float64[2]":  # rosidl takes any two floats
            assert all(type(one) is float for one in value), value
            value = Pair(value)
        wanted = PRIMITIVE.get(of) or message_class(of)
        assert isinstance(value, wanted), f"{name}.{key}: got {type(value).__name__}, expected {of}"
        object.__setattr__(self, key, value)

    return type(name.rpartition("/")[2], (), {"__init__": start, "__setattr__": put})


def service_class(name: str) -> Any:
    """A service with its two messages."""
    return SimpleNamespace(Request=message_class(f"{name}_Request"), Response=message_class(f"{name}_Response"))


@dataclass
class Graph:
    """Everything that nodes have opened; parameters are those that a launch file would give."""

    parameters: Mapping[str, Any] = field(default_factory=dict)
    readers: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    kinds: dict[str, Any] = field(default_factory=dict)
    services: dict[str, Callable[[Any, Any], Any]] = field(default_factory=dict)
    timers: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    nodes: list[str] = field(default_factory=list)

    def publish(self, topic: str, message: Any) -> None:
        """Every reader gets the message at once."""
        for read in list(self.readers[topic]):
            read(message)

    def call(self, service: str, **request: Any) -> Any:
        """What a service answers."""
        kind = self.kinds[service]
        return self.services[service](kind.Request(**request), kind.Response())


class Node:
    """A node of rclpy; a class of it belongs to a graph."""

    graph: Graph

    def __init__(self, name: str) -> None:
        self.graph.nodes.append(name)

    def declare_parameter(self, name: str, value: Any) -> Any:
        given = self.graph.parameters.get(name, value)
        assert isinstance(given, type(value)), name
        return SimpleNamespace(value=given)

    def create_publisher(self, kind: Any, topic: str, _: Any) -> Any:
        assert self.graph.kinds.setdefault(topic, kind) is kind, topic

        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            self.graph.publish(topic, message)

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind: Any, topic: str, read: Callable[[Any], None], _: Any) -> Any:
        assert self.graph.kinds.setdefault(topic, kind) is kind, topic
        self.graph.readers[topic].append(read)
        return topic, read

    def create_service(self, kind: Any, name: str, answer: Callable[[Any, Any], Any]) -> None:
        self.graph.kinds[name], self.graph.services[name] = kind, answer

    def create_timer(self, period_s: float, call: Callable[[], None]) -> None:
        self.graph.timers.append((period_s, call))

    def destroy_publisher(self, _: Any) -> None: ...

    def destroy_subscription(self, made: Any) -> None:
        self.graph.readers[made[0]].remove(made[1])

    def destroy_node(self) -> None:
        self.graph.nodes.pop()

    def get_logger(self) -> Any:
        said = self.graph.said.append
        return SimpleNamespace(info=said, warning=said, error=said)


class Reliability(enum.Enum):
    RELIABLE, BEST_EFFORT = 1, 2


class Durability(enum.Enum):
    TRANSIENT_LOCAL, VOLATILE = 1, 2


def modules(graph: Graph, spin: Callable[[], None]) -> dict[str, ModuleType]:
    """What the node imports of ROS; `spin` is one turn of the executor."""

    def module(name: str, **content: Any) -> ModuleType:
        made = ModuleType(name)
        vars(made).update(content)
        return made

    def forever(_: Any) -> None:
        while True:
            spin()

    node: Any = type("Node", (Node,), {"graph": graph})
    logging = module("rclpy.logging", get_logger=lambda name: node.get_logger(SimpleNamespace(graph=graph)))
    messages: dict[str, dict[str, Any]] = defaultdict(dict)
    for name in interfaces():
        package, room, last = name.split("/")
        if room == "msg":
            messages[f"{package}.msg"][last] = message_class(name)
        elif last.endswith("_Request"):
            known = last.removesuffix("_Request")
            messages[f"{package}.srv"][known] = service_class(f"{package}/{room}/{known}")
    found = [module(name, **content) for name, content in messages.items()]
    found += [module(package) for package in {name.split(".")[0] for name in messages}]
    found += [
        logging,
        module(
            "rclpy",
            init=lambda **_: None,
            try_shutdown=lambda: None,
            spin=forever,
            spin_once=lambda node, timeout_sec: spin(),
            logging=logging,
        ),
        module("rclpy.node", Node=node),
        module("rclpy.signals", SignalHandlerOptions=SimpleNamespace(NO=0)),
        module(
            "rclpy.qos",
            QoSProfile=lambda **given: SimpleNamespace(**given),
            ReliabilityPolicy=Reliability,
            DurabilityPolicy=Durability,
        ),
    ]
    return {made.__name__: made for made in found}


def forget(package: str) -> None:
    """Import a package anew at its next import."""
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        del sys.modules[name]
