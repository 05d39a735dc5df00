"""The controller plugin, compiled against a stub of ros2_control, with what a controller manager does."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hystmpc.codegen import export_controller

from ..codegen.compiled import EXAMPLES, compile_c
from .interfaces import ROS2

PACKAGE = ROS2 / "hystmpc_controller"
STUB = Path(__file__).resolve().parent / "stub"
C = ("-std=c99", "-O0", "-ffp-contract=off", "-fPIC")
CPP = ("-std=c++17", "-O0", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fPIC")
SUCCESS, ERROR = 0, 2
TIP = "tip.yaml"


def written(folder: Path, single: bool = False) -> list[str]:
    """Export the controller of examples/tip.yaml to a folder; the arguments that compile the plugin beside it."""
    export_controller(EXAMPLES / TIP, single=single).write(folder)
    compile_c([*C, "-c", "hystmpc.c", "-o", "hystmpc.o"], folder)
    sources = [str(PACKAGE / "src" / "controller.cpp"), str(STUB / "driver.cpp")]
    return [*CPP, "-I.", f"-I{PACKAGE / 'include'}", f"-I{STUB}", *sources, "hystmpc.o", "-lm"]


def compiled(folder: Path) -> ctypes.CDLL:
    """The plugin as a library."""
    compile_c([*written(folder), "-shared", "-o", "plugin.so"], folder, "c++")
    library = ctypes.CDLL(str(folder / "plugin.so"))
    manager, text, number, whole = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_double, ctypes.c_int
    calls: Mapping[str, tuple[Any, list[Any]]] = {
        "manager_new": (manager, [ctypes.c_uint]),
        "manager_delete": (None, [manager]),
        "set_text": (None, [manager, text, text]),
        "set_number": (None, [manager, text, number]),
        "set_flag": (None, [manager, text, whole]),
        "said": (text, [manager]),
        "names": (text, [manager]),
        "hold": (None, [manager, number]),
        "held": (number, [manager]),
        "measure": (None, [manager, number]),
        "refer": (None, [manager, number]),
        "chain": (whole, [manager, whole]),
        "target": (whole, [manager, number]),
        "update": (ctypes.c_long, [manager]),
        "update_after": (ctypes.c_long, [manager, number]),
        **{name: (whole, [manager]) for name in ("configure", "activate", "deactivate", "cleanup", "stop")},
    }
    for name, (answer, arguments) in calls.items():
        function = getattr(library, name)
        function.restype, function.argtypes = answer, arguments
    return library


class Manager:
    """A controller manager with one controller, one drive in metres and one angle in radians."""

    def __init__(self, library: ctypes.CDLL, rate_hz: int = 25, **parameters: str | float | bool) -> None:
        self._library, self._it = library, library.manager_new(rate_hz)
        given = {"joint": "tip", "command_interface": "drive/position", "command_scale": 0.001, **parameters}
        for name, value in given.items():
            if isinstance(value, bool):
                library.set_flag(self._it, name.encode(), value)
            elif isinstance(value, str):
                library.set_text(self._it, name.encode(), value.encode())
            else:
                library.set_number(self._it, name.encode(), value)

    def __del__(self) -> None:
        self._library.manager_delete(self._it)

    def call(self, name: str, *arguments: float) -> Any:
        """A call of the driver."""
        return getattr(self._library, name)(self._it, *arguments)

    @property
    def said(self) -> str:
        """The last error that was logged."""
        return self.call("said").decode()

    @property
    def held_mm(self) -> float:
        """The command that stands at the drive's interface."""
        return 1000.0 * self.call("held")

    def start(self, angle_deg: float, held_mm: float) -> int:
        """Configure and activate."""
        self.hold(angle_deg, held_mm)
        assert self.call("configure") == SUCCESS, self.said
        return int(self.call("activate"))

    def hold(self, angle_deg: float, held_mm: float) -> None:
        self.call("measure", math.radians(angle_deg))
        self.call("hold", held_mm / 1000.0)

    def target(self, angle_deg: float) -> None:
        assert self.call("target", math.radians(angle_deg)) == 1

    def step(self, angle_deg: float, period_s: float | None = None) -> float:
        """One period: measure, update, and the command then [mm]."""
        self.call("measure", math.radians(angle_deg))
        done = self.call("update") if period_s is None else self.call("update_after", period_s)
        assert done == 0, "an update took memory, or failed"
        return self.held_mm
