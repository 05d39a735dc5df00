"""What may go wrong between a sensor and a controller, injected on purpose."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, final

from pydantic import Field

from hystmpc.trials.config import Settings

from ..settings_types import NotNegative
from ..transports.link import Outgoing

FaultName = Literal[
    "freeze",
    "nan",
    "outlier",
    "dropout",
    "delay",
    "jitter",
    "reorder",
    "duplicate",
    "replay",
    "stamp_jump",
    "out_of_range",
]
_NS = 1e9


class FaultSettings(Settings):
    """One fault of the readings.

    Attributes:
        fault: `freeze` repeats the last angle; `nan`; `outlier` adds `size_deg` with a random sign; `dropout` sends
            nothing; `delay` sends `delay_s` late; `jitter` up to `delay_s` late; `reorder` holds a reading back
            behind the next; `duplicate` sends it twice; `replay` sends an old one again; `stamp_jump` shifts the
            sender's clock by `delay_s`, of either sign; `out_of_range` sends 10 000 deg.
        start_s: when it begins, counted from the first command.
        duration_s: how long it lasts.
        share: of the readings that it hits.
        size_deg: of an outlier.
        delay_s: see `fault`.
    """

    fault: FaultName
    start_s: NotNegative = 0.0
    duration_s: NotNegative = 1e9
    share: float = Field(default=1.0, gt=0, le=1)
    size_deg: NotNegative = 40.0
    delay_s: float = 0.2


@final
class FaultyWire:
    """Readings in, readings out: what is left of them, and when.

    Args:
        faults: what goes wrong.
        seed: of the draws.
    """

    def __init__(self, faults: Sequence[FaultSettings], seed: int) -> None:
        self._faults, self._random = tuple(faults), random.Random(seed)
        self._last = math.nan
        self._old: list[Outgoing] = []
        self._held_back: Outgoing | None = None
        self._under_way: list[tuple[float, int, Outgoing]] = []
        self._count = 0

    def put(self, message: Outgoing, t_s: float) -> None:
        """Take a reading that is measured at `t_s` [s] after the first command."""
        copies, due = [message], t_s
        hit = [f for f in self._faults if f.start_s <= t_s < f.start_s + f.duration_s]
        for fault in hit:
            if self._random.random() < fault.share:
                copies = [one for message in copies for one in self._changed(fault, message)]
                due += self._late_s(fault)
        if not any(f.fault == "freeze" for f in hit):
            self._last = message.angle
        self._old = [*self._old, message][-50:]
        for copy in copies:
            self._count += 1
            heapq.heappush(self._under_way, (due, self._count, copy))

    def due(self, t_s: float) -> list[Outgoing]:
        """What arrives until `t_s` [s]."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= t_s:
            arrived.append(heapq.heappop(self._under_way)[2])
        return arrived

    def _late_s(self, fault: FaultSettings) -> float:
        if fault.fault == "delay":
            return abs(fault.delay_s)
        return self._random.uniform(0.0, abs(fault.delay_s)) if fault.fault == "jitter" else 0.0

    def _changed(self, fault: FaultSettings, message: Outgoing) -> list[Outgoing]:
        """What a fault makes of one reading."""
        values = {
            "freeze": self._last,
            "nan": math.nan,
            "outlier": message.angle + self._random.choice((-1.0, 1.0)) * fault.size_deg,
            "out_of_range": 1e4,
        }
        name = fault.fault
        if name in values:
            return [replace(message, angle=values[name])]
        if name == "stamp_jump":
            return [replace(message, stamp_ns=max(0, message.stamp_ns + round(_NS * fault.delay_s)))]
        if name == "dropout":
            return []
        if name == "duplicate":
            return [message, message]
        if name == "replay":
            return [message, self._random.choice(self._old)] if self._old else [message]
        if name == "reorder":
            before, self._held_back = self._held_back, None if self._held_back else message
            return [message, before] if before else []
        return [message]
