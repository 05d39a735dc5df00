"""Candidate causes: each effect of the catalogue in the forms that an identification may add to a model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..operators.asymmetry import Asymmetry
from ..operators.contact import Contact
from ..operators.creep import Creep
from ..operators.delay import Delay
from ..operators.directional_gain import DirectionalGain
from ..operators.drift import Drift
from ..operators.first_flexure import FirstFlexure
from ..operators.lag import Lag
from ..operators.nonlinear_gain import NonlinearGain
from ..operators.operator import Operator
from ..operators.rate_dependence import RateDependence
from ..operators.rate_limit import RateLimit
from ..operators.servo import Servo
from ..operators.slack import Slack
from ..operators.stick_slip import StickSlip
from .runs import Run

Side = Literal["command", "output"]
CORE = "core"  # variant of an effect that is a freedom of the core and no operator of its own


@dataclass(frozen=True)
class Freedom:
    """One parameter that a fit may move.

    Attributes:
        name: of the parameter.
        lower, upper: bounds, physical signs included.
        scale: a typical change; 0 for a positive parameter that is searched on a logarithmic scale.
    """

    name: str
    lower: float
    upper: float
    scale: float


@dataclass(frozen=True)
class Candidate:
    """One effect at one place.

    Attributes:
        effect: its public name.
        variant: tells apart several forms of one effect.
        side: of the command, before everything that is there, or of the output, behind it.
        order: place among the candidates of a side; small ones come first in the order of the signal.
        operators: in the order of the signal; `starts` overwrite their free parameters. None at all for a freedom of
            the core itself.
        free: parameters that are identified; operators that share one have it in common.
        starts: values of the free parameters from which a fit begins; never exactly neutral, where a shape parameter
            would have no gradient.
        carries: what the state takes over from earlier trials: `bend` for a running maximum, `clock`, or nothing.
    """

    effect: str
    variant: str
    side: Side
    order: int
    operators: tuple[Operator, ...]
    free: tuple[Freedom, ...]
    starts: tuple[tuple[float, ...], ...]
    carries: Literal["", "bend", "clock"] = ""

    @property
    def label(self) -> str:
        """Effect and variant."""
        return f"{self.effect}/{self.variant}"


@dataclass(frozen=True)
class Scale:
    """What sizes of effects are measured in.

    Attributes:
        low, high: range of the command [cmd].
        angle_low, angle_high: range of the angle [deg].
        duration_s: of the longest trial [s].
        total_s: of all trials together [s].
        dt_s: sample time [s].
    """

    low: float
    high: float
    angle_low: float
    angle_high: float
    duration_s: float
    total_s: float
    dt_s: float

    @property
    def span(self) -> float:
        """Range of the command [cmd]."""
        return self.high - self.low

    @property
    def angle_span(self) -> float:
        """Range of the angle [deg]."""
        return self.angle_high - self.angle_low

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Scale:
        """Read off trials; angles by their 1 and 99 % quantiles, so that an outlier does not count."""
        command = np.concatenate([run.command for run in runs])
        angle = np.quantile(np.concatenate([run.angle for run in runs]), (0.01, 0.99))
        durations = [run.command.size * run.dt_s for run in runs]
        return cls(
            float(command.min()),
            float(command.max()),
            float(angle[0]),
            float(angle[1]),
            max(durations),
            sum(durations),
            runs[0].dt_s,
        )


LONGEST_DELAY_S = 0.4


def candidates(scale: Scale, in_core: Iterable[str], without: Sequence[str] = ()) -> tuple[Candidate, ...]:
    """Every effect of the library that changes the simulated angle, sized by the data.

    Args:
        scale: of the trials.
        in_core: effects that the core of the nominal simulator has a parameter for.
        without: effects that are left out.
    """
    made = [c for name, build in _BUILDERS.items() if name not in without for c in build(scale)]
    made += [Candidate(name, CORE, "output", 0, (), (), ((),)) for name in in_core if name not in without]
    return tuple(made)


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
        Candidate("lag", "output", "output", 50, (one,), free, starts),
        Candidate("lag", "two poles", "command", 20, (one, one), free, starts),
        Candidate("lag", "servo", "command", 20, (Servo(0.1, 0.7),), damped, ringing),
        Candidate("lag", "top speed", "command", 20, (RateLimit(1.0), Servo(0.1, 0.7)), limited, slow),
        Candidate("lag", "two ways", "command", 20, (ways,), two, ((0.1, 0.2), (0.3, 0.1))),
    ]


def _delay(s: Scale) -> list[Candidate]:
    free = (Freedom("delay_s", 0.0, LONGEST_DELAY_S, 0.5 * s.dt_s),)
    operator = Delay.at_rate(LONGEST_DELAY_S, s.dt_s)
    return [Candidate("delay", "command", "command", 10, (operator,), free, ((0.6 * s.dt_s,), (3.2 * s.dt_s,)))]


def _rate_dependence(s: Scale) -> list[Candidate]:
    free, kept = (Freedom("width_s", 0.0, 0.5, 0.01),), Freedom("recovery_s", 0.5 * s.dt_s, 30.0, 0.0)
    growth = Freedom("growth", -0.5 / s.span, 5.0 / s.span, 0.2 / s.span)
    skew = Freedom("skew", -0.9, 0.9, 0.2)
    thinning = Freedom("thinning", 0.0, 20.0 / s.span, 0.5 / s.span)
    over = Freedom("lost_over", 1e-3 * s.span, s.span, 0.0)
    starts = ((0.01,), (0.05,))
    skewed = ((0.02, 0.08, 0.0, -0.3, 0.5 / s.span), (0.02, 0.08, 2.0 / s.span, -0.5, 0.5 / s.span))
    dahl = ((0.02, 0.1 * s.span, 0.0, 0.3 / s.span), (0.05, 0.3 * s.span, 0.0, 0.3 / s.span))
    plain, lasting = RateDependence(0.0), RateDependence(0.0, recovery_s=1e4)
    return [
        Candidate("rate_dependence", "command", "command", 60, (plain,), free, starts),
        Candidate("rate_dependence", "skewed", "command", 60, (plain,), (*free, kept, growth, skew, thinning), skewed),
        Candidate("rate_dependence", "presliding", "command", 60, (lasting,), (*free, over, growth, thinning), dahl),
    ]


def _creep(s: Scale) -> list[Candidate]:
    free = (Freedom("share", -1.0, 0.6, 0.05), Freedom("tau_s", 0.5, 3 * s.duration_s, 0.0))
    starts = tuple((share, tau) for tau in (2.0, 10.0) for share in (0.05, -0.1))
    return [
        Candidate("creep", "command", "command", 30, (Creep((0.0,), (5.0,)),), free, starts),
        Candidate("creep", "output", "output", 30, (Creep((0.0,), (5.0,)),), free, starts),
    ]


def _drift(s: Scale) -> list[Candidate]:
    per_min = 60.0 / s.total_s
    offset = Freedom("offset_per_min", -s.angle_span * per_min, s.angle_span * per_min, 0.02 * s.angle_span * per_min)
    gain = Freedom("gain_per_min", -0.5 * per_min, 0.5 * per_min, 0.02 * per_min)
    made = []
    for variant, free, starts in (("offset", (offset,), ((0.0,),)), ("gain", (gain,), ((0.0,),))):
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


_BUILDERS: Mapping[str, Callable[[Scale], list[Candidate]]] = {
    "lag": _lag,
    "delay": _delay,
    "rate_dependence": _rate_dependence,
    "creep": _creep,
    "drift": _drift,
    "first_flexure": _first_flexure,
    "slack": _slack,
    "stick_slip": _stick_slip,
    "contact": _contact,
    "nonlinear_gain": _nonlinear_gain,
    "asymmetry": _asymmetry,
}
