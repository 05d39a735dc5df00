"""The one list of effects; plants, simulator files and the diagnosis read it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from ..operators.dynamics import Delay, Lag
from ..operators.friction import NEVER, Asymmetry, DirectionalGain, RateDependence, StickSlip
from ..operators.measurement import PeriodicDisturbance, Sensor
from ..operators.operator import Operator
from ..operators.slow_changes import Creep, Drift, FirstFlexure, TrialShift
from ..operators.static_curves import Contact, NonlinearGain, Slack
from .effect import Effect, Free, Side

BOTH: tuple[Side, ...] = ("command", "output")
OUTPUT: tuple[Side, ...] = ("output", "command")


def _effect(
    operator: type[Operator],
    equation: str,
    apart: str,
    neutral: Mapping[str, float],
    free: tuple[Free, ...],
    sides: tuple[Side, ...] = BOTH,
    defaults: Mapping[str, float] | None = None,
    why_side: str = "",
    clocks: tuple[str, ...] = (),
) -> Effect:
    return Effect(operator.name, operator, sides, neutral, free, equation, apart, defaults or {}, why_side, clocks)


_LIST = (
    _effect(
        Lag,
        "tau y' + y = u; tau_up_s while y rises and tau_down_s while it falls, if given",
        "From delay and rate dependence: fast steps and small sines of 2 to 4 Hz. Of actuator and sensor: one class.",
        {"tau_s": 1e-6},
        (Free("tau_s", "1", 1e-3, 2.0, (0.1, 0.4)),),
    ),
    _effect(
        Delay,
        "y(t) = u(t - delay_s)",
        "From lag: a step starts late but is not rounded. The side makes no difference to a device that stands still.",
        {"delay_s": 0.0},
        (Free("delay_s", "1", 0.0, 0.5, (0.05, 0.2)),),
    ),
    _effect(
        RateDependence,
        "play of half-width width_s |u'|, which a slower motion keeps for recovery_s",
        "From lag and delay: nothing left of it in a hold, from its first sample on; ramps at three speeds.",
        {"width_s": 0.0},
        (Free("width_s", "1", 0.0, 0.5, (0.05,)),),
        defaults={"recovery_s": 0.0, "growth": 0.0, "skew": 0.0, "thinning": 0.0, "lost_over": NEVER},
    ),
    _effect(
        Creep,
        "y = u - sum_i share_i l_i, tau_i l_i' + l_i = u",
        "From lag: holds. From drift: long holds and a repeat; creep ends and starts again with each new hold.",
        {"share": 0.0},
        (Free("share", "1", -1.5, 0.6, (0.1, -0.1)), Free("tau_s", "1", 0.3, 300.0, (1.5, 8.0, 40.0))),
    ),
    _effect(
        Drift,
        "y = u + (offset_per_min + gain_per_min u) t/60 + offset_per_travel (travel of u)",
        "From creep: holds of 45 s and a repeat; it goes on whatever the command does.",
        {"offset_per_min": 0.0, "gain_per_min": 0.0, "offset_per_travel": 0.0},
        (
            Free("offset_per_min", "span/duration", -0.5, 0.5, (0.02,)),
            Free("gain_per_min", "1/duration", -0.5, 0.5, (0.0,)),
        ),
        clocks=("t", "s"),
    ),
    _effect(
        FirstFlexure,
        "y = u + set max(m - threshold, 0), m the largest u so far; late by tau_s",
        "From creep: repeat the opening motion; the set does not come again.",
        {"set": 0.0},
        (Free("set", "1", -0.6, 1.0, (0.1, -0.1)), Free("threshold", "place", 0.0, 1.0, (0.1, 0.5))),
        defaults={"tau_s": 0.0},
    ),
    _effect(
        Slack,
        "y = max(u - slack, 0), rounded over a toe, y = u below 0",
        "From a curved gain: other pretensions, and slow motion near zero.",
        {"slack": 0.0},
        (Free("slack", "span", 0.0, 0.5, (0.05, 0.15)),),
        sides=("command",),
        defaults={"toe": 0.0},
        why_side="the angle has no zero below which nothing is transmitted",
    ),
    _effect(
        StickSlip,
        "play of half-width break_away exp(-v/stribeck_speed), memory_s v' + v = its own sliding speed",
        "From lag: ramps at three speeds; it jumps at the slowest.",
        {"break_away": 0.0},
        (
            Free("break_away", "span", 0.0, 0.3, (0.03,)),
            Free("stribeck_speed", "span", 0.005, 20.0, (0.05, 0.5)),  # per second
        ),
        defaults={"memory_s": 0.1},
    ),
    _effect(
        Contact,
        "y = u - (1 - stiffness_ratio) max(u - angle, 0), stiffening over a toe",
        "From a curved gain: approach the end from several amplitudes; a corner stays where it is.",
        {"stiffness_ratio": 1.0},
        (Free("angle", "place", 0.2, 1.0, (0.6, 0.85)), Free("stiffness_ratio", "1", 0.0, 1.0, (0.4,))),
        sides=OUTPUT,
        defaults={"toe": 0.0},
    ),
    _effect(
        NonlinearGain,
        "y = u + quadratic w^2 + cubic w^3, w = u - centre",
        "Gravity and nonlinear stretch are one class until orientation or load changes; from contact: no corner.",
        {"quadratic": 0.0, "cubic": 0.0},
        (Free("quadratic", "1/span", -0.6, 0.6, (0.1, -0.1)), Free("cubic", "1/span^2", -0.6, 0.6, (0.0,))),
        defaults={"centre": 0.0},
    ),
    _effect(
        Asymmetry,
        "play between u and g(u) = u + (slope_ratio_above - 1) (u - pivot)+ + (1 - slope_ratio_below) (pivot - u)+",
        "From a wider loop: the width changes along the loop; from a curved gain: only one branch changes.",
        {"slope_ratio_above": 1.0, "slope_ratio_below": 1.0},
        (
            Free("slope_ratio_above", "1", 1.0, 2.0, (1.05,)),
            Free("slope_ratio_below", "1", 0.5, 1.0, (0.95,)),
            Free("pivot", "place", 0.0, 1.0, (0.0, 0.5, 1.0)),
        ),
    ),
    _effect(
        DirectionalGain,
        "y = u + gain d (u - pivot), d from -1 (unloading) to 1 (loading), turning over a travel of 2 turn",
        "A second form of asymmetry: slopes 1 + gain and 1 - gain that meet at the pivot; from a curved gain: d.",
        {"gain": 0.0},
        (
            Free("gain", "1", -0.6, 0.6, (0.03, -0.03)),
            Free("pivot", "place", 0.0, 1.0, (0.1, 0.6)),
            Free("turn", "span", 1e-3, 0.3, (0.03,)),
        ),
        sides=OUTPUT,
    ),
    _effect(
        TrialShift,
        "y = play of half-width width of (gain u + offset), other values in each trial",
        "From mis-set gain and offset: differs between trials. It also hides any single bad trial: rank it last.",
        {"offset": 0.0, "gain": 1.0, "width": 0.0},
        (
            Free("offset", "span", -0.5, 0.5, (0.02,)),
            Free("gain", "1", 0.5, 2.0, (1.0,)),
            Free("width", "span", 0.0, 0.3, (0.0,)),
        ),
        sides=OUTPUT,
    ),
    _effect(
        PeriodicDisturbance,
        "y = u + sum_h amplitude_h sin(2 pi h frequency_hz t + phase_h)",
        "From everything driven by the command: it goes on in holds, at its own frequency.",
        {"amplitude": 0.0},
        (
            Free("frequency_hz", "1", 0.1, 5.0, (0.25, 1.1)),
            Free("amplitude", "span", 0.0, 0.2, (0.01,)),
            Free("phase_rad", "1", -6.4, 6.4, (0.0,)),
        ),
        sides=OUTPUT,
        defaults={"phase_rad": 0.0},
        clocks=("c",),
    ),
    _effect(
        Sensor,
        "y = resolution round((u + sigma n + outlier) / resolution), or the last y in a dropout",
        "White: the upper band of the residual in holds; a grid of values; single samples far off; repeated samples.",
        {
            "resolution": 0.0,
            "sigma": 0.0,
            "outlier_probability": 0.0,
            "outlier_size": 0.0,
            "dropout_probability": 0.0,
        },
        (),  # a noise level is estimated from a residual, not fitted to it
        sides=("output",),
        why_side="a sensor measures the angle",
    ),
)

EFFECTS: Mapping[str, Effect] = MappingProxyType({effect.name: effect for effect in _LIST})
"""Effects by public name, in the order of the documentation."""
