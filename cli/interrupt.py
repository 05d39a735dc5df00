"""Ctrl-C during the start of the program, in which modules are imported."""

from __future__ import annotations

import os
import signal
from typing import Any

_INTERRUPTED = 130


def begin_imports() -> None:
    """From now on Ctrl-C ends the process at once, unless a shell started it in the background, without Ctrl-C.

    An extension module turns `KeyboardInterrupt` during its import into another error.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def end_imports() -> None:
    """From now on Ctrl-C raises `KeyboardInterrupt`, so that the subcommand can stop the device."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(*_: Any) -> None:
    os._exit(_INTERRUPTED)
