"""The device's end of a serial line on a pseudo-terminal: a real port of the operating system, without hardware."""

from __future__ import annotations

import os
import tty
from collections.abc import Callable
from contextlib import suppress
from typing import Self, final


@final
class LineDevice:
    """A device that speaks in lines; a transport opens `port` as it opens a serial port. Linux and macOS.

    Args:
        say: the line of a measurement, of angle and held command; without its newline.
        hear: the command that a line holds; None for a line that is no command.
    """

    def __init__(self, say: Callable[[float, float], bytes], hear: Callable[[bytes], float | None]) -> None:
        self._say, self._hear = say, hear
        self._own, self._port = os.openpty()
        tty.setraw(self._port)
        os.set_blocking(self._own, False)
        self.port = os.ttyname(self._port)
        self._rest, self._commands = b"", list[float]()
        self._open = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.cut()

    def tell(self, angle: float, held: float) -> None:
        """Send one measurement; it is lost where nobody reads the line, as on a real one."""
        self.say(self._say(angle, held) + b"\n")

    def say(self, data: bytes) -> None:
        """Send any bytes."""
        if self._open:
            with suppress(BlockingIOError):
                os.write(self._own, data)

    def spoil(self) -> None:
        """Send lines that are no measurement, of rubbish and of none."""
        self.say(b"\n\x00\xff\xfe\nA\nnan\n" + bytes(range(128, 256)) + b"\n")

    def heard(self) -> list[float]:
        """Every command that has come so far, the oldest first."""
        while self._open:
            try:
                self._rest += os.read(self._own, 4096)
            except OSError:  # nothing more has come
                break
        *lines, self._rest = self._rest.split(b"\n")
        self._commands += [command for line in lines if (command := self._hear(line)) is not None]
        return list(self._commands)

    def cut(self) -> None:
        """Pull the plug; may be done twice."""
        if self._open:
            self._open = False
            os.close(self._own)
            os.close(self._port)
