"""Player of one case: device and controller in separate processes, over UDP or DDS on the loopback."""

from __future__ import annotations

import math
import os
import pty
import re
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

from hystmpc.trials.errors import ConfigError

from .cases import RATE_HZ, SAFE, FaultCase, Link, watchdog_s, write_device, write_run

PROGRAM = (sys.executable, "-c", "from hystmpc.cli.main import main; main()")
"""The command line that starts `hystmpc` with this interpreter."""

_PORT = re.compile(r"udp port (\d+)")
_CTRL_C, _END_POLL_S = b"\x03", 0.02
# What a shell does: it owns the terminal, runs the program in a group of processes of its own in the foreground, and
# hands SIGHUP on to that group when the terminal goes.
_SHELL = """
import fcntl, os, signal, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
child = os.fork()
if not child:
    os.setpgid(0, 0)
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    os.tcsetpgrp(0, os.getpid())
    signal.signal(signal.SIGTTOU, signal.SIG_DFL)
    os.execv(sys.argv[1], sys.argv[1:])
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGHUP, lambda number, frame: os.killpg(child, number))
code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
sys.exit(code if code >= 0 else 128 - code)
"""
_START_S = 60.0  # imports on a busy machine
_END_S = 240.0
_ENDLESS = 124
_POLL_S = 0.002
_SPARE_S = 5.0
_ENDLESSLY = f"error: the controller did not end within {_END_S:g} s"


def start(arguments: Sequence[object], program: Sequence[str] = PROGRAM, **more: Any) -> subprocess.Popen[str]:
    """Start a process of `hystmpc` with these arguments; its output comes through one pipe."""
    command = [*program, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **more)


def start_device(config: Path, program: Sequence[str] = PROGRAM) -> tuple[subprocess.Popen[str], int]:
    """Start a device and return it with its UDP port; 0 for DDS.

    Raises:
        ConfigError: with what it said if it does not start.
    """
    device = start(["device", config], program)
    assert device.stdout is not None
    try:
        line = device.stdout.readline()
        if "device ready" not in line:
            raise ConfigError(f"device: got {line.strip()!r}, expected it to start")
    except BaseException:  # no process may be left, even after Ctrl-C
        end(device)
        raise
    found = _PORT.search(line)
    return device, int(found[1]) if found else 0


def end(process: subprocess.Popen[str]) -> None:
    """End a process as Ctrl-C does; kill it if it does not end."""
    if process.poll() is None:
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if process.stdout is not None:
        process.stdout.close()


@final
class Terminal:
    """Terminal with a shell and one program; Ctrl-C and closing reach all processes started by the program."""

    def __init__(self, arguments: Sequence[object], program: Sequence[str] = PROGRAM) -> None:
        self._ours, theirs = pty.openpty()
        command = [sys.executable, "-c", _SHELL, *program, *map(str, arguments)]
        try:
            # The shell, which ends with the program's exit code.
            self.process: subprocess.Popen[str] = subprocess.Popen(
                command, stdin=theirs, stdout=theirs, stderr=theirs, text=True, start_new_session=True
            )
        finally:
            os.close(theirs)
        self._said: list[bytes] = []
        self._closing = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def said(self) -> str:
        """Output of the program, without the colours."""
        text = b"".join(self._said).decode("utf-8", "replace").replace("\r", "")
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)

    def type_ctrl_c(self) -> None:
        """Type Ctrl-C, which sends SIGINT to the program and all processes started by it."""
        os.write(self._ours, _CTRL_C)

    def wait(self, timeout_s: float) -> int:
        """Exit code of the program.

        Raises:
            TimeoutExpired: if it does not end in time.
        """
        code = self.process.wait(timeout_s)
        self._reader.join(5.0)
        return code

    def close(self) -> None:
        """Close the terminal: SIGHUP to all its processes, no further output; a second call is allowed."""
        if not self._closing.is_set():
            self._closing.set()
            self._reader.join()  # a read that waits would keep the terminal open
            os.close(self._ours)

    def _read(self) -> None:
        while not self._closing.is_set():
            ready, _, _ = select.select([self._ours], [], [], _END_POLL_S)
            if not ready:
                continue
            try:
                data = os.read(self._ours, 65536)
            except OSError:  # the program has ended
                return
            self._said.append(data)


@dataclass(frozen=True)
class Played:
    """Files and exit codes of one played case.

    Attributes:
        folder: with `device.csv`, `said.txt`, the run folder `run` and the configurations.
        fault_ns: monotonic time at which a process got its signal [ns]; 0 where the device's own faults say when.
        ended_ns: monotonic time at which the controller had ended [ns].
        code: exit code of the controller, negative for a signal.
        second_code: exit code of the second run; None where there is none.
    """

    folder: Path
    link: Link
    fault_ns: int
    ended_ns: int
    code: int
    said: str
    second_code: int | None = None


def play(case: FaultCase, folder: Path, link: Link = Link(), program: Sequence[str] = PROGRAM) -> Played:
    """Play one case in a new folder."""
    folder.mkdir(parents=True)
    stage = _Stage(case, folder, link, program)
    try:
        return stage.play()
    finally:
        stage.clear()


@final
class _Stage:
    def __init__(self, case: FaultCase, folder: Path, link: Link, program: Sequence[str]) -> None:
        self._case, self._folder, self._link, self._program = case, folder, link, program
        self._processes: list[subprocess.Popen[str]] = []
        self._terminal: Terminal | None = None
        self._fault_ns = 0
        self._second_code: int | None = None

    def play(self) -> Played:
        """Start both processes, apply the fault, wait until the device is at rest."""
        case = self._case
        device = self._device()
        controller = self._controller()
        self._happen(device, controller)
        code, said = self._result(controller)
        ended_ns = time.monotonic_ns()
        if case.second is not None and case.second.after_fault:
            self._second()
        if case.expected in ("stops", "left alone") and not case.device_gone:
            self._settle()
        text = f"{said}\nexit code {code}\n"
        (self._folder / "said.txt").write_text(text, encoding="utf-8")
        return Played(self._folder, self._link, self._fault_ns, ended_ns, code, said, self._second_code)

    def clear(self) -> None:
        if self._terminal is not None:
            self._terminal.close()
        for process in self._processes:
            end(process)

    def _device(self) -> subprocess.Popen[str]:
        process, port = start_device(write_device(self._case, self._folder, self._link), self._program)
        self._processes.append(process)
        self._link = replace(self._link, port=port)
        return process

    def _controller(self) -> subprocess.Popen[str]:
        arguments = ["run", write_run(self._case, self._folder, self._link), "--out", self._folder / "run"]
        if self._case.terminal:
            self._terminal = Terminal(arguments, self._program)
            process = self._terminal.process
        else:
            process = start(arguments, self._program)
        self._processes.append(process)
        limit = self._case.file_limit_bytes
        if limit is not None:  # a write beyond it fails as on a full disk; the recording process inherits it
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
        return process

    def _happen(self, device: subprocess.Popen[str], controller: subprocess.Popen[str]) -> None:
        """Wait for the time of the fault, and send the signal to the process."""
        case = self._case
        if (case.kill is None and case.second is None) or not self._wait(controller, _commanded):
            return
        if case.second is not None and not case.second.after_fault:
            self._second()
        if case.height is None:
            time.sleep(case.at_s)
        elif not self._wait(controller, lambda rows: _rises(rows, case.height or 0.0, case.rising_per_s)):
            return
        if case.kill is not None:
            self._strike(device if case.kill == "device" else controller)

    def _strike(self, process: subprocess.Popen[str]) -> None:
        """Send the signal; a paused process continues later, a killed device may be restarted."""
        case, number = self._case, getattr(signal, self._case.signal)
        self._fault_ns = time.monotonic_ns()
        if self._terminal is not None and number == signal.SIGINT:
            self._terminal.type_ctrl_c()
        elif self._terminal is not None and number == signal.SIGHUP:
            self._terminal.close()
        else:
            process.send_signal(number)
        if number == signal.SIGSTOP:
            time.sleep(case.pause_s)
            process.send_signal(signal.SIGCONT)
        if case.restart:
            process.wait()
            self._device()

    def _second(self) -> None:
        """Run a second controller with the first one's configuration, to its end."""
        assert self._case.second is not None
        where = ["--out", self._folder / "second"]
        second = start(["run", self._folder / "run.yaml", *where, *self._case.second.arguments], self._program)
        self._processes.append(second)
        self._second_code, said = _output(second)
        (self._folder / "second.txt").write_text(f"{said}\nexit code {self._second_code}\n", encoding="utf-8")

    def _result(self, controller: subprocess.Popen[str]) -> tuple[int, str]:
        """Exit code and output of the controller; 124 if it does not end."""
        if self._terminal is None:
            return _output(controller)
        try:
            code = self._terminal.wait(_END_S)
        except subprocess.TimeoutExpired:
            return _ENDLESS, _ENDLESSLY
        return code, self._terminal.said

    def _settle(self) -> None:
        """Wait until the device holds the safe command for half a second, or the time for its return is over."""
        rows = device_log(self._folder)
        until = time.monotonic() + watchdog_s(self._case) + _SPARE_S
        count = round(0.5 * RATE_HZ)
        seen = len(rows)
        while time.monotonic() < until:
            rows = device_log(self._folder)
            if len(rows) >= seen + count and all(row[3] == SAFE for row in rows[-count:]):
                return
            time.sleep(0.1)

    def _wait(self, controller: subprocess.Popen[str], seen: Callable[[Sequence[tuple[float, ...]]], bool]) -> bool:
        """Wait for a condition on the device's log; return False if the controller has ended before."""
        until = time.monotonic() + _START_S
        while time.monotonic() < until and controller.poll() is None:
            if seen(device_log(self._folder, 2000)):
                return True
            time.sleep(_POLL_S)
        return False


def _output(process: subprocess.Popen[str]) -> tuple[int, str]:
    try:
        said, _ = process.communicate(timeout=_END_S)
    except subprocess.TimeoutExpired:
        return _ENDLESS, _ENDLESSLY
    return process.returncode, said


def _commanded(rows: Sequence[tuple[float, ...]]) -> bool:
    return any(math.isfinite(row[2]) for row in rows)


def _rises(rows: Sequence[tuple[float, ...]], height: float, rising_per_s: float) -> bool:
    """Whether the device holds at least `height` and has risen at that rate over its last three samples."""
    held = [row[3] for row in rows[-4:]]
    return len(held) == 4 and held[-1] >= height and held[-1] - held[0] > 3 * rising_per_s / RATE_HZ


def device_log(folder: Path, last_bytes: int | None = None) -> list[tuple[float, ...]]:
    """Rows of `device.csv`: monotonic [ns], time [s], command received, held, angle [deg]; whole rows only.

    Args:
        last_bytes: read no more than the file's end.
    """
    rows: list[tuple[float, ...]] = []
    with suppress(FileNotFoundError), (folder / "device.csv").open("rb") as file:
        if last_bytes is not None:
            size = file.seek(0, 2)
            file.seek(max(0, size - last_bytes))
            if size > last_bytes:
                file.readline()  # the rest of a row
        for line in file.read().decode("ascii", "replace").split("\n")[:-1]:
            cells = line.split(",")
            if len(cells) == 5 and cells[0].isdigit():
                rows.append(tuple(float(cell) for cell in cells))
    return rows
