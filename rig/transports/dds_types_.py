"""Messages on the wire as ROS 2 lays them out; needs `cyclonedds` (extra `rig`).

The type names are those that ROS 2 gives: package::msg::dds_::Name_.
"""

# No `from __future__ import annotations` here: cyclonedds reads the annotations as types.
from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, uint32


@dataclass
class Float64(IdlStruct, typename="std_msgs::msg::dds_::Float64_"):  # type: ignore[call-arg]  # the base takes it
    """std_msgs/msg/Float64."""

    data: float64


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):  # type: ignore[call-arg]  # the base takes it
    """builtin_interfaces/msg/Time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):  # type: ignore[call-arg]  # the base takes it
    """std_msgs/msg/Header."""

    stamp: Time
    frame_id: str


@dataclass
class Float64Stamped(IdlStruct, typename="hystmpc_msgs::msg::dds_::Float64Stamped_"):  # type: ignore[call-arg]  # the base takes it
    """hystmpc_msgs/msg/Float64Stamped: header, uint32 session, uint32 sequence, float64 data, float64 held."""

    header: Header
    session: uint32
    sequence: uint32
    data: float64
    held: float64
