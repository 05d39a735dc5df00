"""Stops: requested by a signal or another thread, and latched on disk until a person resets the latch."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from filelock import FileLock, Timeout
from platformdirs import user_state_path

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import write_atomically

STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that stop a run; a closed terminal sends SIGHUP to all its processes."""

RUNNING = "the program was killed while it controlled the device"


@final
class StopFlag:
    """Stop request by a signal or another thread, read once a sample; the first cause is kept.

    Attributes:
        cause: of a requested safe stop, empty without one.
        ending: whether the run is to end, or ends already.
        word: 1 after any request, for a loop that reads memory alone.
    """

    def __init__(self) -> None:
        self.cause = ""
        self.ending = False
        self.word = ctypes.c_int(0)

    def set(self, cause: str) -> None:
        """Request a safe stop."""
        self.cause = self.cause or cause
        self.word.value = 1

    def end(self) -> None:
        """Request the regular end: return to the safe command, without a latch."""
        self.ending = True
        self.word.value = 1


def cause_of(error: BaseException) -> str:
    """Type and first 200 characters of an error, on one line, as the cause of a stop."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"


@contextmanager
def stopping_on_signals(flag: StopFlag) -> Iterator[None]:
    """Set the flag on SIGINT (Ctrl-C), SIGTERM and SIGHUP within the block; repetitions change nothing.

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


@final
class Latch:
    """Latch of a stopped device: a file that exists during a run, so that a killed program leaves it set.

    Next to it is a lock of the operating system, held from before the latch is read until after its release: two
    programs never share a device, and the lock of a killed one is free.
    """

    def __init__(self, file: Path) -> None:
        self.file = file

    @classmethod
    def of(cls, name: str, file: Path | None) -> Latch:
        """Latch of a device: `file`, or a file in the user's state folder."""
        return cls(file or user_state_path("hystmpc", appauthor=False) / f"{name}.latched.json")

    @contextmanager
    def held(self) -> Iterator[Latch]:
        """Hold the latch for this program alone within the block.

        Raises:
            ConfigError: if another program controls the device now, or the lock cannot be made.
        """
        lock = FileLock(self.file.with_name(self.file.name + ".lock"))
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(blocking=False)
        except Timeout:
            process = (self._read() or {}).get("pid", "of unknown number")
            raise ConfigError(
                f"{self.file}: process {process} controls this device now, expected it to have ended"
            ) from None
        except OSError as error:
            raise ConfigError(
                f"{lock.lock_file}: cannot be locked ({error.strerror}), expected a place to latch"
            ) from None
        try:
            yield self
        finally:
            lock.release()

    def require_released(self) -> None:
        """Refuse to move a device whose last run was stopped.

        Raises:
            ConfigError: with the cause and how to reset.
        """
        held = self._read()
        if held is not None:
            raise ConfigError(
                f"stop latched since {held.get('since')}: {held.get('cause')}; look at the device, then start with "
                f"--reset (latch: {self.file})"
            )

    def set(self, cause: str) -> None:
        """Latch a stop with its cause.

        Raises:
            ConfigError: if the file cannot be written: a run that could not be latched must not start.
        """
        try:
            write_atomically(self.file, latch_text(cause))
        except OSError as error:
            raise ConfigError(f"{self.file}: cannot be written ({error.strerror}), expected a place to latch") from None

    def release(self) -> None:
        """Release the latch.

        Raises:
            ConfigError: if the file cannot be removed.
        """
        try:
            self.file.unlink(missing_ok=True)
        except OSError as error:
            raise ConfigError(f"{self.file}: cannot be removed ({error.strerror}), expected the latch's file") from None

    def _read(self) -> dict[str, object] | None:
        try:
            content = json.loads(self.file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            content = None
        # A latch that cannot be read is one that is set.
        return content if isinstance(content, dict) else {"cause": "unreadable latch", "since": "?"}


def latch_text(cause: str) -> str:
    """Content of a latch: cause, time, and process."""
    text = {"cause": cause, "since": datetime.now(UTC).isoformat(timespec="seconds"), "pid": os.getpid()}
    return json.dumps(text, indent=2) + "\n"
