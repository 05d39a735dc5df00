"""One gate: every place from which a command can leave the package, found in the sources and compared with a list."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator

import pytest

from ..conftest import ROOT

PYTHON = ("core", "trials", "models", "ctrl", "codegen", "sim", "rig", "gap", "testing", "bench")
PYTHON += ("lab", "cli", "ros2", "examples")
# Calls that may carry a command: of a transport or its wire, of a plant, of a socket.
SENDS = {"write", "apply", "send", "sendto", "publish", "_send"}
SENT = re.compile(r"\b(?:" + "|".join(sorted(SENDS)) + r")\b")
HOLDERS = re.compile(r"transport|wire|device|plant|inner|publisher|writer|_line$|^os$|^self$")

# Where a command leaves: behind intake, plausibility and gate. All that moves a device goes through the first of them:
# run, record, commission, investigate, the node tip_planner.
THE_GATE = {
    "rig/loop.py: self._transport.write": 1,  # behind `Gate.admissible` and `Anchor.in_time`
    "rig/loop.py: self._send": 1,  # which holds that line
    "core/loop.c: send": 1,  # the same judgements in C; whatever they find is left to Python
    "ros2/hystmpc_controller/src/controller.cpp: set_value": 1,  # the exported controller's limits, stop and model
    "ros2/hystmpc_controller/src/controller.cpp: write": 3,  # which holds that line
    "ros2/hystmpc_controller/include/hystmpc_controller/controller.hpp: write": 1,  # its declaration
}
# Wires that the loop writes to; nothing else calls them.
BEHIND_IT = {
    "rig/transports/from_outside.py: self._device.write": 1,
    "rig/transports/simulated.py: self._plant.apply": 1,
    "rig/transports/topics.py: self._wire.write": 2,  # a command; a greeting, which carries none
    "rig/transports/topics.py: wire.write": 1,  # a goodbye
    "rig/transports/dds_.py: self._writer.write": 2,
    "rig/transports/udp.py: self._send": 3,  # a command, a greeting, a goodbye
    "rig/transports/udp.py: self._wire.send": 1,
    "ros2/hystmpc_ros/hystmpc_ros/wire.py: self._publisher.publish": 2,
    "examples/serial_line/drive.py: os.write": 1,
    "examples/modbus/regulator.py: self._send": 2,
    "examples/modbus/regulator.py: self._line.send": 1,
}
# The device's own end of a wire: what it does with a command that has come, and what it says.
THE_DEVICE = {
    "rig/device.py: self._plant.apply": 1,
    "rig/device.py: self._wire.sendto": 1,
    "rig/transports/udp.py: self._wire.sendto": 1,
    "rig/transports/dds_.py: self._wire.write": 1,
    "testing/wire.py: os.write": 1,
}
# Wires under test, with a device of the test behind them; the page's answers; a terminal's key.
NO_DEVICE = {
    "testing/loop.py: self.inner.write": 1,
    "testing/wire.py: c.transport.write": 3,
    "rig/live/page.py: self._transport.write": 2,  # to a browser
    "rig/live/page.py: self.send": 1,
    "lab/faults/play.py: os.write": 1,
    "lab/benchmarks/kill_recording.py: os.write": 1,  # to a pipe
    "lab/benchmarks/random_moments.py: os.write": 2,  # to a pipe, to standard error
    "lab/benchmarks/random_moments.py: wire.sendto": 1,  # datagrams that are passed on
}
# Here `apply` is that of a computed device: no wire is known to these files.
COMPUTED = {
    "ctrl/loop.py",
    "sim/gym_.py",
    "lab/benchmarks/endurance.py",
    "lab/benchmarks/exported_axes.py",
    "lab/benchmarks/faults.py",
    "lab/benchmarks/inputs.py",
    "lab/benchmarks/lstm_presets.py",
    "lab/benchmarks/make_library.py",
    "lab/benchmarks/monitor.py",
    "lab/control/loop.py",
    "lab/control/plants.py",
    "lab/devices/motions.py",
    "testing/model.py",
    "examples/exported_c/loop.py",
    "examples/mujoco_tendon/tendon.py",
    "examples/serial_line/simulated.py",
}
LISTED = THE_GATE | BEHIND_IT | THE_DEVICE | NO_DEVICE


def sends(text: str, where: str) -> Iterator[str]:
    """Calls by which something may leave."""
    if not SENT.search(text):
        return
    for node in ast.walk(ast.parse(text)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in SENDS):
            continue
        of = ast.unparse(node.func.value)
        if HOLDERS.search(of.rpartition(".")[2]):
            yield f"{where}: {of}.{node.func.attr}"


def found() -> Counter[str]:
    """All of them, with how often each stands there."""
    places: Counter[str] = Counter()
    for room in PYTHON:
        for path in sorted((ROOT / room).rglob("*.py")):
            places.update(sends(path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix()))
    for path in sorted(path for room in PYTHON for path in (ROOT / room).rglob("*.[ch]*")):
        where = path.relative_to(ROOT).as_posix()
        if path.suffix in (".c", ".h", ".cpp", ".hpp"):
            code = re.sub(r"/\*.*?\*/|//[^\n]*", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
            calls = re.findall(r"\b(send|sendto|sendmsg|write|set_value|set_command)\s*\(", code)
            places.update(f"{where}: {call}" for call in calls)
    return places


def test_every_place_that_sends_is_in_the_list() -> None:
    """A new one has to say here whether it is behind the gate, and a list that names what is gone is wrong too."""
    places = {
        place: count
        for place, count in found().items()
        if not (place.endswith(".apply") and (place.split(": ")[0] in COMPUTED or "gallery" in place))
    }
    assert places == LISTED


def test_files_of_computed_devices_open_no_wire() -> None:
    """Neither a transport nor a socket, so that what they apply moves nothing."""
    for where in COMPUTED:
        text = (ROOT / where).read_text(encoding="utf-8")
        assert not re.search(r"^\s*(import|from)\s+(socket|serial|rclpy|hystmpc\.rig)\b", text, re.MULTILINE), where


@pytest.mark.parametrize("mover", ["rig/run.py", "ros2/hystmpc_ros/hystmpc_ros/planner.py"])
def test_movers_make_the_one_loop(mover: str) -> None:
    """Gate, anchor, intake and watches are put together in one function; nobody else makes a loop or a gate."""
    assert "control_loop(" in (ROOT / mover).read_text(encoding="utf-8")


def test_nobody_else_puts_a_loop_together() -> None:
    texts = {path: path.read_text(encoding="utf-8") for room in PYTHON for path in (ROOT / room).rglob("*.py")}
    makers = {
        f"{path.relative_to(ROOT).as_posix()}: {node.func.id}"
        for path, text in texts.items()
        if re.search(r"\b(ControlLoop|Gate|Anchor|Intake)\b", text)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        if node.func.id in {"ControlLoop", "Gate", "Anchor", "Intake"}
    }
    assert makers == {f"rig/run.py: {name}" for name in ("ControlLoop", "Gate", "Anchor", "Intake")}


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("self._transport.write(u)", 1),
        ("device.transport.write(u)", 1),
        ("plant.apply(u)", 1),
        ("file.write(text)", 0),
        ("transport.read()", 0),
        ("os.write(line, b'')", 1),
    ],
)
def test_the_search_itself(text: str, count: int) -> None:
    assert len(list(sends(text, "x"))) == count
