"""Exceptions of hystmpc: one base class, each text one line with the wrong value, the expected ones and its place."""

from __future__ import annotations

import difflib
import functools
import importlib.util
from collections.abc import Callable, Iterable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

LONGEST = 292
"""Greatest length of an error text [characters]: with `error: ` before it, a line has at most 300."""


_SHORTEST_PLACE = 24


def in_short(text: str) -> str:
    """Shorten a text to `LONGEST` characters: first the beginning of a long path, then the middle of the text."""
    place, colon, rest = text.partition(": ")
    over = len(text) - LONGEST + len("...")
    if len(text) > LONGEST and "/" in place:
        kept = max(len(place) - over, len(place) - place.rindex("/") - 1, _SHORTEST_PLACE)
        if kept + len("...") < len(place):
            text = f"...{place[-kept:]}{colon}{rest}"
    if len(text) <= LONGEST:
        return text
    end = (LONGEST - 5) * 2 // 5
    return f"{text[: LONGEST - 5 - end]} ... {text[-end:]}"


class HystmpcError(Exception):
    """Base of every intended error of hystmpc; the command line prints its text and exits with 2.

    A text of more than `LONGEST` characters loses its middle, since its beginning names the file and its end the
    remedy.
    """

    def __init__(self, *parts: object) -> None:
        super().__init__(*(in_short(part) if isinstance(part, str) else part for part in parts))


class LogError(HystmpcError):
    """Error of a recorded log that cannot be used; the text names file, row and expected value."""


class ConfigError(HystmpcError):
    """Error of a configuration: unknown key, wrong unit, value out of bounds."""


class ModelError(HystmpcError):
    """Error of a model or simulator file that is foreign, corrupt, of another version, or does not fit its use."""


class ExportError(HystmpcError):
    """Error of an exported model that differs from its reference; no file is left on disk."""


class FitError(HystmpcError):
    """Error of an identification that cannot start or has diverged."""


class FitInterruptedError(FitError):
    """Interruption of a fit by the user before the first result."""


class TrajectoryError(HystmpcError):
    """Error of a reference that cannot be generated within its limits."""


class ControllerError(HystmpcError):
    """Error of a controller configuration; raised before the first sample, never inside the loop."""


class GapError(HystmpcError):
    """Error of trials that cannot be compared with a simulator: no recording, another unit, sign or device."""


def shown(value: object, longest: int = 100) -> str:
    """Text of a value for an error: one line, shortened in its middle to about `longest` characters."""
    try:
        text = " ".join(repr(value).split())
    except Exception as error:  # noqa: BLE001 - such as an integer of more digits than Python writes
        return f"a {type(value).__name__} that cannot be written ({type(error).__name__})"
    half = longest // 2
    return text if len(text) <= longest else f"{text[:half]} ... {text[-half:]}"


def in_a_line(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a public function so that an argument of a wrong type raises `ConfigError`.

    The line holds the text of Python's error, which is its cause.

    Raises:
        ConfigError: by the decorated function, for Python's errors on a wrong type, key, number or file.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, OSError) as error:
            name = function.__qualname__
            got = ", ".join([*map(shown, args), *(f"{key}={shown(value)}" for key, value in kwargs.items())])[:120]
            said = " ".join(f"{type(error).__name__}: {error}".split())
            line = f"{name}: got ({got}), expected what help(hystmpc.{name}) says: {said}"
            raise ConfigError(line) from error

    return call


_LONGEST_NAME = 200


def did_you_mean(got: str, available: Iterable[str]) -> str:
    """Return `available: a, b, c; did you mean 'b'?` for the end of an error line."""
    names = sorted(available)
    return f"available: {', '.join(names)}{nearest(got, names)}"


def nearest(got: str, available: Iterable[str]) -> str:
    """Return `; did you mean 'b'?`, or an empty text if no name is similar."""
    near = [name for name in available if len(name) <= _LONGEST_NAME]  # the search takes the product of the lengths
    close = difflib.get_close_matches(got, near, n=1) if len(got) <= _LONGEST_NAME else []
    return f"; did you mean {close[0]!r}?" if close else ""


def require(package: str, extra: str, purpose: str) -> None:
    """Require an optional package; the error says what to install.

    Raises:
        LogError: if the package is not installed.
    """
    if importlib.util.find_spec(package) is None:
        raise LogError(f"{purpose} needs the package {package}: pip install 'hystmpc[{extra}]'")
