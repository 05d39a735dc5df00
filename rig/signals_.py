"""Signals that end a run: they set a flag, and the loop stops safely."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from .stop_flag import StopFlag

STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that stop a run; a closed terminal sends SIGHUP to all its processes."""


@contextmanager
def stopping_on_signals(flag: StopFlag) -> Iterator[None]:
    """SIGINT (Ctrl-C), SIGTERM and SIGHUP set the flag while the block runs; once more changes nothing.

    Outside the main thread, where Python has no signals, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: Any) -> None:
        del frame
        flag.set(signal.Signals(number).name)

    known = [getattr(signal, name) for name in STOPPING if hasattr(signal, name)]
    before = {number: signal.signal(number, stop) for number in known}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
