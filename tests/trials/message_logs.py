"""Logs of other programs for the tests, made by the real libraries: MCAP with JSON, ROS 2 bags, damaged copies."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.read import read_log
from hystmpc.trials.trial import Trial

START_NS = 1_700_000_000_000_000_000
Message = tuple[str, float, Any]  # topic, time [s], content

STAMPED = "bench_msgs/msg/Float64Stamped"
STAMPED_TEXT = "std_msgs/Header header\nfloat64 data\n"


def write_json(
    path: Path, messages: Sequence[Message], compression: CompressionType = CompressionType.ZSTD, chunk: int = 400
) -> Path:
    """An MCAP file of JSON messages in small chunks."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk, compression=compression)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b'{"type": "object"}')
        channels: dict[str, int] = {}
        for topic, t, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            stamp = START_NS + round(1e9 * t)
            writer.add_message(channels[topic], stamp, json.dumps(content).encode(), stamp)
        writer.finish()
    return path


def bag_types() -> Any:
    """ROS 2's own messages and one of the bench's own."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(STAMPED_TEXT, STAMPED))
    return store


def write_bag(folder: Path, plugin: StoragePlugin, rows: Sequence[tuple[float, float, float]]) -> Path:
    """A bag: command as Float64 and, a little later, the angle as stamped float and in a JointState.

    Args:
        rows: time [s], command, angle [rad].
    """
    store = bag_types()
    types = store.types
    header, stamp, joint = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"], types[JOINTS]
    with BagWriter(folder, version=9, storage_plugin=plugin) as bag:
        command = bag.add_connection("/cmd", "std_msgs/msg/Float64", typestore=store)
        angle = bag.add_connection("/tip/angle", STAMPED, typestore=store)
        joints = bag.add_connection("/joints", JOINTS, typestore=store)
        text = bag.add_connection("/notes", "std_msgs/msg/String", typestore=store)
        for t, u, y in rows:
            logged = START_NS + round(1e9 * t)
            measured = header(stamp(int(t), round(1e9 * (t % 1))), "tip")
            bag.write(command, logged, store.serialize_cdr(types["std_msgs/msg/Float64"](u), "std_msgs/msg/Float64"))
            bag.write(angle, logged + 3_000_000, store.serialize_cdr(types[STAMPED](measured, y), STAMPED))
            state = joint(measured, ["tendon", "tip"], np.array([u, y]), np.array([]), np.array([]))
            bag.write(joints, logged + 4_000_000, store.serialize_cdr(state, JOINTS))
            bag.write(text, logged, store.serialize_cdr(types["std_msgs/msg/String"]("hello"), "std_msgs/msg/String"))
    return folder


JOINTS = "sensor_msgs/msg/JointState"


def mapping(**changes: Any) -> LogMapping:
    """A mapping from plain data."""
    return LogMapping.parse(changes)


def read_or_refused(path: Path, layout: LogMapping | str) -> Trial | None:
    """The trial, or None where the file is refused in one line that names it."""
    try:
        return read_log(path, layout)
    except HystmpcError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert path.name in refusal
    return None


def assert_prefix(found: Trial | None, whole: Trial) -> None:
    """What was read is the beginning of the whole."""
    if found is not None:
        for name in ("t", "command", "angle"):
            np.testing.assert_array_equal(getattr(found, name), getattr(whole, name)[: len(found)])


def columns(trial: Trial) -> Mapping[str, list[float]]:
    """Time, command and angle as lists, for short comparisons."""
    return {name: np.round(getattr(trial, name), 9).tolist() for name in ("t", "command", "angle")}
