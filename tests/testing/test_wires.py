"""The examples of other wires are short and keep the contract: CAN, Modbus TCP, a driver that waits; on real parts."""

from __future__ import annotations

import itertools
import queue
import socket
import struct
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from hystmpc.rig.experiment.record import load_record
from hystmpc.testing import Connected, LoopContract, TransportContract
from hystmpc.testing.wire import Wired
from hystmpc.trials.from_outside import ALLOWED

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FILES = {"can_bus": "drive.py", "modbus": "regulator.py", "blocking_read": "card.py"}
_names = itertools.count()


@contextmanager
def module(folder: str) -> Iterator[Any]:
    """A module of an example, as its folder is where it is run."""
    name = Path(FILES[folder]).stem
    sys.path.insert(0, str(EXAMPLES / folder))
    try:
        sys.modules.pop(name, None)
        yield __import__(name)
    finally:
        sys.path.remove(str(EXAMPLES / folder))
        sys.modules.pop(name, None)


class CanWire(Wired):
    """A drive on python-can's virtual bus."""

    @contextmanager
    def connected(self) -> Iterator[Connected]:
        can = pytest.importorskip("can", reason="python-can is not installed")
        channel, count, commands = f"bus {next(_names)}", itertools.count(1), list[float]()
        with module("can_bus") as drive, can.Bus(interface="virtual", channel=channel) as bus:

            def send(identifier: int, data: bytes) -> None:
                bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

            def tell(angle: float, held: float) -> None:
                send(drive.STATE, drive.TELLS.pack(next(count) % 65536, round(1e3 * held), round(1e3 * angle)))

            def heard() -> list[float]:
                while (message := bus.recv(timeout=0)) is not None:
                    if message.arbitration_id == drive.COMMAND:
                        commands.append(1e-3 * drive.TAKES.unpack(message.data)[0])
                return commands

            def spoil() -> None:
                send(drive.STATE, b"\xff")
                send(0x7FF, b"\x00" * 8)
                bus.send(can.Message(arbitration_id=drive.STATE, is_remote_frame=True, dlc=8, is_extended_id=False))

            transport = drive.Drive(interface="virtual", channel=channel)
            try:
                yield Connected(transport, tell, heard, spoil)
            finally:
                transport.stop()


class Regulator:
    """The other end of Modbus TCP: a real server, which answers whoever asks."""

    def __init__(self) -> None:
        self.commands, self._registers, self._count = list[float](), (0, 0, 0, 0), 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._line: socket.socket | None = None
        self._spoilt = threading.Event()
        threading.Thread(target=self._serve, daemon=True).start()

    def tell(self, angle: float, held: float) -> None:
        self._count += 1
        self._registers = (self._count % 65536, round(100 * angle) % 65536, round(1e3 * held), 1)

    def spoil(self) -> None:
        self._spoilt.set()

    def cut(self) -> None:
        self._server.close()
        if self._line is not None:
            with suppress(OSError):
                self._line.shutdown(socket.SHUT_RDWR)
            self._line.close()

    def _serve(self) -> None:
        with suppress(OSError, struct.error):
            self._line, _ = self._server.accept()
            while head := self._exactly(7):
                number, _, length, unit = struct.unpack(">HHHB", head)
                body = self._exactly(length - 1)
                if self._spoilt.is_set() and body[0] == 4:
                    self._spoilt.clear()
                    answer = b"\x84\x02"  # an exception of Modbus
                elif body[0] == 4:
                    answer = b"\x04\x08" + struct.pack(">HHHH", *self._registers)
                else:
                    self.commands.append(1e-3 * struct.unpack(">BHH", body)[2])
                    answer = body
                self._line.sendall(struct.pack(">HHHB", number, 0, 1 + len(answer), unit) + answer)

    def _exactly(self, size: int) -> bytes:
        assert self._line is not None
        data = b""
        while len(data) < size:
            more = self._line.recv(size - len(data))
            if not more:
                raise OSError("closed")
            data += more
        return data


class ModbusWire(Wired):
    """A regulator behind a real server; it tells the newest measurement only."""

    resolution = 5.1e-3
    keeps = False

    @contextmanager
    def connected(self) -> Iterator[Connected]:
        with module("modbus") as regulator:
            device = Regulator()
            transport = regulator.Regulator("127.0.0.1", device.port)
            try:
                yield Connected(transport, device.tell, lambda: device.commands, device.spoil, device.cut)
            finally:
                transport.stop()
                device.cut()


class Driver:
    """A card's driver that waits for the next sample."""

    def __init__(self) -> None:
        self.samples: queue.Queue[tuple[int, float] | None] = queue.Queue()
        self.volts = list[float]()

    def read_next(self) -> tuple[int, float]:
        found = self.samples.get()
        if found is None:
            raise OSError("the task was stopped")
        return found

    def put(self, volts: float) -> None:
        self.volts.append(volts)

    def close(self) -> None:
        self.samples.put(None)


class CardWire(Wired):
    """A card that waits; what it holds is not told."""

    @contextmanager
    def connected(self) -> Iterator[Connected]:
        with module("blocking_read") as card:
            driver, count = Driver(), itertools.count(1)
            transport = card.Card(driver)

            def tell(angle: float, held: float) -> None:
                del held
                driver.samples.put((next(count), angle / 9.0))

            def heard() -> list[float]:
                return [0.6 * volts for volts in driver.volts]

            try:
                yield Connected(transport, tell, heard, lambda: driver.samples.put(None))
            finally:
                transport.stop()


WIRES: dict[str, type[Wired]] = {"can_bus": CanWire, "modbus": ModbusWire, "blocking_read": CardWire}
LAWS = [name for name in dir(TransportContract) if name.startswith("test_")]
# What depends on the wire; the loop's own laws, which fail a transport before its wire is asked, are tested over UDP.
IN_THE_LOOP = ("test_a_run_ends_at_the_safe_command", "test_a_read_that_hangs_ends_the_run")


@pytest.mark.parametrize("folder", FILES)
def test_it_is_short_and_its_bench_is_read(folder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, "all")
    with module(folder):
        lines = (EXAMPLES / folder / FILES[folder]).read_text().splitlines()
        assert len(lines) <= 60
        assert load_record(EXAMPLES / folder / "bench.yaml").excitations


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("folder", WIRES)
def test_it_keeps_the_contract(folder: str, law: str) -> None:
    contract = type("Contract", (WIRES[folder], TransportContract), {})()
    getattr(contract, law)()


@pytest.mark.slow
@pytest.mark.parametrize("law", IN_THE_LOOP)
@pytest.mark.parametrize("folder", WIRES)
def test_the_loop_is_safe_with_it(folder: str, law: str) -> None:
    contract = type("Contract", (WIRES[folder], LoopContract), {})()
    getattr(contract, law)()
