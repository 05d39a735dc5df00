"""Effects from outside the package: added in Python, or by the entry points of installed packages."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import casadi as ca
import numpy as np

from hystmpc.trials.errors import ModelError, did_you_mean
from hystmpc.trials.from_outside import installed_objects

from ..operators.operator import Operator
from ..operators.shipped import shipped_operators
from .effect import Candidate, Effect, Scale, base_name

GROUP = "hystmpc.effects"
"""Entry points by which an installed package adds effects; the value is MODULE:NAME of an `Effect`."""

_PLAIN = Scale(low=0.0, high=6.0, angle_low=20.0, angle_high=90.0, duration_s=60.0, total_s=240.0, dt_s=0.04)
_INPUTS = (1.0, 1.0, 2.5, 4.0, 3.0, 3.0, 0.5, 1.5)
_SAME = 1e-6  # of the input: a lag of 1 us is as good as none

_added: dict[str, Effect] = {}


def own_effects() -> Mapping[str, Effect]:
    """Effects by name that installed packages offer or that were added, later ones in place of earlier ones.

    Raises:
        ConfigError: if an entry point cannot be imported, or names no effect.
        ModelError: if a diagnosis cannot use an effect.
    """
    return {**_installed(), **_added}


def own_operators() -> Mapping[str, type[Operator]]:
    """Operators by name that these effects consist of."""
    return {kind.name: kind for effect in own_effects().values() for kind in (effect.operator, *effect.other_forms)}


def add_effect(effect: Effect) -> Effect:
    """Add an effect of your own to the library, in this process: files, simulated devices and `diagnose` then know it.

    An entry point makes it known wherever its package is installed. An own effect of the same name is replaced.

    Raises:
        ModelError: if the name is one of the library's, or neutral values or forms contradict the operator.
    """
    _added[effect.name] = checked(effect)
    return effect


def checked(effect: Effect) -> Effect:
    """The effect, if a diagnosis can use it.

    Raises:
        ModelError: if its name is taken, or neutral values or forms contradict its operator.
    """
    if effect.name in shipped_operators():
        raise ModelError(f"effect {effect.name}: an operator of the library has this name, expected another name")
    template = effect.operator.template(**dict.fromkeys(effect.operator.shape, 1))
    names = [parameter.name for parameter in template.parameters]
    for name in effect.neutral:
        if name not in map(base_name, names):
            raise ModelError(f"effect {effect.name}: neutral names {name!r}, {did_you_mean(name, names)}")
    _check_identity(effect, template.with_values(effect.neutral_values(template)))
    for form in effect.forms(_PLAIN):
        _check_form(effect, form)
    return effect


def _check_identity(effect: Effect, neutral: Operator) -> None:
    p, dt = ca.DM(list(neutral.values)), ca.DM(_PLAIN.dt_s)
    x = neutral.at_rest(ca.DM(_INPUTS[0]), ca.DM(_INPUTS[0]), p)
    for u in _INPUTS:
        x, y = neutral.equation(x, ca.DM(u), p, dt)
        if not abs(float(y) - u) <= _SAME * abs(u):
            raise ModelError(
                f"effect {effect.name}: with its neutral values it makes {float(y):.6g} of {u:g}, expected the same"
            )


def _check_form(effect: Effect, form: Candidate) -> None:
    free = [freedom.name for freedom in form.free]
    known = [parameter.name for operator in form.operators for parameter in operator.parameters]
    where = f"effect {effect.name}, form {form.variant!r}"
    if form.effect != effect.name:
        raise ModelError(f"{where}: its effect is {form.effect!r}, expected {effect.name!r}")
    for name in free:
        if name not in known:
            raise ModelError(f"{where}: free names {name!r}, {did_you_mean(name, known)}")
    if not any(name in effect.neutral for name in free):
        raise ModelError(f"{where}: free are {', '.join(free) or 'none'}, expected one of {', '.join(effect.neutral)}")
    if not form.starts or not all(len(start) == len(free) and np.all(np.isfinite(start)) for start in form.starts):
        raise ModelError(f"{where}: starts are {form.starts}, expected one or more of {len(free)} numbers each")


@cache
def _installed() -> Mapping[str, Effect]:
    effects = installed_objects(GROUP, "effect", Effect, shipped_operators())
    return {name: checked(effect) for name, effect in effects.items()}
