"""Sizes of an operator in plain data: given, by default, or told by the names of the parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from hystmpc.trials.errors import ModelError

from .operator import Operator

_LIMITS = (1, 1000)
_GUESSED = range(1, 9)


def template_from(kind: type[Operator], spec: Mapping[str, Any], given: Iterable[str], where: str) -> Operator:
    """An operator of the sizes in `spec`.

    A size that has a default may be left out; it then follows from the parameters' names, as `tau_up_s` means a lag of
    two ways and `share_2` a creep of at least two terms, or else is the default.

    Raises:
        ModelError: on a size that is missing or no whole number within its limits.
    """
    sizes = {key: spec.get(key, kind.default_sizes.get(key)) for key in kind.shape}
    for key, size in sizes.items():
        _check_size(size, kind.size_limits.get(key, _LIMITS), f"{where}: {kind.name}.{key}")
    template, wanted = kind.template(**sizes), set(given)
    for key in kind.default_sizes:
        if key in spec or wanted <= names_of(template):
            continue
        lower, upper = kind.size_limits.get(key, _LIMITS)
        guesses = (kind.template(**{**sizes, key: n}) for n in _GUESSED if lower <= n <= upper)
        template = next((guess for guess in guesses if wanted <= names_of(guess)), template)
    return template


def names_of(operator: Operator) -> set[str]:
    """Names of the operator's parameters."""
    return {parameter.name for parameter in operator.parameters}


def is_number(value: Any) -> bool:
    """Whether plain data is a number; True and False are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check_size(value: Any, limits: tuple[int, int], where: str) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or not limits[0] <= value <= limits[1]:
        raise ModelError(f"{where} is {value!r}, expected a whole number from {limits[0]} to {limits[1]}")
