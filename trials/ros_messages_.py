"""ROS 2 messages in CDR, read without ROS from the definitions that the bag carries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache, lru_cache
from typing import Any

from .extras import require

Decoder = Callable[[bytes], Any]


class UnreadableError(Exception):
    """A message, or its definition, cannot be read; the text says why."""


@lru_cache(maxsize=64)  # parsing a definition takes longer than reading thousands of messages
def cdr_decoder(message_type: str, encoding: str, definition: str) -> Decoder:
    """A function from the bytes of a message to an object with the message's fields.

    Args:
        message_type: such as `std_msgs/msg/Float64`.
        encoding: of the definition, `ros2msg`, `ros2idl`, or empty where the bag has none: then it must be one of
            the message types that come with ROS 2.
        definition: the text of the definition.

    Raises:
        UnreadableError: if the type is not known or its definition cannot be read.
        LogError: if `rosbags` is not installed.
    """
    require("rosbags", "logs", "reading ROS 2 messages")
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if not definition or encoding not in ("ros2msg", "ros2idl"):
        store = _common()
        if message_type not in store.types:
            raise UnreadableError(f"{message_type}: the bag does not define it and it is none of ROS 2's own messages")
    else:
        try:
            parsed = (
                get_types_from_msg(definition, message_type)
                if encoding == "ros2msg"
                else get_types_from_idl(definition)
            )
            store = get_typestore(Stores.EMPTY)
            store.register(parsed)
        except Exception as error:  # noqa: BLE001 - so does the parser of definitions
            raise UnreadableError(f"{message_type}: definition cannot be read ({_line(error)})") from None

    def decode(raw: bytes) -> Any:
        try:
            return store.deserialize_cdr(raw, message_type)
        except Exception as error:  # noqa: BLE001 - the generated parsers raise whatever damaged bytes lead to
            raise UnreadableError(f"{message_type}: {_line(error)}") from None

    return decode


@cache
def _common() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.LATEST)


def fields_of(message: Any, prefix: str = "") -> Mapping[str, float]:
    """Numbers of one message by their paths: `data`, `header.stamp.sec`, `position[0]`; at most 8 of an array."""
    if isinstance(message, bool | int | float):
        return {prefix: float(message)}
    found: dict[str, float] = {}
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
            found |= fields_of(value, f"{prefix}.{name}" if prefix else str(name))
    return found


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
