"""A device and a controller in processes of their own, as a user starts them."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, final

from hystmpc.trials.errors import ConfigError

PROGRAM = (sys.executable, "-c", "from hystmpc.cli.main import main; main()")
"""The command line that starts `hystmpc` with this interpreter."""

_PORT = re.compile(r"udp port (\d+)")
_CTRL_C, _POLL_S = b"\x03", 0.02
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


def start(arguments: Sequence[object], program: Sequence[str] = PROGRAM, **more: Any) -> subprocess.Popen[str]:
    """A process of `hystmpc` with these arguments; what it says comes through one pipe."""
    command = [*program, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **more)


def start_device(config: Path, program: Sequence[str] = PROGRAM) -> tuple[subprocess.Popen[str], int]:
    """A device that is ready, and the UDP port that it listens at; 0 for one behind DDS.

    Raises:
        ConfigError: with what it said if it does not start.
    """
    device = start(["device", config], program)
    assert device.stdout is not None
    try:
        line = device.stdout.readline()
        if "device ready" not in line:
            raise ConfigError(f"device: got {line.strip()!r}, expected it to start")
    except BaseException:  # Ctrl-C, too, must not leave it behind
        end(device)
        raise
    found = _PORT.search(line)
    return device, int(found[1]) if found else 0


def end(process: subprocess.Popen[str]) -> None:
    """End a process as Ctrl-C does, or for good where it does not listen."""
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
    """A terminal with a shell and one program in it; Ctrl-C and closing reach all that the program has started."""

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
        """What the program has written, without the colours."""
        text = b"".join(self._said).decode("utf-8", "replace").replace("\r", "")
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)

    def type_ctrl_c(self) -> None:
        """Type Ctrl-C: SIGINT to the program and to whatever it has started."""
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
        """Close the terminal: SIGHUP to all of them, and nothing can be written any more; may be called twice."""
        if not self._closing.is_set():
            self._closing.set()
            self._reader.join()  # a read that waits would keep the terminal open
            os.close(self._ours)

    def _read(self) -> None:
        while not self._closing.is_set():
            ready, _, _ = select.select([self._ours], [], [], _POLL_S)
            if not ready:
                continue
            try:
                data = os.read(self._ours, 65536)
            except OSError:  # the program has ended
                return
            self._said.append(data)
