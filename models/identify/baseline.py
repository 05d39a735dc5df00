"""Retuning of a nominal simulator: free parameters for its gain, offset, widths and weights."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from ..chain import Chain
from ..contract.metadata import Range
from ..operators.friction import MaxwellSlip
from ..operators.hysteresis import Backlash, CurvedPlays
from ..operators.operator import Operator
from ..operators.prandtl_ishlinskii import PrandtlIshlinskii
from ..operators.static_curves import Line, NonlinearGain
from .free_run import StagedChain

# Parameters of cores that are effects by another name: retuning leaves them at their nominal values.
_EFFECTS_BY_ANOTHER_NAME = {"beta": "rate_dependence"}
_OF_PLAYS_TOO = {"stribeck": "stick_slip", "stribeck_speed": "stick_slip", "one_way": "asymmetry"}
_STRIBECK = (1.0, 4.0)  # first tried, since at none the speed makes no difference; greatest
_ONE_WAY = (0.5, -0.3)  # first tried: a fit that begins at none stays there, where retuning has widened the loop
_STRIBECK_SPEED = (0.01, 0.2, 10.0)  # spans a second: least, first tried and greatest speed at which friction falls
_OF_PLAYS = (PrandtlIshlinskii, CurvedPlays)
_LINEAR_IN_WEIGHTS = (Line, *_OF_PLAYS)
_CURVES = {"quadratic": (1, 0.05), "cubic": (2, 0.1)}  # power of the span, usual change
# In usual changes: of friction and stiffness up to 2.3 on drawn devices, of a further nonlinear gain 4 or more.
_MOST_CURVED = 3.0
_LOOP_SAMPLES = 200
_ROUGHNESS = 0.05  # share of the range over which a difference of slopes counts: 70 samples of 0.3 % of the angle
_LEVEL = 0.03  # the same for the slope itself
_FRICTION = (0.2, 5.0)  # least and greatest factor of the friction of a retuned device
_SLOW_S = 1.0  # sample time of that loop: slow enough for rate-dependent widths to vanish


class Baseline(ABC):
    """Free parameters of a chain in retuning: unknowns z (Z,) with their nominal values and bounds.

    Attributes:
        command: range of the command [cmd].
        nominal, lower, upper, scale: nominal values, bounds and typical changes of z (Z,).
        effects: positions in z that retuning keeps fixed, because they are effects: {effect: {name: position}}.
        begin: values of effects at which their fits begin, one tuple a fit, where these are not those of the simulator.
        held: positions in z of values that are chosen and never fitted.
        width: position in z of the width of the loop, -1 for none.
        linear: of which unknowns the angle is a linear function while the others stay (Z,).
        roughness: rows (R, Z) [deg per unit of z] whose products with z count as errors of single samples: they
            regularise parameters with few samples (Eilers, Marx, Flexible smoothing with B-splines and penalties,
            Statistical Science 11, 1996, with differences of first order).
    """

    effects: Mapping[str, Mapping[str, int]] = MappingProxyType({})
    begin: Mapping[str, tuple[tuple[float, ...], ...]] = MappingProxyType({})
    held: tuple[int, ...] = ()
    width: int = -1
    roughness: Vec = np.empty((0, 0))

    def __init__(
        self, chain: Chain, command: Range, nominal: Sequence[float], ends: tuple[Vec, Vec], scale: Sequence[float]
    ) -> None:
        self.chain, self.command = chain, command
        self.nominal, (self.lower, self.upper), self.scale = np.array(nominal), ends, np.array(scale)
        self.linear = np.zeros(self.nominal.size, dtype=bool)

    @abstractmethod
    def core_values(self, z: Vec) -> tuple[Vec, Vec]:
        """Parameters (P,) of the core and their derivative by z (P, Z)."""

    def chain_values(self, z: Vec) -> tuple[Vec, Vec]:
        """Parameters (P,) of the whole chain and their derivative by z (P, Z)."""
        core, by_z = self.core_values(z)
        p, first = self.chain.values, sum(len(operator.parameters) for operator in self.chain.before)
        slope = np.zeros((p.size, z.size))
        p[first : first + core.size], slope[first : first + core.size] = core, by_z
        return p, slope

    def quantities(self, z: Vec) -> Mapping[str, float]:
        """Quantities `gain` [deg/cmd], `offset` [deg at the middle of the command's range], `backlash_width` [cmd].

        Of a friction force, which leads its displacement: `stiffness` [deg/cmd] and `friction` [deg, half the height of
        the loop] instead of gain and width. They are measured on the major loop.
        """
        gain, offset, height = _major_loop(Chain(self._core(z)), self.command)
        return {"gain": gain, "offset": offset, "backlash_width": height / gain if gain else 0.0}

    def loop_height(self, z: Vec) -> float:
        """Height of the loop [deg]."""
        quantities = self.quantities(z)
        if "friction" in quantities:
            return 2 * quantities["friction"]
        return quantities["gain"] * quantities["backlash_width"]

    def loop_width(self, z: Vec) -> float:
        """Travel after a reversal over which the loop changes its branch [cmd]."""
        return self.quantities(z)["backlash_width"]

    def freed(self) -> Baseline:
        """Baseline with free widths of its plays, which retuning usually keeps fixed."""
        return self

    def _core(self, z: Vec) -> Operator:
        return self.chain.core.with_values(self.core_values(z)[0].tolist())


@final
class BacklashBaseline(Baseline):
    """Backlash whose gain, shift and width are retuned; the ratio of its slopes is an asymmetry.

    z = (g, s, w, a):  m_lo' = g m_lo sqrt(a),  m_up' = g m_up / sqrt(a),  c_lo' = c_lo + s + w / 2,
                       c_up' = c_up + s - w / 2
    """

    effects = MappingProxyType({"asymmetry": {"slope_ratio": 3}})
    width = 2

    def __init__(self, chain: Chain, command: Range) -> None:
        span, nominal = command.upper - command.lower, [1.0, 0.0, 0.0, 1.0]
        self.chain, self.command = chain, command
        width = self.quantities(np.array(nominal))["backlash_width"]
        lower, upper = [0.2, -span, -max(width, 0.0), 0.3], [5.0, span, span, 3.0]
        ends = np.array(lower), np.array(upper)
        super().__init__(chain, command, nominal, ends, [0.1, 0.05 * span, 0.05 * span, 0.1])

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
class FreeCoreBaseline(Baseline):
    """Core with all parameters free, except those that are effects; of curved plays slopes and offset.

    Args:
        command: range of the command [cmd].
        free_widths: whether the half-widths of curved plays are free, too.
        one_friction: whether the half-widths of curved plays are free in proportion, as one factor of the friction.
        anew: whether curved plays that the trials do not show are taken for absent; else they stay as they are given.
    """

    def __init__(
        self, chain: Chain, command: Range, free_widths: bool = False, one_friction: bool = False, anew: bool = False
    ) -> None:
        core, values, parameters = chain.core, np.array(chain.core.values), chain.core.parameters
        span = command.upper - command.lower
        slopes = [abs(v) for v, p in zip(values, parameters, strict=True) if p.unit == "deg/cmd"]
        gain = max(sum(slopes) / (core.pieces + 1 if isinstance(core, CurvedPlays) else 1), 1e-6)
        typical = {"cmd": 0.05 * span, "deg/cmd": 0.1 * gain, "deg": 0.05 * gain * span, "s": 0.02}
        little = {"1/cmd": 0.1 / span, "1": 0.3}
        scale = [
            typical[p.unit] if p.unit in typical else max(0.1 * abs(v), little.get(p.unit, 1e-3) if v == 0 else 1e-3)
            for v, p in zip(values, parameters, strict=True)
        ]
        ends = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])
        self._ratios = np.eye(values.size)  # of the parameters to the unknowns
        super().__init__(chain, command, values.tolist(), ends, scale)
        if isinstance(core, _LINEAR_IN_WEIGHTS):
            self.linear = np.array([p.unit in ("deg/cmd", "deg") for p in parameters])
        names = [p.name for p in parameters]
        effects = _EFFECTS_BY_ANOTHER_NAME | (_OF_PLAYS_TOO if isinstance(core, _OF_PLAYS) else {})
        self.effects = {
            effect: {n: k for k, n in enumerate(names) if effects.get(n) == effect}
            for effect in dict.fromkeys(effects[n] for n in names if n in effects)
        }
        if "stick_slip" in self.effects:
            share, speed = self.effects["stick_slip"].values()
            self.begin = {
                "stick_slip": ((_STRIBECK[0], float(values[speed])),),
                "asymmetry": tuple((first,) for first in _ONE_WAY),
            }
            self.upper[share] = _STRIBECK[1]
            self.lower[speed], self.upper[speed] = _STRIBECK_SPEED[0] * span, _STRIBECK_SPEED[2] * span
        self.width = names.index("alpha") if "alpha" in names else -1
        if isinstance(core, CurvedPlays):
            first = len(slopes) + 1
            stop = values.size - len(core.speeds)
            held = set(range(first if not free_widths else first + core.plays, stop))
            if one_friction and core.plays and core.radii[0] > 0:
                held.discard(first)
                self.lower[first], self.upper[first] = (factor * core.radii[0] for factor in _FRICTION)
                self._ratios[first : first + core.plays] = 0.0
                self._ratios[first : first + core.plays, first] = np.array(core.radii) / core.radii[0]
            self.held = tuple(sorted(held))
            self.roughness = _ROUGHNESS * span * _differences(core, values.size)
            if anew:
                of_plays = np.eye(values.size)[core.pieces + 1 : len(slopes)]
                self.roughness = np.vstack([self.roughness, _LEVEL * span * of_plays])

    def core_values(self, z: Vec) -> tuple[Vec, Vec]:
        return self._ratios @ np.clip(z, self.lower, self.upper), self._ratios.copy()

    def freed(self) -> Baseline:
        curved = isinstance(self.chain.core, CurvedPlays)
        return FreeCoreBaseline(self.chain, self.command, free_widths=True) if curved else self

    def quantities(self, z: Vec) -> Mapping[str, float]:
        if not isinstance(core := self._core(z), MaxwellSlip):
            return super().quantities(z)
        stiffness, offset, height = _major_loop(Chain(core), self.command)
        return {"stiffness": stiffness, "offset": offset, "friction": -0.5 * height}

    def loop_width(self, z: Vec) -> float:
        core = self._core(z)
        return 2 * core.spacing * core.elements if isinstance(core, MaxwellSlip) else super().loop_width(z)


@final
class ScaledBaseline(Baseline):
    """Network with free gain, offset and input scale, represented by Prandtl-Ishlinskii plays.

    z = (g, o, w):  weights' = g weights,  b' = g b + o,  alpha' = w alpha
    """

    width = 2

    def __init__(self, chain: Chain, command: Range) -> None:
        span = command.upper - command.lower
        reach = sum(v for v, p in zip(chain.core.values, chain.core.parameters, strict=True) if p.name != "b")
        ends = np.array([0.2, -reach * span, 0.0]), np.array([5.0, reach * span, 10.0])
        super().__init__(chain, command, [1.0, 0.0, 1.0], ends, [0.1, 0.05 * reach * span, 0.2])

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


@final
class CurvedBaseline(Baseline):
    """Baseline whose static curves before and behind the core are retuned with it.

    Where friction or stiffness of a device has changed, the core's angles and travels have, and with them the curves:
    a curve that stays as it was looks like a further nonlinear gain. Lags and creeps of the simulator are not retuned,
    since they would hide these effects.

    Args:
        inner: baseline of the core.
        curves: positions of the curves' parameters in the chain, with lower and upper end and typical change of each.
    """

    def __init__(self, inner: Baseline, curves: Mapping[int, tuple[float, float, float]]) -> None:
        self._inner, self._curves, self._places = inner, curves, list(curves)
        least, most, scale = (np.array(ends) for ends in zip(*curves.values(), strict=True))
        values = inner.chain.values[self._places]
        ends = np.concatenate([inner.lower, least]), np.concatenate([inner.upper, most])
        whole = [*inner.nominal, *values], ends, [*inner.scale, *scale]
        super().__init__(inner.chain, inner.command, *whole)
        self.effects, self.begin, self.held, self.width = inner.effects, inner.begin, inner.held, inner.width
        self.linear[: inner.nominal.size] = inner.linear
        if len(inner.roughness):
            self.roughness = np.hstack([inner.roughness, np.zeros((len(inner.roughness), values.size))])

    def core_values(self, z: Vec) -> tuple[Vec, Vec]:
        core, by_z = self._inner.core_values(self._of_core(z))
        return core, np.hstack([by_z, np.zeros((core.size, len(self._places)))])

    def chain_values(self, z: Vec) -> tuple[Vec, Vec]:
        p, slope = super().chain_values(z)
        size = self._inner.nominal.size
        p[self._places], slope[self._places, range(size, z.size)] = z[size:], 1.0
        return p, slope

    def quantities(self, z: Vec) -> Mapping[str, float]:
        return self._inner.quantities(self._of_core(z))

    def loop_width(self, z: Vec) -> float:
        return self._inner.loop_width(self._of_core(z))

    def freed(self) -> Baseline:
        freed = self._inner.freed()
        return self if freed is self._inner else CurvedBaseline(freed, self._curves)

    def _of_core(self, z: Vec) -> Vec:
        return z[: self._inner.nominal.size]


def _differences(core: CurvedPlays, size: int) -> Vec:
    """Rows (R, Z) for the differences of neighbouring slopes of each curve."""
    knots = core.pieces + 1
    rows = [np.eye(size)[k + 1] - np.eye(size)[k] for k in range(len(core.slopes)) if (k + 1) % knots]
    return np.array(rows)


def _major_loop(chain: Chain, command: Range) -> tuple[float, float, float]:
    """Gain, offset and height of the major loop, in the second of two slow runs over the range."""
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
    """Free parameters for retuning a nominal chain over a range of commands [cmd]."""
    core: Baseline
    if isinstance(chain.core, Backlash):
        core = BacklashBaseline(chain, command)
    else:
        core = FreeCoreBaseline(chain, command, one_friction=True)
    curves = _curves(core)
    return CurvedBaseline(core, curves) if curves else core


def with_play_friction(chain: Chain, command: Range) -> Chain:
    """Same chain, whose plays can have another friction at rest or one way: effects, which retuning leaves at none."""
    if not isinstance(chain.core, _OF_PLAYS) or chain.core.rate:
        return chain
    speed = _STRIBECK_SPEED[1] * (command.upper - command.lower)
    return replace(chain, core=replace(chain.core, speeds=(0.0, speed, 0.0)))


def without_idle_friction(chain: Chain) -> Chain:
    """Same chain without another friction at rest or one way where that is none."""
    idle = isinstance(chain.core, _OF_PLAYS) and chain.core.speeds[::2] == (0.0, 0.0)
    return replace(chain, core=replace(chain.core, speeds=())) if idle else chain  # type: ignore[type-var]


def _curves(core: Baseline) -> dict[int, tuple[float, float, float]]:
    """Places of the curves' parameters in the chain, with their ends and typical changes."""
    span, at, made = core.command.upper - core.command.lower, 0, dict[int, tuple[float, float, float]]()
    angle_span = max(abs(core.quantities(core.nominal).get("gain", 1.0)) * span, 1e-9)
    for k, operator in enumerate(core.chain.operators):
        wide = span if k < len(core.chain.before) else angle_span
        for place, parameter in enumerate(operator.parameters, start=at):
            if isinstance(operator, NonlinearGain) and parameter.name in _CURVES:
                power, usual = _CURVES[parameter.name]
                usual, given = usual / wide**power, operator.values[place - at]
                made[place] = (given - _MOST_CURVED * usual, given + _MOST_CURVED * usual, usual)
        at += len(operator.parameters)
    return made
