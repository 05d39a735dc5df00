"""Datagrams between controller and device; what arrives is hostile until checksum, order and number say otherwise."""

from __future__ import annotations

import math
import secrets
import socket
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Protocol, final

from hystmpc.trials.errors import ConfigError

from .datagram import SIZE, Datagram, Kind, decode, encode
from .link import Incoming, Outgoing
from .order import NEW, RESTARTED, Order
from .reading import Reading
from .settings import UdpSettings
from .units import Conversion

_TRIES = 64  # datagrams looked at in one call; a flood of rubbish must not cost the deadline
_HELLO_NS = 100_000_000
_GOODBYES = 3

Peer = tuple[str, int]


class Datagrams(Protocol):
    """What the device's end needs of a socket, so that faults can be put before it."""

    def recvfrom(self, size: int, /) -> tuple[bytes, Any]:
        """The oldest datagram and its sender; `BlockingIOError` where there is none."""
        ...

    def sendto(self, data: bytes, peer: Peer, /) -> int:
        """Send a datagram."""
        ...

    def getsockname(self) -> Any:
        """Own address."""
        ...

    def close(self) -> None:
        """Free the port."""
        ...


def _open(host: str, port: int, what: str) -> socket.socket:
    """A socket that is bound and does not block.

    Raises:
        ConfigError: if the address cannot be had.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    wire = socket.socket(family, socket.SOCK_DGRAM)
    try:
        wire.bind((host, port))
    except (OSError, OverflowError) as error:
        wire.close()
        reason = getattr(error, "strerror", None) or error  # an OverflowError has none
        raise ConfigError(f"udp: {what} cannot listen at {host} port {port} ({reason}), expected a free one") from None
    wire.setblocking(False)
    return wire


@final
class UdpTransport:
    """The controller's end. Only the configured device is heard; until it answers it is greeted ten times a second.

    Args:
        settings: addresses.
        conversion: of the wire's units.

    Raises:
        ConfigError: if the own address cannot be had or the device's is none.
    """

    def __init__(self, settings: UdpSettings, conversion: Conversion) -> None:
        self._wire = _open(settings.bind_host, settings.bind_port, "the controller")
        try:
            self._wire.connect((settings.host, settings.port))  # the system drops what comes from elsewhere
        except OSError as error:
            self._wire.close()
            raise ConfigError(f"udp: no way to {settings.host} port {settings.port} ({error})") from None
        self._conversion = conversion
        self._session, self._sequence = secrets.randbits(32), 0
        self._counters: Counter[str] = Counter()
        self._answered, self._greeted_ns, self._open = False, 0, True

    @property
    def counters(self) -> Mapping[str, int]:
        """Datagrams rejected, by cause."""
        return self._counters

    def read(self) -> Reading | None:
        """The oldest measurement that has not been read yet."""
        if not self._answered:
            self._greet()
        for _ in range(_TRIES):
            try:
                data = self._wire.recv(SIZE + 1)
            except BlockingIOError:
                return None
            except ConnectionRefusedError:
                self._counters["nobody listens"] += 1
                raise
            message = decode(data)
            if isinstance(message, str):
                self._counters[message] += 1
            elif message.kind is not Kind.READING:
                self._counters["not a reading"] += 1
            else:
                self._answered = True
                angle, held = self._conversion.angle_deg(message.value), self._conversion.command(message.held)
                now = time.monotonic_ns()
                return Reading(angle, message.sequence, message.session, message.stamp_ns, now, held)
        return None

    def write(self, command: float) -> None:
        """Send a command."""
        self._send(Kind.COMMAND, self._conversion.raw_command(command))

    def stop(self) -> None:
        """Say goodbye, more than once since one may be lost, and close."""
        if not self._open:
            return
        self._open = False
        for _ in range(_GOODBYES):
            with suppress(OSError):  # nobody is there to say goodbye to
                self._send(Kind.STOP, 0.0)
        self._wire.close()

    def _greet(self) -> None:
        now = time.monotonic_ns()
        if now - self._greeted_ns >= _HELLO_NS:
            self._greeted_ns = now
            try:
                self._send(Kind.HELLO, 0.0)
            except ConnectionRefusedError:
                self._counters["nobody listens"] += 1

    def _send(self, kind: Kind, value: float) -> None:
        self._sequence += 1
        self._wire.send(encode(Datagram(kind, self._session, self._sequence, time.monotonic_ns(), value)))


@final
class UdpLink:
    """The device's end: one controller at a time. Another is heard only after the first has been silent or has left.

    Args:
        host, port: where to listen; port 0 takes a free one.
        silence_s: how long a controller has to be silent before another may take its place [s].
        through: puts faults before the socket; None for none.

    Raises:
        ConfigError: if the address cannot be had.
    """

    def __init__(
        self, host: str, port: int, silence_s: float, through: Callable[[Datagrams], Datagrams] | None = None
    ) -> None:
        wire = _open(host, port, "the device")
        self._wire: Datagrams = wire if through is None else through(wire)
        self._silence_ns = round(1e9 * silence_s)
        self._session, self._order = secrets.randbits(32), Order()
        self._peer: Peer | None = None
        self._heard_ns = 0
        self._counters: Counter[str] = Counter()

    @property
    def port(self) -> int:
        """The port it listens at."""
        return int(self._wire.getsockname()[1])

    @property
    def counters(self) -> Mapping[str, int]:
        """Datagrams rejected, by cause."""
        return self._counters

    def receive(self) -> Incoming | None:
        """The oldest command, or goodbye, of the controller that has the device."""
        for _ in range(_TRIES):
            try:
                data, peer = self._wire.recvfrom(SIZE + 1)
            except BlockingIOError:
                return None
            except ConnectionError:  # the answer to a datagram that nobody took
                continue
            message = decode(data)
            if isinstance(message, str):
                self._counters[message] += 1
            elif not self._admitted(message, peer):
                continue
            elif message.kind is Kind.STOP:
                self._peer = None
                return Incoming(math.nan, stopped=True)
            elif message.kind is Kind.COMMAND:
                if math.isfinite(message.value):
                    return Incoming(message.value)
                self._counters["not-a-number"] += 1
        return None

    def send(self, message: Outgoing) -> None:
        """Send a measurement to the controller that has the device."""
        if self._peer is None:
            return
        data = Datagram(Kind.READING, self._session, message.sequence, message.stamp_ns, message.angle, message.held)
        try:
            self._wire.sendto(encode(data), self._peer)
        except OSError:
            self._counters["not sent"] += 1

    def close(self) -> None:
        """Free the port."""
        self._wire.close()

    def _admitted(self, message: Datagram, peer: Peer) -> bool:
        """Whether it comes from the controller that has the device, or from one that may take it now."""
        if message.kind is Kind.READING:
            self._counters["not a command"] += 1
            return False
        now = time.monotonic_ns()
        free = self._peer is None or now - self._heard_ns > self._silence_ns
        if peer != self._peer and not free:
            self._counters["another controller"] += 1
            return False
        if peer != self._peer and message.kind is not Kind.HELLO:
            if message.kind is not Kind.STOP:  # goodbyes come more than once
                self._counters["no greeting"] += 1
            return False
        if self._order.judge(message.session, message.sequence) not in (NEW, RESTARTED):
            self._counters["replayed-or-reordered"] += 1
            return False
        self._peer, self._heard_ns = peer, now
        return True
