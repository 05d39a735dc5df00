"""Identifiability: the effects that a set of motions can tell apart, judged from the commands alone."""

from __future__ import annotations

from dataclasses import dataclass

from .excitation import LONG_HOLD_S, Excitation


@dataclass(frozen=True)
class Confusable:
    """Effects with similar responses to some motions.

    Attributes:
        effects: their public names; two names of one class where `one_class`.
        separable: whether these motions can tell them apart.
        separated_by: the motion that can.
        found: the part of it that these motions have.
        alike_in_sine, alike_in_hold: share of one effect's gap that the other reproduces on a single 0.2 Hz sine, and
            on a ramp with a hold of 8 s (study on a Prandtl-Ishlinskii model with three plays, 50 Hz).
        one_class: equal in command and angle for every motion, by algebra.
    """

    effects: tuple[str, ...]
    separable: bool
    separated_by: str
    found: str
    alike_in_sine: float
    alike_in_hold: float
    one_class: bool = False


_PAIRS: tuple[tuple[tuple[str, ...], str, float, float], ...] = (
    (("lag", "delay", "rate_dependence"), "fast steps and small sines of 2 to 4 Hz", 1.0, 0.99),
    (("actuator lag", "sensor lag"), "nothing; reported as one class, lag", 0.99, 1.0),
    (("lag", "creep"), "holds of 3 s and more", 0.95, 0.3),
    (("creep", "first_flexure"), "the opening motion repeated", 0.97, 0.3),
    (("drift", "creep"), f"holds of {LONG_HOLD_S:g} s and more, and a repeat of a motion", 0.96, 0.78),
    (("stick_slip", "lag"), "ramps at three speeds", 0.83, 0.54),
    (
        ("gravity", "nonlinear stretch"),
        "another orientation or load; reported as one class, nonlinear_gain",
        0.99,
        0.98,
    ),
    (
        ("slack", "nonlinear_gain"),
        "another pretension; slow moves near the lowest command, three times and more",
        0.63,
        0.38,
    ),
    (("contact", "nonlinear_gain"), "the end approached from three amplitudes and more", 0.71, 0.8),
)
"""Effects, the motion that separates them, and the shares `alike_in_sine` and `alike_in_hold` of `Confusable`."""


def confusability(excitation: Excitation) -> tuple[Confusable, ...]:
    """The table of confusable effects, judged for these motions."""
    e, longest = excitation, excitation.longest_hold_s
    hold = f"longest hold {longest:.3g} s" if longest else "no hold"
    repeats = f"{len(e.repeats)} pairs of repeats" if e.repeats else "no repeat"
    speeds = ", ".join(f"{speed:.3g}" for speed in e.ramp_speeds) or "none"
    opening = "comes" if e.opening_repeated else "does not come"
    low = f"{e.low_s:.3g} s in {e.low_visits} visits to the lowest tenth of the command"
    signals = "command and angle only"
    found: tuple[tuple[bool | None, str], ...] = (  # in the order of `_PAIRS`; None: one class whatever the motion
        (e.has_fast, f"{e.steps} fast steps, {e.fast_small} small moves faster than 1.5 Hz"),
        (None, signals),
        (e.has_holds, hold),
        (e.opening_repeated, f"the opening motion {opening} again"),
        (e.has_long_hold and e.has_repeats, f"{hold}, {repeats}"),
        (e.has_speeds, f"ramps at distinct speeds: {speeds}"),
        (None, signals),
        (e.dwells_low and not e.sine_only, low),
        (e.top_levels >= 3, f"{e.top_levels} distinct upper turning points"),
    )
    return tuple(
        Confusable(effects, bool(separable), motion, text, in_sine, in_hold, one_class=separable is None)
        for (effects, motion, in_sine, in_hold), (separable, text) in zip(_PAIRS, found, strict=True)
    )
