"""UDP transport; a datagram is accepted after checks of its checksum, session, sequence and value.

A datagram has 44 bytes, little-endian:

| offset | type | field |
|---|---|---|
| 0 | 4 bytes | magic `HMPC` |
| 4 | u8 | version, 1 |
| 5 | u8 | kind: 1 reading, 2 command, 3 stop, 4 hello |
| 6 | u16 | n, number of measured inputs in a reading; else 0 |
| 8 | u32 | session, chosen by the sender at its start |
| 12 | u32 | sequence |
| 16 | u64 | sender's monotonic clock [ns] |
| 24 | f64 | reading: angle; command: command; else 0 |
| 32 | f64 | reading: command that the device holds; else 0 |
| 40 | u32 | CRC-32 (zlib) of the 40 bytes before |

That is version 1, of a device with one axis. Version 2, of two axes, has 60 bytes. Its head is the same with version 2,
and the numbers of both axes follow:

| offset | type | field |
|---|---|---|
| 24 | 2 f64 | reading: angles x, y; command: commands x, y; else 0 |
| 40 | 2 f64 | reading: commands that the device holds; else 0 |
| 56 | u32 | CRC-32 (zlib) of the 56 bytes before |

An end of one version refuses every datagram of the other one: `wrong size`.

A reading with n measured inputs has n f64 more, before the CRC-32, in the order of the key `inputs` of both ends. An
end that expects another number of them refuses it too.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
import struct
import time
import zlib
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, final

from pydantic import model_validator

from hystmpc.trials.config import Port, Settings
from hystmpc.trials.errors import ConfigError

from ..axes import PerAxis, each, is_known, together
from .transport import (
    NO_INPUTS,
    Admission,
    Conversion,
    Datagrams,
    DeviceLink,
    Incoming,
    Outgoing,
    Peer,
    Reading,
    RunContext,
    Says,
    SocketWrapper,
    Transport,
    TransportBase,
)

MAGIC, VERSION = b"HMPC", 1
_BODIES = {1: struct.Struct("<4sBBHIIQdd"), 2: struct.Struct("<4sBBHIIQdddd")}  # by version, the number of axes
_CRC = struct.Struct("<I")
SIZES = {axes: body.size + _CRC.size for axes, body in _BODIES.items()}
"""Bytes of a datagram by the number of axes."""

SIZE = SIZES[1]


class Kind(IntEnum):
    """Kinds of datagrams."""

    READING = 1
    COMMAND = 2
    STOP = 3
    HELLO = 4


KINDS = {int(kind): kind for kind in Kind}
_SAYS: Mapping[Kind, Says] = {Kind.HELLO: "greeting", Kind.STOP: "goodbye", Kind.COMMAND: "command"}


@dataclass(frozen=True, slots=True)
class Datagram:
    """The fields of one datagram; see the module."""

    kind: Kind
    session: int
    sequence: int
    stamp_ns: int
    value: PerAxis = 0.0
    held: PerAxis = 0.0
    inputs: tuple[float, ...] = ()


def encode(message: Datagram) -> bytes:
    """The bytes of a datagram, (44,) of one axis and (60,) of two, and 8 more for each input; numbers wrap at 2^32."""
    session, sequence = message.session & 0xFFFFFFFF, message.sequence & 0xFFFFFFFF
    stamp_ns, value = message.stamp_ns & 0xFFFFFFFFFFFFFFFF, each(message.value)
    numbers = *value, *each(message.held)
    count = len(message.inputs)
    body = _BODIES[len(value)].pack(MAGIC, len(value), message.kind, count, session, sequence, stamp_ns, *numbers)
    body += struct.pack(f"<{count}d", *message.inputs)
    return body + _CRC.pack(zlib.crc32(body))


def decode(data: bytes, axes: int = 1, inputs: int = 0) -> Datagram | str:
    """Decode a datagram, or name the fault of its bytes; never raises on bytes of any content or length.

    A reading has `inputs` measured inputs.
    """
    further = len(data) - SIZES[axes]
    if further not in (0, 8 * inputs):
        return "wrong size"
    layout, body = _BODIES[axes], data[: -_CRC.size]
    if zlib.crc32(body) != _CRC.unpack_from(data, len(body))[0]:
        return "wrong checksum"
    magic, version, kind, count, session, sequence, stamp_ns, *numbers = layout.unpack_from(body)
    if magic != MAGIC or version != axes or 8 * count != further:
        return "wrong version"
    known = KINDS.get(kind)
    if known is None:
        return "unknown kind"
    if count != (inputs if known is Kind.READING else 0):
        return "wrong size"
    more = struct.unpack_from(f"<{count}d", body, layout.size)
    return Datagram(known, session, sequence, stamp_ns, together(numbers[:axes]), together(numbers[axes:]), more)


_TRIES = 64  # datagrams looked at in one call; a flood of rubbish must not cost the deadline
_HELLO_NS = 100_000_000
_GOODBYES = 3


def _open(host: str, port: int, what: str) -> socket.socket:
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
class UdpTransport(Transport):
    """Controller's end over UDP. Only the configured device is heard; it is greeted until it answers, at 10 Hz.

    Raises:
        ConfigError: if the own address cannot be had or the device's is none.
    """

    def __init__(self, settings: UdpSettings, conversion: Conversion, inputs: Sequence[str] = ()) -> None:
        self._wire = _open(settings.bind_host, settings.bind_port, "the controller")
        try:
            self._wire.connect((settings.host, settings.port))  # the system drops what comes from elsewhere
        except OSError as error:
            self._wire.close()
            raise ConfigError(f"udp: no way to {settings.host} port {settings.port} ({error})") from None
        self._conversion, self._inputs = conversion, tuple(inputs)
        self._size = SIZES[conversion.axes] + 8 * len(self._inputs)
        self._nothing = together([0.0] * conversion.axes)
        self._session, self._sequence = secrets.randbits(32), 0
        self._counters: Counter[str] = Counter()
        self._answered, self._greeted_ns, self._open = False, 0, True
        self._unread: deque[tuple[bytes, int]] = deque()

    @property
    def counters(self) -> Mapping[str, int]:
        return self._counters

    def read(self) -> Reading | None:
        if not self._answered and time.monotonic_ns() - self._greeted_ns >= _HELLO_NS:
            self.greet()
        while self._unread:
            if reading := self.reading(*self._unread.popleft()):
                return reading
        for _ in range(_TRIES):
            try:
                data = self._wire.recv(self._size + 1)
            except BlockingIOError:
                return None
            except ConnectionRefusedError:
                self._counters["nobody listens"] += 1
                raise
            if reading := self.reading(data, time.monotonic_ns()):
                return reading
        return None

    def reading(self, data: bytes, received_ns: int) -> Reading | None:
        """Decode the reading of a datagram; an invalid one is counted."""
        message = decode(data, self._conversion.axes, len(self._inputs))
        if isinstance(message, str):
            self._counters[message] += 1
            return None
        if message.kind is not Kind.READING:
            self._counters["not a reading"] += 1
            return None
        self._answered = True
        angle, held = self._conversion.angle_deg(message.value), self._conversion.command(message.held)
        inputs = dict(zip(self._inputs, message.inputs, strict=True)) if self._inputs else NO_INPUTS
        return Reading(angle, message.sequence, message.session, message.stamp_ns, received_ns, held, inputs=inputs)

    def numbers(self) -> Mapping[str, float] | None:
        """Socket, session and conversion for reading and writing by a loop in C; None for two axes, or with inputs."""
        conversion = self._conversion
        if conversion.axes > 1 or self._inputs:
            return None
        return {
            "descriptor": self._wire.fileno(),
            "own_session": self._session,
            "sent_sequence": self._sequence & 0xFFFFFFFF,
            "angle_factor": conversion.angle_factor,
            "angle_offset": conversion.angle_offset_deg,
            "command_factor": conversion.command_factor,
        }

    def take_back(self, unread: Sequence[tuple[bytes, int]], sent: int) -> None:
        self._unread.extend(unread)
        self._sequence = sent

    def write(self, command: PerAxis) -> None:
        self._send(Kind.COMMAND, self._conversion.raw_command(command))

    def greet(self) -> None:
        """Ask the device to listen; a missing device is counted."""
        self._greeted_ns = time.monotonic_ns()
        try:
            self._send(Kind.HELLO, self._nothing)
        except ConnectionRefusedError:
            self._counters["nobody listens"] += 1

    def stop(self, goodbye: bool = False) -> None:
        """Close the transport, after several goodbyes if wanted, since one may be lost."""
        if not self._open:
            return
        self._open = False
        for _ in range(_GOODBYES if goodbye else 0):
            with suppress(OSError):  # nobody is there to say goodbye to
                self._send(Kind.STOP, self._nothing)
        self._wire.close()

    def _send(self, kind: Kind, value: PerAxis) -> None:
        self._sequence += 1
        now_ns = time.monotonic_ns()
        self._wire.send(encode(Datagram(kind, self._session, self._sequence, now_ns, value, self._nothing)))


@final
class UdpLink(DeviceLink):
    """Device's end over UDP, for one controller at a time, see `Admission`.

    Args:
        silence_s: how long a controller has to be silent before another may take its place [s].
        through: puts faults before the socket; None for none.
        axes: of the device.

    Raises:
        ConfigError: if the address cannot be had.
    """

    greeted = True

    def __init__(
        self, host: str, port: int, silence_s: float, through: SocketWrapper | None = None, axes: int = 1
    ) -> None:
        self._axes = axes
        wire = _open(host, port, "the device")
        self._wire: Datagrams = wire if through is None else through(wire)
        self._session, self._admission = secrets.randbits(32), Admission(silence_s)
        self._peer: Peer | None = None
        self._counters: Counter[str] = Counter()

    @property
    def port(self) -> int:
        """Port on which it listens."""
        return int(self._wire.getsockname()[1])

    @property
    def counters(self) -> Mapping[str, int]:
        return self._counters

    def receive(self) -> Incoming | None:
        for _ in range(_TRIES):
            try:
                data, peer = self._wire.recvfrom(SIZES[self._axes] + 1)
            except BlockingIOError:
                return None
            except ConnectionError:  # the answer to a datagram that nobody took
                continue
            message = decode(data, self._axes)
            accepted = message if isinstance(message, str) else self._admitted(message, peer)
            if isinstance(accepted, Incoming):
                return accepted
            self._counters[accepted] += 1
        return None

    def send(self, message: Outgoing) -> None:
        if self._peer is None:
            return
        stamps = message.sequence, message.stamp_ns
        data = Datagram(Kind.READING, self._session, *stamps, message.angle, message.held, message.inputs)
        try:
            self._wire.sendto(encode(data), self._peer)
        except OSError:
            self._counters["not sent"] += 1

    def close(self) -> None:
        self._wire.close()

    def _admitted(self, message: Datagram, peer: Peer) -> Incoming | str:
        """Content of an admitted message, or the reason of its refusal."""
        says = _SAYS.get(message.kind)
        if says is None:
            return "not a command"
        if reason := self._admission.admit(says, peer, message.session, message.sequence, time.monotonic_ns()):
            return reason
        if says == "command":
            return Incoming(message.value) if is_known(message.value) else "not-a-number"
        self._peer = peer if says == "greeting" else None
        return Incoming(says=says)


class UdpSettings(TransportBase):
    """Transport `kind: udp`: datagrams to a device and back.

    Attributes:
        host, port: of the device.
        bind_host, bind_port: of this end; port 0 takes a free one.
        allow_network: needed for every address beyond the loopback.
    """

    kind: Literal["udp"]
    host: str = "127.0.0.1"
    port: Port = 47001
    bind_host: str = "127.0.0.1"
    bind_port: Port = 0
    allow_network: bool = False

    @model_validator(mode="after")
    def _local(self) -> UdpSettings:
        for name in ("host", "bind_host"):
            _require_local(name, getattr(self, name), self.allow_network)
        return self

    @property
    def place(self) -> str:
        return f"udp {self.host} port {self.port}"

    def open(self, run: RunContext) -> Transport:
        return UdpTransport(self, run.conversion, run.inputs)


class UdpListenSettings(Settings):
    """Link `kind: udp`: address of the device; port 0 takes a free one, which is printed.

    Attributes:
        bind_host: address where it listens.
        bind_port: port where it listens.
        allow_network: whether the address may be other than this machine's own.
    """

    kind: Literal["udp"]
    bind_host: str = "127.0.0.1"
    bind_port: Port = 47001
    allow_network: bool = False

    @model_validator(mode="after")
    def _local(self) -> UdpListenSettings:
        _require_local("bind_host", self.bind_host, self.allow_network)
        return self

    def listen(self, silence_s: float, through: SocketWrapper | None, axes: int = 1) -> DeviceLink:
        """Open the device's end of the wire; `through` injects faults in front of the socket.

        Raises:
            ConfigError: if the address cannot be had.
        """
        return UdpLink(self.bind_host, self.bind_port, silence_s, through, axes)


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this machine's loopback."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _require_local(name: str, host: str, allow_network: bool) -> None:
    """Refuse addresses beyond the loopback unless they are allowed; pydantic reports the error."""
    if not (is_loopback(host) or allow_network):
        raise ValueError(f"got {name} {host!r}, expected a loopback address, or `allow_network: true`")
