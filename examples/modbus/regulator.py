"""A pressure regulator over Modbus TCP: input registers 0 to 3 tell, holding register 0 takes a command."""

import socket
import struct
from contextlib import suppress

from hystmpc.rig import Reading

HEADER, ASK, PUT = struct.Struct(">HHHB"), struct.Struct(">BHH"), struct.Struct(">BHH")
TELLS = struct.Struct(">HHHH")  # count, angle [0.01 deg, signed], held pressure [mbar], state
UNIT, READ_INPUT, WRITE_ONE, TELLING = 1, 4, 6, 1


class Regulator:
    def __init__(self, host: str, port: int = 502) -> None:
        self._line = socket.create_connection((host, port), timeout=2.0)
        self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._line.setblocking(False)
        self._rest, self._number, self._asked, self._count, self._open = b"", 0, False, -1, True
        self.counters = {"refused": 0}

    def read(self) -> Reading | None:
        if not self._asked:
            self._asked = self._send(ASK.pack(READ_INPUT, 0, 4))
        with suppress(BlockingIOError):  # nothing has come
            self._rest += self._line.recv(4096)
        while len(self._rest) >= 6 and len(self._rest) >= (size := 6 + HEADER.unpack_from(self._rest)[2]):
            answer, self._rest = self._rest[HEADER.size : size], self._rest[size:]
            if answer[0] != READ_INPUT or len(answer) != 2 + TELLS.size:
                self.counters["refused"] += answer[0] != WRITE_ONE
                self._asked = self._asked and answer[0] != READ_INPUT | 0x80  # an exception answers the question
                continue
            self._asked, (count, angle, held, state) = False, TELLS.unpack(answer[2:])
            if state == TELLING and count != self._count & 0xFFFF:  # else nothing new
                self._count += (count - self._count) % 65536
                return Reading.now(0.01 * (angle - (angle >> 15 << 16)), self._count, 1e-3 * held)
        return None

    def write(self, command: float) -> None:
        if not self._send(PUT.pack(WRITE_ONE, 0, round(1e3 * command))):
            raise OSError("the line is full")

    def greet(self) -> None:
        pass  # the regulator always listens

    def stop(self, goodbye: bool = False) -> None:  # noqa: ARG002 - the regulator knows no goodbye
        if self._open:
            self._open = False
            self._line.close()

    def _send(self, request: bytes) -> bool:
        self._number = (self._number + 1) % 65536
        data = HEADER.pack(self._number, 0, 1 + len(request), UNIT) + request
        return self._line.send(data) == len(data)
