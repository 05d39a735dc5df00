"""A drive on a CAN bus (python-can): identifier 0x181 tells count, held command and angle, 0x201 takes a command."""

import struct
from typing import Any

import can

from hystmpc.rig import Reading

STATE, COMMAND = 0x181, 0x201
TELLS, TAKES = struct.Struct("<Hhi"), struct.Struct("<i")  # count, held [um], angle [mdeg]; command [um]


class Drive:
    def __init__(self, interface: str = "socketcan", channel: str = "can0", **options: Any) -> None:
        only = [{"can_id": STATE, "can_mask": 0x7FF, "extended": False}]
        self._bus = can.Bus(interface=interface, channel=channel, can_filters=only, **options)
        self._count, self.counters, self._open = 0, {"spoilt": 0}, True

    def read(self) -> Reading | None:
        while (message := self._bus.recv(timeout=0)) is not None:
            if message.is_error_frame or message.is_remote_frame or message.dlc != TELLS.size:
                self.counters["spoilt"] += 1
                continue
            count, held_um, angle_mdeg = TELLS.unpack(message.data)
            self._count += (count - self._count) % 65536  # the drive's counter starts anew after 65535
            return Reading.now(1e-3 * angle_mdeg, self._count, 1e-3 * held_um)
        return None

    def write(self, command: float) -> None:
        data = TAKES.pack(round(1e3 * command))
        self._bus.send(can.Message(arbitration_id=COMMAND, data=data, is_extended_id=False), timeout=0.005)

    def greet(self) -> None:
        pass  # the drive always listens

    def stop(self, goodbye: bool = False) -> None:  # noqa: ARG002 - the drive knows no goodbye
        if self._open:
            self._open = False
            self._bus.shutdown()
