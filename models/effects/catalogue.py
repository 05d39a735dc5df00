"""List of effects: equations, sides, bounds, starting values, confounders, and the motions that separate them.

To add an effect: write its operator in `models/operators/`, its forms and its entry here, and, for the blind check, a
generator.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import final

import casadi as ca
import numpy as np

from hystmpc.trials.errors import ModelError, did_you_mean
from hystmpc.trials.from_outside import installed_objects

from ..operators.dynamics import Delay, Lag, RateLimit, Servo
from ..operators.friction import Asymmetry, DahlDrag, DirectionalGain, RateDependence, StickSlip
from ..operators.measurement import PeriodicDisturbance, Sensor
from ..operators.operator import Operator, shipped_operators
from ..operators.slow_changes import Creep, Drift, FirstFlexure, TrialShift
from ..operators.static_curves import Contact, NonlinearGain, Slack
from .effect import CORE, Candidate, Effect, Freedom, Scale, Side, base_name

LONGEST_DELAY_S = 1.0
_OUTPUT: tuple[Side, ...] = ("output", "command")
_INPUT: tuple[Side, ...] = ("command", "output")

# Forms: bounds and starts are sized by the data; the verdicts of the diagnosis were calibrated with these numbers.


def _lag(s: Scale) -> list[Candidate]:
    free = (Freedom("tau_s", 0.1 * s.dt_s, 5.0, 0.0),)
    two = (Freedom("tau_up_s", 0.1 * s.dt_s, 5.0, 0.0), Freedom("tau_down_s", 0.1 * s.dt_s, 5.0, 0.0))
    starts = tuple((tau,) for tau in (1.5 * s.dt_s, 0.25))
    damped = (*free, Freedom("damping", 0.4, 0.98, 0.1))
    ringing = tuple((*start, 0.75) for start in starts)
    limited = (Freedom("top_speed", 0.02 * s.span, 50 * s.span, 0.0), *damped)
    slow = tuple((2.0 * s.span, *start) for start in ringing)
    one, ways = Lag(0.1, hold=1), Lag(0.1, (0.1,), 1)
    return [
        Candidate("lag", "command", "command", 20, (one,), free, starts),
        Candidate("lag", "held commands", "command", 20, (Lag(0.1),), free, starts),
        Candidate("lag", "output", "output", 50, (one,), free, starts),
        Candidate("lag", "servo", "command", 20, (Servo(0.1, 0.7),), damped, ringing),
        Candidate("lag", "servo, output", "output", 50, (Servo(0.1, 0.7),), damped, ringing),
        Candidate("lag", "top speed", "command", 20, (RateLimit(1.0), Servo(0.1, 0.7)), limited, slow),
        Candidate("lag", "two ways", "command", 20, (ways,), two, ((0.1, 0.2), (0.3, 0.1))),
    ]


def _delay(s: Scale) -> list[Candidate]:
    free = (Freedom("delay_s", 0.0, LONGEST_DELAY_S, 0.5 * s.dt_s),)
    operator = Delay.at_rate(LONGEST_DELAY_S, s.dt_s)
    starts = ((0.6 * s.dt_s,), (3.2 * s.dt_s,))
    return [
        Candidate("delay", "command", "command", 10, (operator,), free, starts),
        Candidate("delay", "output", "output", 50, (operator,), free, starts),
    ]


def _rate_dependence(s: Scale) -> list[Candidate]:
    free, memory = (Freedom("width_s", 0.0, 0.5, 0.01),), Freedom("memory_s", 0.2 * s.dt_s, 30.0, 0.0)
    growth = Freedom("growth", -0.5 / s.span, 5.0 / s.span, 0.2 / s.span)
    skew, lean = Freedom("skew", -0.9, 0.9, 0.2), Freedom("lean", -20.0 / s.span, 20.0 / s.span, 0.5 / s.span)
    leaning = (*free, memory, growth, skew, lean)
    leans = tuple((0.02, 0.05, 0.3 / s.span, 0.0, way / s.span) for way in (-0.3, 0.3))
    level, way = Freedom("width_s", 0.0, 2.0, 0.01), Freedom("way", 1e-3 * s.span, s.span, 0.0)
    stretch, thinning = Freedom("stretch", 0.0, 5.0, 0.2), Freedom("thinning", 0.0, 50.0 / s.span, 0.5 / s.span)
    dahl = ((0.02, 0.1 * s.span, 1.0, 0.3 / s.span), (0.05, 0.3 * s.span, 1.0, 0.3 / s.span))
    plain, presliding = RateDependence(0.0), (level, way, stretch, thinning)
    return [
        Candidate("rate_dependence", "command", "command", 60, (plain,), free, ((0.01,), (0.05,))),
        Candidate("rate_dependence", "leaning", "command", 60, (plain,), leaning, leans),
        Candidate("rate_dependence", "presliding", "command", 60, (DahlDrag(0.0),), presliding, dahl),
    ]


def _creep(s: Scale) -> list[Candidate]:
    free = (Freedom("share", -1.0, 0.6, 0.05), Freedom("tau_s", 0.5, 3 * s.duration_s, 0.0))
    starts = tuple((share, tau) for tau in (2.0, 10.0) for share in (0.05, -0.1))
    one, two = Creep((0.0,), (5.0,)), Creep((0.0, 0.0), (1.0, 15.0))
    made = [Candidate("creep", side, side, 30, (one,), free, starts) for side in _INPUT]
    # Of two terms: a tendon gives way behind its drive, a wall goes on bending; each has one sign.
    slow: tuple[tuple[Side, float, tuple[float, float]], ...] = (
        ("command", 0.05, (0.0, 0.6)), ("output", -0.1, (-1.0, 0.0)),
    )  # fmt: skip
    for side, size, ends in slow:
        both = (
            *(Freedom(f"share_{i}", *ends, 0.05) for i in (1, 2)),
            *(replace(free[1], name=f"tau_{i}_s") for i in (1, 2)),
        )
        made.append(Candidate("creep", f"{side}, two terms", side, 30, (two,), both, ((size, size, 1.0, 15.0),)))
    return made


def _drift(s: Scale) -> list[Candidate]:
    per_min = 60.0 / s.total_s
    offset = Freedom("offset_per_min", -s.angle_span * per_min, s.angle_span * per_min, 0.02 * s.angle_span * per_min)
    gain = Freedom("gain_per_min", -0.95 * per_min, 3.0 * per_min, 0.02 * per_min)
    made = []
    for variant, free, starts in (
        ("offset", (offset,), ((0.0,),)),
        ("gain", (gain,), ((0.0,), (-0.4 * per_min,), (0.8 * per_min,))),
    ):
        for carries in ("clock", ""):
            kind = f"{variant}, {'over all trials' if carries else 'in each trial'}"
            made.append(Candidate("drift", kind, "output", 60, (Drift(0.0, 0.0, 0.0),), free, starts, carries))
    return made


def _first_flexure(s: Scale) -> list[Candidate]:
    free = (
        Freedom("set", -0.6, 1.5, 0.05),
        Freedom("threshold", s.low - 0.2 * s.span, s.high, 0.1 * s.span),
    )
    starts = tuple((value, s.low + at * s.span) for value in (0.05, -0.1) for at in (0.02, 0.4))
    operator = FirstFlexure(0.0, s.low)
    at_tip = Freedom("threshold", s.angle_low - 0.2 * s.angle_span, s.angle_high, 0.1 * s.angle_span)
    tip = (free[0], at_tip, Freedom("tau_s", 0.5 * s.dt_s, s.duration_s, 0.0))
    begin = tuple((0.2, s.angle_low + at * s.angle_span, tau) for at, tau in ((0.05, 0.2), (0.4, 0.2), (0.2, 2.0)))
    return [
        Candidate("first_flexure", "once", "command", 40, (operator,), free, starts, "bend"),
        Candidate("first_flexure", "every trial", "command", 40, (operator,), free, starts),
        Candidate("first_flexure", "late, of the tip", "output", 35, (FirstFlexure(0.0, s.angle_low),), tip, begin),
    ]


def _slack(s: Scale) -> list[Candidate]:
    free = (Freedom("slack", 0.0, 0.6 * s.span + max(s.low, 0.0), 0.05 * s.span),)
    starts = tuple((max(s.low, 0.0) + share * s.span,) for share in (0.03, 0.15))
    toe = Freedom("toe", 1e-3 * s.span, 0.4 * s.span, 0.0)
    rounded = tuple((*start, 0.05 * s.span) for start in starts)
    return [
        Candidate("slack", "sharp", "command", 50, (Slack(0.0),), free, starts),
        Candidate("slack", "rounded", "command", 50, (Slack(0.0),), (*free, toe), rounded),
    ]


def _stick_slip(s: Scale) -> list[Candidate]:
    return [_stick_slip_on("command", 70, s.span), _stick_slip_on("output", 5, s.angle_span)]


def _stick_slip_on(side: Side, order: int, span: float) -> Candidate:
    free = (Freedom("break_away", 0.0, 0.5 * span, 0.02 * span), Freedom("stribeck_speed", 1e-2 * span, 20 * span, 0.0))
    starts = tuple((0.03 * span, speed * span) for speed in (0.1, 1.0))
    return Candidate("stick_slip", side, side, order, (StickSlip(0.0, 1.0),), free, starts)


def _contact(s: Scale) -> list[Candidate]:
    free = (
        Freedom("angle", s.angle_low, s.angle_high, 0.1 * s.angle_span),
        Freedom("stiffness_ratio", 0.0, 1.0, 0.1),
    )
    toe = Freedom("toe", 1e-3 * s.angle_span, 0.25 * s.angle_span, 0.0)
    starts = tuple((s.angle_low + at * s.angle_span, 0.8) for at in (0.4, 0.65, 0.85))
    soft = tuple((s.angle_low + at * s.angle_span, 0.6, 0.1 * s.angle_span) for at in (0.4, 0.65))
    return [
        Candidate("contact", "output", "output", 10, (Contact(0.0, 1.0),), free, starts),
        Candidate("contact", "soft", "output", 10, (Contact(0.0, 1.0),), (*free, toe), soft),
    ]


def _nonlinear_gain(s: Scale) -> list[Candidate]:
    made = []
    for side, low, span in (("output", s.angle_low, s.angle_span), ("command", s.low, s.span)):
        free = (
            Freedom("quadratic", -0.8 / span, 0.8 / span, 0.05 / span),
            Freedom("cubic", -1.2 / span**2, 1.2 / span**2, 0.1 / span**2),
        )
        operator = NonlinearGain(0.0, 0.0, low + 0.5 * span)
        made.append(Candidate("nonlinear_gain", side, side, 20, (operator,), free, ((0.0, 0.0),)))  # type: ignore[arg-type]
    return made


def _asymmetry(s: Scale) -> list[Candidate]:
    above = Freedom("slope_ratio_above", 1.0, 3.0, 0.05)
    below = Freedom("slope_ratio_below", 0.2, 1.0, 0.05)
    pivot = Freedom("pivot", s.angle_low, s.angle_high, 0.1 * s.angle_span)
    starts = tuple((1.05, 0.95, s.angle_low + at * s.angle_span) for at in (0.1, 0.5, 0.9))
    free = (above, below, pivot)
    gain, turn = Freedom("gain", -0.6, 0.6, 0.05), Freedom("turn", 1e-3 * s.angle_span, 0.3 * s.angle_span, 0.0)
    begin = [(g, s.angle_low + at * s.angle_span, 0.03 * s.angle_span) for g in (0.03, -0.03) for at in (0.1, 0.6)]
    operator = DirectionalGain(0.0, 0.0, 1.0)
    return [
        Candidate("asymmetry", "output", "output", 40, (Asymmetry(1.0, 1.0, 0.0),), free, starts),
        Candidate("asymmetry", "directional", "output", 40, (operator,), (gain, pivot, turn), tuple(begin)),
    ]


_LIST = (
    Effect(
        operator=Lag,
        equation="tau y' + y = u; tau_up_s while y rises and tau_down_s while it falls, if given",
        apart="From delay and rate dependence: fast steps and small sines of 2 to 4 Hz. "
        "Of actuator and sensor: one class.",
        neutral={"tau_s": 1e-6},
        forms=_lag,
        other_forms=(Servo, RateLimit),
        confounders=("delay", "rate_dependence", "creep", "stick_slip"),
        separated_by=("fast",),
        shown=({"tau_s": 0.25},),
    ),
    Effect(
        operator=Delay,
        equation="y(t) = u(t - delay_s)",
        apart="From lag: a step starts late but is not rounded. "
        "The side makes no difference to a device that stands still.",
        neutral={"delay_s": 0.0},
        forms=_delay,
        confounders=("lag", "rate_dependence"),
        separated_by=("fast",),
        shown=({"delay_s": 0.2},),
    ),
    Effect(
        operator=RateDependence,
        equation="play of half-width width_s v, memory_s v' + v = |u'|",
        apart="From lag and delay: nothing left of it in a hold, from its first sample on; ramps at three speeds.",
        neutral={"width_s": 0.0},
        defaults={"memory_s": 0.0, "growth": 0.0, "skew": 0.0, "lean": 0.0},
        forms=_rate_dependence,
        other_forms=(DahlDrag,),
        confounders=("lag", "delay"),
        separated_by=("fast", "speeds"),
        shown=({"width_s": 0.1},),
    ),
    Effect(
        operator=DahlDrag,
        equation="y = u - f, df/dx = (r - f) / (way + stretch r), x the travel, r from width_s |u'|",
        apart="A second form of rate dependence, of a friction with presliding: what it holds back stays in a hold.",
        neutral={"width_s": 0.0},
        defaults={"stretch": 1.0, "thinning": 0.0},
        shown=({"width_s": 0.1, "way": 0.5},),
    ),
    Effect(
        operator=Creep,
        equation="y = u - sum_i share_i l_i, tau_i l_i' + l_i = u",
        apart="From lag: holds. From drift: long holds and a repeat; creep ends and starts again with each new hold.",
        neutral={"share": 0.0},
        forms=_creep,
        confounders=("lag", "first_flexure", "drift"),
        separated_by=("holds",),
        shown=({"share": 0.15, "tau_s": 2.5},),
    ),
    Effect(
        operator=Drift,
        equation="y = u + (offset_per_min + gain_per_min u) t/60 + offset_per_travel (travel of u)",
        apart="From creep: holds of 45 s and a repeat; it goes on whatever the command does.",
        neutral={"offset_per_min": 0.0, "gain_per_min": 0.0, "offset_per_travel": 0.0},
        clocks=("t", "s"),
        forms=_drift,
        confounders=("creep",),
        also_taken_for=("trial_shift",),
        separated_by=("long_holds", "repeat"),
        shown=({"offset_per_min": 0.0, "gain_per_min": -0.6},),
    ),
    Effect(
        operator=FirstFlexure,
        equation="y = u + set max(m - threshold, 0), m the largest u so far; late by tau_s",
        apart="From creep: repeat the opening motion; the set does not come again.",
        neutral={"set": 0.0},
        defaults={"tau_s": 0.0},
        forms=_first_flexure,
        confounders=("creep",),
        separated_by=("repeat",),
        shown=({"set": 0.25, "threshold": 1.0},),
    ),
    Effect(
        operator=Slack,
        equation="y = max(u - slack, 0), rounded over a toe, y = u below 0",
        apart="From a curved gain: other pretensions, and slow motion near zero.",
        neutral={"slack": 0.0},
        sides=("command",),
        why_side="the angle has no zero below which nothing is transmitted",
        defaults={"toe": 0.0},
        forms=_slack,
        confounders=("nonlinear_gain",),
        shown=({"slack": 1.0},),
    ),
    Effect(
        operator=StickSlip,
        equation="play of half-width break_away exp(-v/stribeck_speed), memory_s v' + v = its own sliding speed",
        apart="From lag: ramps at three speeds; it jumps at the slowest.",
        neutral={"break_away": 0.0},
        defaults={"memory_s": 0.1},
        forms=_stick_slip,
        confounders=("lag",),
        separated_by=("speeds",),
        shown=({"break_away": 0.5, "stribeck_speed": 6.0, "memory_s": 0.03},),
    ),
    Effect(
        operator=Contact,
        equation="y = u - (1 - stiffness_ratio) max(u - angle, 0), stiffening over a toe",
        apart="From a curved gain: approach the end from several amplitudes; a corner stays where it is.",
        neutral={"stiffness_ratio": 1.0},
        sides=_OUTPUT,
        defaults={"toe": 0.0},
        forms=_contact,
        confounders=("nonlinear_gain",),
        separated_by=("amplitudes",),
        shown=({"angle": 60.0, "stiffness_ratio": 0.2},),
    ),
    Effect(
        operator=NonlinearGain,
        equation="y = u + quadratic w^2 + cubic w^3, w = u - centre",
        apart="Gravity and nonlinear stretch are one class until orientation or load changes; from contact: no corner.",
        neutral={"quadratic": 0.0, "cubic": 0.0},
        defaults={"centre": 0.0},
        forms=_nonlinear_gain,
        confounders=("slack", "contact"),
        also_taken_for=("asymmetry",),
        generic=True,
        shown=({"quadratic": 0.06, "cubic": 0.0},),
    ),
    Effect(
        operator=Asymmetry,
        equation="play between u and g(u) = u + (slope_ratio_above - 1) (u - pivot)+ "
        "+ (1 - slope_ratio_below) (pivot - u)+",
        apart="From a wider loop: the width changes along the loop; from a curved gain: only one branch changes.",
        neutral={"slope_ratio_above": 1.0, "slope_ratio_below": 1.0},
        forms=_asymmetry,
        other_forms=(DirectionalGain,),
        also_taken_for=("nonlinear_gain",),
        generic=True,
        shown=({"slope_ratio_above": 1.3, "slope_ratio_below": 1.0, "pivot": 1.0},),
    ),
    Effect(
        operator=DirectionalGain,
        equation="y = u + gain d (u - pivot), d from -1 (unloading) to 1 (loading), turning over a travel of 2 turn",
        apart="A second form of asymmetry: slopes 1 + gain and 1 - gain that meet at the pivot; from a curved gain: d.",
        neutral={"gain": 0.0},
        sides=_OUTPUT,
        shown=({"gain": -0.12, "pivot": 30.0, "turn": 3.0},),
    ),
    Effect(
        operator=TrialShift,
        equation="y = play of half-width width of (gain u + offset), other values in each trial",
        apart="From mis-set gain and offset: differs between trials. It also hides any single bad trial: rank it last.",
        neutral={"offset": 0.0, "gain": 1.0, "width": 0.0},
        sides=_OUTPUT,
        also_taken_for=("drift",),
        separated_by=("repeat",),
        generic=True,
        shown=({"offset": 4.0, "gain": 0.92}, {"offset": -5.0, "gain": 1.0, "width": 2.0}),
    ),
    Effect(
        operator=PeriodicDisturbance,
        equation="y = u + sum_h amplitude_h sin(2 pi h frequency_hz t + phase_h)",
        apart="From everything driven by the command: it goes on in holds, at its own frequency.",
        neutral={"amplitude": 0.0},
        sides=_OUTPUT,
        defaults={"phase_rad": 0.0},
        clocks=("c",),
        shown=({"frequency_hz": 1.2, "amplitude": 2.0},),
    ),
    Effect(
        operator=Sensor,
        equation="y = resolution round((u + sigma n + outlier) / resolution), or the last y in a dropout",
        apart="White: the upper band of the residual in holds; a grid of values; single samples far off; "
        "repeated samples.",
        neutral={
            "resolution": 0.0,
            "sigma": 0.0,
            "outlier_probability": 0.0,
            "outlier_size": 0.0,
            "dropout_probability": 0.0,
        },
        sides=("output",),
        why_side="a sensor measures the angle",
        shown=(
            {
                "resolution": 1.0,
                "sigma": 0.5,
                "outlier_probability": 0.01,
                "outlier_size": 8,
                "dropout_probability": 0.05,
            },
        ),
    ),
)

GROUP = "hystmpc.effects"
"""Entry points by which an installed package adds effects; the value is MODULE:NAME of an `Effect`."""

_PLAIN = Scale(low=0.0, high=6.0, angle_low=20.0, angle_high=90.0, duration_s=60.0, total_s=240.0, dt_s=0.04)
_INPUTS = (1.0, 1.0, 2.5, 4.0, 3.0, 3.0, 0.5, 1.5)
_SAME = 1e-6  # share of the input: a lag of 1 us counts as none

_added: dict[str, Effect] = {}


def added_effects() -> Mapping[str, Effect]:
    """Effects by name from installed packages or `add_effect`; a later one replaces an earlier one.

    Raises:
        ConfigError: if an entry point cannot be imported, or names no effect.
        ModelError: if a diagnosis cannot use an effect.
    """
    return {**_installed(), **_added}


def added_operators() -> Mapping[str, type[Operator]]:
    """Operators of the added effects, by name."""
    return {kind.name: kind for effect in added_effects().values() for kind in (effect.operator, *effect.other_forms)}


def add_effect(effect: Effect) -> Effect:
    """Add a user's effect to the library in this process, for files, simulated devices and `diagnose`.

    Raises:
        ModelError: if the name is one of the library's, or neutral values or forms contradict the operator.
    """
    _added[effect.name] = checked(effect)
    return effect


def checked(effect: Effect) -> Effect:
    """Return the effect after checking that a diagnosis can use it.

    Raises:
        ModelError: if its name is taken, or neutral values or forms contradict its operator.
    """
    if effect.name in shipped_operators():
        raise ModelError(f"effect {effect.name}: an operator of the library has this name, expected another name")
    template = effect.operator.template(**dict.fromkeys(effect.operator.shape, 1))
    names = [parameter.name for parameter in template.parameters]
    for name in effect.neutral:
        if name not in map(base_name, names):
            raise ModelError(f"effect {effect.name}: neutral names {name!r}, {did_you_mean(name, names)}")
    _check_identity(effect, template.with_values(effect.neutral_values(template)))
    for form in effect.forms(_PLAIN):
        _check_form(effect, form)
    return effect


def _check_identity(effect: Effect, neutral: Operator) -> None:
    p, dt = ca.DM(list(neutral.values)), ca.DM(_PLAIN.dt_s)
    x = neutral.at_rest(ca.DM(_INPUTS[0]), ca.DM(_INPUTS[0]), p)
    for u in _INPUTS:
        x, y = neutral.equation(x, ca.DM(u), p, dt)
        if not abs(float(y) - u) <= _SAME * abs(u):
            raise ModelError(
                f"effect {effect.name}: with its neutral values it makes {float(y):.6g} of {u:g}, expected the same"
            )


def _check_form(effect: Effect, form: Candidate) -> None:
    free = [freedom.name for freedom in form.free]
    known = [parameter.name for operator in form.operators for parameter in operator.parameters]
    where = f"effect {effect.name}, form {form.variant!r}"
    if form.effect != effect.name:
        raise ModelError(f"{where}: its effect is {form.effect!r}, expected {effect.name!r}")
    for name in free:
        if name not in known:
            raise ModelError(f"{where}: free names {name!r}, {did_you_mean(name, known)}")
    if not any(name in effect.neutral for name in free):
        raise ModelError(f"{where}: free are {', '.join(free) or 'none'}, expected one of {', '.join(effect.neutral)}")
    if not form.starts or not all(len(start) == len(free) and np.all(np.isfinite(start)) for start in form.starts):
        raise ModelError(f"{where}: starts are {form.starts}, expected one or more of {len(free)} numbers each")


@cache
def _installed() -> Mapping[str, Effect]:
    effects = installed_objects(GROUP, "effect", Effect, shipped_operators())
    return {name: checked(effect) for name, effect in effects.items()}


_SHIPPED = {effect.name: effect for effect in _LIST}


@final
class _Library(Mapping[str, Effect]):
    """Effects of the list, followed by those of users."""

    def __getitem__(self, name: str) -> Effect:
        return _SHIPPED[name] if name in _SHIPPED else added_effects()[name]

    def __iter__(self) -> Iterator[str]:
        yield from dict.fromkeys((*_SHIPPED, *added_effects()))

    def __len__(self) -> int:
        return sum(1 for _ in self)


EFFECTS: Mapping[str, Effect] = _Library()
"""Effects by public name, in the order of the documentation."""


def _form_of() -> Mapping[str, str]:
    return {operator.name: effect.name for effect in EFFECTS.values() for operator in effect.other_forms}


def diagnosable() -> tuple[str, ...]:
    """Names of effects that a diagnosis can report; the others are forms of these."""
    forms = _form_of()
    return tuple(name for name in EFFECTS if name not in forms)


def candidates(scale: Scale, in_core: Iterable[str], without: Sequence[str] = ()) -> tuple[Candidate, ...]:
    """Candidate operators of all effects that change the angle, with bounds and start values for these data.

    Args:
        in_core: effects for which the core of the nominal simulator has a parameter.
    """
    made = [c for name, effect in EFFECTS.items() if name not in without for c in effect.forms(scale)]
    made += [Candidate(name, CORE, "output", 0, (), (), ((),)) for name in in_core if name not in without]
    return tuple(made)


def effect_of(operator: str) -> str:
    """Effect that an operator name represents; empty for none."""
    return _form_of().get(operator, operator if operator in EFFECTS else "")


def confusable(a: str, b: str) -> bool:
    """Whether two effects are equal, or some motions cannot distinguish them."""
    return a == b or (a in EFFECTS and b in EFFECTS[a].confounders)


def confounders(name: str) -> frozenset[str]:
    """Effects that are easily mistaken for this effect and must be in the library for a reliable diagnosis."""
    effect = EFFECTS.get(name)
    return frozenset((*effect.confounders, *effect.also_taken_for)) if effect else frozenset()
