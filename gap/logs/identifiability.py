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


CONFUSABLE = (
    ("lag", "delay", "rate_dependence"),
    ("lag", "creep"),
    ("creep", "first_flexure"),
    ("creep", "drift"),
    ("stick_slip", "lag"),
    ("slack", "nonlinear_gain"),
    ("contact", "nonlinear_gain"),
)
"""Effects that some motions cannot tell apart."""
_ALSO = (("asymmetry", "nonlinear_gain"), ("drift", "trial_shift"))  # found on development cases


def confusability(excitation: Excitation) -> tuple[Confusable, ...]:
    """The table of confusable effects, judged for these motions."""
    longest = f"longest hold {excitation.longest_hold_s:.3g} s" if excitation.longest_hold_s else "no hold"
    repeats = f"{len(excitation.repeats)} pairs of repeats" if excitation.repeats else "no repeat"
    speeds = ", ".join(f"{speed:.3g}" for speed in excitation.ramp_speeds) or "none"
    signals = "command and angle only"
    return (
        Confusable(
            ("lag", "delay", "rate_dependence"),
            excitation.has_fast,
            "fast steps and small sines of 2 to 4 Hz",
            f"{excitation.steps} fast steps, {excitation.fast_small} small moves faster than 1.5 Hz",
            1.0,
            0.99,
        ),
        Confusable(
            ("actuator lag", "sensor lag"),
            False,
            "nothing; reported as one class, lag",
            signals,
            0.99,
            1.0,
            one_class=True,
        ),
        Confusable(("lag", "creep"), excitation.has_holds, "holds of 3 s and more", longest, 0.95, 0.3),
        Confusable(
            ("creep", "first_flexure"),
            excitation.opening_repeated,
            "the opening motion repeated",
            f"the opening motion {'comes' if excitation.opening_repeated else 'does not come'} again",
            0.97,
            0.3,
        ),
        Confusable(
            ("drift", "creep"),
            excitation.has_long_hold and excitation.has_repeats,
            f"holds of {LONG_HOLD_S:g} s and more, and a repeat of a motion",
            f"{longest}, {repeats}",
            0.96,
            0.78,
        ),
        Confusable(
            ("stick_slip", "lag"),
            excitation.has_speeds,
            "ramps at three speeds",
            f"ramps at distinct speeds: {speeds}",
            0.83,
            0.54,
        ),
        Confusable(
            ("gravity", "nonlinear stretch"),
            False,
            "another orientation or load; reported as one class, nonlinear_gain",
            signals,
            0.99,
            0.98,
            one_class=True,
        ),
        Confusable(
            ("slack", "nonlinear_gain"),
            excitation.dwells_low and not excitation.sine_only,
            "another pretension; slow moves near the lowest command, three times and more",
            f"{excitation.low_s:.3g} s in {excitation.low_visits} visits to the lowest tenth of the command",
            0.63,
            0.38,
        ),
        Confusable(
            ("contact", "nonlinear_gain"),
            excitation.top_levels >= 3,
            "the end approached from three amplitudes and more",
            f"{excitation.top_levels} distinct upper turning points",
            0.71,
            0.8,
        ),
    )


def confounders(name: str) -> frozenset[str]:
    """Effects with which an effect can be confounded; its name is uncertain where the library lacks one of them."""
    return frozenset(other for names in (*CONFUSABLE, *_ALSO) if name in names for other in names if other != name)
