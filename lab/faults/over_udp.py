"""A hostile device behind a real wire, in real time and in a process of its own: for whole samples in C."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection as Pipe

from hystmpc.rig.transports.transport import DeviceLink, Incoming, Outgoing
from hystmpc.rig.transports.udp import UdpLink
from hystmpc.trials.errors import ConfigError

from .description import DeviceSpec
from .hostile import HostileDevice

_HOST = "127.0.0.1"
_PAUSE_S = 0.0005
_PATIENCE_S = 60.0  # a process that starts on a busy machine


@contextmanager
def served(device: HostileDevice) -> Iterator[int]:
    """The UDP port at which the device answers while the block lasts; it has gone through all of it afterwards.

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
    """Until somebody ends it."""
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
