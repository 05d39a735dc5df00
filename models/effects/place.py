"""Effects as plain data, and their places in a chain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from hystmpc.trials.errors import ModelError, did_you_mean

from ..chain import Chain, names_of, operator_spec, template_from
from ..operators.dynamics import Delay
from ..operators.operator import Operator, Parameter, is_number
from .catalogue import EFFECTS
from .effect import Effect, Side, base_name, unit_on

_UNITS = ("s", "hz", "rad")
_SIDES: tuple[Side, ...] = ("command", "output")


@dataclass(frozen=True)
class PlacedEffect:
    """Effect with parameter values on one side of the core."""

    effect: Effect
    side: Side
    operator: Operator


class EffectError(ModelError):
    """Error in the description of an effect.

    Args:
        at: keys from the description to the wrong entry.
    """

    def __init__(self, message: str, at: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.at = at


def effect_from(spec: Any, dt_s: float | None = None) -> PlacedEffect:
    """Build an effect from `{effect: NAME, side: command|output, <sizes>, parameters: {NAME: value}}`.

    A missing parameter takes its neutral value, if there is one; a missing side is the effect's first.

    Args:
        dt_s: sample time [s], needed only for the length of a delay's store.

    Raises:
        EffectError: on an unknown effect, key, side or parameter, a missing parameter, a value out of bounds.
    """
    effect = _effect_of(spec)
    for key in spec:
        known = ("side", "parameters", *effect.operator.shape)
        if key not in ("effect", *known):
            raise EffectError(f"{effect.name}: unknown key {key!r}, {did_you_mean(str(key), known)}", (str(key),))
    side = _side_of(effect, spec.get("side"))
    given = spec.get("parameters") or {}
    if not isinstance(given, Mapping):
        raise EffectError(f"{effect.name}.parameters is {given!r}, expected a mapping of numbers", ("parameters",))
    try:
        template = template_from(effect.operator, _with_store(effect, spec, given, dt_s), given, effect.name)
    except ModelError as error:
        raise EffectError(str(error)) from None
    return PlacedEffect(effect, side, _filled(effect, template, given, side))


def effect_operator(name: str, parameters: Mapping[str, float], dt_s: float | None = None, **sizes: int) -> Operator:
    """Operator of an effect with the given parameter values, and neutral values for all others.

    Raises:
        EffectError: as `effect_from`.
    """
    return effect_from({"effect": name, **sizes, "parameters": dict(parameters)}, dt_s).operator


def neutral_operator(name: str, **sizes: int) -> Operator:
    """Operator of an effect with the values that make it the identity.

    Raises:
        ModelError: on an unknown effect, or a size that has no default and is not given.
    """
    effect = _effect_of({"effect": name})
    template = template_from(effect.operator, sizes, (), name)
    return template.with_values(effect.neutral_values(template))


def effect_spec(placed: PlacedEffect) -> dict[str, Any]:
    """Plain data from which `effect_from` builds the effect again."""
    spec = operator_spec(placed.operator)
    return {"effect": spec.pop("operator"), "side": placed.side, **spec}


def with_effect(chain: Chain, operator: Operator, side: Side) -> Chain:
    """Add an operator on one side of a chain, as the last one in the order of the signal.

    Raises:
        ModelError: if an effect is not allowed on that side.
    """
    effect = EFFECTS.get(operator.name)
    if effect is not None:
        _side_of(effect, side)
    if side == "command":
        return replace(chain, before=(*chain.before, operator))
    return replace(chain, after=(*chain.after, operator))


def _effect_of(spec: Any) -> Effect:
    if not isinstance(spec, Mapping) or "effect" not in spec:
        raise EffectError(f"got {spec!r}, expected a mapping with the key 'effect'")
    name = str(spec["effect"])
    if name not in EFFECTS:
        raise EffectError(f"no effect {name!r}, {did_you_mean(name, EFFECTS)}", ("effect",))
    return EFFECTS[name]


def _side_of(effect: Effect, side: Any) -> Side:
    if side is None:
        return effect.sides[0]
    if side not in _SIDES:
        raise EffectError(f"{effect.name}: side {side!r}, {did_you_mean(str(side), _SIDES)}", ("side",))
    if side not in effect.sides:
        only = effect.sides[0]
        raise EffectError(f"{effect.name} cannot act on the {side} side, only {only}: {effect.why_side}", ("side",))
    return "command" if side == "command" else "output"


def _with_store(effect: Effect, spec: Mapping[str, Any], given: Mapping[str, Any], dt_s: float | None) -> Any:
    """Description completed with the length of a delay's store, from delay and sample time."""
    delay = given.get("delay_s", 0.0)
    if effect.operator is not Delay or "samples" in spec or not is_number(delay):
        return spec
    if dt_s is None:
        return {**spec, "samples": 1}  # a plant sizes the store for its sample time
    return {**spec, "samples": min(1000, max(1, math.ceil(delay / dt_s - 1e-9)))}


def _filled(effect: Effect, template: Operator, given: Mapping[str, Any], side: Side) -> Operator:
    """Template filled with the given values, each checked separately so that an error names its place."""
    values = []
    for name, value in given.items():
        if name not in names_of(template):
            raise EffectError(_unknown(effect, template, str(name), side), ("parameters", str(name)))
        if not is_number(value):
            raise EffectError(f"{effect.name}.{name} is {value!r}, expected a number", ("parameters", name))
    for parameter in template.parameters:
        value = given.get(parameter.name, effect.optional(parameter.name))
        where, unit = f"{effect.name}.{parameter.name}", unit_on(parameter.unit, side)
        if value is None:
            got = ", ".join(map(str, given)) or "none"
            raise EffectError(f"{where} is missing, got {got}; expected a number in {unit}", ("parameters",))
        if not parameter.lower <= value <= parameter.upper:
            shown, limits = f"{value:.6g} {unit}", f"{parameter.lower:.6g} to {parameter.upper:.6g} {unit}"
            at = ("parameters", parameter.name)
            raise EffectError(f"{where} is {shown.removesuffix(' 1')}, expected {limits.removesuffix(' 1')}", at)
        values.append(float(value))
    try:
        return template.with_values(values)
    except ModelError as error:
        raise EffectError(str(error), ("parameters",)) from None


def _unknown(effect: Effect, template: Operator, name: str, side: Side) -> str:
    hint = did_you_mean(name, names_of(template))
    for parameter in template.parameters:
        stem, _, unit = parameter.name.rpartition("_")
        if unit in _UNITS and stem in (name, name.rpartition("_")[0]):
            return (
                f"{effect.name} has no parameter {name!r}, the unit is part of the name: "
                f"did you mean {parameter.name!r} in {unit_on(parameter.unit, side)}? {hint.split(';')[0]}"
            )
    return f"{effect.name} has no parameter {name!r}, {hint}"


def parameters_of(effect: Effect) -> tuple[Parameter, ...]:
    """Parameters of an effect in its smallest size."""
    return _smallest(effect).parameters


def parameter_lines(effect: Effect) -> list[str]:
    """Lines on the parameters: name, unit on the effect's first side, bounds, neutral value if it has one."""
    lines = []
    for p in parameters_of(effect):
        unit = unit_on(p.unit, effect.sides[0])
        neutral = effect.neutral.get(base_name(p.name))
        least = "" if neutral is None else f", neutral {neutral:g}"
        lines.append(f"{p.name} [{unit}] {p.lower:g} to {p.upper:g}{least}")
    return lines


def effect_data(effect: Effect) -> dict[str, Any]:
    """Effect as plain data, with the units on each side."""
    return {
        "name": effect.name,
        "sides": list(effect.sides),
        "why_side": effect.why_side,
        "equation": effect.equation,
        "apart": effect.apart,
        "sizes": dict(_smallest(effect).structure),
        "parameters": [
            {
                "name": p.name,
                "unit": {side: unit_on(p.unit, side) for side in effect.sides},
                "lower": p.lower,
                "upper": p.upper,
                "neutral": effect.neutral.get(base_name(p.name)),
                "meaning": p.meaning,
            }
            for p in parameters_of(effect)
        ],
        "states": list(_smallest(effect).states),
    }


def sides_text(effect: Effect) -> str:
    """Text on the possible sides, and why one is missing."""
    return " or ".join(effect.sides) + (f" ({effect.why_side})" if effect.why_side else "")


def _smallest(effect: Effect) -> Operator:
    sizes = {key: 1 for key in effect.operator.shape if key not in effect.operator.default_sizes}
    return neutral_operator(effect.name, **sizes)


def library_data() -> list[dict[str, Any]]:
    """All effects as plain data."""
    return [effect_data(effect) for effect in EFFECTS.values()]
