"""Start of the program, in which Ctrl-C prints no traceback even during imports."""

from __future__ import annotations

import signal
import sys

_INTERRUPTED = 130


def main() -> None:
    """Import the subcommands and run the program."""
    try:
        from .main import main as program
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)
    try:
        program()
    finally:
        # The exit code is final: Ctrl-C during the end of the interpreter would replace it.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
