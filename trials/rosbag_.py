"""Signals out of ROS 2 bags, without ROS: a folder with metadata.yaml, or one of its files."""

from __future__ import annotations

from pathlib import Path

from .errors import LogError, require
from .mcap_ import open_mcap
from .messages import MessageLog, Topic, late_decoder, one_line

METADATA = "metadata.yaml"
_DEFINITIONS = {"MSG": "ros2msg", "IDL": "ros2idl"}


def is_bag(folder: Path) -> bool:
    """Whether a folder is a ROS 2 bag: metadata.yaml beside at least one storage file."""
    return (folder / METADATA).is_file() and any(any(folder.glob(f"*{end}*")) for end in (".db3", ".mcap"))


def open_bag(path: Path | str) -> MessageLog:
    """Read the messages of a ROS 2 bag (sqlite3 or mcap storage).

    A bag whose recorder was killed has no metadata.yaml: name the storage file itself. An mcap storage that was cut
    off gives what stands before the cut; an sqlite3 storage what the database still yields.

    Args:
        path: the bag's folder, or a storage file.

    Raises:
        LogError: if `rosbags` is not installed, or the bag cannot be read or holds no message.
    """
    place = Path(path)
    if not place.exists():
        raise LogError(f"{path}: no such file")
    require("rosbags", "logs", f"{path}: reading ROS 2 bags")
    messages: list[tuple[str, int, bytes]] = []
    topics: dict[str, Topic] = {}
    note = ""
    try:
        _read(place, topics, messages)
    except Exception as error:  # noqa: BLE001 - on damaged files its parsers raise whatever they meet
        note = f"cut off or damaged: {one_line(error)}; what stands before is read"
    storage = sorted(place.glob("*.mcap")) if place.is_dir() else []
    if note and storage:
        return _recovered(str(path), storage)
    if not messages:
        raise LogError(f"{path}: not a readable ROS 2 bag, or one without a message{f' ({note})' if note else ''}")
    return MessageLog(str(path), topics, messages, note)


def _read(place: Path, topics: dict[str, Topic], messages: list[tuple[str, int, bytes]]) -> None:
    """Fill in topics and messages; what was read before a fault stays."""
    from rosbags.rosbag2 import Reader

    with Reader(place) as reader:
        for connection in reader.connections:
            encoding = _DEFINITIONS.get(connection.msgdef.format.name, "")
            decode = late_decoder(connection.msgtype, encoding, connection.msgdef.data)
            topics[connection.topic] = Topic(connection.topic, connection.msgtype, decode)
        for connection, stamp, raw in reader.messages():
            messages.append((connection.topic, stamp, bytes(raw)))


def _recovered(path: str, storage: list[Path]) -> MessageLog:
    """The mcap files of a bag one by one, each up to where it is whole."""
    require("mcap", "logs", f"{path}: reading a damaged bag")
    logs, notes = [], []
    for file in storage:
        try:
            logs.append(open_mcap(file))
            notes.append(logs[-1].note)
        except LogError as error:
            notes.append(str(error))
    if not logs:
        raise LogError(f"{path}: not a readable ROS 2 bag ({notes[0]})")
    topics = {name: topic for log in logs for name, topic in log.topics.items()}
    messages = [message for log in logs for message in log.messages]
    return MessageLog(path, topics, messages, next((note for note in notes if note), ""))
