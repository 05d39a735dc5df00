"""The one list of operators: simulator files, tests and the command line read it."""

from __future__ import annotations

from typing import Any

from hystmpc.trials.errors import ModelError, did_you_mean

from .backlash import Backlash, InverseBacklash
from .bouc_wen import BoucWen
from .deadband import Deadband
from .delay import Delay
from .drdpi import Drdpi, InverseDrdpi
from .lag import Lag
from .operator import Operator, values_from
from .play import Play
from .prandtl_ishlinskii import InversePrandtlIshlinskii, PrandtlIshlinskii

OPERATORS: tuple[type[Operator], ...] = (
    Play,
    Backlash,
    InverseBacklash,
    PrandtlIshlinskii,
    InversePrandtlIshlinskii,
    Deadband,
    Drdpi,
    InverseDrdpi,
    BoucWen,
    Lag,
    Delay,
)


def operator_from(spec: Any, where: str) -> Operator:
    """Build an operator from `{operator: NAME, <sizes>, parameters: {NAME: value}}`.

    Raises:
        ModelError: on an unknown operator or key, a missing size, a missing, unknown or out-of-bounds parameter.
    """
    if not isinstance(spec, dict) or "operator" not in spec:
        raise ModelError(f"{where}: got {spec!r}, expected a mapping with the key 'operator'")
    kinds = {kind.name: kind for kind in OPERATORS}
    name = str(spec["operator"])
    if name not in kinds:
        raise ModelError(f"{where}: no operator {name!r}, {did_you_mean(name, kinds)}")
    kind = kinds[name]
    for key in spec:
        if key not in ("operator", "parameters", *kind.shape):
            raise ModelError(f"{where}: unknown key {key!r}, {did_you_mean(key, ['parameters', *kind.shape])}")
    template = kind.template(**{key: _size(spec.get(key), f"{where}: {name}.{key}") for key in kind.shape})
    given = spec.get("parameters")
    if not isinstance(given, dict) or not all(_is_number(v) for v in given.values()):
        raise ModelError(f"{where}: {name}.parameters is {given!r}, expected a mapping of numbers")
    try:
        return template.with_values(values_from(name, [p.name for p in template.parameters], given))
    except ModelError as error:
        raise ModelError(f"{where}: {error}") from None


def operator_spec(operator: Operator) -> dict[str, Any]:
    """Plain data from which `operator_from` builds the same operator."""
    names = (parameter.name for parameter in operator.parameters)
    return {
        "operator": operator.name,
        **operator.structure,
        "parameters": dict(zip(names, operator.values, strict=True)),
    }


def _size(value: Any, where: str) -> int:
    if not isinstance(value, int) or not 1 <= value <= 1000:
        raise ModelError(f"{where} is {value!r}, expected a whole number from 1 to 1000")
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
