"""What retuning of the nominal simulator may change: gain, offset, widths, weights; never what has an effect's name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from ..chain import Chain
from ..contract.metadata import Range
from ..operators.friction import MaxwellSlip
from ..operators.hysteresis import Backlash, CurvedPlays
from .free_run import StagedChain

# Parameters of cores that are effects by another name: retuning leaves them at their nominal values.
_EFFECTS_BY_ANOTHER_NAME = {"beta": "rate_dependence"}
_LOOP_SAMPLES = 200
_ROUGHNESS = 0.03  # share of the range over which a difference of slopes counts: 25 samples of 0.3 % of the angle
_SLOW_S = 1.0  # sample time of that loop: slow enough for rate-dependent widths to vanish


class Baseline(ABC):
    """The nominal chain with some freedom z (Z,), nominal values included.

    Attributes:
        chain: the nominal chain.
        command: range of the command [cmd].
        nominal, lower, upper, scale: of z.
        effects: position in z of what retuning leaves alone, because it is an effect: {effect: {name: position}}.
        held: positions in z of what is chosen and never fitted.
        width: position in z of the width of the loop, -1 for none.
        roughness: rows (R, Z) [deg per unit of z] whose products with z count as errors of single samples: they tie
            together what few samples determine (Eilers, Marx, Flexible smoothing with B-splines and penalties,
            Statistical Science 11, 1996, with differences of first order).
    """

    chain: Chain
    command: Range
    nominal: Vec
    lower: Vec
    upper: Vec
    scale: Vec
    effects: Mapping[str, Mapping[str, int]]
    held: tuple[int, ...] = ()
    width: int = -1
    roughness: Vec = np.empty((0, 0))

    @abstractmethod
    def core_values(self, z: Vec) -> tuple[Vec, Vec]:
        """Parameters (P,) of the chain's core and their derivative (P, Z)."""

    @abstractmethod
    def quantities(self, z: Vec) -> Mapping[str, float]:
        """`gain` [deg/cmd], `offset` [deg at the middle of the command's range], `backlash_width` [cmd].

        Of a friction force, which leads its displacement: `stiffness` [deg/cmd] and `friction` [deg, half the height of
        the loop] instead of gain and width.
        """

    def loop_height(self, z: Vec) -> float:
        """Height of the loop [deg]."""
        quantities = self.quantities(z)
        return (
            2 * quantities["friction"]
            if "friction" in quantities
            else quantities["gain"] * quantities["backlash_width"]
        )

    def loop_width(self, z: Vec) -> float:
        """Travel after a reversal over which the loop changes its branch [cmd]."""
        return self.quantities(z)["backlash_width"]

    def freed(self) -> Baseline:
        """The same with the widths of its plays free, where retuning usually holds them; itself where none are held."""
        return self


@final
@dataclass(frozen=True, eq=False)
class BacklashBaseline(Baseline):
    """Gain, shift and width of a backlash; the ratio of its slopes is an asymmetry.

    z = (g, s, w, a):  m_lo' = g m_lo sqrt(a),  m_up' = g m_up / sqrt(a),  c_lo' = c_lo + s + w / 2,
                       c_up' = c_up + s - w / 2

    Attributes:
        chain: the nominal chain, its core a backlash.
        command: range of the command [cmd].
    """

    chain: Chain
    command: Range

    def __post_init__(self) -> None:
        span = self.command.upper - self.command.lower
        width = self.quantities(np.array([1.0, 0.0, 0.0, 1.0]))["backlash_width"]
        for name, value in (
            ("nominal", [1.0, 0.0, 0.0, 1.0]),
            ("lower", [0.2, -span, -max(width, 0.0), 0.3]),
            ("upper", [5.0, span, span, 3.0]),
            ("scale", [0.1, 0.05 * span, 0.05 * span, 0.1]),
        ):
            object.__setattr__(self, name, np.array(value))
        object.__setattr__(self, "effects", {"asymmetry": {"slope_ratio": 3}})
        object.__setattr__(self, "width", 2)

    def core_values(self, z: Vec) -> tuple[Vec, Vec]:
        m_lo, m_up, c_lo, c_up = self.chain.core.values
        root = np.sqrt(z[3])
        steep, flat = m_lo * root, m_up / root
        p = np.array([z[0] * steep, z[0] * flat, c_lo + z[1] + 0.5 * z[2], c_up + z[1] - 0.5 * z[2]])
        slope = np.zeros((4, 4))
        slope[0, [0, 3]], slope[1, [0, 3]] = (steep, 0.5 * z[0] * steep / z[3]), (flat, -0.5 * z[0] * flat / z[3])
        slope[2, [1, 2]], slope[3, [1, 2]] = (1.0, 0.5), (1.0, -0.5)
        return p, slope

    def quantities(self, z: Vec) -> Mapping[str, float]:
        m_lo, m_up, c_lo, c_up = self.core_values(z)[0]
        middle = 0.5 * (self.command.lower + self.command.upper)
        offset = 0.5 * (m_lo * (middle + c_lo) + m_up * (middle + c_up))
        return {
            "gain": float(0.5 * (m_lo + m_up)),
            "offset": float(offset),
            "backlash_width": float(offset * (1 / m_up - 1 / m_lo) + c_lo - c_up),
        }


@final
@dataclass(frozen=True, eq=False)
class FreeCoreBaseline(Baseline):
    """All parameters of the core but one that is an effect by another name; of curved plays slopes and offset.

    Attributes:
        chain: the nominal chain.
        command: range of the command [cmd].
        free_widths: whether the half-widths of curved plays are free, too.
    """

    chain: Chain
    command: Range
    free_widths: bool = False

    def __post_init__(self) -> None:
        core, values = self.chain.core, np.array(self.chain.core.values)
        span = self.command.upper - self.command.lower
        slopes = [abs(v) for v, p in zip(values, core.parameters, strict=True) if p.unit == "deg/cmd"]
        pieces = core.pieces + 1 if isinstance(core, CurvedPlays) else 1
        gain = max(sum(slopes) / pieces, 1e-6)
        typical = {"cmd": 0.05 * span, "deg/cmd": 0.1 * gain, "deg": 0.05 * gain * span, "s": 0.02}
        little = {"1/cmd": 0.1 / span}
        scale = [
            typical.get(p.unit, max(0.1 * abs(v), little.get(p.unit, 1e-3) if v == 0 else 1e-3))
            for v, p in zip(values, core.parameters, strict=True)
        ]
        object.__setattr__(self, "nominal", values)
        object.__setattr__(self, "lower", np.array([p.lower for p in core.parameters]))
        object.__setattr__(self, "upper", np.array([p.upper for p in core.parameters]))
        object.__setattr__(self, "scale", np.array(scale))
        named = {
            _EFFECTS_BY_ANOTHER_NAME[p.name]: {p.name: k}
            for k, p in enumerate(core.parameters)
            if p.name in _EFFECTS_BY_ANOTHER_NAME
        }
        object.__setattr__(self, "effects", named)
        names = [p.name for p in core.parameters]
        object.__setattr__(self, "width", names.index("alpha") if "alpha" in names else -1)
        if isinstance(core, CurvedPlays):
            widths = core.plays if self.free_widths else 0
            object.__setattr__(self, "held", tuple(range(len(slopes) + 1 + widths, values.size)))
            object.__setattr__(self, "roughness", _ROUGHNESS * span * _differences(core, values.size))

    def core_values(self, z: Vec) -> tuple[Vec, Vec]:
        return np.clip(z, self.lower, self.upper), np.eye(z.size)

    def freed(self) -> Baseline:
        return replace(self, free_widths=True) if isinstance(self.chain.core, CurvedPlays) else self

    def quantities(self, z: Vec) -> Mapping[str, float]:
        """Read off the major loop of the core over the command's range."""
        core = self.chain.core.with_values(self.core_values(z)[0].tolist())
        if isinstance(core, MaxwellSlip):
            stiffness, offset, height = _major_loop(Chain(core), self.command)
            return {"stiffness": stiffness, "offset": offset, "friction": -0.5 * height}
        return _loop_quantities(Chain(core), self.command)

    def loop_width(self, z: Vec) -> float:
        core = self.chain.core.with_values(self.core_values(z)[0].tolist())
        return 2 * core.spacing * core.elements if isinstance(core, MaxwellSlip) else super().loop_width(z)


@final
@dataclass(frozen=True, eq=False)
class ScaledBaseline(Baseline):
    """Gain, offset and input scale of a network, through the plays that stand for it.

    z = (g, o, w):  weights' = g weights,  b' = g b + o,  alpha' = w alpha

    Attributes:
        chain: its core a Prandtl-Ishlinskii model fitted to the network's free run.
        command: range of the command [cmd].
    """

    chain: Chain
    command: Range

    def __post_init__(self) -> None:
        span = self.command.upper - self.command.lower
        reach = sum(v for v, p in zip(self.chain.core.values, self.chain.core.parameters, strict=True) if p.name != "b")
        for name, value in (
            ("nominal", [1.0, 0.0, 1.0]),
            ("lower", [0.2, -reach * span, 0.0]),
            ("upper", [5.0, reach * span, 10.0]),
            ("scale", [0.1, 0.05 * reach * span, 0.2]),
        ):
            object.__setattr__(self, name, np.array(value))
        object.__setattr__(self, "effects", {})
        object.__setattr__(self, "width", 2)

    def core_values(self, z: Vec) -> tuple[Vec, Vec]:
        nominal, slope = np.array(self.chain.core.values), np.zeros((len(self.chain.core.values), 3))
        p = nominal.copy()
        for k, parameter in enumerate(self.chain.core.parameters):
            if parameter.unit == "deg/cmd":
                p[k], slope[k, 0] = z[0] * nominal[k], nominal[k]
            elif parameter.name == "b":
                p[k], slope[k, 0], slope[k, 1] = z[0] * nominal[k] + z[1], nominal[k], 1.0
            elif parameter.name == "alpha":
                p[k], slope[k, 2] = z[2] * nominal[k], nominal[k]
        return p, slope

    def quantities(self, z: Vec) -> Mapping[str, float]:
        """Read off the major loop over the command's range."""
        core = self.chain.core.with_values(self.core_values(z)[0].tolist())
        return _loop_quantities(Chain(core), self.command)


def _differences(core: CurvedPlays, size: int) -> Vec:
    """Rows (R, Z) that give the differences of neighbouring slopes of each curve."""
    knots = core.pieces + 1
    rows = [np.eye(size)[k + 1] - np.eye(size)[k] for k in range(len(core.slopes)) if (k + 1) % knots]
    return np.array(rows)


def _loop_quantities(chain: Chain, command: Range) -> Mapping[str, float]:
    """Gain, offset and width of the major loop."""
    gain, offset, height = _major_loop(chain, command)
    return {"gain": gain, "offset": offset, "backlash_width": height / gain if gain else 0.0}


def _major_loop(chain: Chain, command: Range) -> tuple[float, float, float]:
    """Gain and offset of the major loop, run slowly and twice over the range, and how far its way back lies above."""
    up = np.linspace(command.lower, command.upper, _LOOP_SAMPLES)
    u = np.concatenate([up, up[::-1], up, up[::-1]])[:, None]
    staged = StagedChain(chain)
    start = staged.rest(u[0], np.zeros(1))
    theta = staged.simulate(u, _SLOW_S, start)[0][2 * _LOOP_SAMPLES :, 0]
    rise, fall = theta[:_LOOP_SAMPLES], theta[: _LOOP_SAMPLES - 1 : -1]
    quarter = slice(_LOOP_SAMPLES // 4, 3 * _LOOP_SAMPLES // 4)
    gain = float(np.polyfit(up[quarter], 0.5 * (rise + fall)[quarter], 1)[0])
    middle = _LOOP_SAMPLES // 2
    return gain, float(0.5 * (rise + fall)[middle]), float(np.mean((fall - rise)[quarter]))


def baseline_of(chain: Chain, command: Range) -> Baseline:
    """The freedom that retuning has for a chain.

    Args:
        chain: the nominal chain.
        command: range over which it is used [cmd].
    """
    return (BacklashBaseline if isinstance(chain.core, Backlash) else FreeCoreBaseline)(chain, command)
