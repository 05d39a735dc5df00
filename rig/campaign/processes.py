"""A device and a controller in processes of their own, as a user starts them."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hystmpc.trials.errors import ConfigError

PROGRAM = (sys.executable, "-c", "from hystmpc.cli.main import main; main()")
"""The command line that starts `hystmpc` with this interpreter."""

_PORT = re.compile(r"udp port (\d+)")


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
        process.send_signal(signal.SIGINT)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if process.stdout is not None:
        process.stdout.close()
