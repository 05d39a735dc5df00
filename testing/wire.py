"""Contract tests of transports, and a simulated device on a serial line, without hardware."""

from __future__ import annotations

import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import Self, TypeVar, final

from hystmpc.rig.transports.from_outside import missing_methods, reading_fault
from hystmpc.rig.transports.transport import Reading, Transport

_COMES_S = 5.0  # for something to arrive, on a busy machine
_QUIET_S = 0.05  # for nothing to arrive

T = TypeVar("T")


@dataclass(frozen=True)
class Connected:
    """Open transport, and the device's end of the connection.

    Attributes:
        tell: makes the device send one measurement: angle and held command.
        heard: all commands that the device has received, the oldest first.
        spoil: sends invalid data to the transport; None if impossible.
        cut: breaks the connection; None if impossible.
    """

    transport: Transport
    tell: Callable[[float, float], None]
    heard: Callable[[], Sequence[float]]
    spoil: Callable[[], None] | None = None
    cut: Callable[[], None] | None = None


class Wired(ABC):
    """Base of the contract tests of transports: the connection to a device simulated by the test.

    Attributes:
        resolution: of angles and commands on the wire, in its units.
        keeps: whether measurements are queued until they are read; a polled device returns only the newest.
    """

    resolution: float = 1e-3
    keeps: bool = True

    @abstractmethod
    def connected(self) -> AbstractContextManager[Connected]:
        """Context with a transport and its device, both closed at the end."""

    def near(self, got: float, expected: float) -> bool:
        """Whether two numbers are equal up to the resolution of the wire."""
        return abs(got - expected) <= self.resolution


class TransportContract(Wired):
    """Contract tests of a transport: derive a class whose name begins with `Test`, give it `connected`, run pytest."""

    def test_it_has_what_a_transport_has(self) -> None:
        """A transport has four methods and the mapping `counters`."""
        with self.connected() as c:
            require(not missing_methods(c.transport), f"it lacks {missing_methods(c.transport)}")
            require(
                all(isinstance(n, int) for n in dict(c.transport.counters).values()), "counters maps causes to counts"
            )

    def test_a_measurement_comes_once_and_as_it_was_sent(self) -> None:
        """A measurement is read once, with rising sequence, one session, and a stamp of the monotonic clock."""
        with self.connected() as c:
            first = contact(c)
            for k in range(1, 4):
                c.tell(40.0 + k, 0.5 * k)
                reading = until(c.transport.read)
                require(reading_fault(reading, time.monotonic_ns()) == "", reading_fault(reading, time.monotonic_ns()))
                require(self.near(reading.angle_deg, 40.0 + k), f"sent angle {40.0 + k}, read {reading.angle_deg}")
                holds_it = math.isnan(reading.held) or self.near(reading.held, 0.5 * k)
                require(holds_it, f"the device holds {0.5 * k}, read {reading.held}; NaN where the wire does not tell")
                require(reading.sequence > first.sequence, "the sequence has to rise by every measurement")
                require(reading.session == first.session, "the session has to stay while the device runs")
                require(reading.received_ns >= first.received_ns, "received_ns has to rise")
                first = reading
                require(c.transport.read() is None, "a measurement was read twice")

    def test_the_sequence_rises_where_a_counter_of_one_byte_wraps(self) -> None:
        """The sequence rises over 300 measurements."""
        with self.connected() as c:
            last = contact(c).sequence
            for _ in range(300):
                c.tell(40.0, 0.0)
                reading = until(c.transport.read).sequence
                carry = "carry on a counter n that starts again: count += (n - count) % 256"
                require(reading > last, f"the sequence went from {last} to {reading}, it has to rise; {carry}")
                last = reading

    def test_measurements_that_pile_up_come_in_order(self) -> None:
        """Measurements are read in order and none is lost; left out where `keeps` is not set."""
        if not self.keeps:
            return
        with self.connected() as c:
            contact(c)
            for k in range(5):
                c.tell(40.0 + k, 0.0)
            angles = [until(c.transport.read).angle_deg for _ in range(5)]
            require(all(self.near(a, 40.0 + k) for k, a in enumerate(angles)), f"sent 40 to 44, read {angles}")

    def test_commands_arrive_in_order_and_as_they_were_written(self) -> None:
        """Every command arrives, in order and to the resolution of the wire."""
        with self.connected() as c:
            contact(c)
            wanted = [0.0, 0.125, 1.5, 5.9, 0.25]
            for command in wanted:
                c.transport.write(command)
            until(lambda: len(c.heard()) >= len(wanted) or None)
            got = list(c.heard())
            fits = len(got) == len(wanted) and all(map(self.near, got, wanted))
            require(fits, f"wrote {wanted}, the device got {got}")

    def test_only_write_moves_the_device(self) -> None:
        """Opening, reading, greeting and closing, with a goodbye and without, send no command."""
        for goodbye in (False, True):
            with self.connected() as c:
                contact(c)
                c.transport.greet()
                c.transport.stop(goodbye)
                time.sleep(_QUIET_S)
                require(not c.heard(), f"the device got {list(c.heard())} without a write")

    def test_after_stop_nothing_is_sent_and_stop_may_come_twice(self) -> None:
        """After `stop`, which may come twice, no command is sent."""
        with self.connected() as c:
            contact(c)
            c.transport.stop()
            c.transport.stop()
            with suppress(Exception):
                c.transport.write(3.0)
            time.sleep(_QUIET_S)
            require(not c.heard(), f"the device got {list(c.heard())} after stop")

    def test_rubbish_is_no_measurement_and_the_next_good_one_is_read(self) -> None:
        """Invalid data raise or are ignored, and the next measurement is read; left out where `spoil` is None."""
        with self.connected() as c:
            if c.spoil is None:
                return
            contact(c)
            c.spoil()
            time.sleep(_QUIET_S)
            c.tell(47.0, 0.0)
            reading = until(lambda: number(c.transport))
            require(self.near(reading.angle_deg, 47.0), f"sent rubbish and 47, read {reading.angle_deg}")

    def test_a_dead_wire_gives_no_measurement(self) -> None:
        """Reading a cut wire raises or returns None; left out where `cut` is None."""
        with self.connected() as c:
            if c.cut is None:
                return
            contact(c)
            c.cut()
            for _ in range(20):
                reading = None
                with suppress(Exception):
                    reading = c.transport.read()
                require(reading is None, f"the plug is pulled, read {reading}")
                with suppress(Exception):
                    c.transport.write(1.0)
            with suppress(Exception):
                c.transport.stop()


@final
class LineDevice:
    """Simulated device on a pseudo-terminal, which a transport opens as a serial port; Linux and macOS.

    Args:
        say: the line of a measurement, of angle and held command; without its newline.
        hear: the command that a line holds; None for a line that is no command.
    """

    def __init__(self, say: Callable[[float, float], bytes], hear: Callable[[bytes], float | None]) -> None:
        import tty  # not on Windows

        self._say, self._hear = say, hear
        self._device_end, self._port = os.openpty()
        tty.setraw(self._port)
        os.set_blocking(self._device_end, False)
        self.port = os.ttyname(self._port)
        self._rest, self._commands = b"", list[float]()
        self._open = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.cut()

    def tell(self, angle: float, held: float) -> None:
        """Send one measurement; it is lost if no program reads the line, as on a real one."""
        self.say(self._say(angle, held) + b"\n")

    def say(self, data: bytes) -> None:
        """Send arbitrary bytes."""
        if self._open:
            with suppress(BlockingIOError):
                os.write(self._device_end, data)

    def spoil(self) -> None:
        """Send lines that are no measurement."""
        self.say(b"\n\x00\xff\xfe\nA\nnan\n" + bytes(range(128, 256)) + b"\n")

    def heard(self) -> list[float]:
        """All commands received so far, the oldest first."""
        while self._open:
            try:
                self._rest += os.read(self._device_end, 4096)
            except OSError:  # no further data
                break
        *lines, self._rest = self._rest.split(b"\n")
        self._commands += [command for line in lines if (command := self._hear(line)) is not None]
        return list(self._commands)

    def cut(self) -> None:
        """Close the line; may be called twice."""
        if self._open:
            self._open = False
            os.close(self._device_end)
            os.close(self._port)


def require(holds: bool, text: str) -> None:
    """Fail a test with a line of text if a condition does not hold.

    Raises:
        AssertionError: where it does not hold.
    """
    if not holds:
        raise AssertionError(text)


def until(get: Callable[[], T | None]) -> T:
    """Return the first result that is not None.

    Raises:
        AssertionError: if none comes within 5 s.
    """
    end = time.monotonic() + _COMES_S
    while time.monotonic() < end:
        if (reading := get()) is not None:
            return reading
        time.sleep(0.001)
    raise AssertionError(f"nothing came within {_COMES_S:g} s")


def number(transport: Transport) -> Reading | None:
    """Return the next reading with a finite angle, if any; a transport may raise on invalid data."""
    with suppress(Exception):
        reading = transport.read()
        return reading if reading is not None and math.isfinite(reading.angle_deg) else None
    return None


def contact(c: Connected) -> Reading:
    """Wait until the device sends and receives and all readings are read; returns the last one."""

    def answer() -> Reading | None:
        c.heard()
        c.tell(40.0, 0.0)
        time.sleep(0.002)
        reading = number(c.transport)
        if reading is not None and not reading.listens:
            c.transport.greet()
            return None
        return reading

    newest, quiet = until(answer), time.monotonic() + _QUIET_S
    while time.monotonic() < quiet:
        if (reading := number(c.transport)) is not None:
            newest, quiet = reading, time.monotonic() + _QUIET_S
        time.sleep(0.001)
    return newest
