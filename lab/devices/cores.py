"""Cores of random devices: tendons, Dahl elements, rod and air muscle; their time grid."""

from __future__ import annotations

import itertools
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, Self, final

import numpy as np

from hystmpc.trials.types import Vec

from . import kernels, rod_solver
from .muscle import STATES, MuscleNumbers
from .rod import RodCatheter, RodParameters

TRAVEL_MM = 6.0
STROKE = 0.6
"""Share of the travel of the unlogged cycle before a trial, so that a trial does not open a virgin device."""

_NODES = 16
FINE_S = 0.002
RATE_HZ = 25.0
PARTS = round(1 / (RATE_HZ * FINE_S))
_COARSE = 10  # fine steps in one of the rod, whose equations take a hundred times as long as those of the others
_SETTLED_S = 1e6  # a step slow against every relaxation
_BEFORE = 40
_SHAFT, _SEGMENTS = 3, 6
_STRONGEST = 0.95  # friction over pull of a muscle
_BENDING = (0.2, 0.9)  # least and greatest share of the wrap that bends


@dataclass(frozen=True)
class Mounting:
    """Deviation of a device from the one on which its simulator was identified.

    Attributes:
        offset_deg: added to every angle [deg].
    """

    gain: float = 1.0
    friction: float = 1.0
    offset_deg: float = 0.0


@dataclass(frozen=True)
class Core(ABC):
    """Hysteresis from a command to an angle [deg]; the command of a tendon is a displacement [mm].

    Attributes:
        gain: of the angle over a displacement [deg/mm].
        offset_deg: angle at zero displacement [deg].
        UNIT: of the command.
        DRAWN: range of each parameter between devices.
        FRICTION: parameters that are multiplied by the friction factor of a mounting.
        STRIBECK: range of each parameter of a friction that is greater at rest.
    """

    UNIT: ClassVar[str] = "mm"
    DRAWN: ClassVar[Mapping[str, tuple[float, float]]]
    FRICTION: ClassVar[tuple[str, ...]]
    STRIBECK: ClassVar[Mapping[str, tuple[float, float]]] = {}
    gain: float
    offset_deg: float

    @property
    def travel(self) -> float:
        """Greatest command [`UNIT`]."""
        return TRAVEL_MM

    @abstractmethod
    def run(self, x: Vec, scale: Vec) -> Vec:
        """Angles (T,) [deg] for commands x (T,) [`UNIT`] at the core's input and friction factors (T,).

        They are on the fine grid. An unlogged cycle of `STROKE` precedes them.
        """

    def mounted(self, mounting: Mounting) -> Self:
        """Same device with the deviations of a mounting."""
        rubbing = {name: getattr(self, name) * mounting.friction for name in self.FRICTION}
        return replace(
            self, gain=self.gain * mounting.gain, offset_deg=self.offset_deg + mounting.offset_deg, **rubbing
        )

    @abstractmethod
    def stiffer(self, factor: float) -> Self:
        """Same device with another stiffness."""

    @abstractmethod
    def reweighted(self, factor: float) -> Self:
        """Same device with another distribution of its friction over the travel: slower for a factor above 1."""

    @classmethod
    def draw(cls, random: np.random.Generator) -> Self:
        """Draw a device of this kind."""
        return cls(**{name: random.uniform(*ends) for name, ends in cls.DRAWN.items()})

    def with_stribeck(self, random: np.random.Generator) -> Self:
        """Same device with friction that is greater at rest, if it can have it."""
        return replace(self, **{name: float(random.uniform(*ends)) for name, ends in self.STRIBECK.items()})

    def numbers(self) -> dict[str, Any]:
        """Parameters for the sealed answers."""
        return {"core": type(self).__name__, **asdict(self)}


@dataclass(frozen=True)
class QuasiStatic(Core):
    """Core whose angle depends on the path of the displacement alone, not on its speed."""

    @abstractmethod
    def deflection(self, x: Vec, scale: Vec) -> Vec:
        """Distal displacement (T,) [mm] for proximal x (T,) [mm] and friction factors (T,); of a muscle its angle."""

    def run(self, x: Vec, scale: Vec) -> Vec:
        stroke = STROKE * self.travel
        up, down = np.linspace(0.0, stroke, 400), np.linspace(stroke, float(x[0]), 400)
        before = np.concatenate([up, down])
        whole = np.concatenate([before, x])
        factors = np.concatenate([np.full(before.size, scale[0]), scale])
        return self.offset_deg + self.gain * self.deflection(whole, factors)[before.size :]


@dataclass(frozen=True)
class TendonCore(QuasiStatic):
    """Core of an elastic tendon whose tension is lost by friction along its way."""

    CURL: ClassVar[float] = 0.0
    wrap: float
    pretension: float

    def deflection(self, x: Vec, scale: Vec) -> Vec:
        out, tension = np.empty(x.size), self.virgin()
        kernels.capstan(x, self.wrap, scale, self.CURL, tension, self.points(), self.pretension, out)
        return out

    def virgin(self) -> Vec:
        """Tensions (N,) of a virgin tendon [N]."""
        return np.full(self.points()[0].size, self.pretension)

    @abstractmethod
    def points(self) -> tuple[Vec, Vec, Vec]:
        """Displacement of the proximal end, and bend, by the tension of each point (N,) [mm/N]; its drag (N,) [N]."""


@final
@dataclass(frozen=True)
class CapstanCore(TendonCore):
    """Tendon in a bent sheath with friction proportional to the local tension (capstan law); its last part bends.

    The tendon also rubs along the part that bends, so that this part does not move as one piece.

    Attributes:
        gain: tip angle over distal displacement [deg/mm].
        offset_deg: angle at zero distal displacement [deg].
        wrap: friction coefficient times wrap angle.
        load: stiffness that the tendon pulls against [N/mm].
        compliance: of the whole tendon [mm/N].
        pretension: at rest [N].
        bending: share of the tendon's wrap that lies in the part that bends.
    """

    DRAWN: ClassVar = {
        "gain": (9, 13),
        "offset_deg": (10, 30),
        "wrap": (0.18, 0.34),
        "load": (1.5, 2.5),
        "compliance": (0.05, 0.08),
        "pretension": (7, 12),
        "bending": (0.35, 0.7),
    }
    FRICTION = ("wrap",)
    gain: float = 11.0
    offset_deg: float = 20.0
    wrap: float = 0.25
    load: float = 2.0
    compliance: float = 0.06
    pretension: float = 8.0
    bending: float = 0.5

    def points(self) -> tuple[Vec, Vec, Vec]:
        bends = np.arange(_NODES) >= round((1 - self.bending) * _NODES)
        weights = bends / bends.sum() / self.load
        return weights + self.compliance / _NODES, weights, np.zeros(_NODES)

    def stiffer(self, factor: float) -> Self:
        return replace(self, load=self.load * factor)

    def reweighted(self, factor: float) -> Self:
        """Same device with another share of the wrap in the bending part, and another pretension."""
        bending = float(np.clip(self.bending * factor, *_BENDING))
        return replace(self, bending=bending, pretension=self.pretension / factor)


@final
@dataclass(frozen=True)
class DahlCore(QuasiStatic):
    """Displacement minus the deflection of parallel Dahl elements (P. Dahl, Aerospace Corp. TOR-158, 1968).

    Attributes:
        gain: tip angle over distal displacement [deg/mm].
        offset_deg: angle at zero distal displacement [deg].
        friction: sum of the saturated deflections, half the width of the full loop [mm].
        spread: widest over narrowest element.
        breakaway: share by which friction is greater at rest (Stribeck): all widths are multiplied by
            1 + breakaway exp(-(v / speed)^2).
        speed: at which most of that is gone [mm/s].

    Source: of the speed's effect Canudas de Wit et al., A new model for control of systems with friction, IEEE T-AC 40
    (1995), without viscous terms.
    """

    DRAWN: ClassVar = {"gain": (9, 12), "offset_deg": (10, 30), "friction": (0.15, 0.35), "spread": (4, 9)}
    STRIBECK: ClassVar = {"breakaway": (0.2, 0.8), "speed": (0.5, 5.0)}
    FRICTION = ("friction",)
    gain: float = 10.0
    offset_deg: float = 20.0
    friction: float = 0.25
    spread: float = 6.0
    breakaway: float = 0.0
    speed: float = 2.0

    def deflection(self, x: Vec, scale: Vec) -> Vec:
        widths = np.geomspace(1.0, self.spread, 8) * 0.08
        scale = scale * _at_speed(x, self.breakaway, self.speed)
        shares = np.full(8, self.friction / float(widths.sum()))
        out, state = np.empty(x.size), np.zeros(8)
        kernels.dahl(x, scale, widths, shares, state, out)
        return x - out

    def stiffer(self, factor: float) -> Self:
        """Same device with smaller angle and smaller deflection of the elements for the same displacement."""
        return replace(self, gain=self.gain / factor, friction=self.friction / factor)

    def reweighted(self, factor: float) -> Self:
        """Same device with another spread of the elements."""
        return replace(self, spread=self.spread * factor)


def _at_speed(x: Vec, breakaway: float, speed: float) -> Vec:
    """Factors (T,) of the friction at the speeds of a displacement, see `DahlCore`."""
    v = np.diff(x, prepend=x[0]) / FINE_S
    return 1 + breakaway * np.exp(-((v / speed) ** 2))


@final
@dataclass(frozen=True)
class JointsCore(TendonCore):
    """Elastic joints in series, each with dry friction, on an elastic tendon that loses tension along them.

    Joint i holds its moment over the tendon's arm, M_i [N], while it is within its friction of the tension there:

        T exp(-wrap s_i) - d_i <= M_i <= T exp(+wrap s_i) + d_i,  s_i = i / joints + CURL |bend up to joint i|

    Attributes:
        gain: tip angle over distal displacement [deg/mm].
        offset_deg: angle at zero distal displacement [deg].
        friction: mean of the joints' dry friction d_i [N].
        spread: friction of the last joint over that of the first.
        wrap: friction coefficient of the tendon times its wrap angle over all joints, straight.
        load: stiffness of all joints together [N/mm].
        compliance: of the tendon [mm/N].
        pretension: at rest [N].
        breakaway, speed: of the friction of the joints and of the tendon, as those of `DahlCore`.
        joints: how many.
    """

    DRAWN: ClassVar = {
        "gain": (9, 13),
        "offset_deg": (10, 30),
        "friction": (0.05, 0.4),
        "spread": (0.2, 5.0),
        "wrap": (0.02, 0.08),
        "load": (1.5, 2.5),
        "compliance": (0.05, 0.12),
        "pretension": (4, 9),
    }
    STRIBECK: ClassVar = {"breakaway": (0.2, 0.8), "speed": (0.5, 5.0)}
    FRICTION = ("friction", "wrap")
    CURL = 0.8  # what a millimetre of bend adds to the wrap, as share of that of the straight device
    gain: float = 11.0
    offset_deg: float = 20.0
    friction: float = 0.2
    spread: float = 2.0
    wrap: float = 0.05
    load: float = 2.0
    compliance: float = 0.08
    pretension: float = 6.0
    breakaway: float = 0.0
    speed: float = 2.0
    joints: int = 12

    def deflection(self, x: Vec, scale: Vec) -> Vec:
        return super().deflection(x, scale * _at_speed(x, self.breakaway, self.speed))

    def points(self) -> tuple[Vec, Vec, Vec]:
        weights = np.concatenate([[0.0], np.full(self.joints, 1 / (self.joints * self.load))])
        drags = np.geomspace(1.0, self.spread, self.joints)
        shares = weights + np.concatenate([[self.compliance], np.zeros(self.joints)])
        return shares, weights, np.concatenate([[0.0], drags * self.friction / drags.mean()])

    def stiffer(self, factor: float) -> Self:
        return replace(self, load=self.load * factor)

    def reweighted(self, factor: float) -> Self:
        """Same device with another distribution of the friction over its joints."""
        return replace(self, spread=self.spread * factor)


@dataclass(frozen=True)
class Scene:
    """One trial of one device.

    Attributes:
        seed: of the case; everything random of a trial comes from `random`.
        trial: number of the trial in recording order, from 0.
        clock_s: time from the start of the first trial to that of this one [s].
        travel: greatest command [mm or bar].
        rest_deg, span_deg: angle at zero command, and the change to the greatest [deg].
    """

    seed: int
    trial: int
    clock_s: float
    travel: float
    rest_deg: float
    span_deg: float

    def random(self, name: str, every_trial: bool = True) -> np.random.Generator:
        """Random numbers of one effect in this trial, or of the whole device, independent of the effect's size."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode()), self.trial + 1 if every_trial else 0])

    def unit(self, angle: Vec) -> Vec:
        """Bend over the span: 0 at rest, about 1 at the greatest command."""
        return (angle - self.rest_deg) / self.span_deg


def fine_times(samples: int) -> Vec:
    """Times of the fine steps that cover `samples` samples at `RATE_HZ` [s]."""
    return np.asarray(np.arange((samples - 1) * PARTS + 1) * FINE_S, dtype=np.float64)


def rise(signal: Vec) -> Vec:
    """Speed by differences of the fine signal [1/s], zero at the start."""
    return np.asarray(np.diff(signal, prepend=signal[0]) / FINE_S, dtype=np.float64)


@final
@dataclass(frozen=True)
class RodCore(Core):
    """Rod of `devices.rod` on a coarser grid, without its drive, its first flexure and its sensor.

    Its segments are standard linear solids: their relaxation belongs to the device on which the simulator is
    identified, since every device bends with a small delay. The parameters are drawn so that it stays within the
    residual friction error of a backlash or a few plays; more of it would be creep, a withheld effect.

    Attributes:
        gain: tip angle over the displacement of the tendon in the rod [deg/mm].
        offset_deg: angle of the rod at rest, without tendon [deg].
        friction: coefficient of tendon and lumen.
        drag_n: friction of either part, shaft and rod, that does not come from tension [N].
        stiffness_nmm: bending stiffness at rest [N mm/rad].
        pretension_mm: pull that tensions the virgin tendon [mm].
        fast_share, slow_share: stiffness of the Maxwell branches over that at rest.
        slow_s: relaxation time of the slow branch [s].
    """

    DRAWN: ClassVar = {
        "gain": (28, 38),
        "offset_deg": (-20, 5),
        "friction": (0.03, 0.09),
        "drag_n": (0.6, 1.6),
        "stiffness_nmm": (5.5, 8.5),
        "pretension_mm": (3.0, 4.5),
        "fast_share": (0.05, 0.25),
        "slow_share": (0.005, 0.02),
        "slow_s": (1.0, 4.0),
    }
    FRICTION = ("friction", "drag_n")
    gain: float = 32.0
    offset_deg: float = -8.5
    friction: float = 0.06
    drag_n: float = 1.2
    stiffness_nmm: float = 6.9
    pretension_mm: float = 3.6
    fast_share: float = 0.15
    slow_share: float = 0.012
    slow_s: float = 2.0

    def run(self, x: Vec, scale: Vec) -> Vec:
        """Angles with linear interpolation between the rod's coarser steps; see `Core.run`."""
        last = -(-(x.size - 1) // _COARSE) * _COARSE
        times, knots = np.arange(x.size), np.arange(0, last + 1, _COARSE)
        places, factors = (np.interp(knots, times, signal) for signal in (x, scale))
        ways = _ways(replace(self, gain=1.0, offset_deg=0.0), places.tobytes(), factors.tobytes())
        return self.offset_deg + self.gain * np.interp(times, knots, ways)

    def stiffer(self, factor: float) -> Self:
        return replace(self, stiffness_nmm=self.stiffness_nmm * factor)

    def reweighted(self, factor: float) -> Self:
        """Same device with more tension-independent friction, and a smaller coefficient of friction."""
        return replace(self, drag_n=self.drag_n * factor, friction=self.friction / factor)

    def rod(self) -> RodParameters:
        """Parameters of the simulated rod."""
        return RodParameters(
            rest_deg=0.0,
            stiffness_nmm=self.stiffness_nmm,
            pretension_mm=self.pretension_mm,
            friction=self.friction,
            shaft_drag_n=self.drag_n,
            rod_drag_n=self.drag_n,
            fast_share=self.fast_share,
            slow_share=self.slow_share,
            slow_s=self.slow_s,
            set_share=0.0,
            drive_lag_s=0.0,
            shaft_contacts=_SHAFT,
            segments=_SEGMENTS,
        )


@lru_cache(maxsize=64)
def _ways(core: RodCore, places: bytes, factors: bytes) -> Vec:
    """Tendon displacement in the rod [mm] for drive positions [mm] and friction factors, (K,) bytes each; cached."""
    x, scale = np.frombuffer(places), np.frombuffer(factors)
    rod, stroke = core.rod(), STROKE * TRAVEL_MM
    before = np.concatenate([np.linspace(0.0, stroke, _BEFORE), np.linspace(stroke, x[0], _BEFORE)])
    state = RodCatheter(rod).virgin()
    _bends(rod, state, before, np.full(before.size, scale[0]), _SETTLED_S)
    ways = np.radians(_bends(rod, state, x, scale, _COARSE * FINE_S)) * rod.offset_mm
    ways.setflags(write=False)
    return ways


def _bends(rod: RodParameters, state: Vec, places: Vec, factors: Vec, step_s: float) -> Vec:
    """Bend (K,) [deg] at the end of every step; updates `state`. The kernel takes one friction a call."""
    bend, drive, tension = (np.empty(places.size) for _ in range(3))
    whole = rod.numbers()
    packed = rod_solver.packed(whole, rod.step_numbers(step_s))
    ends = [0, *(np.flatnonzero(np.diff(factors)) + 1).tolist(), places.size]
    for first, stop in itertools.pairwise(ends):
        numbers = rod_solver.rubbing(packed, float(factors[first]), rod.contacts)
        part = slice(first, stop)
        out = bend[part], drive[part], tension[part]
        rod_solver.advance(state, places[part], whole, numbers, 1, *out)
    return bend


@final
@dataclass(frozen=True)
class MuscleCore(QuasiStatic):
    """Muscle with slack, friction proportional to its pull and a saturating angle, without lag or creep.

    A friction factor s at work acts by the capstan's law: 1 - friction becomes (1 - friction)^s.

    Attributes:
        greatest_bar: greatest pressure [bar].
        greatest_deg: angle that no pressure exceeds [deg].
        friction: over pull, each way.
        presliding_bar: pressure over which friction turns its side [bar]; longer where the angle would rise as the
            pressure falls, see `kernels.muscle`.
        slack_bar: pressure at which the bladder meets the braid [bar].
        half_bar: pull that gives half of the greatest angle [bar].
        gain: factor of the angle.
        offset_deg: angle without pressure [deg].
    """

    UNIT = "bar"
    DRAWN: ClassVar = {
        "greatest_bar": (2.5, 3.5),
        "greatest_deg": (60.0, 100.0),
        "friction": (0.04, 0.10),
        "presliding_bar": (8.0, 12.0),  # over the friction
        "slack_bar": (0.1, 0.5),
        "half_bar": (0.8, 1.6),
    }
    FRICTION = ("friction",)
    greatest_bar: float = 3.0
    greatest_deg: float = 80.0
    friction: float = 0.07
    presliding_bar: float = 0.7
    slack_bar: float = 0.3
    half_bar: float = 1.2
    gain: float = 1.0
    offset_deg: float = 0.0

    @classmethod
    def draw(cls, random: np.random.Generator) -> Self:
        """A device of this kind with enough presliding at every pressure."""
        numbers = {name: float(random.uniform(*ends)) for name, ends in cls.DRAWN.items()}
        numbers["presliding_bar"] *= numbers["friction"]
        return cls(**numbers)

    @property
    def travel(self) -> float:
        return self.greatest_bar

    def stiffer(self, factor: float) -> Self:
        """Same device with more pull for the same angle."""
        return replace(self, half_bar=self.half_bar * factor)

    def reweighted(self, factor: float) -> Self:
        """Same device with another presliding."""
        return replace(self, presliding_bar=self.presliding_bar * factor)

    def deflection(self, x: Vec, scale: Vec) -> Vec:
        """Angle (T,) without offset [deg] for pressures x (T,) [bar] and friction factors (T,)."""
        out, state = np.empty(x.size), np.zeros(STATES)
        state[2] = -1.0  # the friction of a muscle that was vented
        friction = np.minimum(1 - (1 - self.friction) ** scale, _STRONGEST)
        kernels.muscle(x, friction, self.numbers_of_muscle(), FINE_S, state, out)
        return out

    def numbers_of_muscle(self) -> MuscleNumbers:
        """Parameters for the recursion; valve and air are fast, since lag and creep precede the core."""
        fast = {"supply_bar": 5.0, "valve_s": 0.002, "fill_s": 0.02, "vent_s": 0.02}
        return MuscleNumbers(
            **fast,
            slack_bar=self.slack_bar,
            slack_width_bar=0.08,
            friction=self.friction,
            presliding_bar=self.presliding_bar,
            greatest_deg=self.greatest_deg,
            half_bar=self.half_bar,
            late=0.0,
            late_share=1.0,
            bend_share=1.0,
        )
