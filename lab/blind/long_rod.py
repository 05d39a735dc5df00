"""Causes and mixtures that the diagnosis has missed, on a long catheter with dry friction in its sixteen joints.

Each line is a cause; its device, of one drawn catheter, is diagnosed with a Prandtl-Ishlinskii simulator identified on
other trials of the unaffected device. Ten trials at 25 Hz, gravity included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.models.identify.simulators import identify
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, Vec, no_progress

from ..devices.cores import JointsCore, Scene, rise
from .device import BlindDevice
from .generators import Generator, Shape, Withheld, between, generator_named
from .plan import draw_plan, multisine

NOISE_DEG, RESOLUTION_DEG = 0.10, 0.01
_STRIBECK_MM_S = 2.0
_DRAWN = MappingProxyType(
    {
        "gain": (8, 10),
        "offset_deg": (5, 15),
        "friction": (1.5, 2.5),
        "spread": (0.3, 3.0),
        "wrap": (0.03, 0.06),
        "load": (1.8, 2.4),
        "compliance": (0.12, 0.18),
        "pretension": (6, 9),
    }
)


def _one_way(u: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Friction factor 1 + `size` while the command falls, until it rises."""
    del scene, shape
    way = np.sign(rise(u))
    last = np.maximum.accumulate(np.where(way != 0, np.arange(u.size), 0))
    return np.where(way[last] < 0, 1 + size, 1.0)


def _session_set(angle: Vec, scene: Scene, size: float, shape: Shape) -> Vec:
    """Set of `size` times the largest bend so far, kept from trial to trial: `before N` is that before trial N."""
    bend = np.maximum(np.maximum.accumulate(scene.unit(angle)), shape[f"before {scene.trial}"])
    return angle + size * scene.span_deg * bend


ONE_WAY = Generator("one_way", "asymmetry", "friction", 1.0, 5.0, between(), _one_way)
SESSION_SET = Generator("session_set", "first_flexure", "tip", 0.1, 0.5, between(), _session_set)


_Part = tuple[str, dict[str, float]]


@dataclass(frozen=True)
class Line:
    """Cause or mixture, in two sizes.

    Attributes:
        truth: names that a diagnosis should give; none for a healthy device.
        sizes: each with a size for every effect of `parts`.
        parts: generator and shape of each effect; a generator `stribeck` is the core's own.
        ordered: whether the diagnosis is told that the trials are in recording order.
    """

    name: str
    truth: tuple[str, ...]
    parts: tuple[_Part, ...]
    sizes: tuple[tuple[float, ...], tuple[float, ...]]
    ordered: bool = True


_DELAY, _RISING, _CREEP = ("jittered_delay", {"jitter": 0.05}), ("viscous_wrap", {"power": 1.0}), "tendon_log_creep"
_LAG, _BEAT = ("cascaded_servo", {"inner": 1.8, "strokes_per_s": 8.0}), ("heartbeat", {"rate_hz": 1.2})
_SOFTER = ("thermal_drift", {"sign": 1.0, "walk": 0.2, "softening": 1.0})
_STRIBECK: _Part = ("stribeck", {})
_SET: _Part = ("session_set", {})
LINES = (
    Line("none", (), (), ((), ())),
    Line("delay", ("delay",), (_DELAY,), ((0.11,), (0.06,))),
    Line("lag", ("lag",), (_LAG,), ((0.11,), (0.06,))),
    Line("friction rises with speed", ("rate_dependence",), (_RISING,), ((1.0,), (0.5,))),
    Line("Stribeck", ("stick_slip",), (_STRIBECK,), ((2.0,), (1.0,))),
    Line("Stribeck + delay", ("delay", "stick_slip"), (_STRIBECK, _DELAY), ((2.0, 0.11), (1.0, 0.06))),
    Line("set", ("first_flexure",), (_SET,), ((0.2,), (0.1,))),
    Line("set without the order", ("first_flexure",), (_SET,), ((0.2,), (0.1,)), ordered=False),
    Line("friction one way", ("asymmetry",), (("one_way", {}),), ((1.2,), (0.6,))),
    Line("quantised", ("sensor",), (("dithered_quantiser", {"dither": 0.0}),), ((2.0,), (1.0,))),
    Line("softening + delay", ("delay", "drift"), (_DELAY, _SOFTER), ((0.11, 2.0), (0.08, 1.0))),
    Line(
        "creep + lag + beat",
        ("creep", "lag", "periodic_disturbance"),
        ((_CREEP, {"onset_s": 0.5}), _LAG, _BEAT),
        ((0.08, 0.15, 2.0), (0.04, 0.1, 1.0)),
    ),
    Line(
        "slack + delay + beat + softening",
        ("delay", "drift", "periodic_disturbance", "slack"),
        (("fibre_toe", {}), _DELAY, _BEAT, _SOFTER),
        ((0.8, 0.12, 2.0, 2.0), (0.5, 0.08, 1.5, 1.0)),
    ),
)


@dataclass(frozen=True, eq=False)
class LongRod:
    """Drawn catheter, its simulator, and the commands (T,) of ten trials [mm]."""

    device: BlindDevice
    gravity: Withheld
    simulator: Simulator
    commands: tuple[Vec, ...]

    @classmethod
    def drawn(cls, seed: int) -> LongRod:
        """Draw a catheter and identify its simulator; equal seeds give equal ones."""
        random = np.random.default_rng([seed, 45])
        core = JointsCore(**{name: float(random.uniform(*ends)) for name, ends in _DRAWN.items()}, joints=16)
        gravity = Withheld(generator_named("weight"), float(random.uniform(1, 2)), {"mounting_deg": -40.0})
        device = BlindDevice(core, NOISE_DEG, RESOLUTION_DEG, int(random.integers(2**31)), (gravity,))
        trials = [replace(t, source=f"fit_{k:02d}.csv") for k, t in enumerate(device.record(_commands(random, core)))]
        simulator = identify("pi", trials)[0]
        device = replace(device, seed=int(random.integers(2**31)))
        return cls(device, gravity, simulator, _commands(random, core))

    def trials(self, line: Line, size: int) -> list[Trial]:
        """Trials of the catheter with the causes of a line, in one of its sizes."""
        core, effects = self.device.core, [self.gravity]
        for (name, shape), amount in zip(line.parts, line.sizes[size], strict=True):
            if name == "stribeck":
                core = replace(core, breakaway=amount, speed=_STRIBECK_MM_S)  # type: ignore[call-arg]
            else:
                effects.append(Withheld(_generator(name), amount, shape or self._largest()))
        return replace(self.device, core=core, effects=tuple(effects)).record(self.commands)

    def _largest(self) -> dict[str, float]:
        """Largest bend before each trial, as share of the range."""
        most = np.maximum.accumulate([0.0, *(float(u.max()) for u in self.commands)]) / self.device.core.travel
        return {f"before {k}": float(value) for k, value in enumerate(most)}


def _commands(random: np.random.Generator, core: JointsCore) -> tuple[Vec, ...]:
    plan = draw_plan(random, "rich", core.travel)
    return (*plan.commands[:-2], multisine(random), *plan.commands[-2:])


def _generator(name: str) -> Generator:
    own = {generator.name: generator for generator in (ONE_WAY, SESSION_SET)}
    return own[name] if name in own else generator_named(name)


@dataclass(frozen=True)
class Said:
    """Diagnosis of one line in one size."""

    line: Line
    size: int
    diagnosis: Diagnosis

    @property
    def exact(self) -> bool:
        """Whether the names, or the verdict of a healthy device, are right."""
        names = {effect.name for effect in self.diagnosis.effects}
        return self.diagnosis.verdict == ("named" if self.line.truth else "none") and names == set(self.line.truth)

    @property
    def wrong(self) -> bool:
        """Whether a name is said for sure that is not true."""
        names = {effect.name for effect in self.diagnosis.effects}
        return self.diagnosis.verdict == "named" and not names <= set(self.line.truth)


def missed_lines(seed: int, names: Sequence[str] = (), progress: Progress = no_progress) -> list[Said]:
    """Diagnose the lines of these names, or all, in both sizes on the catheter of a seed.

    Raises:
        ConfigError: on an unknown line.
    """
    known = {line.name: line for line in LINES}
    for name in names:
        if name not in known:
            raise ConfigError(f"no line {name!r}, {did_you_mean(name, known)}")
    rod = LongRod.drawn(seed)
    todo = [(known[name], size) for name in names or known for size in (0, 1)]
    found = []
    for k, (line, size) in enumerate(todo):
        progress(k, len(todo), line.name)
        findings = find_causes(rod.trials(line, size), rod.simulator, ordered=line.ordered)
        found.append(Said(line, size, conclude(findings)[0]))
    return found


COLUMNS = ("cause", "said", "given, deg", "retuned", "with effects", "right")


def row(said: Said) -> list[str]:
    """Line of the table of `COLUMNS`."""
    found, gap = said.diagnosis, said.diagnosis.gap
    names = [f"{effect.name} {effect.probability:.2f}" for effect in found.effects]
    names += [" or ".join(names) for names in found.ambiguity]
    sizes = [gap.nominal_rmse_deg, gap.retuned_rmse_deg, gap.with_effects_rmse_deg]
    mark = "yes" if said.exact else "WRONG" if said.wrong else "no"
    cause = " ".join((said.line.name, *map(str, said.line.sizes[said.size])))
    return [cause, ", ".join(names) or found.verdict, *(f"{size:.2f}" for size in sizes), mark]
