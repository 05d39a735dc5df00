"""A closed loop in Python around an exported controller, compiled as a library, and a simulated device.

hystmpc export-c examples/tip.yaml --out c
cc -std=c99 -O2 -shared -fPIC c/hystmpc.c -o c/hystmpc.so -lm
python examples/exported_c/loop.py c/hystmpc.so
"""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

import hystmpc

REAL = ctypes.c_double  # c_float after --float32


class Command(ctypes.Structure):
    """`hystmpc_command` of the header."""

    _fields_ = (
        ("u", REAL),
        ("predicted_deg", REAL),
        ("departure_deg", REAL),
        ("source", ctypes.c_int),
        ("status", ctypes.c_int),
        ("fault", ctypes.c_int),
        ("missing", ctypes.c_int),
        ("planned", ctypes.c_int),
        ("inverse", ctypes.c_int),
    )


class Controller:
    """The functions of the header on memory of their own."""

    def __init__(self, library: Path) -> None:
        self._c = ctypes.CDLL(str(library.resolve()))
        self._c.hystmpc_memory_bytes.restype = ctypes.c_ulong
        self._c.hystmpc_init.argtypes = [ctypes.c_void_p, REAL, REAL]
        self._c.hystmpc_set_target.argtypes = [ctypes.c_void_p, REAL]
        self._c.hystmpc_step.argtypes = [ctypes.c_void_p, REAL, ctypes.c_void_p]
        self._c.hystmpc_step.restype = Command
        self._memory = ctypes.create_string_buffer(self._c.hystmpc_memory_bytes())

    def init(self, angle_deg: float, command: float) -> None:
        """At rest at an angle, under the command that the device holds."""
        if (refused := self._c.hystmpc_init(self._memory, angle_deg, command)) != 0:
            raise ValueError(f"the controller cannot start there: answer {refused}")

    def set_target(self, angle_deg: float) -> None:
        """Go to an angle."""
        self._c.hystmpc_set_target(self._memory, angle_deg)

    def step(self, measured_deg: float) -> Command:
        """The next command."""
        command: Command = self._c.hystmpc_step(self._memory, measured_deg, None)
        return command


def main(library: Path) -> None:
    """Three targets, one after the other."""
    controller, plant = (
        Controller(library),
        hystmpc.SimulatedPlant(hystmpc.load_model("builtin:tendon-catheter").simulator),
    )
    angle = plant.reset()
    controller.init(angle, 0.0)
    for target in (60.0, 45.0, 70.0):
        controller.set_target(target)
        for _ in range(100):
            angle = plant.apply(controller.step(angle).u)
        print(f"target {target:.1f} deg, reached {angle:.2f} deg")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
