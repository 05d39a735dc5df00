"""Random devices: drive, creep, one of several cores, sensor; and such a device as a plant."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Any, Literal, final

import numpy as np
from pydantic import Field

from hystmpc.ctrl.command import CommandLimits
from hystmpc.models.contract.metadata import Range
from hystmpc.sim.plants.computed import ComputedPlant, Sensing
from hystmpc.trials.types import Vec

from ..study import StudySettings
from . import kernels
from .cores import CapstanCore, Core, DahlCore, JointsCore, MuscleCore, RodCore, TendonCore
from .kernels import CAPSTAN, DAHL, FINE_S, MUSCLE, OWN, ROD, Packed
from .muscle import STATES
from .rod import RodCatheter
from .rod_solver import packed as rod_packed

Family = Literal["rod", "capstan", "dahl", "muscle", "joints", "stribeck"]
FAMILIES: tuple[Family, ...] = ("rod", "capstan", "dahl", "muscle")
OUTSIDE: tuple[Family, ...] = ("joints", "stribeck")
"""Families whose physics no operator of `fit auto` has; drawn where they are asked for."""

RATES_HZ = (25.0, 50.0, 250.0)
ABSENT = 0.3
"""Share of the devices without lag, of those without delay, and of those without creep."""

_SERVO = 0.25  # share of the lags that are servos of second order
_LAG_S, _DELAY_SAMPLES, _CREEP, _CREEP_S = (0.02, 0.25), (0.5, 4.0), (0.03, 0.12), (0.8, 8.0)
_NOISE_DEG, _RATE = (0.03, 0.3), (2.5, 7.0)  # the rate in whole strokes a second
_CORES: Mapping[str, type[Core]] = MappingProxyType(
    {
        "rod": RodCore,
        "capstan": CapstanCore,
        "dahl": DahlCore,
        "muscle": MuscleCore,
        "joints": JointsCore,
        "stribeck": DahlCore,
    }
)
_CODES = {"rod": ROD, "capstan": CAPSTAN, "dahl": DAHL, "muscle": MUSCLE, "joints": CAPSTAN, "stribeck": DAHL}
_ELEMENTS = 8  # of a Dahl core
_REVERSAL = 1.15  # widths of the Dahl elements over those at which the angle stands still at a reversal
_ROD_STEP_S = 0.02  # longest, as in the blind check
_FLEXURE_S, _SETTLED, _LONGEST_S = 10.0, 6.0, 60.0


@dataclass(frozen=True)
class DrawnDevice:
    """Parameters of one random device, from held command [mm or bar] to angle [deg] on a grid of 2 ms.

        x = servo or lag(u(t - delay)),  z' = (x - z) / creep_s,  theta = core(x + creep z),  y = theta + noise

    Attributes:
        family: of `FAMILIES` or `OUTSIDE`.
        lag_s: of the drive [s], 0 for none; of a servo the delay of a ramp, 2 damping / frequency.
        damping: of a second-order servo; 0 for a lag of first order.
        delay_s: whole fine steps [s].
        creep: final over instant answer of the drive to a step, less 1; 0 for none.
        creep_s: its time constant [s].
        rate_per_s: greatest change of the command [command unit/s].
    """

    number: int
    family: str
    rate_hz: float
    core: RodCore | CapstanCore | JointsCore | DahlCore | MuscleCore
    lag_s: float
    damping: float
    delay_s: float
    creep: float
    creep_s: float
    noise_deg: float
    rate_per_s: float
    seed: int

    @property
    def key(self) -> str:
        """Name of the device's files."""
        return f"{self.number:03d}-{self.family}-{self.rate_hz:g}hz"

    @property
    def unit(self) -> str:
        """Unit of the command."""
        return self.core.UNIT

    @property
    def limits(self) -> CommandLimits:
        """Limits of the command."""
        return CommandLimits(0.0, self.core.travel, self.rate_per_s)

    @property
    def truth(self) -> Mapping[str, float]:
        """True values for an identification, 0 for missing parts: lag [s], delay [s], creep [1]."""
        return {"lag": self.lag_s, "delay": self.seen_delay_s, "creep": self.creep}

    @property
    def seen_delay_s(self) -> float:
        """Delay as seen in samples, for an operator that interpolates between samples [s].

        A command that is held over a sample of length T and arrives n + f samples late changes the lag's input within
        the sample. With r = T / tau the lag takes the share (1 - exp(-(1 - f) r)) / (1 - exp(-r)) from the newer one of
        two commands, as interpolation by f' = 1 - share does. Without a lag only the whole samples n are visible.
        """
        whole, part = divmod(round(self.delay_s * self.rate_hz, 6), 1.0)
        if self.lag_s == 0:
            return whole / self.rate_hz
        r = 1.0 / (self.rate_hz * self.lag_s)
        share = math.expm1(-(1.0 - part) * r) / math.expm1(-r) if part else 1.0
        return (whole + 1.0 - share) / self.rate_hz


def draw_devices(
    count: int, seed: int, quick: bool = False, families: Sequence[str] = FAMILIES
) -> tuple[DrawnDevice, ...]:
    """Draw devices of alternating family, each family at all rates; equal arguments give equal devices.

    `ABSENT` of them have no lag, as many no delay and as many no creep, drawn apart from each other.

    Args:
        quick: at 25 Hz alone.
    """
    random = np.random.default_rng([seed, 16])
    rates = RATES_HZ[:1] if quick else RATES_HZ
    gone = [set(random.permutation(count)[: math.ceil(ABSENT * count)].tolist()) for _ in range(3)]
    starts = random.permutation(len(families))
    devices = []
    for k in range(count):
        family, turn = families[k % len(families)], k // len(families)
        rate = rates[(turn + int(starts[k % len(families)])) % len(rates)]
        devices.append(_drawn(np.random.default_rng([seed, 17, k]), k, family, rate, [k in which for which in gone]))
    return tuple(devices)


class DrawnSettings(StudySettings):
    """Settings of a study on random devices.

    Attributes:
        devices: how many are drawn.
        rates_hz: of the drawn devices, those of these sample rates are done [Hz]; all where it is empty.
        families: of `FAMILIES` and `OUTSIDE`, in turn.
        evaluations: closed-loop runs over all motions in the search of each rival's gains, about.
    """

    devices: Annotated[int, Field(ge=1, le=1000)] = 60
    rates_hz: tuple[float, ...] = ()
    families: tuple[Family, ...] = FAMILIES
    evaluations: Annotated[int, Field(ge=10)] = 300

    def chosen(self, drawn: Sequence[DrawnDevice]) -> list[DrawnDevice]:
        """The devices of the wanted sample rates."""
        return [device for device in drawn if not self.rates_hz or device.rate_hz in self.rates_hz]


def drawn_devices(settings: DrawnSettings) -> tuple[DrawnDevice, ...]:
    """All devices of a study's draw."""
    return draw_devices(settings.devices, settings.seed, settings.quick, settings.families)


def _drawn(random: np.random.Generator, number: int, family: str, rate_hz: float, gone: list[bool]) -> DrawnDevice:
    core = _core(random, family)
    lag, creep, rate = (float(random.uniform(*ends)) for ends in (_LAG_S, _CREEP, _RATE))
    delay = float(random.uniform(*_DELAY_SAMPLES)) / rate_hz
    noise, creep_s = (float(np.exp(random.uniform(*np.log(ends)))) for ends in (_NOISE_DEG, _CREEP_S))
    servo, damping = random.random() < _SERVO, float(random.uniform(0.6, 1.0))
    return DrawnDevice(
        number=number,
        family=family,
        rate_hz=rate_hz,
        core=core,
        lag_s=0.0 if gone[0] else lag,
        damping=damping if servo and not gone[0] else 0.0,
        delay_s=0.0 if gone[1] else FINE_S * round(delay / FINE_S),
        creep=0.0 if gone[2] else creep,
        creep_s=creep_s,
        noise_deg=noise,
        rate_per_s=rate * core.travel,
        seed=int(random.integers(2**31)),
    )


def _core(random: np.random.Generator, family: str) -> RodCore | CapstanCore | JointsCore | DahlCore | MuscleCore:
    core = _CORES[family].draw(random)
    if family == "stribeck":
        core = core.with_stribeck(random)
    # Relaxation of the rod itself would be an additional creep.
    return replace(core, fast_share=0.0, slow_share=0.0) if isinstance(core, RodCore) else core  # type: ignore[return-value]


def worn(device: DrawnDevice, friction: float, stiffness: float) -> DrawnDevice:
    """Device with other friction and stiffness, as factors; a stiffer one moves less for the same command.

    The friction of a muscle is divided by its factor: with more of it the angle would rise as the pressure falls.
    """
    core = device.core
    changes: dict[str, Any]
    if isinstance(core, MuscleCore):
        changes = {"friction": core.friction / friction, "greatest_deg": core.greatest_deg / stiffness}
    else:
        changes = {name: getattr(core, name) * friction for name in core.FRICTION} | {"gain": core.gain / stiffness}
    return replace(device, core=replace(core, **changes))


def packed(device: DrawnDevice, delay_s: float) -> Packed:
    """Device in the form of the recursions, with another delay [s]."""
    fine, delay = round(1 / (device.rate_hz * FINE_S)), round(delay_s / FINE_S)
    servo, commands, core = device.damping > 0, -(-delay // fine) + 1, device.core
    drive = (
        -math.expm1(-FINE_S / device.lag_s) if device.lag_s > 0 else 1.0,
        2 * device.damping / device.lag_s if servo else 0.0,
        device.damping,
        device.creep,
        -math.expm1(-FINE_S / device.creep_s),
        float(core.gain),
        float(core.offset_deg),
    )
    steps = max(math.ceil(fine * FINE_S / _ROD_STEP_S - 1e-9), 1) if isinstance(core, RodCore) else 0
    entries, segments, numbers = _core_numbers(core, fine * FINE_S / max(steps, 1))
    states = RodCatheter(core.rod()).state_size if isinstance(core, RodCore) else entries
    return Packed(
        sizes=np.array([_CODES[device.family], fine, commands, delay, steps, entries, segments], dtype=np.intc),
        numbers=np.concatenate([drive, numbers]),
        states=commands + OWN + states,
        room=6 * (max(fine, kernels.SETTLE) + 1),
        commands=commands,
        creep=device.creep,
    )


def _core_numbers(core: Core, step_s: float) -> tuple[int, int, Vec]:
    """Entries of the core's state, or contacts of a rod's shaft; segments of a rod; and what c/drawn.h wants of it."""
    if isinstance(core, RodCore):
        rod = core.rod()
        return rod.shaft_contacts, rod.segments, rod_packed(rod.numbers(), rod.step_numbers(step_s))
    if isinstance(core, TendonCore):
        points = core.points()
        return points[0].size, 0, np.concatenate([(core.wrap, core.pretension, core.CURL), *points])
    if isinstance(core, MuscleCore):
        return STATES, 0, np.array(core.numbers_of_muscle())
    assert isinstance(core, DahlCore)
    widths = np.geomspace(1.0, core.spread, _ELEMENTS)
    # At a reversal an element turns twice as fast as the place moves: together they may not outrun it, else the angle
    # would go on rising while the command falls.
    widths *= _REVERSAL * (2 + core.breakaway) * _ELEMENTS * core.friction / float(widths.sum())
    shares = np.full(_ELEMENTS, core.friction / float(widths.sum()))
    return _ELEMENTS, 0, np.concatenate([(core.breakaway, core.speed), widths, shares])


def _virgin(device: DrawnDevice, p: Packed) -> Vec:
    """State (S,) of a virgin device at command 0."""
    core = device.core
    if isinstance(core, RodCore):
        core_state = RodCatheter(core.rod()).virgin()
    elif isinstance(core, MuscleCore):
        core_state = np.array([0.0, 0.0, -1.0, 0.0, 0.0])
    else:
        core_state = core.virgin() if isinstance(core, TendonCore) else np.zeros(_ELEMENTS)
    return np.concatenate([np.zeros(p.commands + OWN), core_state])


def at_rest(device: DrawnDevice, p: Packed) -> tuple[float, Vec]:
    """True angle [deg] and state at command 0 after a flexure over the whole travel and a rest longer than creep."""
    up = np.linspace(0.0, device.limits.upper, round(0.5 * _FLEXURE_S * device.rate_hz))
    rest_s = min(
        _SETTLED * (device.creep_s if device.creep else 0.0) + 10 * device.lag_s + device.delay_s + 1.0, _LONGEST_S
    )
    commands = np.concatenate([up, up[::-1], np.zeros(round(rest_s * device.rate_hz))])
    state, theta = _virgin(device, p), np.empty(commands.size)
    kernels.run(p, state, commands, theta)
    return float(theta[-1]), state


@final
class DrawnPlant(ComputedPlant):
    """Random device as a plant; a reset leaves it at rest at command 0."""

    def __init__(self, device: DrawnDevice, seed: int) -> None:
        self.device, self.packed = device, packed(device, device.delay_s)
        self.rest = at_rest(device, self.packed)
        self.command_limits = Range(lower=device.limits.lower, upper=device.limits.upper)
        super().__init__(1 / device.rate_hz, 0.0, device.unit, Sensing(device.noise_deg), seed)

    @cached_property
    def reachable_deg(self) -> tuple[float, float]:
        """Angles reached on both branches of a slow stroke over the inner nine tenths of the travel [deg]."""
        travel = self.device.limits.upper
        up = np.linspace(0.0, 0.95 * travel, round(20 * self.device.rate_hz))
        down = np.linspace(0.95 * travel, 0.05 * travel, round(20 * self.device.rate_hz))
        theta, state = np.empty(up.size + down.size), self.rest[1].copy()
        kernels.run(self.packed, state, np.concatenate([up, down]), theta)
        return float(theta[-1]), float(theta[up.size - 1])

    def noise(self, samples: int) -> Vec:
        """Measurement noise at rest and in the following samples (samples + 1,) [deg], as in a run."""
        return self.sensing.noise_deg * np.random.default_rng(self.seed).standard_normal(samples + 1)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, Vec]:
        del random
        return self.rest

    def _advanced(self, state: Vec, u: float, random: np.random.Generator) -> tuple[float, Vec]:
        del random
        after = state.copy()
        return float(kernels.advance(self.packed, after, float(u))), after
