"""Recording plans: which motions a case holds, in which order, and which effects they can tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.trials.types import Vec

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


@dataclass(frozen=True, eq=False)
class Plan:
    """What one case records.

    Attributes:
        commands: command by trial, (T,) each [mm].
    """

    name: str
    types: tuple[str, ...]
    commands: tuple[Vec, ...]
    features: frozenset[str]

    def separates(self, label: str) -> bool:
        """Whether these motions can tell the effect from its confounders."""
        return label not in EFFECTS or self.features >= set(EFFECTS[label].separated_by)


def draw_plan(random: np.random.Generator, name: str | None = None) -> Plan:
    """A plan, every third one poor; unless it says otherwise, the opening motion is recorded again at the end."""
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
