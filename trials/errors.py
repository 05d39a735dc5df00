"""The exceptions of hystmpc: one base class, one line each, saying got, expected, available and where."""

from __future__ import annotations

import difflib
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
