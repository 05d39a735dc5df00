"""Signals of logs that hold messages (JSON, ROS 1, ROS 2): common part of MCAP files and ROS bags."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any, final

import numpy as np

from .errors import LogError, require
from .formats import one_line
from .layouts import HEADER_TIME, LOG_TIME, few
from .signals import Series, SignalLog, split_path, walk

Decoder = Callable[[bytes], Any]


class UnreadableError(Exception):
    """Error on a message, or a definition, that cannot be read."""


@lru_cache(maxsize=64)  # parsing a definition takes longer than reading thousands of messages
def cdr_decoder(message_type: str, encoding: str, definition: str) -> Decoder:
    """Decoder from the bytes of a message to an object with its fields.

    Args:
        encoding: of the definition: `ros2msg`, `ros2idl`, `ros1msg` (ROS 1 messages), or empty for the message types
            that come with ROS 2.

    Raises:
        UnreadableError: if the type is not known or its definition cannot be read.
        LogError: if `rosbags` is not installed.
    """
    require("rosbags", "logs", "reading ROS 2 messages")
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if not definition or encoding not in ("ros1msg", "ros2msg", "ros2idl"):
        store = _common()
        if message_type not in store.types:
            raise UnreadableError(f"{message_type}: the bag does not define it and it is none of ROS 2's own messages")
    else:
        try:
            parsed = (
                get_types_from_msg(definition, message_type)
                if encoding != "ros2idl"
                else get_types_from_idl(definition)
            )
            store = get_typestore(Stores.EMPTY)
            store.register(parsed)
        except Exception as error:  # noqa: BLE001 - so does the parser of definitions
            raise UnreadableError(f"{message_type}: definition cannot be read ({one_line(error)})") from None

    read = store.deserialize_ros1 if encoding == "ros1msg" else store.deserialize_cdr

    def decode(raw: bytes) -> Any:
        try:
            return read(raw, message_type)
        except Exception as error:  # noqa: BLE001 - the generated parsers raise whatever damaged bytes lead to
            raise UnreadableError(f"{message_type}: {one_line(error)}") from None

    return decode


def late_decoder(message_type: str, encoding: str, definition: str) -> Decoder:
    """Decoder that parses the definition of its messages at the first message; see `cdr_decoder`."""
    return lambda raw: cdr_decoder(message_type, encoding, definition)(raw)


@cache
def _common() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.LATEST)


def fields_of(message: Any, prefix: str = "") -> Mapping[str, float]:
    """Numbers of one message by their paths: `data`, `header.stamp.sec`, `position[0]`; at most 8 of an array."""
    if isinstance(message, bool | int | float):
        return {prefix: float(message)}
    numbers: dict[str, float] = {}
    inner: Iterable[tuple[Any, Any]]
    if isinstance(message, Mapping):
        inner = message.items()
    elif isinstance(message, str | bytes):
        return {}
    elif hasattr(message, "__len__"):
        return {k: v for i in range(min(len(message), 8)) for k, v in fields_of(message[i], f"{prefix}[{i}]").items()}
    elif hasattr(message, "item"):
        return {prefix: float(message.item())}
    else:
        inner = vars(message).items() if hasattr(message, "__dict__") else ()
    for name, value in inner:
        if not str(name).startswith("__"):
            numbers |= fields_of(value, f"{prefix}.{name}" if prefix else str(name))
    return numbers


@dataclass(frozen=True)
class Topic:
    """One topic of a log."""

    kind: str
    decode: Decoder  # from the bytes of a message to mappings, sequences and numbers, or to an object with fields


@final
@dataclass(frozen=True, eq=False)
class MessageLog(SignalLog):
    """A `SignalLog` over messages."""

    path: str
    topics: Mapping[str, Topic]
    messages: Sequence[tuple[str, int, bytes]]  # topic, time of the log [ns] and bytes, in the order of the log
    note: str = ""

    def names(self) -> tuple[str, ...]:
        """Every topic and field that held a number in the topic's first message."""
        return tuple(self._fields)

    @cached_property
    def _fields(self) -> dict[str, float]:
        firsts: dict[str, bytes] = {}
        for topic, _, raw in self.messages:
            firsts.setdefault(topic, raw)
        values: dict[str, float] = {}
        for topic, raw in firsts.items():
            try:
                fields = fields_of(self.topics[topic].decode(raw))
            except (UnreadableError, RecursionError, OverflowError):
                continue  # unreadable signals are not listed; a request for one gives the reason
            values |= {f"{topic}.{name}" if name else topic: value for name, value in fields.items()}
        return values

    def series(self, signals: Sequence[str], time: str) -> list[Series]:
        """Return the requested signals with their time stamps; see `SignalLog`.

        A time signal is a field of the same message: `/tip.time_s`, or `time_s` for the field of that name in every
        topic.
        """
        places = [self._place(signal) for signal in signals]
        clocks = [self._clock(time, topic) for topic, _ in places]
        stamps: list[list[float]] = [[] for _ in signals]
        values: list[list[float]] = [[] for _ in signals]
        wanted = {topic for topic, _ in places}
        # Nanoseconds since 1970 are too many digits for a float: they are counted from the first message.
        origin_ns: int | None = None
        for topic, logged_ns, raw in self.messages:
            if topic not in wanted:
                continue
            message = self._decoded(topic, raw)
            stamp_ns = self._header_ns(message, topic) if time == HEADER_TIME else logged_ns
            origin_ns = stamp_ns if origin_ns is None else origin_ns
            since = 1e-9 * (stamp_ns - origin_ns)
            for k, (name, steps) in enumerate(places):
                if name == topic:
                    clock = clocks[k]
                    stamps[k].append(since if clock is None else self._value(message, topic, clock))
                    values[k].append(self._value(message, topic, steps))
        return [Series(np.array(t), np.array(y)) for t, y in zip(stamps, values, strict=True)]

    def _place(self, signal: str) -> tuple[str, list[str | int]]:
        fitting = [name for name in self.topics if signal == name or signal.startswith((f"{name}.", f"{name}["))]
        if not fitting:
            topics = sorted(self.topics)
            raise LogError(f"{self.path}: no topic of signal {signal!r}; topics: {few(topics, 100)}")
        topic = max(fitting, key=len)
        return topic, split_path(signal[len(topic) :])

    def _clock(self, time: str, topic: str) -> list[str | int] | None:
        """Path to the time field; None if time comes from the log or the header."""
        if time in (LOG_TIME, HEADER_TIME):
            return None
        if not time.startswith("/"):
            return split_path(time)
        home, steps = self._place(time)
        if home != topic:
            raise LogError(
                f"{self.path}: time {time!r} is on another topic than {topic!r}, expected {LOG_TIME}, {HEADER_TIME}, "
                "or a field that all topics have"
            )
        return steps

    def _header_ns(self, message: Any, topic: str) -> int:
        parts = [self._value(message, topic, ["header", "stamp", name], HEADER_TIME) for name in ("sec", "nanosec")]
        if not all(map(math.isfinite, parts)):
            raise LogError(f"{self.path}: topic {topic!r}: header.stamp is no time")
        return 1_000_000_000 * int(parts[0]) + int(parts[1])

    def _decoded(self, topic: str, raw: bytes) -> Any:
        try:
            return self.topics[topic].decode(raw)
        except (UnreadableError, RecursionError) as error:
            raise LogError(f"{self.path}: topic {topic!r}: a message cannot be read: {error}") from None

    def _value(self, message: Any, topic: str, steps: Iterable[str | int], what: str = "") -> float:
        steps = list(steps)
        try:
            value = walk(message, steps)
        except (KeyError, TypeError) as error:
            asked, kind, fields = what or path_text(steps), self.topics[topic].kind, few(fields_of(message), 90)
            raise LogError(
                f"{self.path}: topic {topic!r} ({kind}) has no {asked!r} (at {error}); available: {fields}"
            ) from None
        if value is None:
            return math.nan
        if isinstance(value, str | bytes) or not (isinstance(value, int | float) or hasattr(value, "item")):
            raise LogError(
                f"{self.path}: topic {topic!r}: {path_text(steps)!r} is {type(value).__name__}, expected a number"
            )
        try:
            return float(value)
        except (OverflowError, TypeError, ValueError):
            raise LogError(f"{self.path}: topic {topic!r}: {path_text(steps)!r} is no single number") from None


def path_text(steps: Iterable[str | int]) -> str:
    """Path as text: `["position", 0]` becomes `position[0]`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    return text.removeprefix(".")
