"""Playing one case: a device and a controller in processes of their own, over UDP on the loopback."""

from __future__ import annotations

import math
import resource
import signal
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .cases import Case
from .processes import PROGRAM, end, start, start_device
from .setup import write_device, write_run

_START_S = 60.0  # imports and compilation on a busy machine
_END_S = 240.0
_ENDLESS = 124
_PAUSE_S = 2.0
_POLL_S = 0.05


@dataclass(frozen=True)
class Played:
    """What one case left behind.

    Attributes:
        folder: with `device.csv`, `said.txt`, the run folder `run` and the configurations.
        fault_ns: monotonic time at which a process got its signal [ns]; 0 where the device's own faults say when.
        code: exit code of the controller, negative for a signal.
        said: what it printed.
    """

    folder: Path
    fault_ns: int
    code: int
    said: str


def play(case: Case, folder: Path, program: Sequence[str] = PROGRAM) -> Played:
    """Play one case in a new folder.

    Args:
        case: what goes wrong.
        folder: is made.
        program: the command line that starts `hystmpc`.

    Raises:
        ConfigError: if the device does not start.
    """
    folder.mkdir(parents=True)
    first, port = _device(case, folder, program, 0)
    devices = [first]
    controller: subprocess.Popen[str] | None = None
    try:
        controller = _controller(case, folder, program, port)
        fault_ns = 0
        if case.kill is not None and _first_command(folder, controller):
            time.sleep(case.at_s)
            fault_ns = _strike(case, first if case.kill == "device" else controller)
            if case.restart:
                devices.append(_device(case, folder, program, port)[0])
        code, said = _result(controller)
        if case.expected == "left alone":
            time.sleep(5.0)  # the device's watchdog takes over
        (folder / "said.txt").write_text(f"{said}\nexit code {code}\n", encoding="utf-8")
        return Played(folder, fault_ns, code, said)
    finally:
        for process in (*devices, *((controller,) if controller else ())):
            end(process)


def _result(controller: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and output of a controller; 124 for one that does not end."""
    try:
        said, _ = controller.communicate(timeout=_END_S)
    except subprocess.TimeoutExpired:
        return _ENDLESS, f"error: the controller did not end within {_END_S:g} s"
    return controller.returncode, said


def _device(case: Case, folder: Path, program: Sequence[str], port: int) -> tuple[subprocess.Popen[str], int]:
    return start_device(write_device(case, folder, port), program)


def _controller(case: Case, folder: Path, program: Sequence[str], port: int) -> subprocess.Popen[str]:
    limit = case.file_limit_bytes
    more: dict[str, Any] = {}
    if limit is not None:  # a write beyond it fails as on a full disk
        more["preexec_fn"] = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    return start(["run", write_run(case, folder, port), "--out", folder / "run"], program, **more)


def _first_command(folder: Path, controller: subprocess.Popen[str]) -> bool:
    """Wait until the device has got a command; False where the controller has ended before."""
    until = time.monotonic() + _START_S
    while time.monotonic() < until and controller.poll() is None:
        rows = device_log(folder)
        if any(math.isfinite(row[2]) for row in rows[-20:]):
            return True
        time.sleep(_POLL_S)
    return False


def _strike(case: Case, process: subprocess.Popen[str]) -> int:
    """Send the signal; a paused process goes on after a while. Returns the moment [ns]."""
    moment = time.monotonic_ns()
    process.send_signal(getattr(signal, case.signal))
    if case.signal == "SIGSTOP":
        time.sleep(_PAUSE_S)
        process.send_signal(signal.SIGCONT)
    return moment


def device_log(folder: Path) -> list[tuple[float, ...]]:
    """Rows of `device.csv`: monotonic [ns], time [s], command received, held, angle [deg]; whole rows only."""
    file = folder / "device.csv"
    if not file.is_file():
        return []
    rows = []
    for line in file.read_text(encoding="utf-8").split("\n")[:-1]:
        cells = line.split(",")
        if len(cells) == 5 and cells[0].isdigit():
            rows.append(tuple(float(cell) for cell in cells))
    return rows
