"""Reading of measurements within a share of the sample: a slow transport costs angles, never commands."""

from __future__ import annotations

from typing import NamedTuple, final

from .realtime import Clock
from .transports.transport import Reading, Transport

_SHARE = 4  # a quarter of a sample: judging may take as long once more, so half of it is left to decide and to send
_MOST = 4096  # readings, where the clock stands still meanwhile
_SPARED_NS, _SLOW_FOR_NS = 800_000_000, 3_000_000_000


class Taken(NamedTuple):
    """Readings in the order of arrival, the name of the error, and the time that reading took [ns]."""

    readings: list[Reading]
    fault: str
    took_ns: int


@final
class Reader:
    """Reads the transport until it is empty or a quarter of a sample is over; errors are named, not raised.

    At least one call is made. A call that takes longer cannot be interrupted, and no other one follows it. The oldest
    reading comes first, also after such a call, so that a backlog shows as age. `dt_ns` is the sample time [ns].
    """

    def __init__(self, transport: Transport, clock: Clock, dt_ns: int) -> None:
        self._transport, self._clock, self._dt_ns = transport, clock, dt_ns
        self._slow_ns: int | None = None  # when reading last took longer than a sample
        self._read_ns = 0

    def take(self, spared: bool = False) -> Taken:
        """Readings that have arrived.

        With `spared`, a wire whose reading lately took longer than a sample is left to the commands for most of the
        time: it is
        read every 0.8 s.
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
        """Readings that can be read within a time [ns]; none in a negative one."""
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
