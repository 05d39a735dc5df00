"""The exceptions of hystmpc: one base class, one line each, saying got, expected, available and where."""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Iterable


class HystmpcError(Exception):
    """Base of every error that hystmpc raises on purpose; the command line prints its text and exits with 2."""


class LogError(HystmpcError):
    """A recorded log cannot be used; the text names file, row and what was expected."""


class ConfigError(HystmpcError):
    """A configuration is wrong: unknown key, wrong unit, value out of bounds."""


class ModelError(HystmpcError):
    """A model or simulator file is foreign, corrupt, of another version, or does not fit its use."""


class ExportError(HystmpcError):
    """An exported model differs from its reference; nothing is left on disk."""


class FitError(HystmpcError):
    """An identification cannot start or has diverged."""


class FitInterruptedError(FitError):
    """The user ended a fit that had nothing to keep yet."""


class TrajectoryError(HystmpcError):
    """A reference cannot be generated within its limits."""


class ControllerError(HystmpcError):
    """A controller is misconfigured; raised before the first sample, never inside the loop."""


class GapError(HystmpcError):
    """Recorded trials cannot be compared with a simulator: nothing recorded, another unit, sign or device."""


def did_you_mean(got: str, available: Iterable[str]) -> str:
    """Return `available: a, b, c; did you mean 'b'?` for the end of an error line."""
    names = sorted(available)
    close = difflib.get_close_matches(got, names, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"available: {', '.join(names)}{hint}"


def require(package: str, extra: str, purpose: str) -> None:
    """Say in one line what to install where an optional package is missing.

    Args:
        package: import name.
        extra: extra of hystmpc that brings it.
        purpose: what it is needed for, such as `reading ROS 2 bags`.

    Raises:
        LogError: if the package is not installed.
    """
    if importlib.util.find_spec(package) is None:
        raise LogError(f"{purpose} needs the package {package}: pip install 'hystmpc[{extra}]'")
