"""Recording plans: the motions of a case [mm], their order, and the effects that they can separate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.trials.types import Vec

from ..devices.cores import RATE_HZ, TRAVEL_MM

Draw = Callable[[np.random.Generator], Vec]
_REST_S = 1.0


@dataclass(frozen=True)
class MotionType:
    """Kind of motion and the effects that it can reveal.

    Attributes:
        shows: features that `separability` asks for.
    """

    name: str
    draw: Draw
    shows: frozenset[str] = frozenset()


def _clock(seconds: float) -> Vec:
    return np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ


def _through(times: list[float], levels: list[float]) -> Vec:
    """Straight lines through levels at given times, after a short rest."""
    t = np.concatenate([[0.0], _REST_S + np.array(times)])
    return np.interp(_clock(float(t[-1])), t, np.concatenate([[levels[0]], np.array(levels)]))


def sine(random: np.random.Generator) -> Vec:
    """Sine from zero, 0.1 to 0.5 Hz, full or decaying; 25 to 45 s."""
    frequency, seconds = random.choice([0.1, 0.2, 0.3, 0.5]), random.uniform(25, 45)
    whole = np.ceil(seconds * frequency) / frequency
    t = _clock(whole)
    peak = TRAVEL_MM * random.uniform(0.8, 1.0)
    envelope = np.exp(-t / (whole * random.choice([0.7, 1e6])))
    moved = 0.5 * peak * envelope * (1 - np.cos(2 * np.pi * frequency * t))
    return np.concatenate([np.zeros(round(_REST_S * RATE_HZ)), moved])


def triangles(random: np.random.Generator) -> Vec:
    """Ramps up and down at three speeds, far apart, and to two amplitudes."""
    times, levels, now = [0.0], [0.0], 0.0
    for speed in random.permutation([0.6, 1.5, 5.0]):
        for share in (0.9, 0.5):
            for level in (share * TRAVEL_MM, 0.0):
                now += abs(level - levels[-1]) / speed
                times.append(now)
                levels.append(level)
    return _through(times, levels)


def ramp_hold(random: np.random.Generator) -> Vec:
    """Ramps to random levels with holds of 5 to 9 s, up and down."""
    return _moves(random, 6, (5.0, 9.0), 3.0)


def long_hold(random: np.random.Generator) -> Vec:
    """One ramp and a hold of 45 s, back and a hold of 8 s at zero."""
    top = TRAVEL_MM * random.uniform(0.6, 0.95)
    times = np.cumsum([0.0, top / 4.0, 45.0, top / 4.0, 8.0])
    return _through(times.tolist(), [0.0, top, top, 0.0, 0.0])


def steps(random: np.random.Generator) -> Vec:
    """Fast steps to random levels, 1 to 2.5 s apart."""
    return _moves(random, 16, (1.0, 2.5), 30.0)


def point_to_point(random: np.random.Generator) -> Vec:
    """Minimum-jerk moves between random levels with rests of 0.3 to 3 s."""
    pieces, at = [np.zeros(round(_REST_S * RATE_HZ))], 0.0
    for k in range(12):
        level = 0.0 if k == 11 else TRAVEL_MM * random.uniform(0.02, 0.98)
        seconds = abs(level - at) / random.uniform(2.0, 6.0) + 0.3
        s = _clock(seconds)[1:] / seconds
        pieces += [at + (level - at) * s**3 * (10 - 15 * s + 6 * s**2)]
        pieces += [np.full(round(random.uniform(0.3, 3.0) * RATE_HZ), level)]
        at = level
    return np.clip(np.concatenate(pieces), 0.0, TRAVEL_MM)


def fast_small(random: np.random.Generator) -> Vec:
    """Small sines of 1.5 to 4 Hz on a slow stroke up and down."""
    t = _clock(30.0)
    slow = 0.5 * TRAVEL_MM * (1 - np.cos(2 * np.pi * t / 15.0)) * random.uniform(0.6, 0.8)
    small = sum(
        np.sin(2 * np.pi * f * t + random.uniform(0, 6.28)) for f in (random.uniform(1.5, 2.2), random.uniform(2.6, 4))
    )
    return np.clip(slow + 0.25 * small * np.clip(t / 2, 0, 1) * np.clip((30 - t) / 2, 0, 1), 0.0, TRAVEL_MM)


def multisine(random: np.random.Generator) -> Vec:
    """Five incommensurate slow sines over the whole travel, 40 s."""
    t = _clock(40.0)
    total = sum(np.sin(2 * np.pi * f * t + random.uniform(0, 6.28)) for f in random.uniform(0.07, 0.6, 5))
    window = np.clip(np.minimum(t, 40.0 - t) / 3, 0, 1)
    return np.clip(0.5 * TRAVEL_MM * (1 + 0.3 * total) * window, 0.0, TRAVEL_MM)


def _moves(random: np.random.Generator, count: int, rest_s: tuple[float, float], speed: float) -> Vec:
    """Straight moves at one speed [mm/s] to random levels, each with a rest."""
    times, levels, now = [0.0], [0.0], 0.0
    for k in range(count):
        level = 0.0 if k == count - 1 else TRAVEL_MM * random.uniform(0.05, 0.98)
        now += max(abs(level - levels[-1]) / speed, 0.04)
        times.append(now)
        levels.append(level)
        now += random.uniform(*rest_s)
        times.append(now)
        levels.append(level)
    return _through(times, levels)


SINE = MotionType("sine", sine)
TRIANGLES = MotionType("triangles", triangles, frozenset({"speeds", "amplitudes"}))
RAMP_HOLD = MotionType("ramp_hold", ramp_hold, frozenset({"holds", "amplitudes"}))
LONG_HOLD = MotionType("long_hold", long_hold, frozenset({"holds", "long_holds"}))
STEPS = MotionType("steps", steps, frozenset({"fast", "amplitudes"}))
POINT_TO_POINT = MotionType("point_to_point", point_to_point, frozenset({"amplitudes"}))
FAST_SMALL = MotionType("fast_small", fast_small, frozenset({"fast"}))
MULTISINE = MotionType("multisine", multisine, frozenset({"amplitudes"}))


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
    """Recording plan of one case.

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
    """Draw a plan, every third one poor; unless stated otherwise, the first motion is recorded again at the end.

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
    """Three to six trials of triangles or of sines of one frequency, with different amplitudes."""
    frequency, kind = float(random.uniform(0.08, 0.3)), name.removeprefix("aliased ")
    commands = []
    for height in TRAVEL_MM * random.uniform(0.7, 1.0, int(random.integers(3, 7))):
        seconds = np.ceil(random.uniform(30, 45) * frequency) / frequency
        turns = frequency * np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ
        unit = 0.5 * (1 - np.cos(2 * np.pi * turns)) if kind == "sines" else 1 - np.abs(1 - 2 * np.mod(turns, 1.0))
        commands.append(np.concatenate([np.zeros(round(RATE_HZ)), height * unit, [0.0]]))
    return Plan(name, (kind,) * len(commands), tuple(commands), frozenset(), frequency)
