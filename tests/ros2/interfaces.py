"""ROS 2 interface files as lists of fields, by the rules of `rosidl`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROS2 = Path(__file__).resolve().parents[2] / "ros2"
MSGS = ROS2 / "hystmpc_msgs"
PACKAGES = ("hystmpc_msgs", "hystmpc_ros", "hystmpc_controller")

# What std_msgs and builtin_interfaces say, as far as our messages use them.
KNOWN = {
    "builtin_interfaces/msg/Time": [("sec", "int32"), ("nanosec", "uint32")],
    "std_msgs/msg/Header": [("stamp", "builtin_interfaces/msg/Time"), ("frame_id", "string")],
    "std_msgs/msg/Float64": [("data", "float64")],
    "std_msgs/msg/MultiArrayDimension": [("label", "string"), ("size", "uint32"), ("stride", "uint32")],
    "std_msgs/msg/MultiArrayLayout": [("dim", "std_msgs/msg/MultiArrayDimension[]"), ("data_offset", "uint32")],
    "std_msgs/msg/Float64MultiArray": [("layout", "std_msgs/msg/MultiArrayLayout"), ("data", "float64[]")],
    "std_srvs/srv/Trigger_Request": [],
    "std_srvs/srv/Trigger_Response": [("success", "bool"), ("message", "string")],
}


class Pair(list[float]):
    """Two numbers: an array of fixed length, as a new message has it."""

    def __init__(self, values: Iterable[float] = (0.0, 0.0)) -> None:
        super().__init__(values)
        assert len(self) == 2, self


PRIMITIVE: dict[str, Any] = {
    "float64": float, "int32": int, "uint32": int, "string": str, "bool": bool, "float64[]": list, "float64[2]": Pair,
    "std_msgs/msg/MultiArrayDimension[]": list,
}  # fmt: skip
_FIELD = re.compile(
    r"([a-zA-Z]\w*(?:/\w+)*(?:\[2?\])?)\s+([a-z][a-z0-9]*(?:_[a-z0-9]+)*)"
)  # names as rosidl wants them


def fields(text: str) -> list[tuple[str, str]]:
    """Name and full type of every field of a message."""
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    found = []
    for line in filter(None, lines):
        match = _FIELD.fullmatch(line)
        assert match, line
        kind, name = match.groups()
        found.append((name, kind if kind in PRIMITIVE else "/msg/".join(kind.split("/"))))
    return found


def interfaces() -> dict[str, list[tuple[str, str]]]:
    """Fields of every message, request and response of the package, and of those that it uses."""
    found = dict(KNOWN)
    for path in sorted(MSGS.glob("*/*.*")):
        text, name = path.read_text(encoding="utf-8"), f"hystmpc_msgs/{path.parent.name}/{path.stem}"
        if path.suffix == ".msg":
            found[name] = fields(text)
            continue
        asked, answered = re.split(r"^---$", text, flags=re.MULTILINE)
        found |= {f"{name}_Request": fields(asked), f"{name}_Response": fields(answered)}
    return found


def blank(name: str) -> Any:
    """A message with the values that ROS gives a new one; a field that it does not have cannot be set."""
    parts = interfaces()[name]
    kind = type(name.rpartition("/")[2], (), {"__slots__": tuple(field for field, _ in parts)})
    message = kind()
    for field, of in parts:
        setattr(message, field, PRIMITIVE[of]() if of in PRIMITIVE else blank(of))
    return message


def dds_name(name: str) -> str:
    """The type's name on the wire: package::msg::dds_::Name_."""
    package, kind, last = name.split("/")
    return f"{package}::{kind}::dds_::{last}_"
