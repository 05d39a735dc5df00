"""Withheld effects of the blind check: each is a function of its size, registered at its definition.

A new one is a function under `@generates`; its equation must not be the library's. Recursions are in c/effects.c.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.signal import fftconvolve

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.types import Vec

from ..devices.cores import FINE_S, PARTS, TRAVEL_MM, Scene, rise
from ..library import laboratory

Shape = Mapping[str, float]
Site = Literal["drive", "friction", "tip", "sensor"]
Draw = Callable[[np.random.Generator], dict[str, float]]
Apply = Callable[[Vec, Scene, float, Shape], Vec]
UNKNOWN = "unknown"
CONFIGURATION = "configuration_change"
SCATTER, ALIASED_RATE = "friction_by_trial", "aliased_rate"
"""Causes of the aliased suite, whose names are not asked for."""
_REGISTERED: list[Generator] = []
_SPEED_S = 0.03
_LUGRE = np.array([150.0, 0.02, 0.01])  # presliding stiffness, its damping [s], viscous friction [s]
_WALK_S = 1.0
_SESSION_S = 1800.0


@dataclass(frozen=True)
class Generator:
    """Generator of an effect; its equation is not the library's.

    Attributes:
        label: name of the effect that a diagnosis should give; `unknown` where the library has none, or another word
            where no name is asked for.
        site: what `apply` changes: the command on the fine grid, the friction factor (it gets the command there), the
            angle on the fine grid, or the sampled angle.
        typical, greatest: size to begin with, and bound of the search for a size.
        draw: shape numbers besides the size.
        apply: signal (T,), scene, size and shape to the changed signal (T,).
    """

    name: str
    label: str
    site: Site
    typical: float
    greatest: float
    draw: Draw
    apply: Apply


@dataclass(frozen=True)
class Withheld:
    """Generator with its parameters."""

    generator: Generator
    size: float
    shape: Shape = field(default_factory=dict)

    def resized(self, size: float) -> Withheld:
        """Same effect with another size."""
        return replace(self, size=size)


def between(**ranges: tuple[float, float]) -> Draw:
    """Draw uniform shape parameters."""
    return lambda random: {name: float(random.uniform(*ends)) for name, ends in ranges.items()}


def generates(
    label: str, site: Site, typical: float, greatest: float, draw: Draw = between()
) -> Callable[[Apply], Apply]:
    """Register a function as a generator under its name; arguments as the attributes of `Generator`."""

    def register(apply: Apply) -> Apply:
        name = str(getattr(apply, "__name__", label))
        _REGISTERED.append(Generator(name, label, site, typical, greatest, draw, apply))
        return apply

    return register


_LEAST_LAG_S = 4 * FINE_S


@generates("lag", "drive", 0.05, 1.0, between(inner=(1.2, 2.6), strokes_per_s=(3.0, 12.0)))
def cascaded_servo(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Servo of a position over a velocity loop, limited in speed, with a delay of `size` [s] on a ramp.

    The delay is at least 8 ms, below which it is not stable on the grid; the speed limit remains.
    """
    out = np.empty(u.size)
    lag, limit = max(size, _LEAST_LAG_S), shape["strokes_per_s"] * scene.travel
    laboratory().cascade(u, u.size, FINE_S, lag, shape["inner"], limit, out)
    return out


@generates("delay", "drive", 0.05, 1.0, between(jitter=(0.05, 0.25)))
def jittered_delay(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Packets at the sample rate, each delayed by `size` (1 + jitter |n|) [s] without a change of order."""
    sent = np.arange(0, u.size, PARTS)
    random = scene.random("jittered_delay")
    late = size * (1 + shape["jitter"] * np.abs(random.standard_normal(sent.size)))
    arrival = np.maximum.accumulate(sent * FINE_S + late)
    return np.interp(np.arange(u.size) * FINE_S, arrival, u[sent])


@generates("slack", "drive", 0.3, 3.0)
def fibre_toe(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Fibres recruited one after another: x = u - L (1 - exp(-u / L)) with L = `size` [mm of 6 mm]."""
    del shape
    length = size * scene.travel / TRAVEL_MM
    return u - length * (1 - np.exp(-np.maximum(u, 0.0) / length))


@generates("rate_dependence", "friction", 1.0, 60.0, between(power=(0.7, 1.2)))
def viscous_wrap(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Friction factor 1 + `size` (|v| / v0)^a with a speed v filtered by a lubricant film's 30 ms."""
    weights = np.exp(-np.arange(0, 5 * _SPEED_S, FINE_S) / _SPEED_S)
    speed = np.convolve(np.abs(rise(u)), weights / weights.sum())[: u.size]
    return 1 + size * (speed / scene.travel) ** shape["power"]


def log_relaxation(signal: Vec, share: float, onset_s: float) -> Vec:
    """Response of a log-law solid: share * integral of ds(t') log10(1 + (t - t') / onset), without the instant part."""
    t = np.arange(signal.size) * FINE_S
    kernel = share * np.log10(1 + t / onset_s)
    return np.asarray(fftconvolve(np.diff(signal, prepend=signal[0]), kernel)[: signal.size])


@generates("creep", "drive", 0.03, 0.4, between(onset_s=(0.2, 1.0)))
def tendon_log_creep(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Tendon with logarithmic creep: x = u - log_relaxation(u); `size` is the share per decade."""
    del scene
    return u - log_relaxation(u, size, shape["onset_s"])


@generates("stick_slip", "tip", 2.0, 25.0, between(ratio=(0.3, 0.5), stribeck_deg_s=(5.0, 20.0)))
def lugre_tip(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Tip with LuGre friction in its lumen; `size` is the break-away [deg of bending]."""
    del scene
    out = np.empty(angle.size)
    laboratory().lugre(angle, angle.size, FINE_S, size, shape["ratio"], shape["stribeck_deg_s"], _LUGRE, out)
    return out


@generates("contact", "tip", 1.0, 400.0, between(at=(0.5, 0.72)))
def hertz_contact(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Wall with Hertzian contact beyond a bend a: free = y + `size` span ((y - a) / span)^1.5."""
    free, at = scene.unit(angle), shape["at"]
    deep = np.maximum(free - at, 0.0)
    y = deep.copy()
    for _ in range(30):  # monotone and convex: Newton from above goes down to the root
        y = np.maximum(y - (y + size * y**1.5 - deep) / (1 + 1.5 * size * np.sqrt(y)), 0.0)
    return scene.rest_deg + scene.span_deg * (free - deep + y)


@generates("nonlinear_gain", "tip", 3.0, 50.0, between(mounting_deg=(-65.0, -20.0)))
def weight(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Bending by gravity: theta + `size` (sin(theta - phi) - sin(rest - phi)), phi the mounting [deg]."""
    turned, rest = (np.deg2rad(a - shape["mounting_deg"]) for a in (angle, scene.rest_deg))
    return angle + size * (np.sin(turned) - np.sin(rest))


@generates("asymmetry", "tip", 2.0, 30.0, between(turn=(0.02, 0.06), power=(1.6, 2.4)))
def directional_stiffness(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Stiffness that depends on the direction: theta + `size` d p(theta), d a smoothed direction in -1..1."""
    d, bend = np.empty(angle.size), scene.unit(angle)
    laboratory().direction(bend, bend.size, shape["turn"], d)
    return angle + size * d * np.clip(bend, 0.0, 1.2) ** shape["power"]


@generates("creep", "tip", 0.03, 0.4, between(onset_s=(0.2, 1.0)))
def wall_log_creep(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Wall with logarithmic creep: theta + log_relaxation(theta), `size` the share per decade."""
    del scene
    return angle + log_relaxation(angle, size, shape["onset_s"])


def _drift_shape(random: np.random.Generator) -> dict[str, float]:
    return {
        "sign": float(random.choice([-1, 1])),
        "walk": float(random.uniform(0.1, 0.3)),
        "softening": float(random.choice([0, 1])),
    }


@generates("drift", "tip", 0.3, 10.0, _drift_shape)
def thermal_drift(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Drift of `size` [deg/min] and a random walk over the whole session; it scales the bend or shifts it."""
    random = scene.random("thermal_drift", every_trial=False)
    walk = np.cumsum(random.standard_normal(round(_SESSION_S / _WALK_S)))
    minutes = (scene.clock_s + np.arange(angle.size) * FINE_S) / 60
    wander = np.interp(60 * minutes, np.arange(walk.size) * _WALK_S, walk) * np.sqrt(_WALK_S / 60)
    slow = size * shape["sign"] * (minutes + shape["walk"] * wander)
    return angle + slow * (1 - shape["softening"] + shape["softening"] * 2 * scene.unit(angle))


@generates(
    "first_flexure",
    "tip",
    2.0,
    40.0,
    between(**{"yield": (0.1, 0.35), "exponent": (1.3, 2.0), "rate_per_s": (3.0, 12.0)}),
)
def plastic_set(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Plastic set by viscoplastic flow with hardening beyond a yield bend, about `size` [deg], new in each trial."""
    bend, out = np.maximum.accumulate(scene.unit(angle)), np.empty(angle.size)
    flow = shape["yield"], shape["exponent"], shape["rate_per_s"]
    laboratory().plastic(bend, bend.size, FINE_S, *flow, out)
    return angle + size * out / max(1 - shape["yield"], 0.05)


@generates("trial_shift", "tip", 0.6, 20.0, between(gain=(0.3, 0.8)))
def remounting(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Shift of each trial, `size` [deg] times Student's t (5 degrees), and gain of each trial."""
    random = scene.random("remounting")
    shift, gain = random.standard_t(5), random.standard_normal()
    return angle + size * shift + size * shape["gain"] * gain * scene.unit(angle)


@generates("periodic_disturbance", "tip", 1.0, 20.0, between(rate_hz=(0.9, 1.7)))
def heartbeat(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Pulse wave with a dicrotic notch, `size` [deg] high, at a rate that varies by 2 % from beat to beat."""
    random = scene.random("heartbeat")
    beats = int(angle.size * FINE_S * shape["rate_hz"] * 1.5) + 4
    ends = np.cumsum((1 + 0.02 * random.standard_normal(beats)) / shape["rate_hz"]) - random.uniform(0, 1) - 0.5
    phase = np.mod(np.interp(np.arange(angle.size) * FINE_S, ends, np.arange(beats, dtype=np.float64)), 1.0)
    pulse = np.exp(-(((phase - 0.22) / 0.09) ** 2)) + 0.35 * np.exp(-(((phase - 0.52) / 0.08) ** 2))
    return angle + size * (pulse - pulse.mean())


@generates("periodic_disturbance", "tip", 1.0, 20.0, between(rate_hz=(0.18, 0.35)))
def breathing(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Breathing with a rest at the end of expiration: `size` [deg] (1 - cos^4(pi f t)), Lujan's law."""
    phase = scene.random("breathing").uniform(0, 1)
    move = 1 - np.cos(np.pi * (shape["rate_hz"] * np.arange(angle.size) * FINE_S + phase)) ** 4
    return angle + size * (move - move.mean())


@generates("sensor", "sensor", 1.0, 30.0, between(dither=(0.1, 0.5)))
def dithered_quantiser(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Steps of `size` [deg] after a triangular dither of a share of a step."""
    random = scene.random("dithered_quantiser")
    dither = shape["dither"] * size * (random.random(angle.size) - random.random(angle.size))
    return np.round((angle + dither) / size) * size


@generates("sensor", "sensor", 0.2, 5.0, between(freedom=(2.2, 4.0)))
def heavy_tails(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Noise of `size` [deg] with Student's t of 2 to 4 degrees of freedom."""
    return angle + size * np.clip(scene.random("heavy_tails").standard_t(shape["freedom"], angle.size), -30, 30)


@generates("sensor", "sensor", 10.0, 200.0, between(length_s=(0.3, 0.8)))
def dropouts(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Intervals of `length_s`, about `size` of them a minute, in which the last value is repeated."""
    random = scene.random("dropouts")
    length = max(round(25 * shape["length_s"]), 2)
    # One number a sample, compared with the size: a larger size keeps every dropout of a smaller one.
    starts = np.flatnonzero(random.random(angle.size) < size / 60 / 25)
    keep = np.arange(angle.size)
    for start in starts:
        keep[start + 1 : start + length] = np.minimum(keep[start + 1 : start + length], keep[start])
    return angle[keep]


@generates(UNKNOWN, "friction", 1.0, 20.0, between(turn_s=(7.0, 19.0)))
def orientation_friction(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Friction that follows the unlogged, slowly changing roll of the shaft: 1 + `size` (1 + sin(roll)) / 2."""
    t = np.arange(u.size) * FINE_S
    random = scene.random("orientation_friction")
    roll = 2 * np.pi * (t / shape["turn_s"] + random.uniform()) + 1.5 * np.sin(2 * np.pi * t / 23.0)
    return 1 + size * (1 + np.sin(roll)) / 2


@generates(UNKNOWN, "tip", 0.05, 1.0, between(dwell_s=(3.0, 9.0)))
def telegraph_gain(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Gain that jumps between two values at random times (a lead that slips in its grip); `size` is the jump."""
    random = scene.random("telegraph_gain")
    flips = random.random(angle.size) < FINE_S / shape["dwell_s"]
    high = (np.cumsum(flips) + int(random.integers(2))) % 2
    return angle + size * (high - 0.5) * scene.span_deg * scene.unit(angle)


@generates(UNKNOWN, "tip", 2.0, 30.0, between(pause_s=(3.0, 8.0)))
def cross_talk(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Second, unlogged tendon that bends the tip by up to `size` [deg]."""
    random = scene.random("cross_talk")
    seconds = angle.size * FINE_S
    at = np.sort(random.uniform(0, seconds, max(int(seconds / shape["pause_s"]), 2)))
    level = random.uniform(-1, 1, at.size + 1)
    t = np.arange(angle.size) * FINE_S
    pulled, moved = level[np.searchsorted(at, t)], np.empty(t.size)
    laboratory().second_order(pulled, t.size, FINE_S, 9.0, 1.0, moved)
    return angle + size * moved * (1 + 0.5 * scene.unit(angle))


@generates(UNKNOWN, "tip", 0.5, 20.0, between(frequency_hz=(1.2, 2.5), damping=(0.02, 0.06)))
def tip_resonance(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Lightly damped tip that oscillates after every acceleration: theta + `size` (ringing - theta)."""
    del scene
    out = np.empty(angle.size)
    frequency = 2 * np.pi * shape["frequency_hz"]
    laboratory().second_order(angle, angle.size, FINE_S, frequency, shape["damping"], out)
    return angle + size * (out - angle)


def _in_second(scene: Scene, shape: Shape) -> bool:
    """Whether a trial is in the second configuration; `second` holds a bit for each trial."""
    return bool(int(shape["second"]) >> scene.trial & 1)


@generates(CONFIGURATION, "friction", 0.8, 8.0)
def bent_sheath(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Friction factor 1 + `size` in the trials of the second configuration."""
    return np.full(u.size, 1 + size * _in_second(scene, shape))


@generates(CONFIGURATION, "tip", 0.2, 0.9)
def other_lever(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Gain of 1 + `size` in the trials of the second configuration."""
    return angle + size * _in_second(scene, shape) * scene.span_deg * scene.unit(angle)


@generates(CONFIGURATION, "tip", 4.0, 25.0)
def other_zero(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Shift by `size` [deg] in the trials of the second configuration."""
    return angle + size * _in_second(scene, shape)


@generates(SCATTER, "friction", 0.4, 1.5)
def bend_by_trial(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Friction that differs from trial to trial by the bend of the sheath: factor exp(`size` n), n normal."""
    del shape
    return np.full(u.size, np.exp(size * scene.random("bend_by_trial").standard_normal()))


@generates(ALIASED_RATE, "tip", 1.0, 20.0)
def aliased_wave(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Sine of `size` [deg] and `hz` on the clock of the session."""
    t = scene.clock_s + np.arange(angle.size) * FINE_S
    return angle + size * np.sin(2 * np.pi * (shape["hz"] * t + shape["phase"]))


GENERATORS = tuple(_REGISTERED)
FOREIGN_EFFECTS = tuple(generator for generator in GENERATORS if generator.label == UNKNOWN)
LABELS: tuple[str, ...] = tuple(dict.fromkeys(g.label for g in GENERATORS if g.label in EFFECTS))
NAMES = frozenset((*LABELS, CONFIGURATION))
"""What a diagnosis can say of these causes."""


def generator_named(name: str) -> Generator:
    """Generator of that name.

    Raises:
        ConfigError: if there is none.
    """
    for generator in GENERATORS:
        if generator.name == name:
            return generator
    raise ConfigError(f"no generator {name!r}, {did_you_mean(name, [g.name for g in GENERATORS])}")


def generators_of(label: str) -> tuple[Generator, ...]:
    """Generators of one effect.

    Raises:
        ConfigError: on an unknown effect.
    """
    found = tuple(g for g in GENERATORS if g.label == label)
    if not found:
        raise ConfigError(f"no effect {label!r}, {did_you_mean(label, dict.fromkeys(g.label for g in GENERATORS))}")
    return found
