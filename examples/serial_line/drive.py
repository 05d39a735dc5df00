"""A drive on a serial line that counts and checks its lines: `$A,count,angle,held*XX` comes in, `$C,mm*XX` goes out."""

import os
import termios
import tty
from collections import Counter
from contextlib import suppress
from functools import reduce
from operator import xor

from hystmpc.rig import Reading


def framed(text: str) -> bytes:
    """The line that says `text`; XX is the exclusive or of its bytes."""
    return f"${text}*{reduce(xor, text.encode()):02X}\n".encode()


class Drive:
    def __init__(self, port: str, baud: int = 115200) -> None:
        self._line = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._line)
        mode = termios.tcgetattr(self._line)
        mode[4] = mode[5] = getattr(termios, f"B{baud}")  # speed in and out
        termios.tcsetattr(self._line, termios.TCSANOW, mode)
        self._rest, self._open, self.counters = b"", True, Counter()

    def read(self) -> Reading | None:
        with suppress(BlockingIOError):  # nothing has come
            self._rest += os.read(self._line, 4096)
        while b"\n" in self._rest:
            line, _, self._rest = self._rest.partition(b"\n")
            text = line[1:-3].decode(errors="replace")
            if line + b"\n" == framed(text) and text.startswith("A,"):
                _, count, angle, held = text.split(",")
                return Reading.now(float(angle), int(count), float(held))
            self.counters["spoilt"] += 1
        return None

    def write(self, command: float) -> None:
        if os.write(self._line, data := framed(f"C,{command:.4f}")) < len(data):
            raise OSError("the line is full")

    def greet(self) -> None:
        pass  # the drive always listens

    def stop(self, goodbye: bool = False) -> None:  # noqa: ARG002 - the drive knows no goodbye
        if self._open:
            self._open = False
            os.close(self._line)
