"""Start of the program, in which Ctrl-C prints no traceback even during imports."""

from __future__ import annotations

import os
import signal
from typing import Any

_INTERRUPTED = 130


def main() -> None:
    """Import the called subcommand and run the program."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # a background job of a shell ignores Ctrl-C
        signal.signal(signal.SIGINT, _leave)
    from .main import main as program

    try:
        program()
    finally:
        # The exit code is final: Ctrl-C during the end of the interpreter would replace it.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def imported() -> None:
    """End the start: from now on Ctrl-C raises `KeyboardInterrupt`, so that the subcommand can stop the device."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(*_: Any) -> None:
    """End the process at once: an extension module turns `KeyboardInterrupt` during its import into another error."""
    os._exit(_INTERRUPTED)
