"""A bench of two axes for tests: a simulated device behind a real socket, and a run on it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.bench.device import make_plant
from hystmpc.rig.axes import together
from hystmpc.rig.device import FaultyDatagrams, PlaneDeviceSettings, ServerCounts, SimulatedDevice, _open_log
from hystmpc.rig.plane_config import PlaneRunSettings
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports.dds import DdsSettings
from hystmpc.rig.transports.transport import Datagrams
from hystmpc.rig.transports.udp import Datagram, Kind, UdpLink, decode

from ..models.two_axis_examples import RATE, REACH, SHARED, two_axes

RATE_HZ = 50.0
LIMITS = {"lower": [-REACH, -REACH], "upper": [REACH, REACH], "rate_per_s": [RATE, 0.5 * RATE]}
Row = tuple[float, float]


def model_in(folder: Path) -> Path:
    """The file of a device whose tendons and sensor are turned, and whose axes share friction."""
    made = two_axes(((1.0, 0.3), (-0.2, 1.0)), ((1.0, 0.1), (0.2, 1.0)), SHARED).at_sample_time(1 / RATE_HZ)
    return made.save(folder / "both.yaml")


@dataclass
class Tap:
    """A socket that remembers every command as it left the controller, in front of all faults."""

    wire: Datagrams
    commands: list[Datagram] = field(default_factory=list)

    def recvfrom(self, size: int, /) -> tuple[bytes, Any]:
        data, peer = self.wire.recvfrom(size)
        message = decode(data, 2)
        if isinstance(message, Datagram) and message.kind is Kind.COMMAND:
            self.commands.append(message)
        return data, peer

    def sendto(self, data: bytes, peer: tuple[str, int], /) -> int:
        return self.wire.sendto(data, peer)

    def getsockname(self) -> Any:
        return self.wire.getsockname()

    def close(self) -> None:
        self.wire.close()


class DdsTap:
    """What a device's end over DDS takes, remembered as commands of datagrams."""

    def __init__(self, link: Any) -> None:
        self.commands: list[Datagram] = []
        self._take, link._wire.take = link._wire.take, self.take

    def take(self) -> Any:
        message = self._take()
        if message is not None and not message.header.frame_id:
            stamp, pair = message.header.stamp, together(map(float, message.data))
            at = 10**9 * stamp.sec + stamp.nanosec
            self.commands.append(Datagram(Kind.COMMAND, message.session, message.sequence, at, pair))
        return message


@dataclass
class Served:
    """A device that is served in a thread, and the transport that leads to it."""

    transport: Mapping[str, Any]
    tap: Tap | DdsTap
    log: Path
    counts: list[ServerCounts] = field(default_factory=list)

    @property
    def port(self) -> int:
        """Port over UDP."""
        return int(self.transport["port"])

    def rows(self) -> dict[str, np.ndarray]:
        """The device's log by column."""
        table = np.genfromtxt(self.log, delimiter=",", names=True)
        return {name: table[name] for name in table.dtype.names or ()}


def topics() -> dict[str, Any]:
    """Transport of two topics that no other process uses."""
    names = {f"{name}_topic": f"of_{os.getpid()}/{name}" for name in ("angle", "command")}
    return {"kind": "dds", "domain": 80, **names}


@contextmanager
def served(
    folder: Path, faults: Sequence[Mapping[str, Any]] = (), wire: str = "udp", **changes: Any
) -> Iterator[Served]:
    """Serve the device of `model_in` within the block; faults of datagrams only over UDP."""
    model, taps = model_in(folder), list[Tap]()
    plain = {"rate_hz": RATE_HZ, "command_unit": "mm", "limits": LIMITS, "link": {"kind": "udp", "bind_port": 0}}
    plant = {"simulator": str(model), "noise_deg": 0.05}
    settings = PlaneDeviceSettings.parse(plain | {"plant": plant, "faults": list(faults), "seed": 3} | changes)

    def through(wire: Datagrams) -> Datagrams:
        taps.append(Tap(wire))
        return FaultyDatagrams(taps[0], settings.faults, settings.seed)

    link: Any
    if wire == "dds":
        link = DdsSettings.parse(topics()).listen(settings.watchdog_s, None, 2)
        transport, tap = topics(), DdsTap(link)
    else:
        link = UdpLink("127.0.0.1", 0, settings.watchdog_s, through, axes=2)
        transport, tap = {"kind": "udp", "port": link.port}, taps[0]
    made, held = make_plant(settings.plant, settings.dt_s, settings.seed, folder, "mm")
    flag, log = StopFlag(), folder / "device.csv"
    with _open_log(log, 2) as lines:
        device = SimulatedDevice(settings, made, held, link, lines)
        it = Served(transport, tap, log)
        thread = threading.Thread(target=lambda: it.counts.append(device.serve(flag)))
        thread.start()
        try:
            yield it
        finally:
            flag.set("end")
            thread.join()
            link.close()


def bench(folder: Path, port: int, **changes: Any) -> PlaneRunSettings:
    """A bench for that device, with a short reference."""
    plain: dict[str, Any] = {
        "name": "two-planes",
        "rate_hz": RATE_HZ,
        "command_unit": "mm",
        "limits": LIMITS,
        "safe_command": [0.0, 0.5],
        "ramps": {"velocity_per_s": 3.0, "acceleration_per_s2": 20.0, "jerk_per_s3": 400.0},
        "sensor": {"lower_deg": -60, "upper_deg": 60, "dead_after_s": 0.4},
        "transport": {"kind": "udp", "port": port},
        "latch_file": str(folder / "latch.json"),
        "prepare": [{"step": "move", "to": [1.0, -1.0]}],
        "controller": {"model": str(folder / "both.yaml")},
        "reference": {"kind": "points", "points": [[0, 0], [8, -6], [0, 5]], "hold_s": 0.1},
    }
    return PlaneRunSettings.parse(plain | changes)


def require_within_limits(tap: Tap | DdsTap, slack: float = 0.0) -> None:
    """Every command as it left the controller lies within value and rate of its axis.

    The time between two commands is that of their stamps, at least a tenth of a sample.
    """
    assert tap.commands
    for axis in range(2):
        low, high, rate = (LIMITS[key][axis] for key in ("lower", "upper", "rate_per_s"))
        u = np.array([message.value[axis] for message in tap.commands])
        at = 1e-9 * np.array([message.stamp_ns for message in tap.commands], dtype=np.float64)
        order = np.argsort([message.sequence for message in tap.commands])
        u, elapsed = u[order], np.diff(at[order])
        assert np.all((low - 1e-12 <= u) & (u <= high + 1e-12))
        allowed = rate * np.clip(elapsed, 0.1 / RATE_HZ, 1 / RATE_HZ) + slack
        assert np.all(np.abs(np.diff(u)) <= allowed * (1 + 1e-9) + 1e-12)
