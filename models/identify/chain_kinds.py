"""Kinds of model that are operators: their starting points and search regions, estimated from the trials.

To add such a kind: write the operator in `models/operators/` and its entry in `CHAIN_KINDS`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import Motion, first_flexure_end, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..decades import Decades
from ..operators.friction import MaxwellSlip
from ..operators.hysteresis import Backlash, BoucWen
from ..operators.operator import Operator
from ..operators.oscillator import Oscillator, StateNetwork
from ..operators.prandtl_ishlinskii import Drdpi, PrandtlIshlinskii
from .runs import fastest_command


def backlash_starts(trials: Sequence[Trial]) -> list[Chain]:
    """Starting points of a backlash: the two regression lines, and lines of their mean slope with other gaps.

    Raises:
        FitError: if the angle does not rise with the command, or a branch is missing.
    """
    loading, unloading = branch(trials, Motion.LOADING), branch(trials, Motion.UNLOADING)
    slope = 0.5 * (loading[0] + unloading[0])
    middle = 0.5 * (loading[1] + unloading[1])
    # Gaps on either side of the lines, small and large for a catheter of tens of degrees.
    widths = [width * Decades.of(trials).angle for width in (0.5, 2.0)]
    return [
        _lines(unloading, loading),
        *(_lines(np.array([slope, middle + width]), np.array([slope, middle - width])) for width in widths),
    ]


def prandtl_ishlinskii_starts(trials: Sequence[Trial], plays: int) -> list[Chain]:
    """Starting points of plays: equal weights, thresholds spread over 10, 30 and 80 % of the command's range.

    Raises:
        FitError: if the angle does not rise with the command, or a branch is missing.
    """
    loading, unloading = branch(trials, Motion.LOADING), branch(trials, Motion.UNLOADING)
    slope, offset = 0.5 * (loading + unloading)
    span = max(float(np.ptp(trial.command)) for trial in trials)
    share = slope / (plays + 1)
    return [
        Chain(PrandtlIshlinskii(share, (share,) * plays, reach * span / plays, 1e-3, offset))
        for reach in (0.1, 0.3, 0.8)
    ]


FRICTION_KINDS = ("maxwell_slip", "maxwell_slip_rate")
"""Kinds that fit an output that need not rise with the command."""


def falls(of_what: str, unit: str) -> FitError:
    """Error of an output that falls with the command `of_what`; an output in deg probably has a wrong sign."""
    text = f"the angle falls with the command {of_what}, expected it to rise; "
    text += "where `hystmpc check` shows no delay and no second clock, turn the sign of one channel"
    if unit == "deg":
        return FitError(text)
    return FitError(f"{text}; an output that may fall, such as a force, {' and '.join(FRICTION_KINDS)} fit")


def branch(trials: Sequence[Trial], motion: Motion, rises: bool = True) -> Vec:
    """Slope [deg/cmd] and offset [deg] of the regression line through one branch after the first flexure.

    Raises:
        FitError: if too few samples move that way, or the angle falls although it has to rise.
    """
    commands, angles = [], []
    for trial in trials:
        labels = segment(trial).labels
        # The first flexure runs below the later loading branch and would tilt the line.
        chosen = (labels == motion) & (np.arange(len(trial)) >= first_flexure_end(trial))
        commands.append(trial.command[chosen])
        angles.append(trial.angle[chosen])
    u, y = np.concatenate(commands), np.concatenate(angles)
    if u.size < 10 or np.ptp(u) == 0:
        raise FitError(f"{u.size} samples of {motion.name.lower()}, expected at least 10 that move")
    slope, offset = np.polyfit(u, y, 1)
    if rises and slope <= 0:
        share = -slope * float(np.ptp(u)) / float(np.ptp(y))
        way = f"while {motion.name.lower()} (by {share:.2g} of its range over that of the command)"
        raise falls(way, trials[0].units.angle)
    return np.array([slope, offset])


def _lines(unloading: Vec, loading: Vec) -> Chain:
    return Chain(Backlash(unloading[0], loading[0], unloading[1] / unloading[0], loading[1] / loading[0]))


_SEGMENTS = 16  # segments of the longest trial for averaged spectra
_SEEN = 1e-3  # least input power for a valid response, as share of the greatest
_SLOWEST, _FASTEST = 4.0, 1.2  # least frequency [cycles in a trial] and greatest [rad per sample]
_LEAST_DAMPED, _MOST_DAMPED = 0.005, 0.7
_RINGING, _LONGEST = 8.0, 0.2  # ringing of a start in time constants, and at most this share of the shortest trial
_HIDDEN, _ORDER = 12, 3
_VISCOUS = 0.25  # viscous share of the width of the peak; the rest is hysteretic
_BENT = 1e-3  # initial share of the neurons in the output


@dataclass(frozen=True)
class Ringing:
    """Resonance of a device.

    Attributes:
        rad_per_s: angular frequency of the greatest response [rad/s].
        damping: ratio to the critical damping, from the width of the peak.
        stiffness: stiffness of a linear oscillator with this peak [cmd/deg].
        command, angle: standard deviations [cmd], [deg].
        lead_s: time in which the ringing of an unknown start fades [s].
    """

    rad_per_s: float
    damping: float
    stiffness: float
    dt_s: float
    command: float
    angle: float
    lead_s: float

    @classmethod
    def of(cls, trials: Sequence[Trial]) -> Ringing:
        """Resonance of trials, from their averaged spectra.

        H(f) = S_uy(f) / S_uu(f) where the command has power; a linear oscillator has its peak 1 / (2 d k) near w, and
        half the power of it at w (1 -+ d).
        """
        from scipy.signal import csd, welch  # half a second to import

        dt = trials[0].dt
        length = max(max(len(trial) for trial in trials) // _SEGMENTS, 16)
        pairs = [(trial.command - trial.command.mean(), trial.angle - trial.angle.mean()) for trial in trials]
        options = {"fs": 1 / dt, "nperseg": length}
        inside = [(u, y) for u, y in pairs if u.size >= length]
        frequency = welch(inside[0][0], **options)[0]
        power = np.sum([welch(u, **options)[1] for u, _ in inside], axis=0)
        cross = np.sum([csd(u, y, **options)[1] for u, y in inside], axis=0)
        w = 2 * math.pi * frequency
        slowest = _SLOWEST * 2 * math.pi / (max(len(trial) for trial in trials) * dt)
        usable = np.flatnonzero((power > _SEEN * power.max()) & (w >= slowest) & (w * dt <= _FASTEST))
        response = np.abs(cross[usable]) / power[usable] if usable.size else np.ones(1)
        peak = int(np.argmax(response))
        at = float(w[usable[peak]]) if usable.size else slowest
        below = np.flatnonzero(response < response[peak] / math.sqrt(2))
        ends = (below[below < peak].max(initial=0), below[below > peak].min(initial=response.size - 1))
        wide = float(np.ptp(w[usable[list(ends)]])) if usable.size else 0.0
        damping = float(np.clip(0.5 * wide / at, _LEAST_DAMPED, _MOST_DAMPED))
        ringing = min(_RINGING / (_VISCOUS * damping * at), _LONGEST * min(trial.duration_s for trial in trials))
        command, angle = (float(np.std(np.concatenate(signals))) for signals in zip(*pairs, strict=True))
        return cls(at, damping, 0.5 / (damping * float(response[peak])), dt, command, angle, ringing)


def oscillator_starts(ringing: Ringing) -> list[Operator]:
    """Starting points: linear oscillators with this peak, part of their stiffness with memory within the range."""
    mass, damping, stiffness = _linear(ringing)
    return [
        Oscillator(mass, damping, (1 - share) * stiffness, share * stiffness, relaxing, -0.5 * relaxing)
        for relaxing in (0.5 / ringing.angle, 1.5 / ringing.angle)
        for share in (0.3, 0.6)
    ]


def _linear(ringing: Ringing) -> tuple[float, float, float]:
    """Mass, damping and stiffness of the linear oscillator with this peak; a quarter of its width is viscous."""
    w, stiffness = ringing.rad_per_s, ringing.stiffness
    return stiffness / w**2, 2 * _VISCOUS * ringing.damping * stiffness / w, stiffness


def oscillator_box(ringing: Ringing) -> dict[str, tuple[float, float]]:
    """Search region: half to twice the linear oscillator, with any share of memory."""
    mass, stiffness = ringing.stiffness / ringing.rad_per_s**2, ringing.stiffness
    return {
        "mass": (0.5 * mass, 2 * mass),
        "damping": (
            0.1 * ringing.damping * stiffness / ringing.rad_per_s,
            4 * ringing.damping * stiffness / ringing.rad_per_s,
        ),
        "stiffness": (0.2 * stiffness, 1.2 * stiffness),
        "alpha": (0.0, 0.8 * stiffness),
        "gamma": (0.0, 10 / ringing.angle),
        "delta": (-5 / ringing.angle, 5 / ringing.angle),
    }


def state_network_starts(ringing: Ringing, hidden: int = _HIDDEN) -> list[Operator]:
    """Starting point: the rotating pair of the resonance, slower states, and small random neurons."""
    rng, n = np.random.default_rng(0), _ORDER
    left = math.exp(-ringing.damping * ringing.rad_per_s * ringing.dt_s)
    turn = ringing.rad_per_s * ringing.dt_s * math.sqrt(1 - ringing.damping**2)
    a = 0.9 * np.eye(n)
    a[:2, :2] = left * np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    a[2, 1], a[:2, 2] = 0.1, -0.02
    b = np.zeros((n, 2))
    b[1, 0] = turn / ringing.stiffness  # w^2 u / k, summed over a sample, of the second state, y' / w
    w = rng.normal(0.0, _BENT * ringing.angle, (n, hidden))
    vx, vu = rng.normal(0.0, 0.7 / ringing.angle, (hidden, n)), rng.normal(0.0, 0.7 / ringing.command, (hidden, 2))
    c = rng.normal(0.0, 0.7, hidden)
    values = np.concatenate([matrix.ravel() for matrix in (a, b, w, vx, vu, c)])
    return [StateNetwork.template(order=n, hidden=hidden).with_values(values.tolist())]


def state_network_box(ringing: Ringing) -> dict[str, tuple[float, float]]:
    """Search region: any stable system, with neurons over the whole range of the signals."""
    gain = 1 / ringing.stiffness
    return {
        "a": (-0.3, 0.3),
        "b": (-gain, gain),
        "w": (-ringing.angle, ringing.angle),
        "vx": (-1 / ringing.angle, 1 / ringing.angle),
        "vu": (-1 / ringing.command, 1 / ringing.command),
        "c": (-1.0, 1.0),
    }


Ends = Mapping[str, tuple[float, float]]


_BANDS = 2  # dead zones of a `drdpi` on either side of the middle
# Where the middle piece of a `drdpi` may begin, as share of the angles: a fit does not bring a piece to the other side.
_MIDDLES = (0.5, 0.35, 0.65)
_STEEPNESS_S = 0.04  # see `BoucWen`, times the range of the command, as in the code of S2
# Change of the reference that an `inverse_backlash` takes for noise [deg], as in the code of S2; in working units, so
# that it is as much of the range of any other device.
_DEAD_ZONE = 0.027


@dataclass(frozen=True)
class Extent:
    """Ranges and mean branches of the trials of a device, from command to angle.

    Attributes:
        slope, offset: of the mean line through loading and unloading branch [deg/cmd], [deg].
        lag: half the distance between the branches, below zero where the angle leads the command [deg].
        span: range of the command [cmd].
        speed: greatest speed of the command [cmd/s].
        low, high: least and greatest angle [deg].
        ringing: the resonance, for kinds that have one.
    """

    slope: float
    offset: float
    lag: float
    span: float
    speed: float
    low: float
    high: float
    ringing: Ringing | None = None

    @classmethod
    def of(cls, trials: Sequence[Trial], kind: ChainKind) -> Extent:
        """Extent of trials, without slope and lag for a kind with a resonance, where no branch rises.

        Raises:
            FitError: if the angle falls with the command where it has to rise, or a branch is missing.
        """
        span = max(float(np.ptp(t.command)) for t in trials)
        low, high = min(float(t.angle.min()) for t in trials), max(float(t.angle.max()) for t in trials)
        ranges = span, fastest_command(trials), low, high
        if kind.rings:
            return cls((high - low) / span, 0.5 * (low + high), 0.0, *ranges, Ringing.of(trials))
        rises = kind.rises or trials[0].units.angle == "deg"
        loading, unloading = (branch(trials, motion, rises) for motion in (Motion.LOADING, Motion.UNLOADING))
        slope, offset = 0.5 * (loading + unloading)
        middle = 0.5 * (max(t.command.max() for t in trials) + min(t.command.min() for t in trials))
        lag = 0.5 * float(np.polyval(unloading - loading, middle))
        return cls(float(slope), float(offset), lag, *ranges)

    @property
    def resonance(self) -> Ringing:
        """Resonance of the device, for kinds that have one.

        Raises:
            FitError: of another kind.
        """
        if self.ringing is None:
            raise FitError("no resonance was looked for, expected a kind that rings")
        return self.ringing


@dataclass(frozen=True)
class ChainKind:
    """Kind of operator model: its name, starting points and search regions.

    Attributes:
        starts: forward operators to start from, as a function of trials, extent and number of plays.
        box: ends of the global search by parameter; numbered parameters go by their stem.
        first: ends of its initial region; without an entry as `box`.
        fixed: parameters that are set.
        inverse: makes the inverse operator of a forward one; None where there is no inverse map.
        inverse_fixed: parameters of the inverse operator that are set.
        plays: number of plays where the request leaves it open.
        rises: whether the angle has to rise with the command, whatever its unit.
        rings: whether it has a resonance, which then gives the starts; a log may start in motion.
        restarts: of a least-squares fit; None for its default.
    """

    name: str
    title: str
    starts: Callable[[Sequence[Trial], Extent, int], list[Operator]]
    box: Callable[[Extent, int], Ends]
    first: Callable[[Extent, int], Ends] = lambda e, plays: {}
    fixed: tuple[str, ...] = ()
    inverse: Callable[[Operator], Operator] | None = None
    inverse_fixed: tuple[str, ...] = ()
    plays: int = 4
    rises: bool = True
    rings: bool = False
    restarts: int | None = None


def _cores(chains: Sequence[Chain]) -> list[Operator]:
    return [chain.core for chain in chains]


def _drdpi_starts(trials: Sequence[Trial], e: Extent, plays: int) -> list[Operator]:
    """Plays of each start of a `pi`, with dead zones over the angle that are the identity, about three middles."""
    n, starts = _BANDS, list[Operator]()
    for share, chain in itertools.product(_MIDDLES, prandtl_ishlinskii_starts(trials, plays)):
        (*weights, b), below = chain.core.values, share * (e.high - e.low)
        above, middle = e.high - e.low - below, e.low + below
        gaps = [*[below / (n + 1)] * n, *[above / (n + 1)] * n]
        values = [*weights, b - middle, *[1.0] * (2 * n), *gaps, middle]
        starts.append(Drdpi.template(plays=plays, below=n, above=n).with_values(values))
    return starts


def _bouc_wen_starts(trials: Sequence[Trial], e: Extent, plays: int) -> list[Operator]:
    """Mean line with the branches' distance, reached within 10, 30 and 80 % of the command's range."""
    del trials, plays
    steepness, lag = _STEEPNESS_S / e.span, max(e.lag, 0.0)
    return [
        BoucWen(-lag / (reach * e.span), 0.0, 1 / (reach * e.span), e.slope, e.slope, steepness, e.offset)
        for reach in (0.1, 0.3, 0.8)
    ]


_REACHES = (0.03, 0.1, 0.3)  # travel over which a friction force changes sign, as share of the range


def maxwell_slip_starts(
    elements: int, slope: float, offset: float, height: float, span: float, speed: float = 0.0
) -> list[MaxwellSlip]:
    """Starting points of a friction force: sliders of one stiffness that slip within 3, 10 and 30 % of the range.

    Args:
        slope, offset: of the mean line [deg/cmd], [deg].
        height: of friction, half the distance of the branches [deg].
        span: range of the displacement [cmd].
        speed: greatest of the displacement [cmd/s]; 0 for friction that does not depend on it.
    """
    speeds = (0.0, 0.1, 0.1 * speed) if speed else ()

    def start(reach: float) -> MaxwellSlip:
        spacing = reach * span / elements
        stiffness = height / (0.5 * elements * (elements + 1) * spacing)
        return MaxwellSlip(slope, (stiffness,) * elements, spacing, 0.0, offset, speeds)

    return [start(reach) for reach in _REACHES]


_LEAST_HEIGHT = 0.02  # least initial friction, as share of the output's range


def _friction_starts(e: Extent, plays: int, speed: float = 0.0) -> list[Operator]:
    height = max(-e.lag, _LEAST_HEIGHT * (e.high - e.low))
    return [*maxwell_slip_starts(plays, e.slope, e.offset, height, e.span, speed)]


def _friction_box(e: Extent, plays: int) -> Ends:
    """Search region: sliders that all slip within half the range; the ends of `k` also apply to k0."""
    height = e.high - e.low
    return {
        "k": (0.0, 20 * height / e.span),
        "k0": (e.slope - 2 * height / e.span, e.slope + 2 * height / e.span),
        "spacing": (0.0, 0.5 * e.span / plays),
        "growth": (-0.5 / e.span, 0.5 / e.span),
        "b": (e.offset - height, e.offset + height),
        "viscous": (0.0, height / e.speed),
        "stribeck": (0.0, 2.0),
        "stribeck_speed": (1e-3 * e.speed, e.speed),
    }


def _backlash_box(e: Extent, plays: int) -> Ends:
    del plays
    middle = e.offset / e.slope
    m, c = (0.5 * e.slope, 2.0 * e.slope), (middle - e.span, middle + e.span)
    return {"m_lo": m, "m_up": m, "c_lo": c, "c_up": c}


def _plays_box(e: Extent, plays: int) -> Ends:
    """Search region: plays up to half the range, widened by speed by at most a quarter of it."""
    return {
        "a": (0.0, 1.5 * e.slope),
        "alpha": (0.0, 0.5 * e.span / plays),
        "beta": (0.0, 0.25 * e.span / e.speed),
        "b": (e.offset - (e.high - e.low), e.offset + (e.high - e.low)),
    }


def _plays_first(e: Extent, plays: int) -> Ends:
    """First region: weights whose sum is once to twice the slope; a search does not return from far steeper ones."""
    return {"a": (0.0, 4.0 * e.slope / (plays + 1))}


def _drdpi_box(e: Extent, plays: int) -> Ends:
    """Search region: plays at most twice as steep, since dead zones may flatten them."""
    height, middle = e.high - e.low, 0.5 * (e.low + e.high)
    sides = {f"slope_{side}_": (0.0, 3.0) for side in ("below", "above")}
    gaps = {f"gap_{side}_": (0.0, height / _BANDS) for side in ("below", "above")}
    return {
        **_plays_box(e, plays),
        "a": (0.0, 2.0 * e.slope),
        "b": (e.offset - middle - 2 * height, e.offset - middle + 2 * height),
        **sides,
        **gaps,
        "offset": (e.low, e.high),
    }


def _drdpi_first(e: Extent, plays: int) -> Ends:
    """First region: the middle piece of the curve near the middle of the angle, and no other piece much steeper."""
    height, middle = e.high - e.low, 0.5 * (e.low + e.high)
    return {
        **_plays_first(e, plays),
        "b": (e.offset - middle - 0.5 * height, e.offset - middle + 0.5 * height),
        **{f"slope_{side}_": (0.0, 1.5) for side in ("below", "above")},
        "offset": (middle - 0.25 * height, middle + 0.25 * height),
    }


def _bouc_wen_box(e: Extent, plays: int) -> Ends:
    del plays
    height = e.high - e.low
    return {
        "a": (-5 * e.slope, e.slope),
        "v": (0.5 / e.span, 50 / e.span),
        "alpha_": (0.0, 2 * e.slope),
        "b": (e.offset - height, e.offset + height),
    }


def _inverse_backlash(operator: Operator) -> Operator:
    return Backlash(*operator.values).inverse(_DEAD_ZONE)


def _inverse_plays(operator: Operator) -> Operator:
    if not isinstance(operator, PrandtlIshlinskii | Drdpi):
        raise FitError(f"{operator.name} has no inverse plays, expected a pi or a drdpi")
    return operator.inverse()


CHAIN_KINDS: Mapping[str, ChainKind] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            ChainKind(
                "backlash",
                "backlash",
                lambda trials, e, plays: _cores(backlash_starts(trials)),
                _backlash_box,
                inverse=_inverse_backlash,
                inverse_fixed=("dead_zone",),
            ),
            ChainKind(
                "pi",
                "PI",
                lambda trials, e, plays: _cores(prandtl_ishlinskii_starts(trials, plays)),
                _plays_box,
                _plays_first,
                inverse=_inverse_plays,
            ),
            ChainKind(
                "drdpi",
                "DRDPI",
                _drdpi_starts,
                _drdpi_box,
                _drdpi_first,
                inverse=_inverse_plays,
                plays=10,  # as in S1
            ),
            ChainKind("bouc_wen", "Bouc-Wen", _bouc_wen_starts, _bouc_wen_box, fixed=("delta", "steepness")),
            ChainKind(
                "maxwell_slip",
                "Maxwell slip",
                lambda trials, e, plays: _friction_starts(e, plays),
                _friction_box,
                rises=False,
            ),
            ChainKind(
                "maxwell_slip_rate",
                "Maxwell slip, by speed",
                lambda trials, e, plays: _friction_starts(e, plays, e.speed),
                _friction_box,
                rises=False,
            ),
            ChainKind(
                "oscillator",
                "oscillator",
                lambda trials, e, plays: oscillator_starts(e.resonance),
                lambda e, plays: oscillator_box(e.resonance),
                rings=True,
                restarts=1,
            ),
            ChainKind(
                "state_network",
                "state network",
                lambda trials, e, plays: state_network_starts(e.resonance),
                lambda e, plays: state_network_box(e.resonance),
                rings=True,
                restarts=0,
            ),
        )
    }
)
"""The kinds of model that are operators; `models.kinds`, the command line and the tests read this list."""
