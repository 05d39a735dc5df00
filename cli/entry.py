"""Start of the program, in which Ctrl-C prints no traceback even during imports."""

from __future__ import annotations

import signal

from .interrupt import begin_imports


def main() -> None:
    """Import the called subcommand and run the program."""
    begin_imports()
    from .main import main as program

    try:
        program()
    finally:
        # The exit code is final: Ctrl-C during the end of the interpreter would replace it.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
