"""Rooms for calls of the engine: one for each call at work, which may lead to Python and from there to another."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEAST = 1 << 16  # bytes


class _Rooms(threading.local):
    """Rooms of a thread that no call uses now."""

    def __init__(self) -> None:
        self.free: list[NDArray[np.uint8]] = []


_rooms = _Rooms()


def in_room(size: int, function: Any, *given: Any) -> Any:
    """Return function(*given, room); a room of so many bytes is the last argument."""
    free = _rooms.free
    room = free.pop() if free else np.empty(_LEAST, dtype=np.uint8)
    if room.size < size:
        room = np.empty(size, dtype=np.uint8)
    try:
        return function(*given, room)
    finally:
        free.append(room)
