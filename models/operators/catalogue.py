"""The one list of operators: simulator files, tests and the command line read it."""

from __future__ import annotations

from typing import Any

from hystmpc.trials.errors import ModelError, did_you_mean

from .dynamics import Delay, Lag, RateLimit, Servo
from .friction import Asymmetry, DirectionalGain, RateDependence, StickSlip
from .hysteresis import Backlash, BoucWen, InverseBacklash, Play
from .measurement import PeriodicDisturbance, Sensor
from .operator import Operator, values_from
from .prandtl_ishlinskii import Drdpi, InverseDrdpi, InversePrandtlIshlinskii, PrandtlIshlinskii
from .slow_changes import Creep, Drift, FirstFlexure, TrialShift
from .specification import is_number, template_from
from .static_curves import Contact, Deadband, NonlinearGain, Slack

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
    Servo,
    RateLimit,
    Delay,
    RateDependence,
    Creep,
    Drift,
    FirstFlexure,
    Slack,
    StickSlip,
    Contact,
    NonlinearGain,
    Asymmetry,
    DirectionalGain,
    TrialShift,
    PeriodicDisturbance,
    Sensor,
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
