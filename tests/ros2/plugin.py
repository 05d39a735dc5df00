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


def written(folder: Path, single: bool = False, tip: Any = EXAMPLES / TIP) -> list[str]:
    """Export a controller, that of examples/tip.yaml, to a folder; the arguments that compile the plugin beside it."""
    export_controller(tip, single=single).write(folder)
    compile_c([*C, "-c", "hystmpc.c", "-o", "hystmpc.o"], folder)
    sources = [str(PACKAGE / "src" / "controller.cpp"), str(STUB / "driver.cpp")]
    return [*CPP, "-I.", f"-I{PACKAGE / 'include'}", f"-I{STUB}", *sources, "hystmpc.o", "-lm"]


def compiled(folder: Path, tip: Any = EXAMPLES / TIP) -> ctypes.CDLL:
    """The plugin as a library."""
    compile_c([*written(folder, tip=tip), "-shared", "-o", "plugin.so"], folder, "c++")
    library = ctypes.CDLL(str(folder / "plugin.so"))
    manager, text, number, whole = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_double, ctypes.c_int
    numbers = ctypes.POINTER(ctypes.c_double)
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
        "targets": (whole, [manager, numbers, whole]),
        "hold_at": (None, [manager, whole, number]),
        "held_at": (number, [manager, whole]),
        "measure_at": (None, [manager, whole, number]),
        "refer_at": (None, [manager, whole, number]),
        "set_texts": (None, [manager, text, text]),
        "set_numbers": (None, [manager, text, numbers, whole]),
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


class PlaneManager(Manager):
    """A controller manager with a controller of two axes, n drives in metres and two angles in radians."""

    def __init__(
        self,
        library: ctypes.CDLL,
        commands: int,
        rate_hz: int = 25,
        lists: Mapping[str, Any] | None = None,
        **more: Any,
    ) -> None:
        self._library, self._it, self.commands = library, library.manager_new(rate_hz), commands
        library.set_number(self._it, b"command_scale", 0.001)
        named = {"joints": ["tip_x", "tip_y"], "command_interfaces": [f"drive_{k}/position" for k in range(commands)]}
        for name, values in {**named, **(lists or {})}.items():
            if values and isinstance(values[0], float):
                library.set_numbers(self._it, name.encode(), (ctypes.c_double * len(values))(*values), len(values))
            else:
                library.set_texts(self._it, name.encode(), " ".join(values).encode())
        for flag, on in more.items():
            library.set_flag(self._it, flag.encode(), on)

    @property
    def held(self) -> list[float]:
        """The commands that stand at the drives' interfaces [mm]."""
        return [1000.0 * self.call("held_at", k) for k in range(self.commands)]

    def put(self, angles_deg: Any, held_mm: Any) -> None:
        """What the sensor shows and the drives hold."""
        self.see(angles_deg)
        for k, command in enumerate(held_mm):
            self.call("hold_at", k, command / 1000.0)

    def see(self, angles_deg: Any) -> None:
        for i, angle in enumerate(angles_deg):
            self.call("measure_at", i, math.radians(angle))

    def begin(self, angles_deg: Any, held_mm: Any) -> int:
        """Configure and activate."""
        self.put(angles_deg, held_mm)
        assert self.call("configure") == SUCCESS, self.said
        return int(self.call("activate"))

    def lead(self, angles_deg: Any) -> None:
        values = [math.radians(angle) for angle in angles_deg]
        assert self.call("targets", (ctypes.c_double * len(values))(*values), len(values)) == 1

    def advance(self, angles_deg: Any) -> list[float]:
        """One period: measure, update, and the commands then [mm]."""
        self.see(angles_deg)
        assert self.call("update") == 0, "an update took memory, or failed"
        return self.held
