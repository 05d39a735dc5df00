"""A line on which messages are lost, held up, repeated and spoiled on purpose."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar, final

from .faults import FaultSettings

M = TypeVar("M")
_REMEMBERED = 50  # messages that may be replayed


@final
class FaultyLine(Generic[M]):
    """Messages in, messages out: what is left of them, and when.

    Args:
        faults: what goes wrong.
        draws: random numbers.
        spoil: a fault and a message to the message with another content.
    """

    def __init__(
        self, faults: Sequence[FaultSettings], draws: random.Random, spoil: Callable[[FaultSettings, M], M]
    ) -> None:
        self._faults, self._random, self._spoil = tuple(faults), draws, spoil
        self._old: list[M] = []
        self._held_back: M | None = None
        self._under_way: list[tuple[float, int, M]] = []
        self._count = 0

    def active(self, t_s: float) -> list[FaultSettings]:
        """The faults that there are at `t_s` [s] after the first command."""
        return [f for f in self._faults if f.start_s <= t_s < f.start_s + f.duration_s]

    def put(self, message: M, t_s: float) -> None:
        """Take a message that is sent at `t_s` [s] after the first command."""
        copies, due = [message], t_s
        for fault in self.active(t_s):
            if self._random.random() < fault.share:
                copies = [one for message in copies for one in self._changed(fault, message)]
                due += self._late_s(fault)
        self._old = [*self._old, message][-_REMEMBERED:]
        for copy in copies:
            self._count += 1
            heapq.heappush(self._under_way, (due, self._count, copy))

    def due(self, t_s: float) -> list[M]:
        """What arrives until `t_s` [s]."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= t_s:
            arrived.append(heapq.heappop(self._under_way)[2])
        return arrived

    def _late_s(self, fault: FaultSettings) -> float:
        if fault.fault == "delay":
            return abs(fault.delay_s)
        return self._random.uniform(0.0, abs(fault.delay_s)) if fault.fault == "jitter" else 0.0

    def _changed(self, fault: FaultSettings, message: M) -> list[M]:
        """What a fault makes of one message."""
        name = fault.fault
        if name in ("delay", "jitter"):
            return [message]
        if name == "dropout":
            return []
        if name == "duplicate":
            return [message, message]
        if name == "replay":
            return [message, self._random.choice(self._old)] if self._old else [message]
        if name == "reorder":
            before, self._held_back = self._held_back, None if self._held_back else message
            return [message, before] if before else []
        return [self._spoil(fault, message)]
