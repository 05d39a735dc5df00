"""The latch: a stop is remembered on disk until somebody has looked at the device and resets it."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import final

from platformdirs import user_state_path

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import write_atomically

RUNNING = "the program was killed while it controlled the device"


@final
class Latch:
    """One file for one device. It is set while a run lasts, so that a killed program leaves it set.

    Args:
        file: where it is; the folder is made.
    """

    def __init__(self, file: Path) -> None:
        self.file = file

    @classmethod
    def of(cls, name: str, file: Path | None) -> Latch:
        """The latch of a device: `file`, or one in the user's state folder."""
        return cls(file or user_state_path("hystmpc", appauthor=False) / f"{name}.latched.json")

    def require_released(self) -> None:
        """Refuse to move a device whose last run was stopped.

        Raises:
            ConfigError: with the cause and how to reset, or if another program controls the device now.
        """
        self.require_unused()
        held = self._read()
        if held is not None:
            raise ConfigError(
                f"stop latched since {held.get('since')}: {held.get('cause')}; look at the device, then start with "
                f"--reset (latch: {self.file})"
            )

    def require_unused(self) -> None:
        """Refuse to touch a device that another program controls.

        Raises:
            ConfigError: if one does.
        """
        held = self._read() or {}
        cause, process = held.get("cause"), held.get("pid")
        if cause == RUNNING and isinstance(process, int) and process != os.getpid() and _alive(process):
            raise ConfigError(f"{self.file}: process {process} controls this device now, expected it to have ended")

    def set(self, cause: str) -> None:
        """Remember a stop.

        Raises:
            ConfigError: if the file cannot be written: a run that could not be latched must not start.
        """
        text = {"cause": cause, "since": datetime.now(UTC).isoformat(timespec="seconds"), "pid": os.getpid()}
        try:
            write_atomically(self.file, json.dumps(text, indent=2) + "\n")
        except OSError as error:
            raise ConfigError(f"{self.file}: cannot be written ({error.strerror}), expected a place to latch") from None

    def release(self) -> None:
        """Forget the stop.

        Raises:
            ConfigError: if the file cannot be removed.
        """
        try:
            self.file.unlink(missing_ok=True)
        except OSError as error:
            raise ConfigError(f"{self.file}: cannot be removed ({error.strerror}), expected the latch's file") from None

    def _read(self) -> dict[str, object] | None:
        try:
            found = json.loads(self.file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            found = None
        # A latch that cannot be read is one that is set.
        return found if isinstance(found, dict) else {"cause": "unreadable latch", "since": "?"}


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
