"""The library in words and plain data, for tables and JSON."""

from __future__ import annotations

from typing import Any

from ..operators.operator import Operator, Parameter
from .catalogue import EFFECTS
from .effect import Effect, base_name, unit_on
from .place import neutral_operator


def parameters_of(effect: Effect) -> tuple[Parameter, ...]:
    """The effect's parameters in its smallest size."""
    return _smallest(effect).parameters


def parameter_lines(effect: Effect) -> list[str]:
    """One line for each parameter: name, unit on the effect's first side, bounds, neutral value if it has one."""
    lines = []
    for p in parameters_of(effect):
        unit = unit_on(p.unit, effect.sides[0])
        neutral = effect.neutral.get(base_name(p.name))
        least = "" if neutral is None else f", neutral {neutral:g}"
        lines.append(f"{p.name} [{unit}] {p.lower:g} to {p.upper:g}{least}")
    return lines


def effect_data(effect: Effect) -> dict[str, Any]:
    """The effect as plain data; units as they are on each side."""
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
    """The sides, and why one is missing."""
    return " or ".join(effect.sides) + (f" ({effect.why_side})" if effect.why_side else "")


def _smallest(effect: Effect) -> Operator:
    sizes = {key: 1 for key in effect.operator.shape if key not in effect.operator.default_sizes}
    return neutral_operator(effect.name, **sizes)


def library_data() -> list[dict[str, Any]]:
    """Every effect as plain data."""
    return [effect_data(effect) for effect in EFFECTS.values()]
