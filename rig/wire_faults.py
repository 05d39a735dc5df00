"""Faults of a simulated device's wire: their settings, and what they make of readings and datagrams."""

from __future__ import annotations

import heapq
import math
import random
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Generic, Literal, TypeVar, final

from pydantic import Field, model_validator

from hystmpc.trials.config import NotNegative, Settings

from .transports.transport import Datagrams, Outgoing, Peer
from .transports.udp import Datagram, Kind, decode

M = TypeVar("M")


_REMEMBERED = 50  # messages that may be replayed
_NS = 1e9
_STANDING = ("freeze", "blocked", "dislodged")  # faults in which the angle is that of the moment before

_TAKEN = 64  # datagrams taken off the socket in one call

Direction = Literal["readings", "commands"]
FaultName = Literal[
    "freeze",
    "blocked",
    "dislodged",
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
    "corrupt",
]
_SENSOR = ("freeze", "blocked", "dislodged", "nan", "outlier", "stamp_jump", "out_of_range")


class FaultSettings(Settings):
    """One fault of the readings, or of the commands on their way to the device.

    Attributes:
        fault: `dropout` sends nothing; `delay` sends `delay_s` late; `jitter` up to `delay_s` late; `reorder` holds a
            message back behind the next; `duplicate` sends it twice; `replay` sends an old one again; `corrupt` spoils
            one byte of a datagram. Of readings only: `freeze` repeats the last angle; `blocked` sends the last angle
            plus noise, as of a tip that cannot move; `dislodged` the same shifted by `size_deg`, as of a sensor that
            has come off; `nan`; `outlier` adds `size_deg` with a random sign; `stamp_jump` shifts the sender's clock by
            `delay_s`, of either sign; `out_of_range` sends 10 000 deg.
        of: which way the messages go that it hits.
        start_s: when it begins, counted from the first command.
        duration_s: how long it lasts.
        share: of the messages that it hits.
        size_deg: of an outlier, or of the shift of a dislodged sensor.
        noise_deg: standard deviation of the angle of a blocked tip or a dislodged sensor.
        delay_s: see `fault`.
    """

    fault: FaultName
    of: Direction = "readings"
    start_s: NotNegative = 0.0
    duration_s: NotNegative = 1e9
    share: float = Field(default=1.0, gt=0, le=1)
    size_deg: NotNegative = 40.0
    noise_deg: NotNegative = 0.05
    delay_s: float = 0.2

    @model_validator(mode="after")
    def _possible(self) -> FaultSettings:
        if self.of == "commands" and self.fault in _SENSOR:
            known = "dropout, delay, jitter, reorder, duplicate, replay, corrupt"
            raise ValueError(f"got fault {self.fault} of commands, available for them: {known}")
        return self

    @property
    def of_datagrams(self) -> bool:
        """Whether the fault acts on datagrams."""
        return self.of == "commands" or self.fault == "corrupt"


@final
class FaultyLine(Generic[M]):
    """Fault injection in a stream of messages: loss, delay, repetition, reordering, changed content.

    Args:
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
        """Messages that arrive until `t_s` [s]."""
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


@final
class FaultyReadings:
    """Fault injection in the readings of a device."""

    def __init__(self, faults: Sequence[FaultSettings], seed: int) -> None:
        self._random, self._last = random.Random(seed), math.nan
        self._line = FaultyLine([f for f in faults if not f.of_datagrams], self._random, self._changed_content)

    def put(self, message: Outgoing, t_s: float) -> None:
        """Take a reading that is measured at `t_s` [s] after the first command."""
        self._line.put(message, t_s)
        if math.isfinite(message.angle) and not any(f.fault in _STANDING for f in self._line.active(t_s)):
            self._last = message.angle

    def due(self, t_s: float) -> list[Outgoing]:
        """Messages that arrive until `t_s` [s]."""
        return self._line.due(t_s)

    def _changed_content(self, fault: FaultSettings, message: Outgoing) -> Outgoing:
        if fault.fault == "stamp_jump":
            return replace(message, stamp_ns=max(0, message.stamp_ns + round(_NS * fault.delay_s)))
        if fault.fault in ("blocked", "dislodged"):
            shift = fault.size_deg if fault.fault == "dislodged" else 0.0
            return replace(message, angle=self._last + shift + self._random.gauss(0.0, fault.noise_deg))
        values = {
            "freeze": self._last,
            "nan": math.nan,
            "outlier": message.angle + self._random.choice((-1.0, 1.0)) * fault.size_deg,
            "out_of_range": 1e4,
        }
        return replace(message, angle=values[fault.fault])


@final
class FaultyDatagrams:
    """A socket on which commands are lost, late, out of order, repeated or spoiled before the device sees them.

    Readings can be spoiled on their way out. Time counts from the first command that comes.
    """

    def __init__(self, wire: Datagrams, faults: Sequence[FaultSettings], seed: int) -> None:
        self._wire, self._random, self._first_ns = wire, random.Random(seed), 0
        datagram_faults = [f for f in faults if f.of_datagrams]
        self._in: FaultyLine[tuple[bytes, Peer]] = FaultyLine(
            [f for f in datagram_faults if f.of == "commands"],
            self._random,
            lambda fault, one: (self._changed_content(fault, one[0]), one[1]),
        )
        self._out = FaultyLine([f for f in datagram_faults if f.of == "readings"], self._random, self._changed_content)
        self._arrived: deque[tuple[bytes, Peer]] = deque()

    def recvfrom(self, size: int) -> tuple[bytes, Peer]:
        """The oldest datagram that has arrived and its sender; `BlockingIOError` where there is none."""
        for _ in range(_TAKEN):
            try:
                data, peer = self._wire.recvfrom(size)
            except BlockingIOError:
                break
            except ConnectionError:  # the answer to a datagram that nobody took
                continue
            self._begin(data)
            self._in.put((data, peer), self._elapsed_s())
        self._arrived.extend(self._in.due(self._elapsed_s()))
        if not self._arrived:
            raise BlockingIOError
        return self._arrived.popleft()

    def sendto(self, data: bytes, peer: Peer) -> int:
        """Send a datagram, or what the faults leave of it."""
        self._out.put(data, self._elapsed_s())
        for one in self._out.due(self._elapsed_s()):
            self._wire.sendto(one, peer)
        return len(data)

    def getsockname(self) -> Peer:
        """Own address."""
        return self._wire.getsockname()

    def close(self) -> None:
        """Free the port."""
        self._wire.close()

    def _begin(self, data: bytes) -> None:
        if not self._first_ns and isinstance(message := decode(data), Datagram) and message.kind is Kind.COMMAND:
            self._first_ns = time.monotonic_ns()

    def _elapsed_s(self) -> float:
        return 1e-9 * (time.monotonic_ns() - self._first_ns) if self._first_ns else -1.0

    def _changed_content(self, fault: FaultSettings, data: bytes) -> bytes:
        """Change one byte at random."""
        del fault
        spoilt, place = bytearray(data), self._random.randrange(len(data))
        spoilt[place] ^= self._random.randrange(1, 256)
        return bytes(spoilt)
