"""Possible parts of a device, each with the forms between which `fit auto` chooses."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec, lagged

from ..chain import Chain
from ..effects.catalogue import EFFECTS
from ..effects.effect import Candidate, Freedom, Scale
from ..operators.dynamics import Delay, Lag, RateLimit, Servo
from ..operators.hysteresis import Backlash, CurvedPlays
from ..operators.operator import Operator
from ..operators.prandtl_ishlinskii import PrandtlIshlinskii
from ..operators.slow_changes import Creep
from ..operators.static_curves import Line
from ..scheduled import Dependence, MeasuredInput
from .chain_kinds import falls, maxwell_slip_starts
from .runs import Run

Ends = tuple[float, float]
NO_RANGES: Mapping[str, Ends] = MappingProxyType({})

Form = tuple[Candidate, ...]
"""One alternative of a part: effects that are added together; empty for a device without that part."""

_FIRST = 5  # order of effects on the command before delay and lag
WHOLE = "whole samples"
"""Variant of a delay that is not fitted."""
_OFF = 0.3
_USUAL_S = 0.4  # longest usual delay
_USUAL, _STORE = 0.6, 20  # share of the longest usual delay that is still usual; samples of one store
_DAMPING = (0.06, 0.98)
_REACHES = (0.3, 0.1, 0.8)  # widest play at the starts, as share of the command's range
_QUICKEST_S = 0.1  # least relaxation time of the quick of two terms; a quicker one is a lag
_BENT = "pi, 6 plays"  # core that is combined with a curve
_SLACK = "slack/rounded"  # also before gradual plays: the bladder of a muscle has to meet its braid first
_CURVES = ("nonlinear_gain/output", "asymmetry/output", "asymmetry/directional", _SLACK, "contact/output")
_OF_CORE, _OF_DRIVE = ("friction", "gain", "offset"), ("time",)  # groups of parameters that may depend on an input
_VARIES, _BETWEEN = 0.02, 0.1  # least range of an input by its size; least share of its samples in the middle half
_PLAYS, _FEW, _MANY = 5, 4, 8  # number of curved plays, and of pieces in their curves
_RADII = (0.02, 0.45)  # narrowest and widest play, as shares of the command's range


@dataclass(frozen=True)
class Part:
    """Part of a device with its possible forms."""

    name: str
    forms: tuple[Form, ...]


def device_parts(scale: Scale, late_s: float = 0.0) -> tuple[Part, ...]:
    """Drive, creep and curve of the command, with bounds and starts from the list of effects.

    A drive holds each command over its sample. For an input that is linear between samples, half a sample of delay is
    missing; therefore every lag is combined with a delay. The curve, of a valve or an amplifier, is before the drive:
    behind a slow lag a core cannot represent it, and it would be identified as hysteresis. Plays whose width grows with
    speed are excluded: in motion they resemble a delay, and in holds they are wrong.

    Bounds follow from the trials: a delay that the shortest trial can show, a lag or creep that the longest can, a top
    speed that the command exceeds. A servo may oscillate for long.

    Args:
        late_s: approximate delay of the device, see `dead_time`; where long, the search for a delay is around it [s].
    """
    known = _forms_of(scale, "delay", "lag", "creep", "nonlinear_gain")
    delay = _as_late(known["delay/command"], late_s, scale)
    one = replace(known["lag/command"], variant="one pole", operators=(Lag(0.1),))
    one = replace(one, free=(_as_slow(one.free[0], scale),))
    two = replace(one, variant="two poles", operators=(Lag(0.1), Lag(0.1)))
    slow = replace(one, starts=(*one.starts, (2.0,)))
    servo = replace(known["lag/servo"], operators=(Servo(0.1, 0.7, 0),), starts=((2.0 * scale.dt_s, 0.75), (0.2, 0.75)))
    servo = replace(servo, free=(_as_slow(servo.free[0], scale), Freedom("damping", *_DAMPING, 0.1)))
    ways = replace(known["lag/two ways"], operators=(Lag(0.1, (0.1,)),), starts=((0.3, 0.3), (2.0, 2.0)))
    ways = replace(ways, free=tuple(_as_slow(way, scale) for way in ways.free))
    lags: tuple[Form, ...] = ((slow,), (two,), (servo,), (ways,))
    drives = ((), delay, (_top_speed(scale),), *lags, *((*_short(delay), *lag) for lag in lags))
    creeps = ((), *((form,) for form in _creeps(known["creep/command"], scale)))
    valve = replace(known["nonlinear_gain/command"], variant="before the drive", order=_FIRST)
    return Part("drive", drives), Part("creep", creeps), Part("valve", ((), (valve,)))


def input_parts(trials: Sequence[Trial], scale: Scale, ranges: Mapping[str, Ends] = NO_RANGES) -> tuple[Part, ...]:
    """For each measured input that varies, its effects on the core, and that on the time constants of the drive.

    A dependence is affine, or bent at the reference where the trials show values in the middle half of the range. The
    reference is the median of the samples where that is one, else the middle of the range.

    Args:
        ranges: of inputs over which a dependence is to hold; that of the trials where left out or narrower.
    """
    parts: list[Part] = []
    command, angle = (np.concatenate([getattr(t, name) for t in trials]) for name in ("command", "angle"))
    for name in trials[0].inputs:
        values = np.concatenate([trial.inputs[name] for trial in trials])
        if not varies(values):
            continue
        low, high, middle = float(values.min()), float(values.max()), float(np.median(values))
        quarter = 0.25 * (high - low)
        middle = middle if low + quarter < middle < high - quarter else 0.5 * (low + high)
        ends = ranges.get(name, (low, high))
        given = MeasuredInput(name, middle, min(low, ends[0]), max(high, ends[1]))
        columns = np.column_stack([values, command, np.ones(values.size)])
        rise = float(np.linalg.lstsq(columns, angle, rcond=None)[0][0])
        between = float(np.mean((values > low + quarter) & (values < high - quarter)))
        ways = (False, True) if between > _BETWEEN else (False,)
        for part, groups in ((name, _OF_CORE), (f"{name}, drive", _OF_DRIVE)):
            sets = [s for k in range(1, len(groups) + 1) for s in itertools.combinations(groups, k)]
            made = {(g, b): _dependence(Dependence(given, g, b), scale, rise) for g in groups for b in ways}
            forms = [tuple(made[group, bent] for group in s) for bent in ways for s in sets]
            parts.append(Part(part, ((), *forms)))
    return tuple(parts)


def varies(values: Vec) -> bool:
    """Whether a measured input varies enough for a dependence on it."""
    return float(np.ptp(values)) > _VARIES * float(np.max(np.abs(values)))


def _dependence(depends: Dependence, scale: Scale, rise: float) -> Candidate:
    """Candidate that starts from none; an offset from the rise of the output with the input."""
    given = depends.input
    usual = (0.05 * scale.angle_span if depends.group == "offset" else 0.2) / (given.upper - given.lower)
    pairs = zip(depends.names, depends.bounds, strict=True)
    free = tuple(Freedom(name, low, high, usual) for name, (low, high) in pairs)
    start = (rise if depends.group == "offset" else 0.0,) * len(free)
    way = "bent" if depends.bent else "affine"
    return Candidate(f"{depends.group}_by_{given.name}", way, "command", 0, (), free, (start,), depends=depends)


def _forms_of(scale: Scale, *effects: str) -> Mapping[str, Candidate]:
    return {c.label: c for effect in effects for c in EFFECTS[effect].forms(scale)}


def _as_slow(tau: Freedom, scale: Scale) -> Freedom:
    return replace(tau, upper=max(tau.upper, 0.5 * scale.duration_s))


def _as_late(delay: Candidate, late_s: float, scale: Scale) -> Form:
    """Delay near that of the device, where that is longer than usual; else one of up to a usual delay."""
    if late_s > _USUAL * _USUAL_S:
        return split_delay(delay, late_s, _USUAL_S, scale.dt_s)
    free = (replace(delay.free[0], upper=_USUAL_S),)
    return (replace(delay, operators=(Delay.at_rate(_USUAL_S, scale.dt_s),), free=free),)


def split_delay(delay: Candidate, about_s: float, reach_s: float, dt_s: float) -> Form:
    """Delay of `about_s` +- `reach_s`: a fitted one after short fixed ones, since a long store compiles for minutes."""
    whole = max(0, math.floor((about_s - reach_s) / dt_s))
    count = math.ceil(whole / _STORE)
    pieces = [len(part) for part in np.array_split(np.arange(whole), count)] if count else []
    first = Candidate(
        delay.effect, WHOLE, delay.side, delay.order - 1, tuple(Delay(n * dt_s, _STORE) for n in pieces), (), ((),)
    )
    operator = Delay.at_rate(about_s - whole * dt_s + reach_s, dt_s)
    free = (replace(delay.free[0], upper=operator.samples * dt_s),)
    start = about_s + _OFF * dt_s - whole * dt_s  # at whole samples the error has a kink
    rest = replace(delay, operators=(operator,), free=free, starts=((start,),))
    return (first, rest) if pieces else (rest,)


def straight(form: Form) -> Form:
    """Form of lag and delay changed to a lag for a linear input between samples; else empty."""
    lags = [c for c in form if c.effect == "lag"]
    if not lags or len(lags) == len(form) or any(isinstance(o, RateLimit) for c in lags for o in c.operators):
        return ()
    return tuple(replace(c, operators=tuple(replace(o, hold=1) for o in c.operators)) for c in lags)  # type: ignore[type-var]


def whole_delay(form: Form) -> float:
    """Fixed delay of whole samples in a form, which its parameters leave out [s]."""
    return sum(sum(operator.values) for c in form if c.variant == WHOLE for operator in c.operators)


def _short(delay: Form) -> Form:
    return tuple(replace(c, starts=c.starts[:1]) for c in delay)


def _top_speed(scale: Scale) -> Candidate:
    """Rate limit without a lag, from the range in the longest trial up to the fastest command."""
    slowest = min(0.02 * scale.span, scale.span / scale.duration_s, 0.1 * scale.fastest)
    free = (Freedom("top_speed", slowest, scale.fastest, 0.0),)
    start = min(0.5 * scale.span, 0.5 * scale.fastest)
    return Candidate("lag", "top speed", "command", 20, (RateLimit(1.0),), free, ((start,),))


def _creeps(creep: Candidate, scale: Scale) -> tuple[Candidate, Candidate]:
    share, tau = creep.free
    slowest, middle = 3.0 * scale.duration_s, 2.0
    share = replace(share, lower=-3.0, upper=0.9)
    one = replace(creep, free=(share, tau), starts=tuple((-0.1, start) for start in (2.0, 10.0)))
    free = (
        replace(share, name="share_1"),
        replace(share, name="share_2"),
        replace(tau, name="tau_1_s", lower=_QUICKEST_S, upper=middle),
        replace(tau, name="tau_2_s", lower=middle, upper=max(slowest, 2.0 * middle)),
    )
    start = (-0.05, -0.05, 0.3, min(8.0, 0.5 * slowest))
    both = replace(creep, variant="two terms", operators=(Creep((0.0, 0.0), (1.0, 10.0)),), free=free, starts=(start,))
    return one, both


@dataclass(frozen=True)
class CoreForm:
    """Form of the hysteresis core.

    Attributes:
        label: in tables, such as `pi, 6 plays`.
        starts: chains of one structure; their values are the starting points of a fit.
        size: free parameters, those of the curve included.
        curve: static or directional curve behind the core; empty for none.
    """

    label: str
    starts: tuple[Chain, ...]
    size: int
    curve: Form = ()


def plain_of(core: CoreForm, cores: Sequence[CoreForm]) -> CoreForm:
    """Core without its curve."""
    label = core.label.removesuffix("".join(f", {c.label}" for c in core.curve))
    return next(other for other in cores if other.label == label)


_LEADS = 0.1  # share of the output's range: half the distance of the rising branch above the falling one
_FALLS = -0.3  # correlation above which dynamics of a drive may be the cause
_SLIDERS = (4, 10)


def core_forms(trials: Sequence[Trial], scale: Scale) -> tuple[CoreForm, ...]:
    """Rate-independent cores, alone and with a curve, in the order of their number of parameters.

    The first is a line, a device without hysteresis. The richest is `CurvedPlays`, or a sum of stops where the output
    leads the command or falls with it, as friction forces do. Fits start from the regression line; if it falls with a
    low correlation, from a line that rises over the ranges of both.

    Raises:
        FitError: if the angle falls with the command, except for an output other than deg.
    """
    command = np.concatenate([trial.command for trial in trials])
    angle = np.concatenate([trial.angle for trial in trials])
    slope, offset = (float(v) for v in np.polyfit(command, angle, 1))
    span, height = float(np.ptp(command)), float(np.ptp(angle))
    if slope <= 0 and (unit := trials[0].units.angle) == "deg":
        raise falls(f"(by {-slope * span / height:.2g} of its range over that of the command)", unit)
    lead = _lead(trials)
    stops = _stops(slope, offset, max(lead, 0.0), span, scale) if lead > _LEADS * height or slope <= 0 else ()
    line = CoreForm("line", (Chain(Line(slope, offset)),), 2)
    known = _forms_of(scale, "nonlinear_gain", "asymmetry", "slack", "contact")
    if slope <= 0 and float(np.corrcoef(command, angle)[0, 1]) < _FALLS:
        return line, *stops
    if slope <= 0:
        slope = height / span
        offset = float(angle.mean() - slope * command.mean())
    # Without this curve, a device without hysteresis would get plays for their curve.
    return line, _bent(line, known[_CURVES[0]]), *_plays(slope, offset, command, known), *stops


def _lead(trials: Sequence[Trial]) -> float:
    """Half the distance by which the output is higher for a rising command than for a falling one [deg]."""
    ways = [segment(trial).labels for trial in trials]
    way = np.concatenate([np.where(w == Motion.LOADING, 1.0, np.where(w == Motion.UNLOADING, -1.0, 0.0)) for w in ways])
    command = np.concatenate([trial.command for trial in trials])
    columns = np.column_stack([way, command, np.ones(way.size)])
    return float(np.linalg.lstsq(columns, np.concatenate([trial.angle for trial in trials]), rcond=None)[0][0])


def _stops(slope: float, offset: float, height: float, span: float, scale: Scale) -> tuple[CoreForm, ...]:
    made = []
    for elements in _SLIDERS:
        for speed in (0.0, span / scale.duration_s):
            least = max(height, 0.02 * scale.angle_span)
            starts = maxwell_slip_starts(elements, slope, offset, least, span, speed)
            label = f"maxwell_slip, {elements} sliders{' by speed' if speed else ''}"
            made.append(CoreForm(label, tuple(Chain(start) for start in starts), len(starts[0].values)))
    return tuple(made)


def _bent(core: CoreForm, curve: Candidate) -> CoreForm:
    label = f"{core.label}, {curve.label}"
    return replace(core, label=label, size=core.size + len(curve.free), curve=(curve,))


def _plays(slope: float, offset: float, command: Vec, known: Mapping[str, Candidate]) -> list[CoreForm]:
    span = float(np.ptp(command))

    def backlash(reach: float) -> Operator:
        half = 0.25 * reach * span
        return Backlash(slope, slope, offset / slope + half, offset / slope - half)

    def pi(plays: int, reach: float) -> PrandtlIshlinskii:
        share = slope / (plays + 1)
        return PrandtlIshlinskii(share, (share,) * plays, reach * span / plays, 0.0, offset)

    made = [CoreForm("backlash", tuple(Chain(backlash(reach)) for reach in _REACHES), 4)]
    made += [
        CoreForm(f"pi, {plays} plays", tuple(Chain(pi(plays, reach)) for reach in _REACHES), plays + 3)
        for plays in (3, 6, 10)
    ]
    plain = next(core for core in made if core.label == _BENT)

    made += [_bent(plain, known[curve]) for curve in _CURVES]
    bottom, radii = offset + slope * float(command.min()), tuple(np.geomspace(*_RADII, _PLAYS) * span)

    def curved(pieces: int, turn: int) -> CoreForm:
        slopes = (slope / (_PLAYS + 1),) * ((pieces + 1) * (_PLAYS + 1))
        core = CurvedPlays(slopes, bottom, radii, float(command.min()), float(command.max()), pieces, turn)
        many = f"{pieces} piece{'s' if pieces > 1 else ''}"
        label = f"curved_plays, {_PLAYS}{' gradual' if turn else ''} plays of {many}"
        return CoreForm(label, (Chain(core),), len(slopes) + 1)

    gradual = curved(_MANY, 1)
    return [
        *made,
        curved(1, 0),
        curved(1, 1),
        curved(_FEW, 0),
        gradual,
        _bent(gradual, known[_SLACK]),
        curved(_MANY, 0),
    ]


LONGEST_SHARE = 0.25
"""Of the shortest trial: a longer delay is not looked for, too little of the trial would show it."""

_TAUS_S = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
_NEARER = (0.7, 0.84, 1.0, 1.19, 1.4)
_FINEST, _FINER = 16, 1.15  # samples up to which every delay is tried, and the factor between longer ones


def dead_time(runs: Sequence[Run]) -> float:
    """Delay [s] of the best line behind a dead time and a lag of first order, on a coarse grid of both.

        theta = a + b G u,  G = exp(-s delay) / (tau s + 1)

    of all trials, each with its separate offset. It is only a starting point: hysteresis delays the angle, too.

    Source: first-order plus dead-time models, e.g. Astrom and Hagglund, Advanced PID Control (2006), section 2.6.
    """
    dt_s = runs[0].dt_s
    most = max(1, math.floor(LONGEST_SHARE * min(run.command.size for run in runs)))
    shifts = {round(v) for v in np.geomspace(_FINEST, most, 1 + math.ceil(max(0.0, math.log(most / _FINEST, _FINER))))}
    delays = sorted({*range(min(_FINEST, most) + 1), *shifts}) if most > _FINEST else list(range(most + 1))
    angles = [run.angle - run.angle.mean() for run in runs]
    delay_samples, tau = _best(runs, angles, delays, _TAUS_S)
    near = range(math.floor(delay_samples / _FINER), min(most, math.ceil(delay_samples * _FINER)) + 1)
    return _best(runs, angles, near, [tau * factor for factor in _NEARER])[0] * dt_s


def _best(
    runs: Sequence[Run], angles: Sequence[Vec], delays: Sequence[int], taus: Sequence[float]
) -> tuple[int, float]:
    """Delay in samples and time constant [s] of the least squared error."""
    best, chosen = math.inf, (0, 0.0)
    for tau in taus:
        kept = math.exp(-runs[0].dt_s / tau) if tau else 0.0
        late = [lagged(run.command - run.command[0], kept) for run in runs]
        for delay in delays:
            left = _left(late, angles, delay)
            if left < best:
                best, chosen = left, (delay, tau)
    return chosen


def _left(late: Sequence[Vec], angles: Sequence[Vec], delay: int) -> float:
    """Squared error of the best line through delayed commands."""
    squares = products = power = 0.0
    for command, angle in zip(late, angles, strict=True):
        moved = np.concatenate([np.zeros(delay), command[: command.size - delay]])
        moved -= moved.mean()
        squares += float(moved @ moved)
        products += float(moved @ angle)
        power += float(angle @ angle)
    return power - products**2 / squares if squares > 0 else power
