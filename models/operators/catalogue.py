"""Operators by name, and operators in plain data: simulator files, effects and the command line read them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from hystmpc.trials.errors import ModelError, did_you_mean

from ..effects.own import own_operators
from .operator import Operator, values_from
from .shipped import shipped_operators

_LIMITS = (1, 1000)
_GUESSED = range(1, 9)


def operators() -> Mapping[str, type[Operator]]:
    """Every operator by name: those that ship, and those of effects that users have added."""
    return {**own_operators(), **shipped_operators()}


def operator_from(spec: Any, where: str) -> Operator:
    """Build an operator from `{operator: NAME, <sizes>, parameters: {NAME: value}}`.

    Raises:
        ModelError: on an unknown operator or key, a missing size, a missing, unknown or out-of-bounds parameter.
    """
    if not isinstance(spec, dict) or "operator" not in spec:
        raise ModelError(f"{where}: got {spec!r}, expected a mapping with the key 'operator'")
    name = str(spec["operator"])
    kind = shipped_operators().get(name) or own_operators().get(name)
    if kind is None:
        raise ModelError(f"{where}: no operator {name!r}, {did_you_mean(name, operators())}")
    for key in spec:
        if key not in ("operator", "parameters", *kind.shape):
            raise ModelError(f"{where}: unknown key {key!r}, {did_you_mean(key, ['parameters', *kind.shape])}")
    given = spec.get("parameters")
    if not isinstance(given, dict) or not all(is_number(v) for v in given.values()):
        raise ModelError(f"{where}: {name}.parameters is {given!r}, expected a mapping of numbers")
    template = template_from(kind, spec, given, where)
    try:
        return template.with_values(values_from(name, [p.name for p in template.parameters], given))
    except ModelError as error:
        raise ModelError(f"{where}: {error}") from None


def operator_spec(operator: Operator) -> dict[str, Any]:
    """Plain data from which `operator_from` builds the same operator."""
    names = (parameter.name for parameter in operator.parameters)
    return {
        "operator": operator.name,
        **{key: size for key, size in operator.structure.items() if size != operator.default_sizes.get(key)},
        "parameters": dict(zip(names, operator.values, strict=True)),
    }


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
