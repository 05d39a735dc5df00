"""Recording plans: which motions a case holds, in which order, and which effects they can tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from hystmpc.trials.types import Vec

from ..logs.identifiability import CONFUSABLE
from .motions import (
    FAST_SMALL,
    LONG_HOLD,
    MULTISINE,
    POINT_TO_POINT,
    RAMP_HOLD,
    SINE,
    STEPS,
    TRIANGLES,
    MotionType,
)

RICH = (SINE, TRIANGLES, RAMP_HOLD, POINT_TO_POINT, STEPS, FAST_SMALL, LONG_HOLD)
_PLANS: Mapping[str, tuple[MotionType, ...]] = MappingProxyType(
    {
        "rich": RICH,
        "short": (SINE, TRIANGLES, POINT_TO_POINT, STEPS, RAMP_HOLD),
        "no_holds": (SINE, SINE, TRIANGLES, MULTISINE, FAST_SMALL, SINE),
        "no_fast": (SINE, MULTISINE, RAMP_HOLD, POINT_TO_POINT, LONG_HOLD),
        "no_repeats": (*RICH, MULTISINE),
        "sines": (SINE, SINE, SINE, SINE, SINE, SINE),
    }
)
POOR = ("no_holds", "no_fast", "no_repeats", "sines")

# What motions must contain for the effect to be told from its twins: the last column of the table in the design.
_NEEDS: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "lag": frozenset({"fast"}),
        "delay": frozenset({"fast"}),
        "rate_dependence": frozenset({"fast", "speeds"}),
        "creep": frozenset({"holds"}),
        "drift": frozenset({"long_holds", "repeat"}),
        "first_flexure": frozenset({"repeat"}),
        "stick_slip": frozenset({"speeds"}),
        "contact": frozenset({"amplitudes"}),
        "trial_shift": frozenset({"repeat"}),
    }
)


@dataclass(frozen=True, eq=False)
class Plan:
    """What one case records.

    Attributes:
        name: of the kind of plan.
        types: motion type by trial.
        commands: command by trial, (T,) each [mm].
        features: what these motions can show.
    """

    name: str
    types: tuple[str, ...]
    commands: tuple[Vec, ...]
    features: frozenset[str]

    def separates(self, label: str) -> bool:
        """Whether these motions can tell the effect from its twins."""
        return self.features >= _NEEDS.get(label, frozenset())


def draw_plan(random: np.random.Generator, name: str | None = None) -> Plan:
    """A plan; every third one is poor. Except where the plan says so, the opening motion is recorded again at the end.

    Args:
        random: draws.
        name: kind of plan, drawn where left out.
    """
    if name is None:
        poor = random.random() < 1 / 3
        name = str(random.choice(POOR if poor else ("rich", "rich", "short")))
    kinds = [_PLANS[name][k] for k in random.permutation(len(_PLANS[name]))]
    commands = [kind.draw(random) for kind in kinds]
    features = {feature for kind in kinds for feature in kind.shows}
    if name != "no_repeats":
        again = [0, int(random.integers(1, len(kinds)))]
        kinds += [kinds[k] for k in again]
        commands += [commands[k] for k in again]
        features.add("repeat")
    return Plan(name, tuple(kind.name for kind in kinds), tuple(commands), frozenset(features))


def confusable(a: str, b: str) -> bool:
    """Whether two effects are the same or one of the confusable pairs."""
    return a == b or any(a in names and b in names for names in CONFUSABLE)
