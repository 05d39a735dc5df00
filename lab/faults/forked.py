"""`hystmpc` in a process that is forked from one with its imports done: a real process, with real sockets and signals.

What a program needs to start as users start it, is tested by those which do (`play` in a terminal, tests/cli).
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import final

_MADE = multiprocessing.get_context("forkserver")
_MADE.set_forkserver_preload(
    ["hystmpc.bench.device", "hystmpc.rig.device", "hystmpc.rig.run", "hystmpc.rig.experiment.review"]
)


def _program(output: Connection, arguments: Sequence[str]) -> None:
    from hystmpc.cli.main import main

    for stream in (1, 2):
        os.dup2(output.fileno(), stream)
    output.close()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["hystmpc", *arguments]
    main()


@final
class Forked:
    """What `play` and tests ask of a `subprocess.Popen[str]`."""

    def __init__(self, arguments: Sequence[object]) -> None:
        said, output = _MADE.Pipe(duplex=False)
        self.args = [str(argument) for argument in arguments]
        self._process = _MADE.Process(target=_program, args=(output, self.args), daemon=True)
        self._process.start()
        output.close()
        self.stdout = os.fdopen(os.dup(said.fileno()), encoding="utf-8")
        said.close()
        assert self._process.pid is not None
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        """Exit code; negative for a signal, None while it runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """Exit code."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Exit code, after its end."""
        self._process.join(timeout)
        if (code := self._process.exitcode) is None:
            assert timeout is not None
            raise subprocess.TimeoutExpired(self.args, timeout)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, None]:
        """What it has said, after its end; it says less than a pipe holds."""
        self.wait(timeout)
        return self.stdout.read(), None

    def send_signal(self, number: int) -> None:
        """Send a signal; none to a process that has ended."""
        if self._process.exitcode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill it."""
        self.send_signal(signal.SIGKILL)
