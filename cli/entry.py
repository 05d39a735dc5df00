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
        # The work is done or refused, and the exit code stands: Ctrl-C while the interpreter ends would replace it.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
