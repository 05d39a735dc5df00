"""What a transport has to say, read in a share of the sample: a slow wire costs angles, never commands."""

from __future__ import annotations

from typing import NamedTuple, final

from .realtime import Clock
from .transports.transport import Reading, Transport

_SHARE = 4  # a quarter of a sample: judging may take as long once more, so half of it is left to decide and to send
_MOST = 4096  # readings, where the clock stands still meanwhile
_SPARED_NS, _SLOW_FOR_NS = 800_000_000, 3_000_000_000


class Taken(NamedTuple):
    """What was read: readings in the order of arrival, the name of what failed, and how long it took [ns]."""

    readings: list[Reading]
    fault: str
    took_ns: int


@final
class Reader:
    """Reads until nothing is left or a quarter of a sample is over; what it raises is named.

    At least one call is made. A call that takes longer cannot be broken off here, and no other one follows it. What is
    left comes first the next time: the oldest is read first, so that a backlog shows as age.

    Args:
        dt_ns: sample time [ns].
    """

    def __init__(self, transport: Transport, clock: Clock, dt_ns: int) -> None:
        self._transport, self._clock, self._dt_ns = transport, clock, dt_ns
        self._slow_ns: int | None = None  # when reading last took longer than a sample
        self._read_ns = 0

    def take(self, spared: bool = False) -> Taken:
        """What has arrived.

        Args:
            spared: whether a wire on which reading lately took longer than a sample is left to the commands for most of
                the time: it is read every 0.8 s.
        """
        now = self._clock.now_ns()
        slow = self._slow_ns is not None and now - self._slow_ns < _SLOW_FOR_NS
        if spared and slow and now - self._read_ns < _SPARED_NS:
            return Taken([], "", 0)
        taken = self.within(self._dt_ns // _SHARE)
        self._read_ns = now + taken.took_ns
        if taken.took_ns > self._dt_ns:
            self._slow_ns = self._read_ns
        return taken

    def within(self, budget_ns: int) -> Taken:
        """What has arrived, as far as it can be read in a time [ns]; nothing in one below 0."""
        readings: list[Reading] = []
        began = now = self._clock.now_ns()
        fault = ""
        while now - began <= budget_ns and len(readings) < _MOST:
            try:
                reading = self._transport.read()
            except Exception as error:  # noqa: BLE001 - a device's driver may raise anything
                fault = f"transport-{type(error).__name__}"
                break
            if reading is None:
                break
            readings.append(reading)
            now = self._clock.now_ns()
        return Taken(readings, fault, self._clock.now_ns() - began)
