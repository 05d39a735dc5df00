"""Recording plans: which motions a case holds, in which order, and which effects they can tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.trials.types import Vec

from .cores import RATE_HZ, TRAVEL_MM
from .motions import FAST_SMALL, LONG_HOLD, MULTISINE, POINT_TO_POINT, RAMP_HOLD, SINE, STEPS, TRIANGLES, MotionType

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
ALIASED = ("aliased triangles", "aliased sines")
"""Plans of one motion at one frequency, for the `aliased` suite."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What one case records.

    Attributes:
        commands: command by trial, (T,) each [mm or bar].
        aliased_hz: frequency of all its motions; 0 where they differ.
    """

    name: str
    types: tuple[str, ...]
    commands: tuple[Vec, ...]
    features: frozenset[str]
    aliased_hz: float = 0.0

    def separates(self, label: str) -> bool:
        """Whether these motions can tell the effect from its confounders."""
        return label not in EFFECTS or self.features >= set(EFFECTS[label].separated_by)

    @property
    def seconds(self) -> float:
        """Length of the trials together [s]."""
        return sum(u.size for u in self.commands) / RATE_HZ


def draw_plan(random: np.random.Generator, name: str | None = None, travel: float = TRAVEL_MM) -> Plan:
    """A plan, every third one poor; unless it says otherwise, the opening motion is recorded again at the end.

    Args:
        name: of the plan, one of `ALIASED` too; drawn where left out.
        travel: greatest command of the device, for which the motions, drawn in mm, are scaled [mm or bar].
    """
    plan = _aliased(random, name) if name in ALIASED else _mixed(random, name)
    return replace(plan, commands=tuple(u * (travel / TRAVEL_MM) for u in plan.commands))


def _mixed(random: np.random.Generator, name: str | None) -> Plan:
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


def _aliased(random: np.random.Generator, name: str) -> Plan:
    """Three to six trials of triangles or of sines, all of one frequency, to heights that differ."""
    frequency, kind = float(random.uniform(0.08, 0.3)), name.removeprefix("aliased ")
    commands = []
    for height in TRAVEL_MM * random.uniform(0.7, 1.0, int(random.integers(3, 7))):
        seconds = np.ceil(random.uniform(30, 45) * frequency) / frequency
        turns = frequency * np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ
        unit = 0.5 * (1 - np.cos(2 * np.pi * turns)) if kind == "sines" else 1 - np.abs(1 - 2 * np.mod(turns, 1.0))
        commands.append(np.concatenate([np.zeros(round(RATE_HZ)), height * unit, [0.0]]))
    return Plan(name, (kind,) * len(commands), tuple(commands), frozenset(), frequency)
