"""Simulated hostile device on a virtual clock: drive, sensor, stream, watchdog and log; also over UDP."""

from __future__ import annotations

import math
import multiprocessing
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection as Pipe
from typing import Any, ClassVar, final

import numpy as np
from pydantic import PrivateAttr

from hystmpc.rig.realtime import Clock
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.rig.transports.transport import DeviceLink, Incoming, Outgoing, Reading, RunContext, Transport
from hystmpc.rig.transports.udp import UdpLink
from hystmpc.trials.errors import ConfigError

from .description import SAFE, BodyState, DeviceFault, DeviceSpec, FaultKind, Row, at_rest, moved

_NS = 1_000_000_000
_STEP_NS = 2_000_000  # of the body, at most
_ROW_NS = 10_000_000  # period of the log rows, besides commands
_SOCKET = 256  # capacity for unread readings; beyond it the newest are lost, as in a socket
_BETWEEN_NS = 200_000_000  # time between two connections
_OUTSIDE_DEG = 9_999.0
_LONGEST_NS = 600 * _NS


class EndlessError(BaseException):
    """Error of a device that is used for longer than its time limit, an endless loop; never caught in passing."""


@dataclass
class DeviceState:
    """Variable state of a device."""

    body: BodyState
    ns: int = _NS
    target: float = SAFE
    position: float = SAFE
    told: float = SAFE
    shown_deg: float = math.nan
    next_reading_ns: int = _NS
    next_row_ns: int = _NS
    newest_ns: int = _NS  # measurement time of the newest reading that was read
    heard_ns: int | None = None  # time of a controller's last message; None if the watchdog is off
    returns: bool = False
    deaf: bool = True
    sequence: int = 0
    session: int = 1
    motion: int = -1
    open: bool = False
    began_ns: list[int | None] = field(default_factory=list)
    frozen_deg: float = math.nan
    done: set[str] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class DeviceReading:
    """One reading in transit; times of the device [ns]."""

    taken_ns: int
    arrives_ns: int
    angle_deg: float
    told: float
    sequence: int
    session: int
    listens: bool


@final
class HostileDevice:
    """Simulated device, computed up to the time of each access, over several consecutive connections."""

    def __init__(self, spec: DeviceSpec) -> None:
        self.spec, self.rows = spec, list[Row]()
        self.state = DeviceState(at_rest(spec.body, SAFE), began_ns=[None] * len(spec.faults))
        self._random = np.random.default_rng([spec.seed, 7])
        self._wire = deque[DeviceReading]()
        self._period_ns = round(_NS / spec.stream_hz)

    def began_s(self, kind: FaultKind) -> float:
        """Start time of the fault of that kind [s]; NaN before it or without it."""
        for fault, began in zip(self.spec.faults, self.state.began_ns, strict=True):
            if fault.kind == kind and began is not None and began <= self.state.ns:
                return began / _NS
        return math.nan

    def connect(self, clock: Clock) -> Connection:
        """Connect a controller with its clock; return the connection."""
        self.begin()
        return Connection(self, clock)

    def begin(self) -> None:
        """Begin a connection: earlier messages in transit are lost, and a greeting is required."""
        state = self.state
        self.advance(state.ns + _BETWEEN_NS)
        self._wire.clear()
        state.motion, state.open, state.deaf = state.motion + 1, True, True

    def leave(self, goodbye: bool) -> None:
        """End a connection; the goodbye disables the watchdog if the drive is at rest."""
        state = self.state
        state.open = False
        if goodbye and abs(state.position - SAFE) <= 1e-3:
            state.heard_ns = None

    def settle(self, seconds: float) -> None:
        """Advance the time without a controller."""
        self.advance(self.state.ns + round(seconds * _NS))

    def active(self, kind: FaultKind) -> DeviceFault | None:
        """Fault of that kind if it is active, else None."""
        for fault, began in zip(self.spec.faults, self.state.began_ns, strict=True):
            if fault.kind == kind and began is not None:
                since_s = (self.state.ns - began) / _NS
                if 0.0 <= since_s < fault.lasts_s and not self._pauses(fault, since_s):
                    return fault
        return None

    @staticmethod
    def _pauses(fault: DeviceFault, since_s: float) -> bool:
        turns = fault.kind in ("outside", "held_nan") and fault.period_s > 0
        return turns and int(since_s / fault.period_s) % 2 == 1

    def advance(self, ns: int) -> None:
        """Compute the device up to a given time.

        Raises:
            EndlessError: beyond ten minutes of its time.
        """
        state = self.state
        if ns > _LONGEST_NS:
            raise EndlessError(f"no end after {_LONGEST_NS / _NS:.0f} s")
        while state.ns < ns:
            until = min(ns, state.ns + _STEP_NS, state.next_reading_ns, state.next_row_ns)
            if until > state.ns:
                self._step((until - state.ns) / _NS)
                state.ns = until
            if state.ns == state.next_reading_ns:
                self._show()
                state.next_reading_ns += self._period_ns
            if state.ns == state.next_row_ns:
                self._note(math.nan, state.target)
                state.next_row_ns += _ROW_NS

    def take(self, command: float) -> None:
        """Receive a command."""
        state, before = self.state, self.state.target
        for k, (fault, began) in enumerate(zip(self.spec.faults, state.began_ns, strict=True)):
            if began is None and state.motion >= fault.motion:
                state.began_ns[k] = state.ns + round(fault.at_s * _NS)
        if state.deaf and self.spec.sessions:
            return
        state.heard_ns = state.ns
        if self.active("deaf") is None and self.active("wanders") is None:
            state.target, state.returns = command, False
        self._note(command, before)

    def greet(self) -> None:
        """Receive a greeting of a controller."""
        self.state.deaf = False

    def due(self) -> DeviceReading | None:
        """Oldest reading that has arrived; a present one if `read` always has something."""
        if self.active("reads_slowly") is not None:
            self._wire.clear()
            self._show(flight_s=0.0)
        if not self._wire or self._wire[0].arrives_ns > self.state.ns:
            return None
        found = self._wire.popleft()
        self.state.newest_ns = max(self.state.newest_ns, found.taken_ns)
        return found

    def once(self, kind: FaultKind) -> float:
        """Duration of a single fault [s]; 0 before its start or after its end."""
        fault = self.active(kind)
        if fault is None or fault.kind in self.state.done:
            return 0.0
        self.state.done.add(fault.kind)
        return fault.size

    def _step(self, dt_s: float) -> None:
        state, spec = self.state, self.spec
        if self.active("restarts") is not None and state.session == 1:
            state.session, state.sequence, state.deaf, state.heard_ns = 2, 0, True, None
            state.target = state.position = SAFE
        self._watch()
        if state.returns:
            way = spec.return_rate * dt_s
            state.target += min(max(SAFE - state.target, -way), way)
        if (wanders := self.active("wanders")) is not None:
            state.target += wanders.size * dt_s * (1.0 if state.ns // _NS % 4 < 2 else -1.0)
        way = spec.drive_rate * dt_s
        state.position += min(max(state.target - state.position, -way), way)
        steepens = self.active("steepens")
        body = spec.body if steepens is None else replace(spec.body, gain=steepens.size * spec.body.gain)
        stuck, dithers = self.active("stuck"), self.active("dithers")
        held_fast = stuck is not None or dithers is not None
        angle = moved(body, state.body, state.position, dt_s)
        if not held_fast:
            state.frozen_deg = angle
        elif dithers is not None:
            phase = 2.0 * math.pi * state.ns / _NS / dithers.period_s
            state.body.angle_deg = state.frozen_deg + dithers.size * math.sin(phase)
        else:
            state.body.angle_deg = state.frozen_deg

    def _watch(self) -> None:
        state, spec = self.state, self.spec
        silent = state.heard_ns is not None and state.ns - state.heard_ns > spec.watchdog_s * _NS
        if silent or (self.active("leaves") is not None and not state.returns):
            state.returns, state.deaf, state.heard_ns = True, True, None

    def _show(self, flight_s: float | None = None) -> None:
        state, spec = self.state, self.spec
        state.sequence += 1
        state.told = self._told()
        state.shown_deg = self._measured()
        if self.active("silent") is not None:
            return
        flight = spec.flight_s if flight_s is None else flight_s
        if (ages := self.active("ages")) is not None:
            flight += ages.size * (state.ns / _NS - self.began_s("ages"))
        if len(self._wire) < _SOCKET or flight > spec.flight_s:
            arrives, listens = state.ns + round(flight * _NS), not (state.deaf and spec.sessions)
            self._wire.append(
                DeviceReading(state.ns, arrives, state.shown_deg, state.told, state.sequence, state.session, listens)
            )

    def _measured(self) -> float:
        state, spec = self.state, self.spec
        angle = state.body.angle_deg + spec.noise_deg * float(self._random.standard_normal())
        if self.active("outside") is not None:
            return _OUTSIDE_DEG
        if (shifted := self.active("shifted")) is not None:
            angle += shifted.size
        if (spikes := self.active("spikes")) is not None and state.sequence % 10 == 0:
            angle += spikes.size
        return round(angle / spec.quantum_deg) * spec.quantum_deg if spec.quantum_deg else angle

    def _told(self) -> float:
        if not self.spec.tells or self.active("held_nan") is not None:
            return math.nan
        held = self.active("held")
        return self.state.position if held is None else held.size

    def _note(self, received: float, before: float) -> None:
        state = self.state
        motion = state.motion if state.open else -1
        age_s = (state.ns - state.newest_ns) / _NS - self.spec.flight_s
        self.rows.append(
            Row(
                state.ns / _NS,
                motion,
                received,
                before,
                state.target,
                state.told,
                state.body.x,
                state.body.angle_deg,
                state.shown_deg,
                max(age_s, 0.0),
            )
        )


@final
class Connection(Transport):
    """Connection to a device; `read` and `write` may take time, which then passes on the clock.

    Args:
        clock: of whoever controls; it is made to pass by waiting.
    """

    def __init__(self, device: HostileDevice, clock: Clock) -> None:
        self._device, self._clock = device, clock
        self._offset_ns = device.state.ns - clock.now_ns()
        self._open = True

    @property
    def counters(self) -> Mapping[str, int]:
        return {}

    def read(self) -> Reading | None:
        self._pass()
        self._spend(self._device.once("stalls"))
        slow = self._device.active("reads_slowly")
        self._spend(0.0 if slow is None else slow.size)
        found = self._device.due()
        if found is None:
            return None
        numbers = found.sequence, found.session, found.taken_ns
        return Reading(found.angle_deg, *numbers, self._clock.now_ns(), found.told, found.listens)

    def write(self, command: float) -> None:
        self._pass()
        slow = self._device.active("writes_slowly")
        self._spend(0.0 if slow is None else slow.size)
        self._device.take(command)

    def greet(self) -> None:
        self._pass()
        self._device.greet()

    def stop(self, goodbye: bool = False) -> None:
        self._pass()
        if self._open:
            self._open = False
            self._device.leave(goodbye)

    def _spend(self, seconds: float) -> None:
        if seconds > 0:
            self._clock.wait_until(self._clock.now_ns() + round(seconds * _NS))
            self._pass()

    def _pass(self) -> None:
        self._device.advance(self._clock.now_ns() + self._offset_ns)


class HostileSettings(SimulatedSettings):
    """Settings of a hostile device in place of a simulated one, on its virtual clock."""

    in_process: ClassVar[bool] = True
    _device: HostileDevice | None = PrivateAttr(None)

    @classmethod
    def of(cls, device: HostileDevice) -> HostileSettings:
        """Settings of an existing device."""
        settings = cls(kind="simulated", plant={"hostile": device.spec.name}, seed=device.spec.seed)
        settings._device = device
        return settings

    def open(self, run: RunContext) -> Transport:
        assert self._device is not None
        return self._device.connect(clock_of(run))


def clock_of(run: RunContext) -> Clock:
    """Clock of a run; a device with a slow `read` advances it."""
    clock: Any = getattr(run.now_ns, "__self__", None)
    assert clock is not None, "a hostile device needs the clock itself"
    found: Clock = clock
    return found


_HOST = "127.0.0.1"
_PAUSE_S = 0.0005
_PATIENCE_S = 60.0  # start of a process on a busy machine


@contextmanager
def served(device: HostileDevice) -> Iterator[int]:
    """Serve the device over UDP within the block; yields the port, and updates the device at the end.

    Raises:
        ConfigError: if its process does not start.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(device.spec, theirs), daemon=True)
    process.start()
    try:
        if not ours.poll(_PATIENCE_S):
            raise ConfigError(f"device {device.spec.name}: its process has not started within {_PATIENCE_S:g} s")
        yield int(ours.recv())
        ours.send("end")
        device.rows, device.state = ours.recv()
    finally:
        process.terminate()
        process.join()


def _serve(spec: DeviceSpec, pipe: Pipe) -> None:
    device, link = HostileDevice(spec), UdpLink(_HOST, 0, spec.watchdog_s)
    device.begin()
    offset = time.monotonic_ns() - device.state.ns
    pipe.send(link.port)
    while not pipe.poll():
        device.advance(time.monotonic_ns() - offset)
        while (message := link.receive()) is not None:
            _said(device, message)
        _send(device, link, offset)
        time.sleep(_PAUSE_S)
    link.close()
    pipe.send((device.rows, device.state))


def _said(device: HostileDevice, message: Incoming) -> None:
    if message.says == "command":
        device.take(message.command)
    elif message.says == "greeting":
        device.greet()
    else:
        device.leave(goodbye=True)


def _send(device: HostileDevice, link: DeviceLink, offset_ns: int) -> None:
    while (found := device.due()) is not None:
        stamp = found.taken_ns + offset_ns
        link.send(Outgoing(found.angle_deg, found.told, found.sequence, stamp, found.listens))
